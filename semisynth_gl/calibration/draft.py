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
from semisynth_gl.calibration.recipes import Style, is_outdoors, suitable_recipes, untried_style
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.calibration.sizes import Size
from semisynth_gl.config import Config
from semisynth_gl.config.load import Overrides, overridden, parse_values
from semisynth_gl.config.scene_sections import BackgroundSection, TexturesSection
from semisynth_gl.frame.camera import Eye
from semisynth_gl.frame.raw_camera import RawCamera, vector_of
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.textures.image_files import printable

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
_CAMERA_KEYS = ("width_px", "height_px", "focal_px", "baseline_m", "cx_left_px", "doffs_px", "cy_px")


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """What a config is written from.

    Attributes:
        name: the config's name.
        rig: the rig.
        disparity: range and wanted histogram of disparity.
        images: the user's sources of photographs, as absolute paths.
        large_px: side of large patches.
        style: the mix of recipes and the look of surfaces.
        grey: whether all photographs are grey.
        overrides: keys that the user sets, as `load_config` takes them.
    """

    name: str
    rig: Rig
    disparity: DisparityRange
    images: Sequence[str]
    large_px: int
    style: Style
    grey: bool = False
    overrides: Overrides = ()

    def config(self) -> Config:
        """Return the config; raises InputError where its numbers make no valid one."""
        return parse_values(self.values(), f"{self.name}.yaml", self.overrides)

    def values(self) -> dict[str, Any]:
        """Return the config's values before the user's overrides: sections and keys in the YAML's order."""
        disparity, camera = self.disparity, self.rig.camera
        smallest, largest = (round(part * camera.width_px) for part in (_SMALLEST_OF_WIDTH, _LARGEST_OF_WIDTH))
        values = {
            "name": self.name,
            "camera": {
                **{key: getattr(camera, key) for key in _CAMERA_KEYS},
                "fy_over_fx": camera.fy_over_fx if abs(camera.fy_over_fx - 1) > _SQUARE else None,
                "colour": "grey" if self.grey else None,
            },
            "lens": _lens(self.rig.raw) if self.rig.raw else None,
            "outputs": ["visibility", "valid"] if self.rig.raw else None,
            "disparity": {
                "signed": disparity.signed or None,
                "min_px": disparity.min_px,
                "max_px": disparity.max_px,
                "target": {
                    "form": "histogram",
                    "bin_px": disparity.bin_px,
                    "first_px": float(disparity.target.edges_px[0]),
                    "shares": [round(float(share), 4) for share in disparity.target.shares],
                },
            },
            "background": _background(self.rig, disparity),
            "particles": {"size_px": (max(smallest, 1), max(largest, 2))},
            "scenes": [
                {"recipe": recipe["recipe"], "weight": weight, **recipe}
                for recipe, weight in zip(self.style.recipes, self.style.weights, strict=True)
            ],
            "textures": {
                "texels_per_pixel": self.style.texels_per_pixel,
                "large_px": self.large_px,
                "source": "images",
                "images": list(self.images),
            },
            "imperfections": {"blur_px": self.style.blur_px},
        }
        made: dict[str, Any] = _rounded(values)
        return made

    def text(self) -> str:
        """Return the config as YAML, below a comment on the calibration."""
        yaml, text = YAML(), StringIO()
        yaml.width = sys.maxsize
        yaml.indent(mapping=2, sequence=4, offset=2)
        text.write(f"# {self.name}: written by semisynth-gl calibrate from {printable(self.rig.source)}.\n")
        for name, section in overridden(self.values(), self.overrides).items():
            yaml.dump({name: section}, text)
            text.write("\n")
        return text.getvalue().rstrip("\n") + "\n"


def describe(
    name: str,
    rig: Rig,
    images: Sequence[str],
    disparity: DisparityRange,
    photographed: Sequence[Size],
    overrides: Overrides = (),
) -> Draft:
    """Describe a config without trials.

    Of ``name``, runs of characters other than ASCII letters and digits become one hyphen in the config's name.
    ``images`` are files, folders and globs with photographs of the sizes ``photographed``.
    """
    sides = sorted(map(min, photographed)) or [0]
    return Draft(
        re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-") or "calibrated",
        rig,
        disparity,
        [str(expanded(path).absolute()) for path in images],
        max(min(sides[len(sides) // 2], rig.camera.width_px, _LARGEST_SIDE), TexturesSection().patch_px),
        untried_style(suitable_recipes(rig, disparity)),
        overrides=overrides,
    )


def _lens(lenses: Mapping[Eye, RawCamera]) -> dict[str, Any]:
    eyes: dict[str, Any] = {
        eye: {
            **{key: getattr(raw, key) for key in ("fx_px", "fy_px", "cx_px", "cy_px")},
            "distortion": list(raw.distortion),
            "rotation_deg": [math.degrees(each) for each in vector_of(raw.rotation)],
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
        farthest = -doffs_px if disparity.signed else max(0.0, -doffs_px)
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


def _rounded(value: Any) -> Any:  # noqa: ANN401 - any value of a config
    """Return a value as YAML shall have it, without keys that are None, and with ranges of equal ends as numbers.

    Numbers have ten digits, which is enough for any calibration, and lists of numbers are on one line. Text that is not
    printable is in quotes: without these, a line break of Unicode in a file's name would be read as a space.
    """
    match value:
        case bool() | int():
            return value
        case str():
            return value if value.isprintable() else DoubleQuotedScalarString(value)
        case float():
            rounded = float(f"{value:.10g}") + 0.0
            return int(rounded) if rounded.is_integer() else rounded
        case (low, high) if isinstance(value, tuple) and low == high:
            return _rounded(low)
        case Mapping():
            return {key: _rounded(each) for key, each in value.items() if each is not None}
        case _:
            made = CommentedSeq(map(_rounded, value))
            if not any(isinstance(each, dict | str) for each in made):
                made.fa.set_flow_style()
            return made
