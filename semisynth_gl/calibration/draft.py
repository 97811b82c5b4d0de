"""The draft of a config: what a rig, its photographs and its disparities tell, and the style that trials choose."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from semisynth_gl.calibration.arrays import Size
from semisynth_gl.calibration.disparity_range import DisparityRange
from semisynth_gl.calibration.photographs import are_grey, patch_sides, photograph_sizes
from semisynth_gl.calibration.recipes import SceneRecipe, suitable_recipes
from semisynth_gl.calibration.rectification import Rectification
from semisynth_gl.calibration.rig import Rig, median_size, rig_ranges
from semisynth_gl.calibration.style import Style, untried_style
from semisynth_gl.config.load import Overrides
from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.frame.camera import Eye
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.lens.chain import LensChain
from semisynth_gl.textures.image_files import find_images
from semisynth_gl.textures.subjects import of_subjects, photographed_subjects

# Ratios of fy to fx nearer to 1 are rounding.
_SQUARE = 1e-6
# Rooms, and most halls, have no pixels farther than this.
_INDOOR_M = 20.0
# Shares of such far pixels: only indoor scenes suit up to the first, only outdoor scenes beyond the second.
_INDOOR_AT_MOST, _OUTDOOR_FROM = 0.005, 0.05
# Ratio of the largest to the smallest depth up to which a street or an open ground would not fit.
_DEPTH_OF_FLAT = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """What a config is written from.

    Attributes:
        name: the config's name.
        rigs: the rigs, scaled by ``scale`` if that is given.
        disparity: range and wanted histogram of disparity.
        images: the user's sources of photographs, as absolute paths.
        photograph_count: number of photographs.
        subject_count: number of subjects that they show.
        large_px: side of large patches.
        scale: the user's scale of images and maps against the calibrated size.
        grey: whether all photographs are grey.
        rectification: deviations that were measured in pairs; None without pairs.
        fitting_count: number of photographs with a calibrated size; 0 where sizes were not compared.
        layout: the layout that suits the rigs, see `suited_layout`; None for the default.
        lenses: each eye's way through its lens; None without a calibration of the cameras before rectification.
        patch_px: side of patches.
        overrides: keys that the user sets, as `load_config` takes them.
        tried: the style that trial pairs chose; None before any were rendered.
    """

    name: str
    rigs: Sequence[Rig]
    disparity: DisparityRange
    images: Sequence[str]
    photograph_count: int
    subject_count: int
    large_px: int
    scale: float | None = None
    grey: bool = False
    rectification: Rectification | None = None
    fitting_count: int = 0
    layout: str | None = None
    lenses: Mapping[Eye, LensChain] | None = None
    patch_px: int = TexturesSection().patch_px
    overrides: Overrides = ()
    tried: Style | None = None

    @property
    def style(self) -> Style:
        """The mix of recipes and the look of surfaces; without trials, as in the packaged configs."""
        return self.tried or untried_style(self.recipes)

    @property
    def photographs(self) -> str:
        """Text with the number of photographs and, if that differs, the number of their subjects."""
        return f"{self.photograph_count}{of_subjects(self.photograph_count, self.subject_count)}"

    @property
    def size(self) -> Size:
        """Size of the config's images: the median over the rigs."""
        return median_size(self.rigs)

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Least and largest value over the rigs, by key of the section ``camera``; see `rig_ranges`."""
        return rig_ranges(self.rigs)

    @property
    def fy_over_fx(self) -> float:
        """Ratio of the focal lengths in y and x, in the middle of the rigs' range: a config has one."""
        return sum(self.ranges["fy_over_fx"]) / 2

    @property
    def square(self) -> bool:
        """Whether fx and fy are equal but for rounding."""
        return abs(self.fy_over_fx - 1) <= _SQUARE

    @property
    def doffs_px(self) -> float:
        """The middle of the rigs' cx_right - cx_left."""
        return sum(self.ranges["doffs_px"]) / 2

    @property
    def scenes(self) -> tuple[tuple[str, ...], str]:
        """The kinds of scenes that suit the wanted pixels, ``indoor``, ``outdoor`` or both, and the reason."""
        disparity, ranges, doffs_px = self.disparity, self.ranges, self.doffs_px
        if disparity.max_px + doffs_px < _DEPTH_OF_FLAT * (disparity.min_px + doffs_px):
            # The view ends so soon behind the nearest things that a wall has to close it, even outdoors.
            return ("indoor",), f"the farthest pixels are less than {_DEPTH_OF_FLAT:g} times as far as the nearest"
        focal_px, baseline_m = (math.sqrt(math.prod(ranges[key])) for key in ("focal_px", "baseline_m"))
        share = float(disparity.target.cumulative(focal_px * baseline_m / _INDOOR_M - doffs_px))
        kinds = {"indoor": share <= _OUTDOOR_FROM, "outdoor": share > _INDOOR_AT_MOST}
        reason = f"{share:.1%} of the wanted pixels are farther than {_INDOOR_M:g} m"
        return tuple(kind for kind, suits in kinds.items() if suits), reason

    @property
    def recipes(self) -> tuple[SceneRecipe, ...]:
        """The recipes that suit the scenes."""
        return suitable_recipes(self.scenes[0], self.disparity, self.size.width_px, self.doffs_px)


def describe(
    name: str,
    rigs: Sequence[Rig],
    images: Sequence[str],
    disparity: DisparityRange,
    **known: Any,  # noqa: ANN401 - attributes of `Draft`
) -> Draft:
    """Describe a config by its rigs, its photographs and what else of a `Draft` is known.

    ``name`` is any text, such as a file's stem; see `config_name`. ``images`` are files, folders and globs. Raises
    InputError where there is no photograph.
    """
    photographs = find_images(images)
    patch_px, large_px = patch_sides(photograph_sizes(photographs), median_size(rigs).width_px)
    return Draft(
        config_name(name),
        rigs,
        disparity,
        [str(expanded(path).absolute()) for path in images],
        len(photographs),
        len(photographed_subjects(photographs)),
        large_px,
        grey=are_grey(photographs),
        patch_px=patch_px,
        **known,
    )


def config_name(stem: str) -> str:
    """Return a name for a config, of letters, digits and hyphens, made from any text such as a file's stem."""
    return re.sub(r"[^A-Za-z0-9]+", "-", stem).strip("-") or "calibrated"
