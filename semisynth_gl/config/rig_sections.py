"""The sections about the rig: cameras, lenses, projector, deviation and imperfections."""

from math import degrees, radians
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from semisynth_gl.config.fields import (
    FROM_LIST,
    SMALLEST,
    ZERO,
    ConfigError,
    ConfigSection,
    NotNegativeRange,
    PathText,
    Positive,
    PositiveRange,
    Range,
    RangeField,
    Share,
    Vector,
    within,
)
from semisynth_gl.frame.camera import MOST_FOCAL_RATIO, MOST_TURN_RAD, Eye
from semisynth_gl.frame.channels import Colour
from semisynth_gl.frame.raw_camera import COEFFICIENTS, LensModel, RawCamera, rotation_of

# Maximum number of pixels of an image, for memory.
_MOST_PIXELS = 1 << 27
_MOST_TURN_DEG = round(degrees(MOST_TURN_RAD))
_SUB_FRAMES = 7

# All OpenGL 4.5 drivers support images of this width and height.
_Side = Annotated[int, Field(ge=1, le=16_384)]
_PatternSide = Annotated[int, Field(ge=1, le=8192)]
# A ratio of 1 is left out of `model_dump`, so that configs with square pixels keep their digests from before this key.
_FocalRatio = Annotated[float, Field(ge=0.5, le=2, exclude_if=lambda ratio: ratio == 1)]
_BaselineCount = Annotated[int, Field(ge=1, le=64)]
_BaselineList = Annotated[tuple[Positive, ...], FROM_LIST, Field(min_length=1, max_length=64)]

LensBorder = Literal["black", "replicate"]
_PAINTED_PATTERNS = ("dots", "stripes")


class CameraSection(ConfigSection):
    """The rectified pair of cameras."""

    width_px: _Side
    """image width"""
    height_px: _Side
    """image height"""
    focal_px: PositiveRange | None = None
    """focal length"""
    focal_mm: PositiveRange | None = None
    """focal length, with ``sensor_width_mm``, instead of ``focal_px``"""
    sensor_width_mm: Positive | None = None
    """width of the part of the sensor that the image covers"""
    fy_over_fx: _FocalRatio = 1.0
    """focal length in y over that in x, ``focal_px``; 1.00123 for Cityscapes"""
    baseline_m: PositiveRange | None = None
    """distance between the cameras"""
    baselines: _BaselineCount | _BaselineList = 1
    """number of right cameras per scene, or a list of their distances, metres"""
    cx_left_px: RangeField | None = None
    """x of the left principal point; by default, both points are symmetric about the centre"""
    cx_right_px: RangeField | None = None
    """x of the right principal point, instead of ``doffs_px``"""
    cy_px: RangeField | None = None
    """y of both principal points; by default the centre, (height - 1) / 2"""
    doffs_px: RangeField | None = None
    """cx_right - cx_left at the longest baseline, in proportion at shorter ones; by default 0"""
    sway_m: NotNegativeRange = ZERO
    """amplitude of the rig's sway along each axis"""
    sway_deg: NotNegativeRange = ZERO
    """amplitude of the rig's rotation about each axis"""
    sway_s: PositiveRange = Range(1.0, 3.0)
    """periods of ``sway_m`` and ``sway_deg``"""
    colour: Colour = "rgb"
    """``rgb``, or ``grey`` for monochrome cameras"""

    def _check_rules(self) -> None:
        if self.width_px * self.height_px > _MOST_PIXELS:
            text = f"expected width_px x height_px of at most {_MOST_PIXELS}, got {self.width_px} x {self.height_px}"
            raise ConfigError(text, ("width_px", "height_px"))
        focal = "focal_px", "focal_mm", "sensor_width_mm"
        if [getattr(self, key) is None for key in focal] not in ([False, True, True], [True, False, False]):
            raise ConfigError("give either focal_px, or focal_mm with sensor_width_mm", focal)
        if self.cx_right_px is not None and (self.cx_left_px is None or self.doffs_px is not None):
            keys = "cx_left_px", "cx_right_px", "doffs_px"
            raise ConfigError("cx_right_px needs cx_left_px, and excludes doffs_px", keys)
        baseline_m, baselines = self.baseline_m, self.baselines
        if isinstance(baselines, tuple) == (baseline_m is not None):
            text = "give either baseline_m, or baselines as a list of metres; baseline_m: null removes baseline_m"
            raise ConfigError(text, ("baseline_m", "baselines"))
        if baseline_m is not None and baseline_m.low == baseline_m.high and baselines != 1:
            text = f"expected a range for {baselines} baselines, got only {baseline_m.low:g} m"
            raise ConfigError(text, ("baseline_m", "baselines"))

    @property
    def baseline_ranges_m(self) -> tuple[Range, ...]:
        """The ranges from which the baselines of a scene are sampled, in the order of the pairs; at least one."""
        if isinstance(self.baselines, tuple):
            return tuple(Range(metres, metres) for metres in self.baselines)
        assert self.baseline_m is not None  # noqa: S101 - see `_check_rules`
        return (self.baseline_m,) * self.baselines

    @property
    def all_doffs_px(self) -> Range:
        """Range of all differences cx_right - cx_left that may be sampled."""
        if self.doffs_px is not None:
            return self.doffs_px
        left, right = self.cx_left_px, self.cx_right_px
        return ZERO if left is None or right is None else Range(right.low - left.high, right.high - left.low)


class RawEyeSection(ConfigSection):
    """A camera before rectification, as OpenCV's stereoCalibrate and stereoRectify describe it."""

    fx_px: PositiveRange
    """focal length along x"""
    fy_px: PositiveRange | None = None
    """focal length along y; by default ``fx_px``"""
    cx_px: RangeField | None = None
    """x of the principal point; by default (width - 1) / 2"""
    cy_px: RangeField | None = None
    """y of the principal point; by default (height - 1) / 2"""
    distortion: Annotated[tuple[RangeField, ...], FROM_LIST, Field(max_length=12)]
    """coefficients in OpenCV's order: k1, k2, p1, p2, ...; for a fisheye, k1 to k4"""
    rotation_deg: Vector = (ZERO, ZERO, ZERO)
    """rotation vector of R1 or R2, degrees"""


class LensSection(ConfigSection):
    """The cameras before rectification, sampled per sequence; they change images, not truth."""

    model: LensModel = "radial-tangential"
    """OpenCV's ``radial-tangential`` with 4, 5, 8 or 12 coefficients, or ``fisheye`` with 4"""
    raw_width_px: _Side
    """width of the raw images"""
    raw_height_px: _Side
    """height of the raw images"""
    left: RawEyeSection
    """the left camera"""
    right: RawEyeSection
    """the right camera"""
    border: LensBorder = "black"
    """colour where the sensor saw nothing: ``black``, or ``replicate`` for the nearest pixel's colour"""
    border_disparity: bool = True
    """keep disparities in the borders; if false, they are inf there"""

    def _check_rules(self) -> None:
        known = COEFFICIENTS[self.model]
        for name, eye in (("left", self.left), ("right", self.right)):
            if len(eye.distortion) not in known:
                text = f"{self.model} has {' or '.join(map(str, known))} coefficients, got {len(eye.distortion)}"
                raise ConfigError(text, (f"{name}.distortion", "model"))

    def sample(self, eye: Eye, rng: np.random.Generator) -> RawCamera:
        """Sample the camera of one eye: each range once, always in the same order."""
        values: RawEyeSection = getattr(self, eye)
        width_px, height_px, fx_px = self.raw_width_px, self.raw_height_px, values.fx_px.sample(rng)
        defaults = (values.fy_px, fx_px), (values.cx_px, (width_px - 1) / 2), (values.cy_px, (height_px - 1) / 2)
        fy_px, cx_px, cy_px = ((stated or Range(default, default)).sample(rng) for stated, default in defaults)
        distortion = tuple(each.sample(rng) for each in values.distortion)
        x, y, z = (radians(each.sample(rng)) for each in values.rotation_deg)
        rotation = rotation_of((x, y, z))
        return RawCamera(width_px, height_px, fx_px, fy_px, cx_px, cy_px, self.model, distortion, rotation)


class ProjectorSection(ConfigSection):
    """A projector that moves with the rig; it changes images, not truth."""

    pattern: PathText = "dots"
    """``dots``, vertical ``stripes``, or the path of a picture"""
    pattern_width_px: _PatternSide = 1280
    """width of the pattern or picture"""
    pattern_height_px: _PatternSide = 800
    """height of the pattern or picture"""
    size_px: Annotated[float, Field(ge=1, le=100)] = 2.5
    """dot's diameter or stripe's width, pixels of the pattern"""
    density: Annotated[float, Field(gt=0, le=0.5)] = 0.05
    """share of the pattern that dots or stripes cover"""
    field_of_view_deg: Annotated[RangeField, within(SMALLEST, 170)] = Range(90.0, 90.0)
    """angle across the pattern's width"""
    position_m: Vector = (ZERO, ZERO, ZERO)
    """x, y, z in the left camera's frame"""
    turn_deg: Vector = (ZERO, ZERO, ZERO)
    """rotation vector in the left camera's frame, degrees"""
    power: NotNegativeRange
    """light of a dot on a surface 1 m in front of the projector; 1 is the light in the photographs"""
    ambient: NotNegativeRange = Range(1.0, 1.0)
    """all other light, in the unit of ``power``"""
    share: Share = 1.0
    """share of the sequences with the projector on"""

    @property
    def painted(self) -> bool:
        """Whether the program paints the pattern instead of reading a picture."""
        return self.pattern in _PAINTED_PATTERNS


class RigSection(ConfigSection):
    """Deviation of the right camera from the rectified camera."""

    right_roll_deg: Annotated[RangeField, within(-_MOST_TURN_DEG, _MOST_TURN_DEG)] = ZERO
    """rotation about the viewing direction; positive turns the image clockwise"""
    right_pitch_deg: Annotated[RangeField, within(-_MOST_TURN_DEG, _MOST_TURN_DEG)] = ZERO
    """rotation about the x axis; positive moves the image up"""
    right_y_px: RangeField = ZERO
    """distance of the right principal point below the left principal point"""
    focal_ratio: Annotated[RangeField, within(1 / MOST_FOCAL_RATIO, MOST_FOCAL_RATIO)] = Range(1.0, 1.0)
    """right focal length over left focal length"""
    twin: bool = False
    """render each scene twice: pair 2 i deviates, pair 2 i + 1 is rectified"""

    def _check_rules(self) -> None:
        if self == RigSection.model_construct(twin=True):
            text = "twin adds a rectified pair to each deviating pair, but no pair deviates: set other keys of rig, too"
            raise ConfigError(text, type(self).model_fields)

    def is_rectified(self) -> bool:
        """Return whether no pair deviates."""
        return self == RigSection()


class ImperfectionsSection(ConfigSection):
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
    """share of light lost at half a diagonal from the principal point"""
    white_balance: Annotated[RangeField, within(-4, 4)] = ZERO
    """gains of red and of blue, in powers of 2"""
    sharpening: Annotated[RangeField, within(0, 10)] = ZERO
    """amount of the unsharp mask"""
    jpeg_quality: Annotated[RangeField, within(1, 100)] | None = None
    """JPEG quality, 1 to 100; by default no compression"""

    def changes_nothing(self) -> bool:
        """Return whether images stay as they are rendered."""
        return self.model_copy(update={"sub_frames": _SUB_FRAMES}) == ImperfectionsSection()
