"""Kinds of arrays that their numbers tell: camera matrices, rotations, projections, poses, sizes."""

import re
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from semisynth_gl.calibration.arrays import Size
from semisynth_gl.calibration.names import Entry, eye_of
from semisynth_gl.calibration.rig import turned_size_fault
from semisynth_gl.calibration.tree import Array, FormatError, Name

# Numbers are printed with six digits.
_PRINTED = 1e-4
_LARGEST = 1e9
_LARGEST_SIDE_PX = 99_999
# Names of a size, letters only.
_WIDTHS = ("width", "imagewidth", "imgwidth", "imagew", "w", "cols", "resx")
_HEIGHTS = ("height", "imageheight", "imgheight", "imageh", "h", "rows", "resy")
_SIZES = (
    *("size", "imagesize", "imgsize", "imsize", "imagersize", "framesize", "resolution", "imageresolution"),
    *("srect", "s", "wh", "dimensions", "shape", "imageshape", "imgshape", "hw"),
)
_HEIGHT_FIRST = ("shape", "hw")
# Words in names of sizes of other things.
_OTHERS = {"board", "pattern", "chessboard", "checkerboard", "chess", "grid", "tag", "marker", "roi", "crop"}


def is_camera_matrix(value: Array) -> bool:
    """Return whether nine numbers are [fx s cx; 0 fy cy; 0 0 1]."""
    if not are_numbers(value, 9):
        return False
    k = value.reshape(3, 3)
    zeros = abs(k[1, 0]) + abs(k[2, 0]) + abs(k[2, 1]) + abs(k[2, 2] - 1)
    return bool(min(k[0, 0], k[1, 1]) > 1 and zeros < _PRINTED)


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
    if not are_numbers(value, 12, 16):
        return False
    pose = value.reshape(-1, 4)
    return is_rotation(pose[:3, :3]) and (len(pose) == 3 or np.allclose(pose[3], (0, 0, 0, 1)))


def is_reprojection(value: Array) -> bool:
    """Return whether sixteen numbers are OpenCV's Q, from disparities to points."""
    if not are_numbers(value, 16):
        return False
    q = value.reshape(4, 4)
    return bool(q[0, 0] == q[1, 1] == 1 and q[2, 3] > 1 and q[3, 2] != 0 and not q[2, :3].any())


def are_numbers(value: Array, *sizes: int) -> bool:
    """Return whether an array has one of the sizes, and all its numbers are finite and of usable magnitude."""
    # Written so that nan fails too.
    return value.size in sizes and bool((np.abs(value) <= _LARGEST).all())


def is_coefficients(value: Array) -> bool:
    """Return whether an array may be the coefficients of a lens: none, or four and more in a row or a column."""
    return value.ndim < 3 and max(value.shape, default=0) == value.size and (value.size == 0 or value.size >= 4)


def checked_size(width: float, height: float) -> Size | None:
    """Return a size; None for 0 x 0, as OpenCV writes an unknown one. Raises FormatError for sides that are none."""
    if width == 0 and height == 0:
        return None
    for side in (width, height):
        if not (1 <= side <= _LARGEST_SIDE_PX and side == int(side)):
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
    sizes: dict[bool, list[Size | None]] = {True: [], False: []}
    sides: dict[tuple[Name, str], dict[str, float]] = {}
    for entry in entries:
        key = re.sub(r"\(.*?\)|[^a-z]", "", entry.key.lower())
        of_rig = cameras is None or eye_of(entry.name) in {"", *cameras}
        if not of_rig or _OTHERS & set(entry.words) or not are_numbers(entry.value, 1, 2, 3, 4):
            continue
        if entry.value.size > 1 and key in _SIZES:
            sizes["rect" in entry.words] += _listed(entry.value, key, matrices)
        elif entry.value.size == 1 and key in (*_WIDTHS, *_HEIGHTS):
            side = "width" if key in _WIDTHS else "height"
            sides.setdefault((entry.name[:-1], eye_of(entry.name)), {})[side] = float(entry.value.ravel()[0])
    sizes[False] += [checked_size(found["width"], found["height"]) for found in sides.values() if len(found) == 2]
    rectified, raw = ([size for size in sizes[key] if size is not None] for key in (True, False))
    return rectified, raw


def is_turned(size: Size, matrices: Sequence[Array]) -> bool:
    """Return whether the principal points of camera matrices say that a size is height and width."""
    return bool(matrices) and turned_size_fault(size, *matrices) is not None


def _listed(value: Array, key: str, matrices: Sequence[Array]) -> Iterator[Size | None]:
    """Yield the size that a list states, or the sizes of both cameras, as Basalt lists them."""
    # NumPy's shape begins with the height, unless a script wrote shape[::-1], and ends with the number of channels.
    shape = any(key.endswith(each) for each in _HEIGHT_FIRST)
    for first, second in (value if value.shape == (2, 2) else value.reshape(1, -1))[:, :2].tolist():
        size = checked_size(second, first) if shape else checked_size(first, second)
        yield Size(*reversed(size)) if shape and size is not None and is_turned(size, matrices) else size
