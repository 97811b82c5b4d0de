"""The sections that hold for all pairs of a dataset: no recipe may change their keys."""

from collections.abc import Collection, Iterator
from math import degrees
from typing import Annotated, Any

from pydantic import Field, model_validator

from semisynth_gl.codecs import DISPARITY_CODECS, FLOW_CODECS, IMAGE_CODECS
from semisynth_gl.config.fields import (
    ZERO,
    NotNegative,
    NotNegativeRange,
    Positive,
    PositiveRange,
    Range,
    RangeField,
    Section,
    Share,
    at_least,
    at_most,
    count,
    one_of,
)
from semisynth_gl.frame.camera import MOST_FOCAL_RATIO, MOST_TURN_RAD
from semisynth_gl.plugins import BUILT_IN
from semisynth_gl.seeds.splits import Split, SplitName

_MOST_TURN_DEG = round(degrees(MOST_TURN_RAD))
_SUB_FRAMES = 7

# Largest number of characters in a licence.
_LONGEST_LICENCE = 1000

LAYOUTS = BUILT_IN["layouts"]
"""The names of the program's own layouts: the modules of `semisynth_gl.layouts`."""

_Licence = Annotated[str, Field(max_length=_LONGEST_LICENCE)]


class RigSection(Section):
    """How the right camera deviates from the rectified one, drawn per sequence.

    Truth stays exact: the output ``correspondence`` holds the offset from each pixel to the same point in the other
    view, and disparity is x_left - x_right. The sections ``disparity`` and ``background`` refer to the rectified pair.

    Attributes:
        right_roll_deg: rotation about the viewing direction; positive values turn the image clockwise.
        right_pitch_deg: rotation about the x axis; positive values move the image upwards.
        right_y_px: distance by which the right principal point lies below the left one.
        focal_ratio: ratio of the right focal length to the left one.
        twin: render each scene with the rectified camera too: pair 2 i deviates, pair 2 i + 1 does not.
    """

    right_roll_deg: Annotated[RangeField, at_most(_MOST_TURN_DEG), at_least(-_MOST_TURN_DEG)] = ZERO
    right_pitch_deg: Annotated[RangeField, at_most(_MOST_TURN_DEG), at_least(-_MOST_TURN_DEG)] = ZERO
    right_y_px: RangeField = ZERO
    focal_ratio: Annotated[RangeField, at_most(MOST_FOCAL_RATIO), at_least(1 / MOST_FOCAL_RATIO)] = Range(1.0, 1.0)
    twin: bool = False

    def _faults(self) -> Iterator[str]:
        if self.twin and self.model_copy(update={"twin": False}).none():
            yield "twin adds a rectified pair to each deviating pair, but no pair deviates: set another key too"

    def none(self) -> bool:
        """Return whether the pairs are rectified."""
        return self == RigSection()


class ImperfectionsSection(Section):
    """Imperfections of a real rig's images, drawn for each image; both eyes share ``motion_blur``.

    Attributes:
        exposure_stops: power of 2 by which the image is multiplied.
        gamma: exponent of the tone curve.
        noise: standard deviation of the sensor's noise, 8-bit levels.
        blur_px: standard deviation of the lens blur.
        motion_blur: exposure time as a fraction of the time between frames.
        sub_frames: number of moments of the exposure whose images are averaged.
        vignetting: share of the light that is lost at half an image diagonal from the principal point.
        white_balance: powers of 2 by which red and blue are multiplied, drawn separately.
        sharpening: amount of the unsharp mask.
        jpeg_quality: quality, 1 to 100, of the JPEG compression that the image goes through; by default none.
    """

    exposure_stops: Annotated[RangeField, at_most(20), at_least(-20)] = ZERO
    gamma: Annotated[PositiveRange, at_most(100)] = Range(1.0, 1.0)
    noise: Annotated[NotNegativeRange, at_most(255)] = ZERO
    blur_px: Annotated[NotNegativeRange, at_most(1000)] = ZERO
    motion_blur: Annotated[NotNegativeRange, at_most(1)] = ZERO
    sub_frames: Annotated[int, Field(ge=2, le=64)] = _SUB_FRAMES
    vignetting: Annotated[NotNegativeRange, at_most(0.95)] = ZERO
    white_balance: Annotated[RangeField, at_most(4), at_least(-4)] = ZERO
    sharpening: Annotated[NotNegativeRange, at_most(10)] = ZERO
    jpeg_quality: Annotated[RangeField, at_least(1), at_most(100)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _no_vertical_disparity(cls, values: Any) -> Any:  # noqa: ANN401 - whatever the YAML holds
        for key, instead in (("vertical_offset_px", "right_y_px"), ("roll_deg", "right_roll_deg")):
            if isinstance(values, dict) and key in values:
                raise ValueError(
                    f"{key} is no imperfection of the images, since truth must follow it: set rig.{instead}"
                )
        return values

    def none(self) -> bool:
        """Return whether the section leaves the images as they are rendered."""
        return self.model_copy(update={"sub_frames": _SUB_FRAMES}) == ImperfectionsSection()


class ChecksSection(Section):
    """Conditions on each pair (of sequences, the first frame), as drawn and as written; else it is redrawn.

    Attributes:
        min_brightness: smallest mean of the darker image that passes, 8-bit levels.
        min_texture: smallest texture of the flatter image that passes: the median over 8 x 8 cells of the standard
            deviation of luminance, 8-bit levels.
        min_valid: smallest share of pixels with a valid disparity that passes, in each view.
        attempts: number of attempts at a scene; if all fail, the pair is an error.
    """

    min_brightness: Annotated[float, Field(ge=0, le=255)] = 8.0
    min_texture: NotNegative = 1.0
    min_valid: Share = 0.5
    attempts: Annotated[int, count(10_000)] = 10


class SequenceSection(Section):
    """Sequences: successive frames of one moving scene.

    Attributes:
        length: number of frames per sequence.
        frame_s: time between two frames.
    """

    length: Annotated[int, count(100_000)] = 1
    frame_s: Positive = 0.04


class FilesSection(Section):
    """Encodings of the dataset's files.

    Attributes:
        image: ``png``.
        disparity: ``pfm``, or KITTI's ``png16`` (up to 256 px; -128 to 128 px where signed).
        flow: Middlebury's ``flo``, SceneFlow's ``pfm``, or KITTI's ``png16`` (up to 512 px).
    """

    image: Annotated[str, one_of(IMAGE_CODECS)] = "png"
    disparity: Annotated[str, one_of(DISPARITY_CODECS)] = "pfm"
    flow: Annotated[str, one_of(FLOW_CODECS)] = "flo"


class SplitsSection(Section):
    """Photographs and models that only validation or test pairs show.

    Attributes:
        validation: share of the photographs' subjects that only validation pairs show (at least one subject).
        test: share of the photographs' subjects that only test pairs show (at least one subject).
        models: hold out the same shares of each family of models too.
    """

    validation: Annotated[float, Field(gt=0, lt=1)] = 0.1
    test: Annotated[float, Field(gt=0, lt=1)] = 0.1
    models: bool = False

    def _faults(self) -> Iterator[str]:
        if self.validation + self.test >= 1:
            yield f"validation and test add up to {self.validation + self.test:g}: expected less than 1"

    def split(self, name: SplitName, splits: Collection[SplitName], seed: int) -> Split:
        """Return the split ``name`` of a dataset; ``splits`` are all splits that the dataset has.

        ``seed`` is the dataset's seed, which chooses the subjects that are held out.
        """
        shares: dict[SplitName, float] = {"validation": self.validation, "test": self.test}
        held_out = {held: share for held, share in shares.items() if held in splits}
        return Split(seed, name, held_out, self.models)


class LicencesSection(Section):
    """Licences that the index and the card state.

    Attributes:
        dataset: licence of the dataset, by the name that hubs use.
        images: licence of your photographs and of a plug-in's pictures.
        models: licence of your models and of a plug-in's models.
    """

    dataset: _Licence = "unknown"
    images: _Licence = "unknown"
    models: _Licence = "unknown"
