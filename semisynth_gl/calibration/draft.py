"""The draft of a config: what a rig, its photographs and its disparities tell, and the style that trials choose."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from semisynth_gl.calibration.disparity_range import DisparityRange
from semisynth_gl.calibration.kinds import Size
from semisynth_gl.calibration.photographs import are_grey, photograph_sizes
from semisynth_gl.calibration.recipes import SceneRecipe, suitable_recipes
from semisynth_gl.calibration.rig import Rig, median_size, rig_ranges
from semisynth_gl.calibration.style import Style, untried_style
from semisynth_gl.config.load import Overrides
from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.frame.camera import Eye
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.lens.chain import LensChain
from semisynth_gl.textures.image_files import find_images
from semisynth_gl.textures.subjects import of_subjects, photographed_subjects

# Largest side of large patches, px. Two dozen patches of this side take 100 MB.
_LARGEST_SIDE = 1024
# Rooms, and most halls, have no pixels farther than this; outdoors a larger share of pixels is farther.
_INDOOR_M, _OUTDOOR_FROM = 20.0, 0.02
# Ratio of the largest to the smallest depth up to which a street or an open ground would not fit.
_DEPTH_OF_FLAT = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """What a config is written from.

    Attributes:
        name: the config's name.
        rigs: the rigs.
        disparity: range and wanted histogram of disparity.
        images: the user's sources of photographs, as absolute paths.
        photograph_count: number of photographs.
        subject_count: number of subjects that they show.
        large_px: side of large patches.
        grey: whether all photographs are grey.
        lenses: each eye's way through its lens; None without a calibration of the cameras before rectification.
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
    grey: bool = False
    lenses: Mapping[Eye, LensChain] | None = None
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
    def doffs_px(self) -> float:
        """The middle of the rigs' cx_right - cx_left."""
        return sum(self.ranges["doffs_px"]) / 2

    @property
    def outdoors(self) -> bool:
        """Whether more than 2 % of the wanted pixels are farther than 20 m.

        A view whose largest depth is less than three times its smallest is indoors: a wall has to close it.
        """
        disparity, doffs_px = self.disparity, self.doffs_px
        if disparity.max_px + doffs_px < _DEPTH_OF_FLAT * (disparity.min_px + doffs_px):
            return False
        focal_px, baseline_m = (math.sqrt(math.prod(self.ranges[key])) for key in ("focal_px", "baseline_m"))
        return float(disparity.target.cumulative(focal_px * baseline_m / _INDOOR_M - doffs_px)) > _OUTDOOR_FROM

    @property
    def recipes(self) -> tuple[SceneRecipe, ...]:
        """The recipes that suit the scenes."""
        return suitable_recipes(self.disparity, self.size.width_px, self.doffs_px, outdoors=self.outdoors)


def describe(
    name: str,
    rigs: Sequence[Rig],
    images: Sequence[str],
    disparity: DisparityRange,
    lenses: Mapping[Eye, LensChain] | None = None,
    overrides: Overrides = (),
) -> Draft:
    """Describe a config by its rigs, its photographs and the other attributes of a `Draft`.

    ``name`` is any text, such as a file's stem: the config's name has its letters and digits, and hyphens. ``images``
    are files, folders and globs. Raises InputError where there is no photograph.
    """
    photographs = find_images(images)
    sides = sorted(map(min, photograph_sizes(photographs)))
    median = sides[len(sides) // 2] if sides else 0
    return Draft(
        re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-") or "calibrated",
        rigs,
        disparity,
        [str(expanded(path).absolute()) for path in images],
        len(photographs),
        len(photographed_subjects(photographs)),
        max(min(median, median_size(rigs).width_px, _LARGEST_SIDE), TexturesSection().patch_px),
        are_grey(photographs),
        lenses,
        overrides,
    )
