"""The sections that hold for all pairs of a dataset: no recipe may change their keys."""

from collections.abc import Collection, Iterator
from math import degrees
from typing import Annotated

from pydantic import Field

from semisynth_gl.codecs import DISPARITY_CODECS, FLOW_CODECS, IMAGE_CODECS
from semisynth_gl.config.fields import (
    SMALLEST,
    ZERO,
    NotNegative,
    Positive,
    Range,
    RangeField,
    Rule,
    Section,
    Share,
    one_of,
    within,
)
from semisynth_gl.frame.camera import MOST_FOCAL_RATIO, MOST_TURN_RAD
from semisynth_gl.plugins import BUILT_IN
from semisynth_gl.seeds.splits import Split, SplitName

_MOST_TURN_DEG = round(degrees(MOST_TURN_RAD))
_SUB_FRAMES = 7

LAYOUTS = BUILT_IN["layouts"]
"""The names of the program's own layouts: the modules of `semisynth_gl.layouts`."""


class RigSection(Section):
    """Deviation of the right camera from the rectified one."""

    right_roll_deg: Annotated[RangeField, within(-_MOST_TURN_DEG, _MOST_TURN_DEG)] = ZERO
    """rotation about the viewing direction; positive turns the image clockwise"""
    right_pitch_deg: Annotated[RangeField, within(-_MOST_TURN_DEG, _MOST_TURN_DEG)] = ZERO
    """rotation about the x axis; positive moves the image up"""
    right_y_px: RangeField = ZERO
    """right principal point's distance below the left one"""
    focal_ratio: Annotated[RangeField, within(1 / MOST_FOCAL_RATIO, MOST_FOCAL_RATIO)] = Range(1.0, 1.0)
    """right focal length over the left one"""
    twin: bool = False
    """render each scene twice: pair 2 i deviates, pair 2 i + 1 is rectified"""

    def _rules(self) -> Iterator[Rule]:
        text = "twin adds a rectified pair to each deviating pair, but no pair deviates: set another key too"
        yield self == RigSection.model_construct(twin=True), text, type(self).model_fields

    def none(self) -> bool:
        """Return whether the pairs are rectified."""
        return self == RigSection()


class ImperfectionsSection(Section):
    """Imperfections of real images, sampled per image; both eyes share ``motion_blur``."""

    exposure_stops: Annotated[RangeField, within(-20, 20)] = ZERO
    """brightness in powers of 2"""
    gamma: Annotated[RangeField, within(SMALLEST, 100)] = Range(1.0, 1.0)
    """exponent of the tone curve"""
    noise: Annotated[RangeField, within(0, 255)] = ZERO
    """standard deviation of the noise, 8-bit levels"""
    blur_px: Annotated[RangeField, within(0, 1000)] = ZERO
    """standard deviation of the lens blur"""
    motion_blur: Annotated[RangeField, within(0, 1)] = ZERO
    """exposure time over ``sequence.frame_s``"""
    sub_frames: Annotated[int, Field(ge=2, le=64)] = _SUB_FRAMES
    """number of images averaged over an exposure"""
    vignetting: Annotated[RangeField, within(0, 0.95)] = ZERO
    """share of light lost in the corners, half a diagonal from the principal point"""
    white_balance: Annotated[RangeField, within(-4, 4)] = ZERO
    """gains of red and of blue, in powers of 2"""
    sharpening: Annotated[RangeField, within(0, 10)] = ZERO
    """amount of the unsharp mask"""
    jpeg_quality: Annotated[RangeField, within(1, 100)] | None = None
    """JPEG quality, 1 to 100; by default no compression"""

    def none(self) -> bool:
        """Return whether the section leaves the images as they are rendered."""
        return self.model_copy(update={"sub_frames": _SUB_FRAMES}) == ImperfectionsSection()


class ChecksSection(Section):
    """Conditions on each pair (of a sequence, its first frame). A scene that fails is sampled again."""

    min_brightness: Annotated[float, Field(ge=0, le=255)] = 8.0
    """least mean of the darker image, 8-bit levels"""
    min_texture: NotNegative = 1.0
    """least texture of the flatter image, as ``textures.min_texture``"""
    min_valid: Share = 0.5
    """least share of valid disparities in each view"""
    attempts: Annotated[int, Field(ge=1, le=10_000)] = 10
    """attempts before the run fails"""


class SequenceSection(Section):
    """Successive frames of one moving scene."""

    length: Annotated[int, Field(ge=1, le=100_000)] = 1
    """frames per sequence"""
    frame_s: Positive = 0.04
    """time between two frames"""


class FilesSection(Section):
    """Encodings of the dataset's files."""

    image: Annotated[str, one_of(IMAGE_CODECS)] = "png"
    """``png``"""
    disparity: Annotated[str, one_of(DISPARITY_CODECS)] = "pfm"
    """``pfm``, or KITTI's ``png16`` (up to 256 px; -128 to 128 px where signed)"""
    flow: Annotated[str, one_of(FLOW_CODECS)] = "flo"
    """Middlebury's ``flo``, SceneFlow's ``pfm``, or KITTI's ``png16`` (up to 512 px)"""


class SplitsSection(Section):
    """What only validation or test pairs show."""

    validation: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """share of the photographs' subjects"""
    test: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """share of the photographs' subjects"""
    models: bool = False
    """hold out the same shares of models too"""

    def _rules(self) -> Iterator[Rule]:
        total = self.validation + self.test
        yield total >= 1, f"validation and test add up to {total:g}: expected less than 1", ("validation", "test")

    def split(self, name: SplitName, splits: Collection[SplitName], seed: int) -> Split:
        """Return the split ``name`` of a dataset with this seed; ``splits`` are all splits that the dataset has."""
        shares: dict[SplitName, float] = {"validation": self.validation, "test": self.test}
        return Split(seed, name, {held: share for held, share in shares.items() if held in splits}, self.models)


class LicencesSection(Section):
    """Licences that the dataset's index and card state."""

    dataset: str = "unknown"
    """the dataset's, by the name that hubs use"""
    images: str = "unknown"
    """that of your photographs and of a plug-in's pictures"""
    models: str = "unknown"
    """that of your models and of a plug-in's models"""
