"""Drafts a config from a rig, its photographs and its disparities, and writes it as YAML."""

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

from semisynth_gl.calibration.disparity_range import DisparityDistribution
from semisynth_gl.calibration.rig import RectifiedRig
from semisynth_gl.calibration.sizes import ImageSize
from semisynth_gl.config import Config
from semisynth_gl.config.load import parse_values
from semisynth_gl.config.scene_sections import BackgroundSection, TexturesSection
from semisynth_gl.frame.camera import Eye
from semisynth_gl.frame.raw_camera import RawCamera
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.scene.rig import BEYOND_NEAR
from semisynth_gl.textures.image_files import printable

TEXELS = ((0.8, 1.5), (0.4, 0.75))
"""The values of textures.texels_per_pixel that trials try; without trials, the first is used."""

# Maximum side of large patches, px. 24 patches of this side take 100 MB.
_LARGEST_SIDE = 1024
# If fy / fx differs from 1 by at most this, the difference is only rounding.
_SQUARE = 1e-6
# Diameters of particles as fractions of the image's width, as in the packaged configs: 60 and 420 px of 1500.
_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH = 0.04, 0.28
# Back walls have the disparities of this farthest share of the target. Particles can hide a wall that is too far, but
# not a wall that is too near.
_WALL_UP_TO = 0.05
# Disparities of the far plane, as fractions of the way from the smallest possible disparity to min_px.
_PLANE_OF_MIN = (0.1, 0.7)
# Rooms and most halls have no pixels beyond the first value, m. Outdoors, a share above the second value is farther.
_INDOOR_M, _OUTDOOR_FROM = 20.0, 0.02
# Below this ratio of the largest to the smallest depth, streets and open ground would not fit.
_DEPTH_OF_FLAT = 3.0
# Number of particles in rooms, streets and still lifes. With two to six, views were either empty or full.
_FLOATING = [12, 40]
# Ranges of disparity, as quantiles of the target: for these particles, for the walls of rooms, and for panels.
_NEAR, _ROOM_ENDS, _PANELS = (0.4, 0.98), (0.1, 0.4), (0.1, 0.8)
# If walls and panels cannot reach this quantile of the target, there are only recipes without them.
_STILL_UP_TO = 0.9
# Sides of panels, as fractions of the image's width.
_PANEL_OF_WIDTH = (0.3, 1.0)
_CAMERA_KEYS = ("width_px", "height_px", "focal_px", "baseline_m", "cx_left_px", "doffs_px", "cy_px")


@dataclass(frozen=True, slots=True, eq=False)
class ConfigDraft:
    """A config that is not written yet, with the rig and the disparities that it is for.

    Attributes:
        rig: the rig.
        disparity: the range and the wanted histogram of disparity.
        sections: the config's values, as `rounded` returns them. The last of the ``scenes`` is clutter.
    """

    rig: RectifiedRig
    disparity: DisparityDistribution
    sections: dict[str, Any]

    def config(self) -> Config:
        """Return the config; raises InputError if its values are not valid."""
        return parse_values(self.sections, f"{self.sections['name']}.yaml")

    def text(self) -> str:
        """Return the config as YAML, with a comment that names the calibration."""
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
    name: str,
    rig: RectifiedRig,
    images: Sequence[str],
    disparity: DisparityDistribution,
    photographed: Sequence[ImageSize],
) -> ConfigDraft:
    """Draft a config without trials: recipes of equal weights, and textures as in the packaged configs.

    In ``name``, runs of characters other than ASCII letters and digits become one hyphen. ``images`` are files, folders
    and globs of photographs, which have the sizes ``photographed``.
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
    return ConfigDraft(rig, disparity, rounded(sections))


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


def _background(rig: RectifiedRig, disparity: DisparityDistribution) -> dict[str, Any]:
    """Return the section background: a back wall; outdoors, a far plane between min_px and infinity.

    The wall's rotation is limited so that its disparity changes by one bin from the middle of the image to the side: if
    a wall of disparity d rotates by a, then d + doffs becomes (d + doffs) (1 + tan(a) x / f) at x px from the middle.
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


def is_outdoors(rig: RectifiedRig, disparity: DisparityDistribution) -> bool:
    """Return whether more than 2 % of the wanted pixels are farther than 20 m.

    A view is indoors if its largest depth is less than three times its smallest: only a wall can end it there.
    """
    doffs_px = rig.camera.doffs_px
    if disparity.max_px + doffs_px < _DEPTH_OF_FLAT * (disparity.min_px + doffs_px):
        return False
    return float(disparity.target.cumulative(rig.camera.focal_baseline / _INDOOR_M - doffs_px)) > _OUTDOOR_FROM


def suitable_recipes(rig: RectifiedRig, disparity: DisparityDistribution) -> list[dict[str, Any]]:
    """Return the recipes that suit the wanted disparities.

    Rooms, streets and still lifes state their particles as layers, since walls, ground and panels already have the
    wanted disparities. If the range is too narrow for walls, these recipes are left out. The particles of the last two
    recipes are solved to fill the part of the target that the other recipes lack.
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
    # Walls and panels keep their distance from the near plane.
    reached = (most + doffs_px) / BEYOND_NEAR - doffs_px >= disparity.target.quantile(_STILL_UP_TO)
    still = (outdoor if is_outdoors(rig, disparity) else indoor) if reached else []
    floating: list[dict[str, Any]] = [{"recipe": "sparse", "particles": {"density": "sparse"}}, {"recipe": "clutter"}]
    return [*(recipe | {"particles": particles} for recipe in still), *floating]


def rounded(value: Any) -> Any:  # noqa: ANN401 - any value of a config
    """Return a config's value for YAML: keys with the value None are left out, and (x, x) becomes the number x.

    Numbers are rounded to ten digits, which is enough for any calibration. Lists of numbers go on one line. Unprintable
    text is quoted: otherwise a Unicode line break in a file's name would be read as a space.
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
