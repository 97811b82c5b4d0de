"""A rendered stereo pair as arrays, with the origin at the top left."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, Crop, Eye, StereoCamera
from semisynth_gl.frame.channels import CHANNELS, OUTSIDE, ROLES, SKY, ViewArrays
from semisynth_gl.inputs.arguments import check_one_of


def as_rgb(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image as (H, W, 3): for a grey image, (H, W), a read-only view of it with three equal components."""
    return image if image.ndim == 3 else np.broadcast_to(image[..., np.newaxis], (*image.shape, 3))


def finite_range(values: NDArray[np.float32]) -> tuple[int, float, float]:
    """Return the number of finite values, the smallest and the largest of them; all three are 0 where there is none."""
    if values.size:
        smallest, largest = values.min(), values.max()
        # Usually all are finite. A copy of the finite values would take eight times as long.
        if np.isfinite(smallest) and np.isfinite(largest):
            return values.size, float(smallest), float(largest)
    finite = values[np.isfinite(values)]
    return (finite.size, float(finite.min()), float(finite.max())) if finite.size else (0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A rendered stereo pair with its truth.

    Disparity is x_left - x_right in px in both views. It is inf where nothing is seen and, without the config's
    ``disparity.signed``, where x_left - x_right is zero or negative. Depth and normals are in the camera frame of their
    view. If only the left view has truth, the right view has its image and, if requested, its raw image and map.

    Attributes:
        camera: the camera of the images; in a cropped pair, the camera of the crop.
        left: the left view.
        right: the right view.
    """

    camera: StereoCamera
    left: ViewArrays
    right: ViewArrays

    @classmethod
    def from_arrays(cls, camera: StereoCamera, arrays: Mapping[str, NDArray[Any]]) -> "Frame":
        """Build a frame from arrays by role, as `arrays` returns them; see `ViewArrays` for errors."""
        left, right = (
            ViewArrays({name: arrays[row.role(eye)] for name, row in CHANNELS.items() if row.role(eye) in arrays})
            for eye in EYES
        )
        return cls(camera, left, right)

    def view(self, eye: Eye) -> ViewArrays:
        """Return one eye's view; raises InputError if ``eye`` is not "left" or "right"."""
        check_one_of("eye", eye, EYES)
        return self.left if eye == "left" else self.right

    def correspondences(self, eye: Eye) -> NDArray[np.float64]:
        """Return the vector from each pixel of a view to the same point in the other view, from the view's disparity.

        The result is (H, W, 2) float64 px, to the right and down, and nan where there is no disparity. The output
        ``correspondence`` has the same values, rounded to float32.
        """
        disparity = self.view(eye).disparity.astype(np.float64)
        disparity[~np.isfinite(disparity)] = np.nan
        if self.camera.rectified:
            along = -disparity if eye == "left" else disparity
            return np.stack([along, 0 * along], axis=-1)
        y_px, x_px = np.mgrid[: disparity.shape[0], : disparity.shape[1]].astype(np.float64)
        depth_m = self.camera.depth_at(eye, x_px, y_px, disparity)
        return self.camera.correspondence(eye, x_px, y_px, depth_m)

    def points(self, eye: Eye = "left") -> NDArray[np.float32]:
        """Return the point that each pixel of a view shows, from its disparity and the calibration.

        The result is (H, W, 3) float32: x right, y down and z forward in the left camera's frame, metres, for either
        view. All three are nan where the pixel has no disparity or shows a point at infinity, such as the sky, and
        everywhere with a baseline of 0.

        Raises:
            InputError: where there is no such view.
            AttributeError: where the view has no disparity.
        """
        disparity = self.view(eye).disparity
        y_px, x_px = np.mgrid[: disparity.shape[0], : disparity.shape[1]]
        depth_m = self.camera.depth_at(eye, x_px, y_px, disparity.astype(np.float64))
        has_point = np.isfinite(disparity) & np.isfinite(depth_m) & (depth_m > 0)
        if self.camera.rectified:
            # The disparity of infinity, which float32 may have rounded to a finite depth.
            has_point &= disparity != np.float32(-self.camera.doffs_px)
        if "sky" in self.view(eye):
            has_point &= self.view(eye).sky != SKY
        points = self.camera.rays(eye, x_px, y_px) * np.where(has_point, depth_m, np.nan)[..., None]
        points[..., 0] += self.camera.offset_m(eye)
        return points.astype(np.float32)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return both views' arrays by role: ``left``, ``right``, ``disparity_left`` and so on."""
        views = {role: (self.view(eye), channel.name) for role, (eye, channel) in ROLES.items()}
        return {role: view[name] for role, (view, name) in views.items() if name in view}

    def cropped(self, crop: Crop) -> "Frame":
        """Return a crop of both views, as copies. Raw images stay whole, since their maps refer to whole images.

        Masks keep their values, which refer to whole images; see `with_own_masks`.

        Raises:
            InputError: where the crop reaches beyond the image.
        """
        camera = self.camera.cropped(crop)
        part = slice(crop.y_px, crop.bottom_px), slice(crop.x_px, crop.right_px)
        left, right = (
            ViewArrays({name: (array if name == "raw" else array[part]).copy() for name, array in view.items()})
            for view in (self.left, self.right)
        )
        return Frame(camera, left, right)

    def with_own_masks(self) -> "Frame":
        """Return the frame with masks that refer to its images: they are 0 also where a point is outside a crop."""
        views = []
        for eye in EYES:
            view, masks = self.view(eye), {}
            for name, channel in CHANNELS.items():
                if channel.mask is not None and channel.mask in view:
                    vectors = self.correspondences(eye) if name == "disparity" else view[name]
                    masks[channel.mask] = np.where(_within(vectors), view[channel.mask], np.uint8(OUTSIDE))
            views.append(view.with_channels(masks))
        return Frame(self.camera, *views)


def _within(vectors: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Return where vectors (H, W, 2) from the pixels of an image end within it, (H, W) bool."""
    height, width = vectors.shape[:2]
    x, y = np.arange(width) + vectors[..., 0], np.arange(height)[:, None] + vectors[..., 1]
    within: NDArray[np.bool_] = (x >= -0.5) & (x < width - 0.5) & (y >= -0.5) & (y < height - 0.5)
    return within
