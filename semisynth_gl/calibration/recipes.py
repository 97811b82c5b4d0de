"""The recipes of a calibrated config."""

from typing import Any

from semisynth_gl.calibration.disparity_range import DisparityRange
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.scene.rig import BEYOND_NEAR

# Rooms, and most halls, have no pixels farther than this; outdoors a larger share of pixels is farther.
_INDOOR_M, _OUTDOOR_FROM = 20.0, 0.02
# Ratio of the largest to the smallest depth up to which a street or an open ground would not fit.
_DEPTH_OF_FLAT = 3.0
# Number of particles in scenes that mostly show other objects. With two to six, views were either empty or full.
_FLOATING = [12, 40]
# Ends of ranges of disparity, as quantiles of the wanted distribution: of these particles, of walls, of panels.
_NEAR, _ROOM_ENDS, _PANELS = (0.4, 0.98), (0.1, 0.4), (0.1, 0.8)
# Walls and panels must reach this quantile of disparity; else no recipe has them.
_STILL_UP_TO = 0.9
# Sides of panels, as fractions of the image's width.
_PANEL_OF_WIDTH = (0.3, 1.0)


def is_outdoors(rig: Rig, disparity: DisparityRange) -> bool:
    """Return whether more than 2 % of the wanted pixels are farther than 20 m.

    A view whose largest depth is less than three times its smallest is indoors: a wall has to close it.
    """
    doffs_px = rig.camera.doffs_px
    if disparity.max_px + doffs_px < _DEPTH_OF_FLAT * (disparity.min_px + doffs_px):
        return False
    return float(disparity.target.cumulative(rig.camera.focal_baseline / _INDOOR_M - doffs_px)) > _OUTDOOR_FROM


def suitable_recipes(rig: Rig, disparity: DisparityRange) -> list[dict[str, Any]]:
    """Return the recipes that suit the wanted disparities.

    Recipes of furnished, open and still scenes state their particles as layers, since their walls, ground and panels
    already lie at the wanted disparities. Where the range is so narrow that walls cannot reach these, there are no such
    recipes. The last two recipes are solved for the part of the wanted distribution that the others leave.
    """
    width_px, doffs_px = rig.camera.width_px, rig.camera.doffs_px
    # Rounded as in the written config, so that ranges lie within its limits.
    least, most = (float(f"{limit:.10g}") for limit in (disparity.min_px, disparity.max_px))

    def between(shares: tuple[float, float]) -> list[float]:
        ends = (float(f"{disparity.target.quantile(share):.3g}") for share in shares)
        return [min(max(end, least), most) for end in ends]

    particles = {"layers": [{"disparity_px": between(_NEAR), "count": _FLOATING}]}
    panels = {
        "panels": [3, 6],
        "panel_disparity_px": between(_PANELS),
        "panel_size_px": [float(round(share * width_px)) for share in _PANEL_OF_WIDTH],
        "panel_slant_deg": [0, 45],
    }
    empty = {"cuboid": 0, "plane": 0}
    room = {**empty, "room": 1, "wall_disparity_px": between(_ROOM_ENDS)}
    indoor: list[dict[str, Any]] = [
        {"recipe": "room", "background": room},
        {"recipe": "bare-room", "background": room, "room": {"furniture": [0, 3], "small": [2, 10]}},
        {"recipe": "still", "background": {**empty, "cuboid": 1}, "structures": panels},
    ]
    outdoor: list[dict[str, Any]] = [
        {"recipe": "street", "background": {**empty, "street": 1}},
        {"recipe": "still-outdoors", "background": {**empty, "plane": 1}, "structures": {"ground": 1, **panels}},
    ]
    # Walls and panels keep a distance from the near plane.
    reached = (most + doffs_px) / BEYOND_NEAR - doffs_px >= disparity.target.quantile(_STILL_UP_TO)
    still = (outdoor if is_outdoors(rig, disparity) else indoor) if reached else []
    floating: list[dict[str, Any]] = [{"recipe": "sparse", "particles": {"density": "sparse"}}, {"recipe": "clutter"}]
    return [*(recipe | {"particles": particles} for recipe in still), *floating]
