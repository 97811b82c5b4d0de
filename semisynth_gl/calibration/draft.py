"""The draft of a config: what a rig, its photographs and its disparities tell, and the YAML that follows."""

import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedSeq
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from semisynth_gl.calibration.disparity_range import DisparityRange
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.calibration.sizes import Size
from semisynth_gl.config import Config
from semisynth_gl.config.load import parse_values
from semisynth_gl.config.scene_sections import BackgroundSection, TexturesSection
from semisynth_gl.frame.camera import Eye
from semisynth_gl.frame.raw_camera import RawCamera
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.scene.rig import BEYOND_NEAR
from semisynth_gl.textures.image_files import printable

TEXELS = ((0.8, 1.5), (0.4, 0.75))
"""Tried values of textures.texels_per_pixel; without trials, the first."""

# Largest side of large patches, px. Two dozen patches of this side take 100 MB.
_LARGEST_SIDE = 1024
# Ratios of fy to fx nearer to 1 are rounding.
_SQUARE = 1e-6
# Diameters of particles as fractions of the image's width, as in the packaged configs: 60 and 420 px of 1500.
_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH = 0.04, 0.28
# Back walls have the disparities of this farthest share of the wanted pixels. Particles can hide a wall that is too
# far, but not one that is too near.
_WALL_UP_TO = 0.05
# Ends of the far plane's disparities, as fractions of the way from the farthest possible disparity to min_px.
_PLANE_OF_MIN = (0.1, 0.7)
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
_CAMERA_KEYS = ("width_px", "height_px", "focal_px", "baseline_m", "cx_left_px", "doffs_px", "cy_px")


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """What a config is written from.

    Attributes:
        rig: the rig.
        disparity: range and wanted histogram of disparity.
        sections: the config's values as `rounded` returns them; the last of the ``scenes`` is clutter.
    """

    rig: Rig
    disparity: DisparityRange
    sections: dict[str, Any]

    def config(self) -> Config:
        """Return the config; raises InputError where its numbers make no valid one."""
        return parse_values(self.sections, f"{self.sections['name']}.yaml")

    def text(self) -> str:
        """Return the config as YAML, below a comment on the calibration."""
        yaml, text = YAML(), StringIO()
        yaml.width = sys.maxsize
        yaml.indent(mapping=2, sequence=4, offset=2)
        name, source = self.sections["name"], printable(self.rig.source)
        text.write(f"# {name}: written by semisynth-gl calibrate from {source}.\n")
        for section, values in self.sections.items():
            yaml.dump({section: values}, text)
            text.write("\n")
        return text.getvalue().rstrip("\n") + "\n"


def describe(
    name: str, rig: Rig, images: Sequence[str], disparity: DisparityRange, photographed: Sequence[Size]
) -> Draft:
    """Describe a config without trials: recipes of equal weights, and textures as in the packaged configs.

    Of ``name``, runs of characters other than ASCII letters and digits become one hyphen in the config's name.
    ``images`` are files, folders and globs with photographs of the sizes ``photographed``.
    """
    camera, recipes = rig.camera, suitable_recipes(rig, disparity)
    sides = sorted(map(min, photographed)) or [0]
    sections = {
        "name": re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-") or "calibrated",
        "camera": {
            **{key: getattr(camera, key) for key in _CAMERA_KEYS},
            "fy_over_fx": camera.fy_over_fx if abs(camera.fy_over_fx - 1) > _SQUARE else None,
        },
        "lens": _lens(rig.raw) if rig.raw else None,
        "outputs": ["visibility", "valid"] if rig.raw else None,
        "disparity": {
            "signed": disparity.min_px <= 0 or None,
            "min_px": disparity.min_px,
            "max_px": disparity.max_px,
            "target": {
                "form": "histogram",
                "bin_px": disparity.bin_px,
                "first_px": float(disparity.target.edges_px[0]),
                "shares": [round(float(share), 4) for share in disparity.target.shares],
            },
        },
        "background": _background(rig, disparity),
        "particles": {
            "size_px": (
                max(round(_SMALLEST_OF_WIDTH * camera.width_px), 1),
                max(round(_LARGEST_OF_WIDTH * camera.width_px), 2),
            )
        },
        "scenes": [{"recipe": recipe["recipe"], "weight": 1 / len(recipes), **recipe} for recipe in recipes],
        "textures": {
            "texels_per_pixel": TEXELS[0],
            "large_px": max(min(sides[len(sides) // 2], camera.width_px, _LARGEST_SIDE), TexturesSection().patch_px),
            "source": "images",
            "images": [str(expanded(path).absolute()) for path in images],
        },
        "imperfections": {"blur_px": 0.0},
    }
    return Draft(rig, disparity, rounded(sections))


def _lens(lenses: Mapping[Eye, RawCamera]) -> dict[str, Any]:
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to load

    eyes: dict[str, Any] = {
        eye: {
            **{key: getattr(raw, key) for key in ("fx_px", "fy_px", "cx_px", "cy_px")},
            "distortion": list(raw.distortion),
            "rotation_deg": Rotation.from_matrix(raw.rotation).as_rotvec(degrees=True).tolist(),
        }
        for eye, raw in lenses.items()
    }
    raw = lenses["left"]
    return {"model": raw.model, "raw_width_px": raw.width_px, "raw_height_px": raw.height_px, **eyes}


def _background(rig: Rig, disparity: DisparityRange) -> dict[str, Any]:
    """Return a background of back walls, or outdoors of a far plane between min_px and infinity.

    A wall turns so far that it lies in one bin of the target from the image's side to its middle: for a wall of
    disparity d turned by a, d + doffs becomes (d + doffs) (1 + tan(a) x / f) at x px from the middle.
    """
    min_px, doffs_px = disparity.min_px, rig.camera.doffs_px
    if is_outdoors(rig, disparity):
        farthest = -doffs_px if min_px <= 0 else max(0.0, -doffs_px)
        ends = tuple(farthest + float(f"{part * (min_px - farthest):.2g}") for part in _PLANE_OF_MIN)
        return {"cuboid": 0, "plane": 1, "plane_disparity_px": ends}
    deep_px = float(f"{disparity.target.quantile(_WALL_UP_TO) - min_px:.2g}")
    steepest = rig.camera.width_px / 2 / rig.camera.focal_px
    far_px = max(min_px + doffs_px, disparity.bin_px)
    turn_deg = float(f"{math.degrees(math.atan(disparity.bin_px / far_px / steepest)):.2g}")
    return {
        "cuboid": 1,
        "plane": 0,
        "wall_disparity_px": (min_px, min_px + deep_px),
        "wall_turn_deg": turn_deg if turn_deg < BackgroundSection().wall_turn_deg else None,
    }


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


def rounded(value: Any) -> Any:  # noqa: ANN401 - any value of a config
    """Return a config's value as YAML shall have it, without keys that are None, and ranges of equal ends as numbers.

    Numbers have ten digits, which is enough for any calibration, and lists of numbers are on one line. Text that is not
    printable is in quotes: without these, a line break of Unicode in a file's name would be read as a space.
    """
    match value:
        case bool() | int():
            return value
        case str():
            return value if value.isprintable() else DoubleQuotedScalarString(value)
        case float():
            number = float(f"{value:.10g}") + 0.0
            return int(number) if number.is_integer() else number
        case (low, high) if isinstance(value, tuple) and low == high:
            return rounded(low)
        case Mapping():
            return {key: rounded(each) for key, each in value.items() if each is not None}
        case _:
            made = CommentedSeq(map(rounded, value))
            if not any(isinstance(each, dict | str) for each in made):
                made.fa.set_flow_style()
            return made
