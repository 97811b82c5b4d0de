"""A rectified rig, as a calibration gives it: the checks that all forms share, and its size in other pixels."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import StereoCamera
from semisynth_gl.errors import InputError

# What calibrations lose by being printed with six digits, and far less than would be seen in an image.
_SAME_FOCAL = 1e-4
_SAME_CY_PX = 0.05
# KITTI's second camera stands 0.5 % of the baseline off its place, and is called rectified.
_OFF_BASELINE = 0.01

Size = tuple[int, int]
"""Width and height of an image, pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Projections:
    """Two projection matrices, as a file has them, not yet judged.

    Attributes:
        left: (3, 4) float64, pixels from metres.
        right: (3, 4) float64, from the same frame.
        size: of the images; None where the file does not say.
        source: the file's name, or both names, for messages.
        ndisp: an upper bound of the disparities, where the file has one.
        vmin_px: the least disparity, likewise.
        vmax_px: the largest, likewise.
    """

    left: NDArray[np.float64]
    right: NDArray[np.float64]
    size: Size | None
    source: str
    ndisp: float | None = None
    vmin_px: float | None = None
    vmax_px: float | None = None


@dataclass(frozen=True, slots=True)
class Rig:
    """A rectified rig.

    Attributes:
        camera: both cameras.
        source: where it comes from, for messages and comments.
        ndisp: an upper bound of the disparities, px, where the calibration has one.
        vmin_px: the least disparity, likewise.
        vmax_px: the largest, likewise.
    """

    camera: StereoCamera
    source: str
    ndisp: float | None = None
    vmin_px: float | None = None
    vmax_px: float | None = None

    @property
    def size(self) -> Size:
        """Width and height of the images."""
        return self.camera.width_px, self.camera.height_px

    def scaled(self, scale: float) -> "Rig":
        """Return the rig of images reduced by a factor, below 1, or enlarged.

        Pixel centres are at whole numbers, so that a position c becomes (c + 0.5) s - 0.5. Middlebury's own reduced
        calibrations have c s, which moves both principal points alike and no disparity.
        """
        camera = self.camera

        def moved(position_px: float) -> float:
            return (position_px + 0.5) * scale - 0.5

        def times(number: float | None) -> float | None:
            return None if number is None else number * scale

        width_px, height_px = scaled_size(self.size, scale)
        return replace(
            self,
            camera=StereoCamera(
                width_px,
                height_px,
                camera.focal_px * scale,
                camera.baseline_m,
                moved(camera.cx_left_px),
                moved(camera.cx_right_px),
                moved(camera.cy_px),
            ),
            ndisp=times(self.ndisp),
            vmin_px=times(self.vmin_px),
            vmax_px=times(self.vmax_px),
        )


def scaled_size(size: Size, scale: float) -> Size:
    """Return the size of an image times a factor, rounded to whole pixels."""
    width_px, height_px = (max(1, int(side * scale + 0.5)) for side in size)
    return width_px, height_px


def plain_rig(focal_px: float, baseline_m: float, size: Size) -> Rig:
    """Return the rig of three numbers, its principal points at the centre of the images.

    Raises:
        InputError: where the baseline is 0 or negative, or a number is no such quantity.
    """
    if not baseline_m > 0:
        raise InputError(f"--baseline-m {baseline_m:g}: expected a distance above 0, from the left camera to the right")
    return Rig(StereoCamera.centred(*size, focal_px, baseline_m), "--focal-px, --baseline-m and --size")


def rectified(found: Projections, size: Size | None) -> Rig:
    """Judge projection matrices, and return the rig that they describe.

    A rectified pair has K [I | t] on both sides, with one focal length, one cy and t along x alone.

    Args:
        found: the matrices.
        size: of the images, as the user gave it; None where they did not.

    Raises:
        InputError: with the numbers, where the pair is not rectified, the baseline is 0 or negative, the size is not
            known, or the file has another than the user gave.
    """
    source = found.source
    for name, matrix in (("left", found.left), ("right", found.right)):
        _check_pinhole(source, name, matrix)
    focal_px, right_focal_px = float(found.left[0, 0]), float(found.right[0, 0])
    if abs(focal_px - right_focal_px) > _SAME_FOCAL * focal_px:
        raise InputError(
            _not_rectified(source, f"focal lengths differ: {focal_px:g} px left, {right_focal_px:g} right")
        )
    for name, fy_px in (("left", float(found.left[1, 1])), ("right", float(found.right[1, 1]))):
        if abs(fy_px - focal_px) > _SAME_FOCAL * focal_px:
            raise InputError(
                f"{source}: the {name} camera has fx = {focal_px:g} and fy = {fy_px:g} px: expected square pixels, as "
                "rectification makes them"
            )
    cy_px, right_cy_px = float(found.left[1, 2]), float(found.right[1, 2])
    if abs(cy_px - right_cy_px) > _SAME_CY_PX:
        raise InputError(_not_rectified(source, f"cy differs: {cy_px:g} px left, {right_cy_px:g} px right"))
    # Where the left camera stands in the right one's frame, metres: P = K [I | t].
    offset = np.linalg.solve(found.left[:, :3], found.left[:, 3]) - np.linalg.solve(
        found.right[:, :3], found.right[:, 3]
    )
    baseline_m = float(offset[0])
    across_m = float(np.hypot(offset[1], offset[2]))
    if across_m > _OFF_BASELINE * abs(baseline_m):
        y, z = (f"{float(offset[axis]):g} m" for axis in (1, 2))
        raise InputError(
            _not_rectified(source, f"the right camera stands {baseline_m:g} m to the right, but also {y} below and {z} "
            f"before the left one, more than {_OFF_BASELINE:.0%} of the baseline")
        )  # fmt: skip
    if baseline_m <= 0:
        raise InputError(
            f"{source}: the baseline is {baseline_m:g} m: expected the right camera at the right of the left one; "
            "swap the two, in the calibration and in your images"
        )
    if found.size is not None and size is not None and found.size != size:
        raise InputError(
            f"{source}: is for images of {_shown(found.size)}, but --size says {_shown(size)}: leave --size out, or "
            "give --scale if your images are reduced"
        )
    known = found.size or size
    if known is None:
        raise InputError(f"{source}: does not say how large the images are: give --size WIDTHxHEIGHT")
    cx_left_px, cx_right_px = float(found.left[0, 2]), float(found.right[0, 2])
    camera = StereoCamera(*known, focal_px, baseline_m, cx_left_px, cx_right_px, cy_px)
    return Rig(camera, source, found.ndisp, found.vmin_px, found.vmax_px)


def _check_pinhole(source: str, name: str, matrix: NDArray[np.float64]) -> None:
    """Check that a (3, 4) matrix begins with [f 0 cx; 0 f cy; 0 0 1]."""
    if not np.isfinite(matrix).all():
        raise InputError(f"{source}: the {name} projection matrix holds {matrix.tolist()}: expected finite numbers")
    focal_px = float(matrix[0, 0])
    if not focal_px > 0:
        raise InputError(f"{source}: the {name} focal length is {focal_px:g} px: expected a calibrated camera, above 0")
    others = [float(matrix[at]) for at in ((0, 1), (1, 0), (2, 0), (2, 1))]
    if max(map(abs, others)) > _SAME_FOCAL * focal_px or abs(matrix[2, 2] - 1) > _SAME_FOCAL:
        raise InputError(
            _not_rectified(source, f"the {name} projection matrix turns or skews: expected [f 0 cx; 0 f cy; 0 0 1], "
            f"got {matrix[:, :3].tolist()}")
        )  # fmt: skip


def _not_rectified(source: str, why: str) -> str:
    return (
        f"{source}: is not rectified: {why}. Rectify first (OpenCV: stereoRectify), and give the calibration of the "
        "rectified images"
    )


def _shown(size: Size) -> str:
    return f"{size[0]} x {size[1]}"
