"""All steps from files to a config that `generate` takes as it is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from semisynth_gl.calibration.document import Background, Ranges, background_of, document, name_of, ranges_of
from semisynth_gl.calibration.maps import find_maps, measure
from semisynth_gl.calibration.photographs import check_sizes
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.calibration.target import DisparityRange, chosen_range, measured_range
from semisynth_gl.errors import InputError
from semisynth_gl.read.disparity import KITTI_PNG_SCALE
from semisynth_gl.textures.image_files import find_images


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
    ranges = ranges_of(rigs)
    if maps:
        disparity, disparity_from = _measured(maps, rigs, png_scale, ranges.doffs_px[0])
    else:
        disparity, disparity_from = _chosen(rigs, range_px, ranges.doffs_px[0])
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


def _measured(
    maps: Sequence[str], rigs: Sequence[Rig], png_scale: float, least_doffs_px: float
) -> tuple[DisparityRange, str]:
    paths = find_maps(maps)
    measured = measure(paths, {rig.size for rig in rigs}, png_scale)
    shown = ", ".join(str(path) for path in paths[:3]) + (f" and {len(paths) - 3} more" if len(paths) > 3 else "")
    low, high = (measured.histogram.quantile(share) for share in (0.001, 0.999))
    return measured_range(measured.histogram, least_doffs_px), (
        f"Measured from {measured.maps} disparity {'map' if measured.maps == 1 else 'maps'}, each counting the same: "
        f"{shown}; {measured.pixels} pixels, {measured.valid / measured.pixels:.1%} with a disparity, all but a "
        f"thousandth of them above {low:.4g} px and below {high:.4g} px. max_px leaves a tenth of room above that."
    )


def _chosen(
    rigs: Sequence[Rig], range_px: tuple[float, float] | None, least_doffs_px: float
) -> tuple[DisparityRange, str]:
    how = "wide and smooth; give disparity maps with --disparity to have it measured."
    if range_px is not None:
        found = chosen_range(*range_px, least_doffs_px)
        return found, f"The range is --range-px; the histogram is chosen, not measured: {how}"
    known = [largest for rig in rigs if (largest := _largest(rig)) is not None]
    if not known:
        raise InputError(
            f"nothing tells how large disparities are: {rigs[0].source} has no ndisp; give disparity maps with "
            "--disparity, or the range with --range-px LOW HIGH"
        )
    high_px, name, source = max(known)
    least = [rig.vmin_px for rig in rigs if rig.vmin_px is not None and rig.vmin_px > 0]
    # Only where every rig has one does the least of them stand for all.
    low_px = min(least) if len(least) == len(rigs) else None
    several = len(rigs) > 1
    upper = f"the largest of {len(known)} calibrations, {name} of {source}" if several else f"{name} of the calibration"
    if low_px is not None:
        lower = "the least vmin of all" if several else "vmin of the calibration"
    elif least_doffs_px < 0:
        lower = f"a fiftieth of the way there from -doffs, {-least_doffs_px:g} px"
    else:
        lower = "a fiftieth of that"
    return chosen_range(low_px, high_px, least_doffs_px), (
        f"max_px is {upper}, min_px {lower}; the histogram is chosen, not measured: {how}"
    )


def _largest(rig: Rig) -> tuple[float, str, str] | None:
    """Return the most that a calibration says of disparities, by what name, and its source."""
    for name, value in (("ndisp", rig.ndisp), ("vmax", rig.vmax_px)):
        if value is not None and 0 < value < math.inf:
            return value, name, rig.source
    return None
