"""Kinds of arrays, told by their numbers, and by words where numbers do not tell; sizes of images."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from semisynth_gl.calibration.names import Entry, label_of
from semisynth_gl.calibration.tree import Array, FormatError, Name

# Numbers are printed with six digits.
_PRINTED = 1e-4
_LARGEST = 1e9
_LARGEST_SIDE_PX = 99_999
# A principal point farther from the centre than this, as a fraction of the side, may be that of another size.
_NEAR_CENTRE = 0.1
# Names of sizes, letters only.
_WIDTHS = ("width", "imagewidth", "imgwidth", "imagew", "w", "cols", "resx")
_HEIGHTS = ("height", "imageheight", "imgheight", "imageh", "h", "rows", "resy")
_SIZE = r"(image|img|im|imager|frame)?size|(image)?resolution|srect|s|wh|dimensions|(image|img)?shape|hw"
# Words in names of sizes of other things.
_OTHERS = "board|pattern|chess|checker|grid|tag|marker|roi|crop"


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
    return max(value.shape, default=0) == value.size and value.size != 1 and are_numbers(value, 0, *range(4, 33))


class Kind(NamedTuple):
    """What arrays of a kind are: a test of their numbers, a regular expression for a word of their names, a shape."""

    fits: Callable[[Array], bool]
    words: str
    shape: tuple[int, ...]


KINDS: Mapping[str, Kind] = {
    "K": Kind(is_camera_matrix, "", (3, 3)),
    "D": Kind(is_coefficients, "d$|dist|coef|kc|radtan|equidistant", (-1,)),
    "R": Kind(is_rotation, "", (3, 3)),
    "P": Kind(is_projection, "", (3, 4)),
    "Q": Kind(is_reprojection, "", (4, 4)),
    "T": Kind(lambda value: are_numbers(value, 3), "t$|tr$|trans|trns|tvec|shift|position", (3,)),
}
"""Kinds of arrays by OpenCV's names; R1, R2 and R are of one kind."""


def stated_sizes(entries: Iterable[Entry], matrices: Sequence[Array]) -> tuple[list[Size], list[Size]]:
    """Return two lists: the sizes of rectified images, and the sizes of raw images.

    Height and width change places where the principal points of the camera matrices say so. 0 x 0 is OpenCV's unknown
    size. Raises FormatError where a side is no number of pixels.
    """
    sides: dict[tuple[Name, bool], list[float]] = {}
    for entry in entries:
        value, key = entry.value.ravel(), (entry.name, entry.has("rect"))
        if entry.has(_OTHERS) or not are_numbers(value, 1, 2, 3, 4):
            continue
        if value.size > 1 and re.fullmatch(_SIZE, entry.key):
            sides[key] = value[:2].tolist()[:: -1 if entry.key.endswith(("shape", "hw")) else 1]
        elif value.size == 1 and entry.key in (*_WIDTHS, *_HEIGHTS):
            found = sides.setdefault(((*entry.name[:-1], label_of(entry.name)), False), [0.0, 0.0])
            found[entry.key in _HEIGHTS] = float(value[0])
    rectified, raw = list[Size](), list[Size]()
    for (_, of_rectified), (width, height) in sides.items():
        if not all(0 <= side <= _LARGEST_SIDE_PX and side == int(side) for side in (width, height)):
            raise FormatError(f"expected a width and height of whole pixels, got {width:g} x {height:g}")
        size = Size(int(width), int(height))
        if all(size):
            turned = matrices and turned_size_fault(size, *matrices)
            (rectified if of_rectified else raw).append(Size(*size[::-1]) if turned else size)
    return rectified, raw


def turned_size_fault(size: Size, *matrices: Array) -> str | None:
    """Return a message if width and height are swapped, judged by the principal points; None if they are not.

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
