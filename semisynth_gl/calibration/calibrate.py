"""All steps from files to a config that `generate` takes as it is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from semisynth_gl.calibration.document import Background, Ranges, background_of, document, name_of, ranges_of
from semisynth_gl.calibration.maps import KITTI_PNG_SCALE, find_maps, measure
from semisynth_gl.calibration.photographs import check_sizes
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.calibration.target import DisparityRange, chosen_range, measured_range
from semisynth_gl.errors import InputError
from semisynth_gl.textures.images import find_images


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """What was found.

    Attributes:
        text: the config, YAML.
        ranges: of the rigs.
        disparity: range and histogram.
        disparity_from: where these come from, a sentence.
        background: which kind of scenes.
        images: the photographs.
        fitting: how many of them have the size of a calibration.
    """

    text: str
    ranges: Ranges
    disparity: DisparityRange
    disparity_from: str
    background: Background
    images: Sequence[Path]
    fitting: int


def calibrated_config(
    name: str,
    rigs: Sequence[Rig],
    images: Sequence[str],
    *,
    maps: Sequence[str] = (),
    png_scale: float = KITTI_PNG_SCALE,
    range_px: tuple[float, float] | None = None,
    scale: float | None = None,
    other_camera: bool = False,
) -> Calibrated:
    """Put a config together.

    Args:
        name: of the config; what names may not hold is replaced.
        rigs: at least one, as they were calibrated.
        images: photographs: files, folders and globs.
        maps: disparity maps, likewise; the histogram is measured from them.
        png_scale: levels of 16-bit PNG maps per pixel of disparity.
        range_px: the range of disparity, where there are no maps and calibrations have none.
        scale: of images and maps, against the size that was calibrated.
        other_camera: whether photographs may have other sizes than the rig's images.

    Raises:
        InputError: where anything is missing or does not fit together.
        ReadError: where a map cannot be read.
    """
    photographs = find_images(images)
    fitting = 0 if other_camera else check_sizes(photographs, [rig.size for rig in rigs], scale)
    if scale is not None:
        rigs = [rig.scaled(scale) for rig in rigs]
    if maps:
        disparity, disparity_from = _measured(maps, rigs, png_scale)
    else:
        disparity, disparity_from = _chosen(rigs, range_px)
    ranges = ranges_of(rigs)
    absolute = [str(Path(path).expanduser().absolute()) for path in images]
    text = document(
        name_of(name),
        rigs,
        disparity,
        scale=scale,
        disparity_from=disparity_from,
        images=absolute,
        images_from=f"Photographs: {len(photographs)} when this was written.",
    )
    background = background_of(ranges, disparity)
    return Calibrated(text, ranges, disparity, disparity_from, background, photographs, fitting)


def _measured(maps: Sequence[str], rigs: Sequence[Rig], png_scale: float) -> tuple[DisparityRange, str]:
    paths = find_maps(maps)
    measured = measure(paths, {rig.size for rig in rigs}, png_scale)
    shown = ", ".join(str(path) for path in paths[:3]) + (f" and {len(paths) - 3} more" if len(paths) > 3 else "")
    low, high = (measured.histogram.quantile(share) for share in (0.001, 0.999))
    return measured_range(measured.histogram), (
        f"Measured from {measured.maps} disparity {'map' if measured.maps == 1 else 'maps'}, each counting the same: "
        f"{shown}; {measured.pixels} pixels, {measured.valid / measured.pixels:.1%} with a disparity, all but a "
        f"thousandth of them above {low:.4g} px and below {high:.4g} px. max_px leaves a tenth of room above that."
    )


def _chosen(rigs: Sequence[Rig], range_px: tuple[float, float] | None) -> tuple[DisparityRange, str]:
    how = "wide and smooth; give disparity maps with --disparity to have it measured."
    if range_px is not None:
        low, high = range_px
        return chosen_range(low, high), f"The range is --range-px; the histogram is chosen, not measured: {how}"
    largest = [rig.ndisp or rig.vmax_px for rig in rigs]
    least = [rig.vmin_px for rig in rigs if rig.vmin_px is not None and rig.vmin_px > 0]
    known = [value for value in largest if value is not None and 0 < value < math.inf]
    if not known:
        raise InputError(
            f"nothing tells how large disparities are: {rigs[0].source} has no ndisp; give disparity maps with "
            "--disparity, or the range with --range-px LOW HIGH"
        )
    names = "ndisp" if rigs[0].ndisp else "vmax"
    # Only where every rig has one does the least of them stand for all.
    low_px = min(least) if len(least) == len(rigs) else None
    lower = "vmin of the calibration" if low_px is not None else "a fiftieth of that"
    return chosen_range(low_px, max(known)), (
        f"max_px is {names} of the calibration, min_px {lower}; the histogram is chosen, not measured: {how}"
    )
