"""What `calibrate` found, as lines for a person."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from semisynth_gl.calibration.draft import Draft
from semisynth_gl.calibration.photographs import impossible_splits
from semisynth_gl.calibration.stereo_rectify import WIDEST_FISHEYE_DEG
from semisynth_gl.calibration.style import Style
from semisynth_gl.frame.camera import Eye
from semisynth_gl.inputs.errors import counted
from semisynth_gl.judge.place import MeasuredPlace
from semisynth_gl.lens.chain import LensChain
from semisynth_gl.textures.crop_report import TextureReport

# Baselines of rigs that are not in another unit than assumed.
_SHORTEST_M, _LONGEST_M = 0.002, 5.0
# Rectified photographs have at least this share of the border that the rectification leaves, if that share of the image
# is border.
_LEAST_OF_BORDER, _MUCH_BORDER = 0.3, 0.03


def rig_summary(draft: Draft, report: TextureReport) -> list[str]:
    """Return lines about the rig, its disparities, scenes and photographs."""
    ranges, disparity, count = draft.ranges, draft.disparity, draft.photograph_count
    focal_px, angle = _shown_range(ranges["focal_px"], "px"), _shown_range(_views_deg(draft), "degrees")
    if not draft.square:
        focal_px += f" (fy {draft.fy_over_fx:.6g} times that)"
    far_m, near_m = (_distance_m(draft, *end) for end in ((disparity.min_px, max), (disparity.max_px, min)))
    scenes, reason = draft.scenes
    patches = counted(report.total("kept"), "patch")
    lines = [
        f"layout           {draft.layout or 'middlebury, and webdataset from 10,000 pairs on'}",
        f"image size       {draft.size}",
        f"focal length     {focal_px}, a view of {angle} across",
        f"baseline         {_shown_range(ranges['baseline_m'], 'm')}",
        f"doffs            {_shown_range(ranges['doffs_px'], 'px')}",
        f"disparity        {disparity.min_px:g} to {disparity.max_px:g} px, mean {disparity.target.mean_px:.2f} px",
        f"                 {disparity.origin}",
        f"distance         {near_m} to {far_m} m",
        f"scenes           {' and '.join(scenes)} ({reason})",
        f"photographs      {draft.photographs}{', all grey' * draft.grey}, which give {patches}",
    ]
    if 0 < draft.fitting_count < count:
        lines.append(f"                 {count - draft.fitting_count} differ in size from the rig's images")
    splits = impossible_splits(draft.subject_count)
    if splits:
        lines.append(f"                 too few to hold some out for {' or '.join(splits)}")
    if draft.lenses is not None:
        lines.append(f"lens             {_shown_lenses(draft.lenses)}")
    if draft.rectification is not None:
        lines.append(f"rectification    {draft.rectification.summary()}")
    return lines


def style_summary(style: Style, place: MeasuredPlace | None) -> list[str]:
    """Return lines about recipes and textures, and about the place where one was measured."""
    parts = zip(style.weights, style.recipes, strict=True)
    lines = [f"recipes          {', '.join(f'{weight:.0%} {recipe.name}' for weight, recipe in parts)}"]
    if place is None:
        return lines
    if place.values["border"].size:
        lines.insert(0, f"black border     {place.values['border'].mean():.1f}% of the photographs")
    low, high = style.texels_per_pixel
    lines.append(f"textures         {low:g} to {high:g} texels per pixel, blurred by {style.blur_px:g} px")
    near, compared = style.near(place.values)
    # Without enough pictures of the place, there is no deviation to compare with.
    if compared:
        means = f"means of {near} of {counted(compared, 'measure')}"
        lines.append(f"place            {means} expected within one standard deviation of its pictures")
    return lines


def baseline_note(ends_m: tuple[float, float]) -> str | None:
    """Return a warning about an unlikely baseline, since most files do not state its unit; None for a likely one."""
    if ends_m[0] >= _SHORTEST_M and ends_m[1] <= _LONGEST_M:
        return None
    return f"the baseline is {_shown_range(ends_m, 'm')}: check the unit in your files, and give it if it is not metres"


def view_note(draft: Draft) -> str | None:
    """Return a note on the view of fisheyes that was narrowed to the default; None where it was not."""
    rig = draft.rigs[0]
    if draft.lenses is None or not math.isclose(rig.view_deg, WIDEST_FISHEYE_DEG, rel_tol=1e-3):
        return None
    lost = 1 - min(float(chain.shown.mean()) for chain in draft.lenses.values())
    return (
        f"the rectified images show {rig.view_deg:.0f} degrees across, so that their middle stays sharp: {lost:.0%} of "
        "the fisheye's image is lost. Give another field of view to change that"
    )


def raw_note(draft: Draft, place: MeasuredPlace | None) -> str | None:
    """Return a warning about photographs, and pairs, that seem unrectified; None without a sign of it."""
    reasons = []
    if draft.rectification is not None and draft.rectification.is_large(draft.size.width_px):
        reasons.append("the right camera deviates far")
    if draft.lenses is not None and place is not None and len(place.values["border"]):
        border = 1 - float(np.mean([chain.valid.mean() for chain in draft.lenses.values()]))
        found = float(place.values["border"].mean()) / 100
        if border > _MUCH_BORDER and found < _LEAST_OF_BORDER * border:
            reasons.append(f"the lens leaves {border:.1%} border, and they have {found:.1%}")
    if not reasons:
        return None
    return (
        f"the photographs are probably not rectified as the calibration says: {'; '.join(reasons)}. Photographs "
        "straight from the cameras have to be rectified (rectify_to)"
    )


def _shown_lenses(lenses: Mapping[Eye, LensChain]) -> str:
    borders = [f"{1 - float(chain.valid.mean()):.1%} of the {eye} image" for eye, chain in lenses.items()]
    density = max(chain.density for chain in lenses.values())
    shown = min(float(chain.shown.mean()) for chain in lenses.values())
    return (
        f"{lenses['left'].raw.model}; borders: {', '.join(borders)}; at least {shown:.0%} of each raw image in view, "
        f"up to {density:.2f} times as fine as the rectified one"
    )


def _distance_m(draft: Draft, disparity_px: float, choose: Callable[[list[float]], float]) -> str:
    """Return the distance of a disparity, m, the least or the largest over the rigs."""
    sums = [(rig.camera.focal_baseline, disparity_px + rig.camera.doffs_px) for rig in draft.rigs]
    return f"{choose([focal / px if px > 0 else math.inf for focal, px in sums]):.3g}"


def _views_deg(draft: Draft) -> tuple[float, float]:
    angles = [float(f"{rig.view_deg:.3g}") for rig in draft.rigs]
    return min(angles), max(angles)


def _shown_range(ends: tuple[float, float], unit: str) -> str:
    """Return a range as a person reads it, such as ``994.978 px`` or ``0.16 to 0.38 m``."""
    low, high = ends
    return f"{low:.6g} {unit}" if f"{low:.6g}" == f"{high:.6g}" else f"{low:.6g} to {high:.6g} {unit}"
