"""The stereo camera, a pair of pinhole cameras, and crops of its images.

Frame (OpenCV's): x right, y down, z forward, metres, origin in the left camera. The right camera is at
(+baseline, 0, 0), and looks in the same direction unless it deviates. The centre of the top left pixel is (0, 0).
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.arguments import LEAST, MOST, MOST_PX, CheckedFields, to_real, to_whole
from semisynth_gl.inputs.errors import InputError

Floats = NDArray[np.float64]
Eye = Literal["left", "right"]
EYES: tuple[Eye, Eye] = ("left", "right")
OTHER_EYE: Mapping[Eye, Eye] = {"left": "right", "right": "left"}


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Floats:
    """Return the camera matrix K, (3, 3) float64."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


@dataclass(frozen=True, slots=True)
class Crop(CheckedFields):
    """A rectangle of whole pixels, the same in both images.

    Attributes:
        x_px: first column.
        y_px: first row.
        width_px: number of columns.
        height_px: number of rows.

    Raises:
        InputError: where the rectangle is empty or begins before pixel 0.
    """

    x_px: Annotated[int, 0]
    y_px: Annotated[int, 0]
    width_px: Annotated[int, 1]
    height_px: Annotated[int, 1]

    @property
    def right_px(self) -> int:
        """Column after the last column."""
        return self.x_px + self.width_px

    @property
    def bottom_px(self) -> int:
        """Row after the last row."""
        return self.y_px + self.height_px


MOST_TURN_RAD = np.deg2rad(10.0).item()
"""Maximum roll and pitch of a deviating right camera: stereo networks search for a point near its row."""
MOST_FOCAL_RATIO = 1.25
"""Maximum ratio of the longer focal length to the shorter one."""


@dataclass(frozen=True, slots=True)
class CameraDeviation(CheckedFields):
    """Deviation of a right camera from the rectified right camera, which has the same centre.

    Attributes:
        roll_rad: right-handed rotation about z; a positive roll turns the image's content clockwise.
        pitch_rad: right-handed rotation about x, after the roll; a positive pitch moves the image's content upwards.
        y_px: y of the right principal point minus y of the left one.
        focal_ratio: the right focal length divided by the left one.
    """

    roll_rad: Annotated[float, -MOST_TURN_RAD, MOST_TURN_RAD] = 0.0
    pitch_rad: Annotated[float, -MOST_TURN_RAD, MOST_TURN_RAD] = 0.0
    y_px: Annotated[float, -MOST_PX, MOST_PX] = 0.0
    focal_ratio: Annotated[float, 1 / MOST_FOCAL_RATIO, MOST_FOCAL_RATIO] = 1.0

    @property
    def rotation(self) -> Floats:
        """The rotation right_from_rectified, (3, 3) float64."""
        sin_roll, sin_pitch = np.sin((self.roll_rad, self.pitch_rad))
        cos_roll, cos_pitch = np.cos((self.roll_rad, self.pitch_rad))
        roll = np.array([[cos_roll, -sin_roll, 0], [sin_roll, cos_roll, 0], [0, 0, 1]])
        pitch = np.array([[1, 0, 0], [0, cos_pitch, -sin_pitch], [0, sin_pitch, cos_pitch]])
        return np.asarray(pitch @ roll)


RECTIFIED = CameraDeviation()

# OpenGL counts pixels in 32 bits.
_MOST_SIDE_PX = 2**31 - 1


@dataclass(frozen=True, slots=True)
class StereoCamera(CheckedFields):
    """A pair of pinhole cameras with equal focal lengths, rectified except for the right one's deviation.

    Attributes:
        width_px: image width.
        height_px: image height.
        focal_px: focal length in x; 1e-9 to 1e6.
        baseline_m: distance between the two centres; 0 to 1e9.
        cx_left_px: x of the left principal point; the image centre is (width - 1) / 2. Principal points lie within 1e6
            px of pixel 0.
        cx_right_px: x of the right principal point.
        cy_px: y of both principal points.
        deviation: deviation of the right camera; the other attributes describe the pair without it.
        fy_over_fx: focal length in y divided by that in x; 1 for square pixels.

    Raises:
        InputError: where a value has the wrong type or is out of range.
    """

    width_px: Annotated[int, 1, _MOST_SIDE_PX]
    height_px: Annotated[int, 1, _MOST_SIDE_PX]
    focal_px: Annotated[float, LEAST, MOST_PX]
    baseline_m: Annotated[float, 0, MOST]
    cx_left_px: Annotated[float, -MOST_PX, MOST_PX]
    cx_right_px: Annotated[float, -MOST_PX, MOST_PX]
    cy_px: Annotated[float, -MOST_PX, MOST_PX]
    deviation: CameraDeviation = RECTIFIED
    fy_over_fx: Annotated[float, LEAST, MOST] = 1.0

    def __post_init__(self) -> None:
        CheckedFields.__post_init__(self)  # super() fails in a dataclass with slots
        to_real("focal_y_px", self.focal_y_px, LEAST, MOST_PX)

    @classmethod
    def centred(
        cls, width_px: int, height_px: int, focal_px: float, baseline_m: float, doffs_px: float = 0.0
    ) -> "StereoCamera":
        """Build a camera with cx_left = c - doffs_px / 2 and cx_right = c + doffs_px / 2, c being the image centre."""
        width_px, height_px = to_whole("width_px", width_px), to_whole("height_px", height_px)
        doffs_px = to_real("doffs_px", doffs_px)
        cx, cy = (width_px - 1) / 2, (height_px - 1) / 2
        return cls(width_px, height_px, focal_px, baseline_m, cx - doffs_px / 2, cx + doffs_px / 2, cy)

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> Self:
        """Build a camera from the dictionary that `values` returns.

        Raises:
            TypeError, InputError: where values are missing or wrong.
        """
        known = {key.name: values[key.name] for key in fields(cls) if key.name in values}
        return cls(**known | {"deviation": CameraDeviation(**values.get("deviation", {}))})

    def values(self, *, deviation: bool = False) -> dict[str, Any]:
        """Return the attributes and "doffs_px" by name, in JSON's types.

        A fy_over_fx of 1 is left out, and so is the deviation of a rectified pair unless ``deviation`` is set.
        """
        values = asdict(self)
        stated = values.pop("deviation")
        if self.fy_over_fx == 1:
            del values["fy_over_fx"]
        values["doffs_px"] = self.doffs_px
        return values | {"deviation": stated} if deviation or not self.rectified else values

    def cropped(self, crop: Crop) -> "StereoCamera":
        """Return the camera of a crop of both images; disparities stay the same.

        Raises:
            InputError: where the crop reaches beyond the image.
        """
        if crop.right_px > self.width_px or crop.bottom_px > self.height_px:
            raise InputError(
                f"a crop must lie within the image of {self.width_px} x {self.height_px} px, got "
                f"{crop.width_px} x {crop.height_px} at ({crop.x_px}, {crop.y_px})"
            )
        return replace(
            self,
            width_px=crop.width_px,
            height_px=crop.height_px,
            cx_left_px=self.cx_left_px - crop.x_px,
            cx_right_px=self.cx_right_px - crop.x_px,
            cy_px=self.cy_px - crop.y_px,
        )

    def scaled(self, x: float, y: float, size: tuple[int, int]) -> "StereoCamera":
        """Return the camera of both images, resized by the factors ``x`` and ``y``.

        ``size`` is the new height and width, px. The outer corner of the first pixel keeps its position.
        """
        if x == y == 1:
            return self
        return replace(
            self,
            width_px=size[1],
            height_px=size[0],
            focal_px=self.focal_px * x,
            cx_left_px=(self.cx_left_px + 0.5) * x - 0.5,
            cx_right_px=(self.cx_right_px + 0.5) * x - 0.5,
            cy_px=(self.cy_px + 0.5) * y - 0.5,
            deviation=replace(self.deviation, y_px=self.deviation.y_px * y),
            fy_over_fx=self.fy_over_fx * (y / x),
        )

    @property
    def rectified(self) -> bool:
        """Whether the right camera does not deviate: then a point has the same row in both images."""
        return self.deviation == RECTIFIED

    @property
    def left_view_key(self) -> tuple[float, ...]:
        """The values on which the left view depends: cameras with the same key differ only in the right eye."""
        return self.width_px, self.height_px, self.focal_px, self.focal_y_px, self.cx_left_px, self.cy_px

    @property
    def doffs_px(self) -> float:
        """Difference of the principal points, cx_right - cx_left, as in Middlebury's calib.txt."""
        return self.cx_right_px - self.cx_left_px

    @property
    def focal_y_px(self) -> float:
        """Focal length in y."""
        return self.focal_px * self.fy_over_fx

    @property
    def focal_baseline(self) -> float:
        """Focal length in x times baseline, px m."""
        return self.focal_px * self.baseline_m

    def intrinsics_px(self, eye: Eye) -> tuple[float, float, float, float]:
        """Return cx, cy, fx and fy of one eye: its principal point and its focal lengths, px."""
        if eye == "left":
            return self.cx_left_px, self.cy_px, self.focal_px, self.focal_y_px
        deviation = self.deviation
        focal_px = self.focal_px * deviation.focal_ratio
        return self.cx_right_px, self.cy_px + deviation.y_px, focal_px, focal_px * self.fy_over_fx

    def matrix(self, eye: Eye) -> Floats:
        """Return the camera matrix K of one eye, (3, 3) float64."""
        cx, cy, fx, fy = self.intrinsics_px(eye)
        return camera_matrix(fx, fy, cx, cy)

    def offset_m(self, eye: Eye) -> float:
        """Return x of one eye's centre in the left camera's frame."""
        return 0.0 if eye == "left" else self.baseline_m

    def turn(self, eye: Eye) -> Floats | None:
        """Return the rotation eye_from_left, (3, 3) float64; None if the eye is not rotated."""
        return None if eye == "left" or self.rectified else self.deviation.rotation

    def disparity_px(self, depth_m: Floats | float) -> Floats:
        """Return the disparity x_left - x_right = f B / Z - doffs of planar depths, in a rectified pair.

        The result is float64, of any shape, and not clamped. For deviating pairs, see `correspondence`.
        """
        return self.focal_baseline / np.asarray(depth_m, np.float64) - self.doffs_px

    def depth_m(self, disparity_px: Floats | float) -> Floats:
        """Return the planar depth Z = f B / (d + doffs) of disparities in a rectified pair; any shape, float64.

        A depth that is inf, negative or, with a baseline of 0, nan means none. For deviating pairs, see `depth_at`.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.focal_baseline / (np.asarray(disparity_px, np.float64) + self.doffs_px)

    def rays(self, eye: Eye, x_px: Floats, y_px: Floats) -> Floats:
        """Return directions (..., 3) through pixel positions (...), in the left camera's frame.

        Each direction has a planar depth of 1 in the eye's own view, so that z = 1 unless the right camera deviates.
        """
        directions = self.rays_of_eye(eye, x_px, y_px)
        turn = self.turn(eye)
        return directions if turn is None else directions @ turn

    def correspondence(self, eye: Eye, x_px: Floats, y_px: Floats, depth_m: Floats) -> Floats:
        """Return the vectors from pixel positions in one view to the positions of the same points in the other view.

        ``depth_m`` (...) has the planar depths of the points in the view ``eye``, inf at infinity. The result is
        (..., 2) float64 px, right and down; not finite where the point is not in front of the other eye.
        """
        if self.rectified:
            along = self.disparity_px(depth_m) * (-1 if eye == "left" else 1)
            return np.stack([along, np.zeros_like(along)], axis=-1)
        direction, shift, (cx, cy, fx, fy) = self._seen_from_other(eye, x_px, y_px)
        with np.errstate(divide="ignore", invalid="ignore"):
            point = direction + shift / np.asarray(depth_m, np.float64)[..., None]
            z = np.where(point[..., 2] > 0, point[..., 2], np.nan)
            right = fx * point[..., 0] / z + (cx - np.asarray(x_px))
            down = fy * point[..., 1] / z + (cy - np.asarray(y_px))
        return np.stack([right, down], axis=-1)

    def depth_at(self, eye: Eye, x_px: Floats, y_px: Floats, disparity_px: Floats) -> Floats:
        """Return the planar depths in one view, (...) float64 m, of pixels (...) with disparities x_left - x_right.

        A depth that is inf, negative or nan means none.
        """
        if self.rectified:
            return self.depth_m(disparity_px)
        direction, shift, (cx, _, fx, _) = self._seen_from_other(eye, x_px, y_px)
        sign = -1 if eye == "left" else 1
        # The point's column in the other view, from the principal point. Its projection is solved for the depth.
        column = np.asarray(x_px, np.float64) + sign * np.asarray(disparity_px, np.float64) - cx
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(
                (fx * shift[0] - column * shift[2]) / (column * direction[..., 2] - fx * direction[..., 0])
            )

    def rays_of_eye(self, eye: Eye, x_px: Floats, y_px: Floats) -> Floats:
        """Return directions (..., 3) with z = 1 through pixel positions (...), in the eye's own frame."""
        cx, cy, fx, fy = self.intrinsics_px(eye)
        x = (np.asarray(x_px, np.float64) - cx) / fx
        y = (np.asarray(y_px, np.float64) - cy) / fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def _seen_from_other(
        self, eye: Eye, x_px: Floats, y_px: Floats
    ) -> tuple[Floats, Floats, tuple[float, float, float, float]]:
        """Return pixels' directions (..., 3) and the eye's position (3,) in the other eye's frame.

        The third value is the other eye's `intrinsics_px`.
        """
        other = OTHER_EYE[eye]
        direction = self.rays(eye, x_px, y_px)
        shift = np.array([self.offset_m(eye) - self.offset_m(other), 0.0, 0.0])
        turn = self.turn(other)
        if turn is not None:
            direction, shift = direction @ turn.T, turn @ shift
        return direction, shift, self.intrinsics_px(other)
