"""One eye's images: rendered by a pinhole camera, seen through the lens, and rectified by OpenCV.

    rendered image   by a pinhole camera with the rectified view, in at least the resolution of the sensor
    raw image        what the sensor sees; it gets the imperfections
    rectified image  by ``initUndistortRectifyMap`` and ``remap``, bilinear, as users' programs rectify

Truth does not pass the lens: it is computed at the centre of each rectified pixel.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.rig_sections import LensBorder
from semisynth_gl.frame.camera import Eye, Floats, StereoCamera
from semisynth_gl.frame.raw_camera import RawCamera
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.opencv import open_opencv

# Step of the pixel grid at which the lens is computed exactly; between grid points, cubics interpolate.
_GRID_PX = 16
# Tolerance, px, of the round trip through lens and inverse.
_INVERSE_PX = 1e-3
# Largest density that counts as 1: a denser image would be wider by 2 px at most.
_SAME_DENSITY = 1 + 1e-4
# Tolerance at the sensor's border, px, since OpenCV's maps are float32.
_BORDER_PX = 1e-3


@dataclass(frozen=True, eq=False)
class EyeRectification:
    """The raw camera of one eye, and the rectification of its images for the rectified pair ``camera``.

    ``border`` says what the rectified image shows where the sensor saw nothing: black, or the nearest pixel's colour.
    Raises InputError where OpenCV is missing, or the lens bends two directions of the rectified view to one raw pixel.
    """

    raw: RawCamera
    camera: StereoCamera
    eye: Eye
    border: LensBorder

    def __post_init__(self) -> None:
        x, y = (each[::_GRID_PX, ::_GRID_PX].astype(np.float64) for each in self.maps)
        x, y = self.raw.to_rectified(self.pinhole, x, y)
        rows, columns = (np.arange(0, side, _GRID_PX) for side in self.valid.shape)
        error_px = np.hypot(x - columns, y - rows[:, None])
        failed = self.valid[::_GRID_PX, ::_GRID_PX] & ~(error_px < _INVERSE_PX * np.max([1, self.density]))
        if failed.any():
            row, column = np.argwhere(failed)[0] * _GRID_PX
            raise InputError(
                f"lens.{self.eye}: the distortion {list(self.raw.distortion)} bends two directions to one pixel of the "
                f"raw image, one of them at ({column}, {row}) of the rectified image: it holds for a narrower view only"
            )

    @cached_property
    def _cv2(self) -> Any:  # noqa: ANN401 - a module without types
        return open_opencv("the config's section lens, which rectifies raw images,")

    @cached_property
    def pinhole(self) -> Floats:
        """The camera matrix of the rectified eye, (3, 3) float64."""
        return self.camera.matrix(self.eye)

    @cached_property
    def maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The column and the row of the raw image that each rectified pixel shows, (H, W) float32 px each."""
        cv2, raw = self._cv2, self.raw
        model = cv2.fisheye if raw.model == "fisheye" else cv2
        size = self.camera.width_px, self.camera.height_px
        distortion, rotation = (np.array(each, np.float64) for each in (raw.distortion, raw.rotation))
        x, y = model.initUndistortRectifyMap(raw.matrix, distortion, rotation, self.pinhole, size, cv2.CV_32FC1)
        return x, y

    @cached_property
    def raw_map(self) -> NDArray[np.float32]:
        """Both maps as one array, (H, W, 2) float32 px: column and row; inf behind the raw camera."""
        positions = np.stack(self.maps, axis=2)
        # The rays of the rectified camera at depth 1 have depths in the raw camera's frame that are linear in x and y.
        across, down, middle = np.array(self.raw.rotation)[:, 2] @ np.linalg.inv(self.pinhole)
        rows, columns = (np.arange(side) for side in positions.shape[:2])
        ahead = across * columns + down * rows[:, None] + middle > 0
        positions[~(ahead & np.isfinite(positions).all(axis=2))] = np.inf
        return positions

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """The rectified pixels for which the raw image has all four pixels to interpolate from, (H, W) bool."""
        x, y = np.moveaxis(self.raw_map, 2, 0)
        inside: NDArray[np.bool_] = (x >= -_BORDER_PX) & (x <= self.raw.width_px - 1 + _BORDER_PX)
        inside &= (y >= -_BORDER_PX) & (y <= self.raw.height_px - 1 + _BORDER_PX)
        return inside

    @cached_property
    def density(self) -> float:
        """Supersampling factor: the largest number of raw pixels along a rectified pixel, at least 1."""
        seen = self.valid[::_GRID_PX, ::_GRID_PX]
        # Behind the raw camera, maps are inf.
        x, y = (np.where(seen, each[::_GRID_PX, ::_GRID_PX].astype(np.float64) / _GRID_PX, 0) for each in self.maps)
        a, b = (np.diff(each, axis=1)[:-1] for each in (x, y))
        c, d = (np.diff(each, axis=0)[:, :-1] for each in (x, y))
        seen = seen[:-1, :-1] & seen[1:, :-1] & seen[:-1, 1:]
        # The larger singular value of each 2 x 2 matrix of derivatives.
        total, product = a * a + b * b + c * c + d * d, a * d - b * c
        largest = np.sqrt((total + np.sqrt(np.maximum(total * total - 4 * product * product, 0))) / 2)
        most = float(largest.max(where=seen, initial=1.0))
        return most if most > _SAME_DENSITY else 1.0

    def raw_image(self, rendered: NDArray[np.uint8], density: float) -> NDArray[np.uint8]:
        """Return the raw image of a rendered image, both (H, W, 3) or (H, W) uint8.

        ``density`` is the number of rendered pixels along a rectified pixel. Beyond the rendered image, its outermost
        pixels are repeated.
        """
        x, y = self._sensor_maps
        if density != 1:
            x, y = ((each + 0.5) * np.float32(density) - np.float32(0.5) for each in (x, y))
        cv2 = self._cv2
        image: NDArray[np.uint8] = cv2.remap(rendered, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return image

    def within_view(self, raw_image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a raw image in which pixels that are not `used` are black; `rectify` returns the same for both."""
        used = self.used
        return np.where(used[..., None] if raw_image.ndim == 3 else used, raw_image, np.uint8(0))

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """The raw pixels in the rectified view, and those that are read to interpolate it, (H, W) bool."""
        width, height = self.camera.width_px, self.camera.height_px
        columns, rows = self._sensor_maps
        within = (columns >= -0.5) & (columns < width - 0.5) & (rows >= -0.5) & (rows < height - 0.5)
        # A rectified pixel reads four raw pixels, which are among the 3 x 3 around the nearest one.
        nearest = np.zeros(within.shape, np.uint8)
        x, y = self.maps
        last_x, last_y = self.raw.width_px - 1, self.raw.height_px - 1
        read = np.isfinite(x) & np.isfinite(y)
        if self.border == "black":
            read &= (x > -1) & (x < last_x + 1) & (y > -1) & (y < last_y + 1)
        column, row = (np.rint(at[read].clip(0, last)).astype(np.intp) for at, last in ((x, last_x), (y, last_y)))
        nearest[row, column] = 1
        interpolated: NDArray[np.bool_] = self._cv2.dilate(nearest, np.ones((3, 3), np.uint8)) > 0
        return within | interpolated

    @cached_property
    def _sensor_maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The column and the row of the rectified image that each raw pixel shows, (H, W) float32 px each."""
        raw = self.raw
        across, along = _cubic(raw.width_px)
        down, below = _cubic(raw.height_px)
        grid = np.meshgrid(along, below)
        far = 4.0 * np.max([self.camera.width_px, self.camera.height_px])
        # Raw pixels beyond the view show its border. Positions far away would make the cubics overshoot in the view.
        x, y = (np.clip(np.nan_to_num(each, nan=-far), -far, far) for each in raw.to_rectified(self.pinhole, *grid))
        # Float32 holds displacements to 1e-5 px, but not positions.
        columns, rows = (
            (down @ (each - at)).astype(np.float32) @ across.T.astype(np.float32)
            for each, at in zip((x, y), grid, strict=True)
        )
        columns += np.arange(raw.width_px, dtype=np.float32)
        rows += np.arange(raw.height_px, dtype=np.float32)[:, None]
        return columns, rows

    def rectify(self, raw_image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a raw image as a user's program rectifies it, (H, W, 3) or (H, W) uint8."""
        cv2 = self._cv2
        mode = cv2.BORDER_CONSTANT if self.border == "black" else cv2.BORDER_REPLICATE
        image: NDArray[np.uint8] = cv2.remap(raw_image, *self.maps, cv2.INTER_LINEAR, borderMode=mode)
        return image


def _cubic(count: int) -> tuple[Floats, Floats]:
    """Return the weights of cubic interpolation from a grid to ``count`` pixels, (count, N), and the grid, (N,) px."""
    number = max(4, -(-(count - 1) // _GRID_PX) + 1)
    grid = np.linspace(0, count - 1, number)
    position = np.arange(count) / max(count - 1, 1) * (number - 1)
    first = np.clip(np.floor(position).astype(int) - 1, 0, number - 4)
    weights = np.zeros((count, number))
    for k in range(4):
        others = [first + each for each in range(4) if each != k]
        weight = np.prod([(position - other) / (first + k - other) for other in others], axis=0)
        weights[np.arange(count), first + k] = weight
    return weights, grid
