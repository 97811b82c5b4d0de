"""Making a config for `generate` from a rig's calibration and photographs."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from semisynth_gl.calibration.arrays import Size
from semisynth_gl.calibration.disparity_range import disparity_range
from semisynth_gl.calibration.draft import Draft, describe
from semisynth_gl.calibration.matching import given_pairs, open_matcher, pairs_among
from semisynth_gl.calibration.photographs import centre_crop, check_sizes, photograph_sizes
from semisynth_gl.calibration.raw_photographs import lens_chains, rectify_photographs
from semisynth_gl.calibration.rectification import fitting_pairs, measure_rectification
from semisynth_gl.calibration.rig import Rig, plain_rig
from semisynth_gl.calibration.rig_files import read_rigs
from semisynth_gl.calibration.summary import baseline_note, raw_note, rig_summary, style_summary, view_note
from semisynth_gl.calibration.write import make_config, suited_layout, write
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.config import Config
from semisynth_gl.config.load import Overrides
from semisynth_gl.frame.camera import Eye
from semisynth_gl.histogram import total_variation
from semisynth_gl.inputs.arguments import LEAST, to_real, to_whole
from semisynth_gl.inputs.errors import BackendError, InputError, counted, shown
from semisynth_gl.inputs.user_files import Files, expanded, names_of
from semisynth_gl.judge.measured_view import working_width
from semisynth_gl.judge.place import MeasuredPlace, map_files, measure_place
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
        notes: sentences on possible faults of the input.
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
    fov_deg: float | None = None,
    disparity: Files = (),
    depth: Files = (),
    png_scale: float = KITTI_DISPARITY.steps,
    pairs: Sequence[tuple[str | PathLike[str], str | PathLike[str]]] = (),
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
            without borders, to 1, for as much of the raw images as they can show; by default OpenCV's default.
        fov_deg: angle, 10 to 170 degrees, that the width of the rectified images takes, instead of ``alpha``; by
            default at most 100 for a fisheye.
        disparity: disparity maps, true or predicted, from which the wanted histogram is measured.
        depth: depth maps instead: whole numbers in millimetres, or floating point in metres.
        png_scale: levels per pixel of disparity in 16-bit PNG maps.
        pairs: left and right photographs of the rig, in which the right camera's deviation is measured; needs OpenCV.
            By default the pairs among ``images`` that have names as in Middlebury, ETH3D or KITTI.
        rectify_to: folder for rectified photographs, where ``images`` and ``pairs`` are photographs as the cameras take
            them; the config then cuts patches from these.
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
    kind, image_sources = "depth" if depth else "disparity", names_of(images)
    trials = to_whole("trials", trials, least=0)
    scale = None if scale is None else to_real("scale", scale, least=LEAST)
    png_scale = to_real("png_scale", png_scale, least=LEAST)
    range_px, range_m = _two_numbers("range_px", range_px), _two_numbers("range_m", range_m)
    _check_one(
        "states the disparities", range_px=range_px, range_m=range_m, disparity=disparity or None, depth=depth or None
    )
    _check_one("chooses the view", alpha=alpha, fov_deg=fov_deg)
    for argument, value in {"rectify_to": rectify_to, "pairs": pairs}.items():
        if other_camera and value:
            raise InputError("needs photographs of the rig, but other_camera is set", argument=argument)
    given, stated = _given_pairs(pairs), _size(size)
    notes: list[str] = []
    photographed = [] if other_camera else photograph_sizes(find_images(image_sources))
    reading = {
        "alpha": None if alpha is None else to_real("alpha", alpha, 0, 1),
        "fov_deg": None if fov_deg is None else to_real("fov_deg", fov_deg, 10, 170),
        "unit": unit,
        "cameras": cameras,
        "keys": calib_keys,
        "photographed": _calibrated(photographed, scale),
    }
    rigs = _rigs(names_of(calib), focal_px, baseline_m, stated, reading)
    notes += dict.fromkeys(note for rig in rigs for note in rig.notes)
    if crop := centre_crop(photographed, [rig.size for rig in rigs], scale):
        notes.append(
            f"the photographs are taken for the centre, {crop}, of the calibrated images, {rigs[0].size}: principal "
            "points were moved with it. If they show another part, give the calibration of such images"
        )
        rigs = [rig.cropped(crop) for rig in rigs]
    maps = map_files(names_of(depth or disparity), kind)
    scaled = rigs if scale is None else [rig.scaled(scale) for rig in rigs]
    if rectify_to is not None:
        folder = expanded(fspath(rectify_to))
        given = _rectified(image_sources, given, scaled, folder, notes)
        image_sources = [str(folder)]
        photographed = photograph_sizes(find_images(image_sources))
    fitting_count = 0 if other_camera else check_sizes(photographed, [rig.size for rig in rigs], scale)
    depths = kind == "depth"
    disparity_px = disparity_range(scaled, maps, png_scale=png_scale, depths=depths, range_px=range_px, range_m=range_m)
    matched = [] if other_camera else _matched_pairs(given, image_sources, scaled, notes)
    draft = describe(
        name,
        scaled,
        image_sources,
        disparity_px,
        scale=scale,
        fitting_count=fitting_count,
        rectification=measure_rectification(matched, scaled) if matched else None,
        lenses=_lenses(scaled, notes),
        overrides=overrides,
    )
    # The config is checked before the trials, which take longest.
    config = make_config(draft)
    if trials and [recipe.recipe for recipe in config.scenes] != [recipe.name for recipe in draft.recipes]:
        raise InputError(
            "scenes cannot be set where trial pairs weigh the recipes: make no trials, or change scenes in the file "
            "that is written",
            argument="overrides",
        )
    draft = replace(draft, layout=suited_layout(config, rigs))
    # Prepares the dataset's patches: unusable photographs are reported now, and the patches are cached.
    report = prepare_atlas(config.textures, Split(0)).report
    place = None
    if trials:
        width_px = working_width(draft.size.width_px)
        depths_of = scaled[0].camera if depths else None
        place = measure_place(find_images(image_sources), maps, width_px, png_scale, depths_of)
        draft = _fitted(draft, place, trials, listener or Listener())
    config = make_config(draft)
    expected = [_expectation(config)] if trials else []
    summary = [*rig_summary(draft, report), *style_summary(draft.style, place), *expected]
    unrectified = raw_note(draft, place) if rectify_to is None else None
    narrowed = view_note(draft) if alpha is None and fov_deg is None else None
    notes += filter(None, [narrowed, baseline_note(draft.ranges["baseline_m"]), unrectified])
    return Calibration(config, write(draft), summary, notes)


def _check_one(effect: str, **sources: object) -> None:
    given = [argument for argument, value in sources.items() if value is not None]
    if len(given) > 1:
        raise InputError(f"{given[0]} also {effect}: give only one of them", argument=given[1])


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


def _given_pairs(pairs: Sequence[tuple[str | PathLike[str], str | PathLike[str]]]) -> list[tuple[Path, Path]]:
    for pair in pairs:
        if isinstance(pair, str) or not isinstance(pair, Sequence) or len(pair) != 2:
            raise InputError(f"expected pairs of a left and a right photograph, got {shown(pair)}", argument="pairs")
    return [pair for left, right in pairs for pair in given_pairs(fspath(left), fspath(right))]


def _rigs(
    calib: Sequence[str],
    focal_px: float | None,
    baseline_m: float | None,
    size: Size | None,
    reading: Mapping[str, Any],
) -> list[Rig]:
    """Read the rigs, or make one of plain numbers; ``reading`` has the other arguments of `read_rigs`."""
    plain = {"focal_px": focal_px, "baseline_m": baseline_m}
    if calib:
        for argument, value in plain.items():
            if value is not None:
                raise InputError("the calibration states the same: give one or the other", argument=argument)
        return read_rigs(calib, size=size, **reading)
    for argument in ("alpha", "fov_deg"):
        if reading[argument] is not None:
            raise InputError("is for the lenses of a calibration: give one, or leave this out", argument=argument)
    missing = [argument for argument, value in (plain | {"size": size}).items() if value is None]
    if missing or size is None:
        raise InputError("missing: give a calibration, or focal length, baseline and size", argument=missing[0])
    return [plain_rig(to_real("focal_px", focal_px), to_real("baseline_m", baseline_m), size)]


def _calibrated(photographs: Sequence[Size], scale: float | None) -> Size | None:
    """Return the size that calibrated images have by most of the photographs of the rig; None without any."""
    if not photographs:
        return None
    ((size, count),) = Counter(photographs).most_common(1)
    return size.scaled(1 / (scale or 1)) if 2 * count > len(photographs) else None


def _matched_pairs(
    given: list[tuple[Path, Path]], images: Sequence[str], rigs: Sequence[Rig], notes: list[str]
) -> list[tuple[Path, Path]]:
    """Return the pairs to match: the given pairs, or those among the photographs, which need OpenCV or get a note."""
    pairs = given or fitting_pairs(pairs_among(find_images(images)), rigs)
    if pairs:
        try:
            open_matcher()
        except InputError as error:
            if given:
                raise
            notes.append(f"the deviation of rows in {counted(len(pairs), 'pair')} was not measured: {error}")
            return []
    return pairs


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


def _rectified(
    images: Sequence[str], given: list[tuple[Path, Path]], rigs: Sequence[Rig], folder: Path, notes: list[str]
) -> list[tuple[Path, Path]]:
    """Rectify photographs into a folder; return the rectified ones of the given pairs."""
    if len(rigs) > 1 or rigs[0].raw is None:
        fault = next((f"; {rig.source}: {rig.lens_fault}" for rig in rigs if rig.lens_fault), "")
        raise InputError(
            "expected the calibration of one rig with its cameras before rectification (K and D of both, with R1 and "
            f"R2 or R and T): give it, or rectified photographs{fault}",
            argument="rectify_to",
        )
    photographs = find_images(images)
    written, told = rectify_photographs(photographs, given or pairs_among(photographs), images, rigs[0], folder)
    notes += told
    return [(written[left], written[right]) for left, right in given if {left, right} <= written.keys()]


def _fitted(draft: Draft, place: MeasuredPlace, trials: int, listener: Listener) -> Draft:
    """Render and measure trial pairs for the draft's style."""
    # Imported here: loading OpenGL and models takes longer than writing a config without trials.
    from semisynth_gl.calibration.trial import fit  # noqa: PLC0415

    try:
        return fit(draft, place.values, trials, listener)
    except BackendError as error:
        message = f"{error}\nWithout OpenGL, make no trials: the config is then made without trial pairs"
        raise BackendError(message) from None


def _expectation(config: Config) -> str:
    """Return a line on the expected distance of the mix's disparities from the wanted ones."""
    # Imported here: loading models takes longer than writing a config without trials.
    from semisynth_gl.scene.mix import MixSampler  # noqa: PLC0415
    from semisynth_gl.scene.sources import prepare_sources  # noqa: PLC0415

    sources = prepare_sources(config, Split(0))
    mix = MixSampler(config, 0, sources.libraries, sources.atlas.patches)
    variation = total_variation(mix.expected(), config.shown_histogram())
    return f"                 disparities expected at a total variation of {variation:.3f} from the wanted ones"
