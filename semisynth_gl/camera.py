"""The rectified stereo camera: two pinholes that differ by a baseline and, in some rigs, by cx; crops of its images.

Frame (OpenCV's): x right, y down, z forward, metres, origin in the left camera. The right camera stands at
(+baseline, 0, 0). Pixels: the centre of the top-left pixel is (0, 0).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.arguments import check_real, check_type, to_whole
from semisynth_gl.errors import InputError

Eye = Literal["left", "right"]
EYES: tuple[Eye, Eye] = ("left", "right")
OTHER_EYE: Mapping[Eye, Eye] = {"left": "right", "right": "left"}


@dataclass(frozen=True, slots=True)
class Crop:
    """A rectangle of both images, whole pixels.

    Attributes:
        x_px: column of its left pixels.
        y_px: row of its top pixels.
        width_px: number of columns.
        height_px: number of rows.
    """

    x_px: int
    y_px: int
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        for name in ("x_px", "y_px", "width_px", "height_px"):
            to_whole(f"a crop's {name}", getattr(self, name))
        if min(self.x_px, self.y_px) < 0 or min(self.width_px, self.height_px) < 1:
            raise InputError(f"a crop begins at 0 or more and holds at least 1 x 1 pixel, got {self}")

    @property
    def right_px(self) -> int:
        """Column after the last column."""
        return self.x_px + self.width_px

    @property
    def bottom_px(self) -> int:
        """Row after the last row."""
        return self.y_px + self.height_px


@dataclass(frozen=True, slots=True)
class StereoCamera:
    """A rectified pair of pinhole cameras with one focal length.

    Attributes:
        width_px: image width.
        height_px: image height.
        focal_px: focal length, equal in x and y.
        baseline_m: distance between the two centres; 0 is allowed.
        cx_left_px: x of the left principal point; the image centre is (width - 1) / 2.
        cx_right_px: x of the right principal point.
        cy_px: y of both principal points.
    """

    width_px: int
    height_px: int
    focal_px: float
    baseline_m: float
    cx_left_px: float
    cx_right_px: float
    cy_px: float

    def __post_init__(self) -> None:
        for name in ("width_px", "height_px"):
            to_whole(name, getattr(self, name))
        for name in ("focal_px", "baseline_m", "cx_left_px", "cx_right_px", "cy_px"):
            check_real(name, getattr(self, name))
        if self.width_px < 1 or self.height_px < 1:
            raise InputError(f"an image needs at least 1 x 1 pixel, got {self.width_px} x {self.height_px}")
        if self.focal_px <= 0:
            raise InputError(f"focal_px must be positive, got {self.focal_px}")
        if self.baseline_m < 0:
            raise InputError(f"baseline_m must be zero or positive, got {self.baseline_m}")

    @classmethod
    def centred(
        cls, width_px: int, height_px: int, focal_px: float, baseline_m: float, doffs_px: float = 0.0
    ) -> "StereoCamera":
        """Build a camera whose principal points lie at the image centre, half of ``doffs_px`` to either side."""
        cx, cy = (width_px - 1) / 2, (height_px - 1) / 2
        return cls(width_px, height_px, focal_px, baseline_m, cx - doffs_px / 2, cx + doffs_px / 2, cy)

    def cropped(self, crop: Crop) -> "StereoCamera":
        """Return the camera of a crop of both images; disparities stay the same.

        Raises:
            InputError: where the crop reaches beyond the image.
        """
        check_type("crop", crop, Crop)
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

    @property
    def doffs_px(self) -> float:
        """Difference of the principal points, cx_right - cx_left, as in Middlebury's calib.txt."""
        return self.cx_right_px - self.cx_left_px

    @property
    def focal_baseline(self) -> float:
        """Focal length times baseline, px m."""
        return self.focal_px * self.baseline_m

    def cx_px(self, eye: Eye) -> float:
        """Return x of one eye's principal point."""
        return self.cx_left_px if eye == "left" else self.cx_right_px

    def offset_m(self, eye: Eye) -> float:
        """Return x of one eye's centre in the left camera's frame."""
        return 0.0 if eye == "left" else self.baseline_m

    def disparity_px(self, depth_m: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return the disparity x_left - x_right = f B / Z - doffs of planar depths; any shape, float64, not clamped."""
        return self.focal_baseline / np.asarray(depth_m, np.float64) - self.doffs_px

    def depth_m(self, disparity_px: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return the planar depth Z = f B / (d + doffs) of disparities; any shape, float64.

        Inf, negative and, with a baseline of 0, nan: there is none.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.focal_baseline / (np.asarray(disparity_px, np.float64) + self.doffs_px)

    def rays(self, eye: Eye, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return directions (..., 3) with z = 1 through pixel positions (...), in the camera frame."""
        x = (np.asarray(x_px, np.float64) - self.cx_px(eye)) / self.focal_px
        y = (np.asarray(y_px, np.float64) - self.cy_px) / self.focal_px
        return np.stack([x, y, np.ones_like(x)], axis=-1)
