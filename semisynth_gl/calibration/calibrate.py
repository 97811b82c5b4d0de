"""Makes a config for `generate` from a rig's calibration and photographs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from semisynth_gl.calibration.disparity_range import disparity_range
from semisynth_gl.calibration.draft import ConfigDraft, describe
from semisynth_gl.calibration.rig import RectifiedRig
from semisynth_gl.calibration.rig_files import read_rig
from semisynth_gl.calibration.sizes import ImageSize, check_sizes, majority_size, photograph_sizes
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.config import Config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.arguments import LEAST, to_real, to_whole
from semisynth_gl.inputs.errors import InputError, counted, shown
from semisynth_gl.inputs.user_files import Files, names_of
from semisynth_gl.judge.measure_input import working_width
from semisynth_gl.judge.place import map_files, measure_place
from semisynth_gl.lens.rectification import EyeRectification
from semisynth_gl.listener import Listener
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.image_files import find_images
from semisynth_gl.textures.prepare import prepare_atlas

# A unit may be wrong if the view is wider, the largest disparity minus that of infinity smaller, or the scene nearer.
_WIDEST_DEG, _LEAST_PX, _NEAREST_M = 150, 2, 0.01


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedConfig:
    """A config for a rig, and texts about how it was made.

    Attributes:
        config: the config.
        text: the config as YAML.
        summary: lines about the config, as ``semisynth-gl calibrate`` prints them.
        notes: sentences on what was guessed, and what was ignored.
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
    range_px: tuple[float, float] | None = None,
    range_m: tuple[float, float] | None = None,
    other_camera: bool = False,
    trials: int = 6,
    name: str = "calibrated",
    listener: Listener | None = None,
) -> CalibratedConfig:
    """Make a config for a rig: its cameras, its range of disparities, and the photographs that give patches.

    Args:
        images: the photographs, raw or rectified: files, folders and globs.
        calib: calibration files of most tools that write YAML, JSON, XML, .npz, .npy or text. If they describe the
            cameras before rectification, the config gets the section lens, which needs OpenCV.
        focal_px: focal length. It replaces ``calib``, together with ``baseline_m`` and ``size``.
        baseline_m: distance between the cameras.
        size: width and height of the images, px; by default stated by the calibration, else that of most photographs.
        scale: size of the images relative to the calibrated size, such as 0.5 for half the width.
        unit: unit of the translation, ``"mm"``, ``"cm"`` or ``"m"``; by default guessed from its length.
        calib_keys: for K1, D1, R1, P1, K2, D2, R2, P2, R, T, Q and size, the name of that value in the files. It is for
            files whose names are not recognised. Of all other values, only the size and the lens model are used.
        cameras: the left and the right camera, such as ``("cam1", "cam2")``, if the calibration has more than two.
        alpha: the argument of OpenCV's stereoRectify, for a calibration without P1 and P2. 0 crops all borders, 1 keeps
            as much of the raw images as possible. The default is OpenCV's, with a view of at most 100 degrees for a
            fisheye.
        disparity: disparity maps, ground truth or predictions. The wanted histogram is measured in them.
        png_scale: levels per pixel of disparity in 16-bit PNG maps.
        range_px: smallest and largest disparity, instead of ``disparity``.
        range_m: smallest and largest distance, instead of ``range_px``.
        other_camera: whether a different camera took the photographs. They may then have any size.
        trials: number of pairs to render and measure for each recipe at each of two texture scales. With 0, recipes
            have equal weights, and textures are as in the packaged configs.
        name: the config's name; runs of characters other than ASCII letters and digits become one hyphen.
        listener: is told the number of pairs to render, and each finished pair.

    Raises:
        InputError: if an argument is not valid, or arguments contradict each other.
        ReadError: if a file cannot be read.
        BackendError: if OpenGL is missing, and ``trials`` is above 0.
    """
    sources, files, trials = names_of(images), names_of(calib), to_whole("trials", trials, least=0)
    scale = 1.0 if scale is None else to_real("scale", scale, LEAST, 16)
    png_scale = to_real("png_scale", png_scale, least=LEAST)
    alpha = None if alpha is None else to_real("alpha", alpha, 0, 1)
    for argument, pair in {"size": size, "range_px": range_px, "range_m": range_m, "cameras": cameras}.items():
        if pair is not None and len(pair) != 2:
            raise InputError(f"expected two, got {shown(pair)}", argument=argument)
    wanted = None if size is None else ImageSize(*(to_whole("size", side, least=1) for side in size))
    ranges = {"range_px": range_px, "range_m": range_m, "disparity": disparity or None}
    given = [argument for argument, value in ranges.items() if value is not None]
    if len(given) > 1:
        raise InputError("expected only one of disparity maps, a range in px and a range in m", argument=given[-1])
    photographs = find_images(sources)
    sizes = photograph_sizes(photographs)
    of_rig = [] if other_camera else sizes
    about_files = {"unit": unit, "calib_keys": calib_keys or None, "cameras": cameras, "alpha": alpha}
    numbers = {"focal_px": focal_px, "baseline_m": baseline_m, "size": wanted}
    rig = _rig(files, numbers, majority_size(of_rig, scale), about_files)
    check_sizes(of_rig, rig.size, scale)
    rig, maps = rig.scaled(scale), map_files(names_of(disparity))
    disparities = disparity_range(rig, maps, png_scale=png_scale, range_px=range_px, range_m=range_m)
    notes = [*rig.notes, *_doubts(rig.camera, disparities.max_px)]
    try:
        # Raises if OpenCV is missing, or if a lens maps two directions of the rectified image to one pixel.
        for eye, raw in (rig.raw or {}).items():
            EyeRectification(raw, rig.camera, eye, "black")
    except InputError as error:
        rig = replace(rig, raw=None)
        notes.append(f"the lenses were ignored: {error}")
    draft = describe(name, rig, sources, disparities, sizes)
    # Before the trials, so that unusable photographs are reported early. The atlas is cached for `generate`.
    atlas = prepare_atlas(draft.config().textures, Split(0))
    grey = bool((atlas.layers[..., :3] == atlas.layers[..., :1]).all())
    if grey:
        draft.sections["camera"]["colour"] = "grey"
    notes += [f"not usable: {skipped}" for skipped in atlas.report.images_skipped]
    if trials:
        place = measure_place(photographs, maps, working_width(rig.size.width_px), png_scale)
        # Imported here: loading OpenGL and models takes longer than writing a config without trials.
        from semisynth_gl.calibration.trial import fit  # noqa: PLC0415

        draft = fit(draft, place.values, trials, listener or Listener())
    source = f"{len(photographs)}{', all grey' * grey}, which give {counted(atlas.report.total('kept'), 'patch')}"
    config, margin = draft.config(), " with a margin" * bool(maps)
    return CalibratedConfig(config, draft.text(), _summary(draft, config, source, margin), notes)


def _doubts(camera: StereoCamera, max_px: float) -> list[str]:
    """Return sentences on values that may have wrong units."""
    most_px, view_deg = max_px + camera.doffs_px, 2 * math.degrees(math.atan(camera.width_px / 2 / camera.focal_px))
    near_m, lengths = camera.focal_baseline / most_px, "--baseline-m and --range-m are in metres; see --unit"
    doubts = {
        f"the view is {view_deg:.0f} degrees wide: --focal-px is in pixels": view_deg > _WIDEST_DEG,
        f"the largest disparity, {max_px:.4g} px, exceeds the width: {lengths}": max_px > camera.width_px,
        f"the largest disparity is {most_px:.2g} px above that of infinity: {lengths}": most_px < _LEAST_PX,
        f"the smallest distance is {near_m:.2g} m: {lengths}": near_m < _NEAREST_M,
    }
    return [text for text, is_doubtful in doubts.items() if is_doubtful]


def _rig(
    files: Sequence[str], numbers: Mapping[str, Any], photographed: ImageSize | None, about_files: Mapping[str, Any]
) -> RectifiedRig:
    """Return the rig from calibration files, or else from ``numbers``: focal length, baseline and size."""
    needless = {key: value for key, value in numbers.items() if key != "size"} if files else about_files
    for argument, value in needless.items():
        if value is not None:
            states = "the calibration states it: do not give both"
            raise InputError(states if files else "it needs calibration files", argument=argument)
    if files:
        return read_rig(files, size=numbers["size"], photographed=photographed, **about_files)
    for argument, value in numbers.items():
        if value is None:
            raise InputError("missing: give a calibration, or focal length, baseline and size", argument=argument)
    width_px, height_px = numbers["size"]
    camera = StereoCamera.centred(width_px, height_px, numbers["focal_px"], numbers["baseline_m"])
    return RectifiedRig(camera, "the focal length, baseline and size given")


def _summary(draft: ConfigDraft, config: Config, photographs: str, margin: str) -> list[str]:
    """Return lines about the disparities, photographs, scenes and textures of the config."""
    disparity = config.disparity
    totals_px = (px + draft.rig.camera.doffs_px for px in (disparity.max_px, disparity.min_px))
    near_m, far_m = (draft.rig.camera.focal_baseline / px if px > 0 else math.inf for px in totals_px)
    mix = (f"{scene['weight']:.0%} {scene['recipe']}" for scene in draft.sections["scenes"])
    texels, blur_px = config.textures.texels_per_pixel, config.imperfections.blur_px.high
    mean_px = config.wanted_histogram().mean_px
    return [
        f"disparity        {disparity.min_px:g} to {disparity.max_px:g} px{margin}, mean {mean_px:.2f} px",
        f"distance         {near_m:.3g} to {far_m:.3g} m",
        f"photographs      {photographs}",
        f"recipes          {', '.join(mix)}",
        f"textures         {texels.low:g} to {texels.high:g} texels per pixel, blurred by {blur_px:g} px",
    ]
