"""Kinds of arrays that their numbers tell: camera matrices, rotations, projections, poses, sizes."""

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from semisynth_gl.calibration.names import Entry, eye_of
from semisynth_gl.calibration.tree import Array, FormatError, Name

# Numbers are printed with six digits.
_PRINTED = 1e-4
_LARGEST = 1e9
_LARGEST_SIDE_PX = 99_999
# A principal point farther from the centre than this, as a fraction of the side, may be that of another size.
_NEAR_CENTRE = 0.1
# Names of a size, letters only.
_WIDTHS = ("width", "imagewidth", "imgwidth", "imagew", "w", "cols", "resx")
_HEIGHTS = ("height", "imageheight", "imgheight", "imageh", "h", "rows", "resy")
_SIZES = (
    *("size", "imagesize", "imgsize", "imsize", "imagersize", "framesize", "resolution", "imageresolution"),
    *("srect", "s", "wh", "dimensions", "shape", "imageshape", "imgshape", "hw"),
)
# Words in names of sizes of other things.
_OTHERS = {"board", "pattern", "chessboard", "checkerboard", "chess", "grid", "tag", "marker", "roi", "crop"}


class Size(NamedTuple):
    """Size of an image, pixels."""

    width_px: int
    height_px: int

    def __str__(self) -> str:
        return f"{self.width_px} x {self.height_px}"

    def scaled(self, scale: float) -> "Size":
        """Return the size times a factor, rounded to whole pixels."""
        return Size(*(max(1, int(side * scale + 0.5)) for side in self))


def are_numbers(value: Array, *sizes: int) -> bool:
    """Return whether an array has one of the sizes, and all its numbers are finite and of usable magnitude."""
    # Written so that nan fails too.
    return value.size in sizes and bool((np.abs(value) <= _LARGEST).all())


def is_camera_matrix(value: Array) -> bool:
    """Return whether nine numbers are [fx s cx; 0 fy cy; 0 0 1]."""
    if not are_numbers(value, 9):
        return False
    k = value.reshape(3, 3)
    return bool(min(k[0, 0], k[1, 1]) > 1 and np.abs([k[1, 0], *(k[2] - (0, 0, 1))]).sum() < _PRINTED)


def is_rotation(value: Array) -> bool:
    """Return whether nine numbers are a rotation."""
    if not are_numbers(value, 9):
        return False
    r = value.reshape(3, 3)
    return bool(np.allclose(r @ r.T, np.eye(3), atol=_PRINTED) and np.linalg.det(r) > 0)


def is_rotation_vector(value: Array) -> bool:
    """Return whether three numbers may be a rotation's axis times its angle, less than a full turn."""
    return are_numbers(value, 3) and bool(np.linalg.norm(value) < 2 * np.pi)


def is_projection(value: Array) -> bool:
    """Return whether twelve numbers are the projection matrix of a rectified camera."""
    return are_numbers(value, 12) and is_camera_matrix(value.reshape(3, 4)[:, :3])


def is_pose(value: Array) -> bool:
    """Return whether 12 or 16 numbers are a rotation and a translation."""
    pose = value.reshape(-1, 4) if are_numbers(value, 12, 16) else np.zeros((3, 4))
    return is_rotation(pose[:3, :3]) and np.allclose(pose[3:], (0, 0, 0, 1))


def is_reprojection(value: Array) -> bool:
    """Return whether sixteen numbers are OpenCV's Q, from disparities to points."""
    if not are_numbers(value, 16):
        return False
    q = value.reshape(4, 4)
    return bool(q[0, 0] == q[1, 1] == 1 and q[2, 3] > 1 and q[3, 2] != 0 and not q[2, :3].any())


def is_coefficients(value: Array) -> bool:
    """Return whether an array may be the coefficients of a lens: none, or four and more in a row or a column."""
    return value.ndim < 3 and max(value.shape, default=0) == value.size and (value.size == 0 or value.size >= 4)


def checked_size(width: float, height: float) -> Size | None:
    """Return a size; None for 0 x 0, as OpenCV writes an unknown one. Raises FormatError for sides that are none."""
    if width == height == 0:
        return None
    if not all(1 <= side <= _LARGEST_SIDE_PX and side == int(side) for side in (width, height)):
        raise FormatError(
            f"expected a width and height of 1 to {_LARGEST_SIDE_PX} whole pixels, got {width:g} x {height:g}"
        )
    return Size(int(width), int(height))


def stated_sizes(
    entries: Iterable[Entry], cameras: tuple[str, str] | None, matrices: Sequence[Array]
) -> tuple[list[Size], list[Size]]:
    """Return two lists: the sizes of rectified images, and the sizes of raw images.

    Args:
        entries: the arrays of a calibration.
        cameras: the left and the right camera by number or name, where others do not count; None for all.
        matrices: camera matrices; their principal points tell whether a shape begins with the height.

    Raises:
        FormatError: where a side is no number of pixels.
    """
    rectified, raw = list[Size | None](), list[Size | None]()
    sides: dict[tuple[Name, str], dict[str, float]] = {}
    for entry in entries:
        key = re.sub(r"\(.*?\)|[^a-z]", "", entry.key.lower())
        of_rig = cameras is None or eye_of(entry.name) in {"", *cameras}
        if not of_rig or _OTHERS & set(entry.words) or not are_numbers(entry.value, 1, 2, 3, 4):
            continue
        if entry.value.size > 1 and key in _SIZES:
            # Basalt lists the sizes of both cameras, NumPy's shape ends with the number of channels.
            rows = entry.value if entry.value.shape == (2, 2) else entry.value.reshape(1, -1)
            found = [checked_size(*row[:2]) for row in rows.tolist()]
            if key.endswith(("shape", "hw")):  # begins with the height, unless a script wrote shape[::-1]
                turned = [each and Size(*reversed(each)) for each in found]
                found = [a if b and is_turned(b, matrices) else b for a, b in zip(found, turned, strict=True)]
            (rectified if "rect" in entry.words else raw).extend(found)
        elif entry.value.size == 1 and key in (*_WIDTHS, *_HEIGHTS):
            side = "width" if key in _WIDTHS else "height"
            sides.setdefault((entry.name[:-1], eye_of(entry.name)), {})[side] = float(entry.value.ravel()[0])
    raw += [checked_size(**found) for found in sides.values() if len(found) == 2]
    return [size for size in rectified if size], [size for size in raw if size]


def is_turned(size: Size, matrices: Sequence[Array]) -> bool:
    """Return whether the principal points of camera matrices say that a size is height and width."""
    return bool(matrices) and turned_size_fault(size, *matrices) is not None


def turned_size_fault(size: Size, *matrices: Array) -> str | None:
    """Return what is wrong with a size whose width and height have changed places, by camera matrices; None for others.

    The principal points are far from the centre of such a size, and near the centre of the turned one.
    """

    def distance(width_px: int, height_px: int) -> float:
        return max(float(abs(m[k, 2] / side - 0.5)) for m in matrices for k, side in enumerate((width_px, height_px)))

    turned = Size(size.height_px, size.width_px)
    far = distance(*size)
    if far <= _NEAR_CENTRE or distance(*turned) > min(_NEAR_CENTRE, far / 2):
        return None
    cx_px, cy_px = matrices[0][:2, 2]
    return (
        f"the principal point ({cx_px:.6g}, {cy_px:.6g}) is far from the centre of images of {size}, and near that of "
        f"{turned}: the size is probably written as height, width: expected width, then height"
    )
