"""Making a config for `generate` from a rig's calibration and photographs."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path

from semisynth_gl.calibration.disparity_range import disparity_range
from semisynth_gl.calibration.draft import Draft, describe
from semisynth_gl.calibration.kinds import Size
from semisynth_gl.calibration.photographs import check_sizes, photograph_sizes
from semisynth_gl.calibration.raw_photographs import lens_chains, rectify_photographs
from semisynth_gl.calibration.rig import Rig, plain_rig
from semisynth_gl.calibration.rig_files import read_rigs
from semisynth_gl.calibration.write import make_config, write
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.config import Config
from semisynth_gl.config.load import Overrides
from semisynth_gl.frame.camera import Eye
from semisynth_gl.inputs.arguments import LEAST, to_real, to_whole
from semisynth_gl.inputs.errors import BackendError, InputError, counted, shown
from semisynth_gl.inputs.user_files import Files, names_of
from semisynth_gl.judge.measured_view import working_width
from semisynth_gl.judge.place import map_files, measure_place
from semisynth_gl.lens.chain import LensChain
from semisynth_gl.listener import Listener
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.image_files import find_images
from semisynth_gl.textures.prepare import prepare_atlas


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A config for a rig, and lines about its making.

    Attributes:
        config: the config.
        text: the config as YAML, with comments on the origin of its numbers.
        summary: lines about the config, as ``semisynth-gl calibrate`` prints them.
        notes: sentences on what was concluded or left out.
    """

    config: Config
    text: str
    summary: Sequence[str]
    notes: Sequence[str]


def calibrate(
    images: Files,
    *,
    calib: Files = (),
    focal_px: float | None = None,
    baseline_m: float | None = None,
    size: tuple[int, int] | None = None,
    scale: float | None = None,
    unit: str | None = None,
    calib_keys: Mapping[str, str] | None = None,
    cameras: tuple[str, str] | None = None,
    alpha: float | None = None,
    disparity: Files = (),
    png_scale: float = KITTI_DISPARITY.steps,
    rectify_to: str | PathLike[str] | None = None,
    range_px: tuple[float, float] | None = None,
    range_m: tuple[float, float] | None = None,
    other_camera: bool = False,
    trials: int = 6,
    overrides: Overrides = (),
    name: str = "calibrated",
    listener: Listener | None = None,
) -> Calibration:
    """Make a config for a rig: its camera, the disparities that it sees, and the photographs to cut patches from.

    Args:
        images: the photographs: files, folders and globs.
        calib: calibration files of any tool that writes YAML, JSON, XML, .npz, .npy or text. Where they state the
            cameras before rectification, the config gets the section lens, for which OpenCV is needed.
        focal_px: focal length; with ``baseline_m`` and ``size``, instead of ``calib``.
        baseline_m: distance between the cameras.
        size: width and height of the images, px; by default what the calibration states, else the photographs' size.
        scale: size of the images relative to the calibrated size, such as 0.5 for half the width.
        unit: unit of the translation, ``"mm"``, ``"cm"`` or ``"m"``; by default the likeliest.
        calib_keys: names of values in the files by K1, D1, R1, P1, K2, D2, R2, P2, R, T, Q and size, where their names
            do not tell.
        cameras: names or numbers of the left and the right camera, of a calibration with more than two.
        alpha: how to rectify a calibration that does not say it, as OpenCV's stereoRectify takes it: from 0, for images
            without borders, to 1, for as much of the raw images as they can show; by default OpenCV's default, with a
            view of at most 100 degrees for a fisheye.
        disparity: disparity maps, true or predicted, from which the wanted histogram is measured.
        png_scale: levels per pixel of disparity in 16-bit PNG maps.
        rectify_to: folder for rectified photographs, where ``images`` are photographs as the cameras take them; the
            config then cuts patches from these.
        range_px: least and largest disparity, instead of ``disparity``.
        range_m: least and largest distance, instead of ``range_px``.
        other_camera: whether another camera took the photographs, so that they may have any size.
        trials: number of pairs to render and measure for each recipe at each of two texture scales; with 0, no pair is
            rendered, recipes have equal weights, and textures are as in the packaged configs.
        overrides: keys to set in the config, as `load_config` takes them; the trial pairs have them, too.
        name: the config's name; characters other than letters, digits and hyphens become hyphens.
        listener: hears the number of pairs to render, and each finished pair.

    Raises:
        InputError: where an argument is not valid, or arguments do not fit together.
        ReadError: where a file cannot be read.
        BackendError: where OpenGL is missing, and ``trials`` is above 0.
    """
    sources, trials = names_of(images), to_whole("trials", trials, least=0)
    scale = None if scale is None else to_real("scale", scale, least=LEAST)
    png_scale = to_real("png_scale", png_scale, least=LEAST)
    range_px, range_m = _two_numbers("range_px", range_px), _two_numbers("range_m", range_m)
    ranges = {"range_px": range_px, "range_m": range_m, "disparity": disparity or None}
    given = [argument for argument, value in ranges.items() if value is not None]
    if len(given) > 1:
        raise InputError(f"{given[0]} also states the disparities: give only one of them", argument=given[1])
    if other_camera and rectify_to is not None:
        raise InputError("needs photographs of the rig, but other_camera is set", argument="rectify_to")
    files, stated = names_of(calib), _size(size)
    photographed = [] if other_camera else photograph_sizes(find_images(sources))
    alpha = None if alpha is None else to_real("alpha", alpha, 0, 1)
    if files:
        stated_twice = "the calibration states the same: give one or the other"
        _refuse({"focal_px": focal_px, "baseline_m": baseline_m}, stated_twice)
        rigs = read_rigs(
            files,
            size=stated,
            photographed=_calibrated(photographed, scale),
            unit=unit,
            alpha=alpha,
            cameras=cameras,
            keys=calib_keys,
        )
    else:
        of_files = {"calib_keys": calib_keys, "cameras": cameras, "unit": unit, "alpha": alpha}
        _refuse(of_files, "is about a calibration's files: give one, or leave this out")
        rigs = [_plain_rig(focal_px, baseline_m, stated)]
    notes = list(dict.fromkeys(note for rig in rigs for note in rig.notes))
    calibrated = [rig.size for rig in rigs]
    rigs = rigs if scale is None else [rig.scaled(scale) for rig in rigs]
    maps = map_files(names_of(disparity))
    if rectify_to is not None:
        notes += rectify_photographs(sources, _raw_rig(rigs), Path(rectify_to))
        sources = [fspath(rectify_to)]
        photographed = photograph_sizes(find_images(sources))
    check_sizes(photographed, calibrated, scale)
    disparities = disparity_range(rigs, maps, png_scale=png_scale, range_px=range_px, range_m=range_m)
    draft = describe(name, rigs, sources, disparities, _lenses(rigs, notes), overrides)
    # The config is checked before the trials, which take longest.
    config = make_config(draft)
    # Prepares the dataset's patches: unusable photographs are reported now, and the patches are cached.
    patches = prepare_atlas(config.textures, Split(0)).report
    notes += [f"not readable: {skipped}" for skipped in patches.images_skipped]
    if trials:
        if [recipe.recipe for recipe in config.scenes] != [recipe.name for recipe in draft.recipes]:
            raise InputError(
                "scenes cannot be set where trial pairs weigh the recipes: make no trials, or change scenes in the "
                "file that is written",
                argument="overrides",
            )
        place = measure_place(find_images(sources), maps, working_width(draft.size.width_px), png_scale)
        # Imported here: loading OpenGL and models takes longer than writing a config without trials.
        from semisynth_gl.calibration.trial import fit  # noqa: PLC0415

        try:
            draft = fit(draft, place.values, trials, listener or Listener())
        except BackendError as error:
            message = f"{error}\nWithout OpenGL, make no trials: the config is then made without trial pairs"
            raise BackendError(message) from None
    return Calibration(make_config(draft), write(draft), _summary(draft, patches.total("kept")), notes)


def _refuse(arguments: Mapping[str, object], reason: str) -> None:
    """Raise InputError if any of the arguments, by name, is given."""
    for argument, value in arguments.items():
        if value not in (None, {}):
            raise InputError(reason, argument=argument)


def _two_numbers(name: str, values: Sequence[float] | None) -> tuple[float, float] | None:
    if values is None:
        return None
    if len(values) != 2:
        raise InputError(f"expected two numbers, got {shown(values)}", argument=name)
    return to_real(name, values[0]), to_real(name, values[1])


def _size(size: tuple[int, int] | None) -> Size | None:
    if size is None:
        return None
    if len(size) != len(Size._fields):
        raise InputError(f"expected width and height, got {shown(size)}", argument="size")
    return Size(*(to_whole("size", side, least=1) for side in size))


def _calibrated(photographs: Sequence[Size], scale: float | None) -> Size | None:
    """Return the size that calibrated images have by most of the photographs of the rig; None without any."""
    if not photographs:
        return None
    ((size, count),) = Counter(photographs).most_common(1)
    return size.scaled(1 / (scale or 1)) if 2 * count > len(photographs) else None


def _plain_rig(focal_px: float | None, baseline_m: float | None, size: Size | None) -> Rig:
    if focal_px is None or baseline_m is None or size is None:
        given = {"focal_px": focal_px, "baseline_m": baseline_m, "size": size}
        missing = next(argument for argument, value in given.items() if value is None)
        raise InputError("missing: give a calibration, or focal length, baseline and size", argument=missing)
    return plain_rig(to_real("focal_px", focal_px), to_real("baseline_m", baseline_m), size)


def _raw_rig(rigs: Sequence[Rig]) -> Rig:
    """Return the only rig, if its cameras before rectification are known."""
    if len(rigs) > 1 or rigs[0].raw is None:
        fault = next((f"; {rig.source}: {rig.lens_fault}" for rig in rigs if rig.lens_fault), "")
        raise InputError(
            "expected the calibration of one rig with its cameras before rectification (K and D of both, with R1 and "
            f"R2 or R and T): give it, or rectified photographs{fault}",
            argument="rectify_to",
        )
    return rigs[0]


def _lenses(rigs: Sequence[Rig], notes: list[str]) -> Mapping[Eye, LensChain] | None:
    """Return the lenses of a calibration that states them; None, and a note, where a config cannot have them."""
    notes += [f"the lenses of {rig.source} were left out: {rig.lens_fault}" for rig in rigs if rig.lens_fault]
    if not any(rig.raw for rig in rigs):
        return None
    if len(rigs) > 1:
        notes.append(f"the lenses of {len(rigs)} rigs were left out: a config has one; give one calibration for it")
        return None
    try:
        return lens_chains(rigs[0])
    except InputError as error:
        notes.append(f"the lenses were left out: {error}")
        return None


def _summary(draft: Draft, patches: int) -> list[str]:
    """Return lines about the rig, its disparities, photographs, scenes and textures."""
    ranges, disparity, style = draft.ranges, draft.disparity, draft.style
    views = [rig.view_deg for rig in draft.rigs]
    near_m, far_m = min(_distances_m(draft, disparity.max_px)), max(_distances_m(draft, disparity.min_px))
    mix = (f"{weight:.0%} {recipe.name}" for weight, recipe in zip(style.weights, style.recipes, strict=True))
    low, high = style.texels_per_pixel
    lines = [
        f"image size       {draft.size}",
        f"focal length     {_shown(ranges['focal_px'], 'px')}, a view of {_shown((min(views), max(views)), 'degrees')}",
        f"baseline         {_shown(ranges['baseline_m'], 'm')}",
        f"doffs            {_shown(ranges['doffs_px'], 'px')}",
        f"disparity        {disparity.min_px:g} to {disparity.max_px:g} px, mean {disparity.target.mean_px:.2f} px",
        f"                 {disparity.origin}",
        f"distance         {near_m:.3g} to {far_m:.3g} m",
        f"photographs      {draft.photographs}{', all grey' * draft.grey}, which give {counted(patches, 'patch')}",
        f"recipes          {', '.join(mix)}",
        f"textures         {low:g} to {high:g} texels per pixel, blurred by {style.blur_px:g} px",
    ]
    if draft.lenses is not None:
        borders = (f"{1 - float(chain.valid.mean()):.1%} of the {eye} image" for eye, chain in draft.lenses.items())
        density = max(chain.density for chain in draft.lenses.values())
        lines.append(
            f"lens             {draft.lenses['left'].raw.model}; borders: {', '.join(borders)}; raw images are up to "
            f"{density:.2f} times as fine"
        )
    return lines


def _distances_m(draft: Draft, disparity_px: float) -> list[float]:
    """Return the distance of a disparity for each rig, m."""
    sums = ((rig.camera.focal_baseline, disparity_px + rig.camera.doffs_px) for rig in draft.rigs)
    return [focal_baseline / px if px > 0 else math.inf for focal_baseline, px in sums]


def _shown(ends: tuple[float, float], unit: str) -> str:
    """Return a range as a person reads it, such as ``994.978 px`` or ``0.16 to 0.38 m``."""
    low, high = (f"{end:.6g}" for end in ends)
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
