"""Values of calibration files: arrays, rotations and sizes, checked as they are read."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.rig import Size
from semisynth_gl.inputs.errors import shown

# Keys of the width and the height, and keys of lists or mappings with both.
_SIZES = (("image_width", "image_height"), ("width", "height"), ("LEFT.width", "LEFT.height"))
_SIZE_PAIRS = ("image_size", "imageSize", "size", "resolution")
_LARGEST_SIDE_PX = 99_999
_SIDES = 2
# Rotations are printed with six digits.
_ROTATION_ERROR = 1e-4
_SHOWN = 400

Matrix = NDArray[np.float64]


class FormatError(Exception):
    """A file breaks its format, as the message says without naming the file."""


def numbers(key: str, node: Any, shape: tuple[int, ...] | None) -> Matrix:  # noqa: ANN401 - any YAML value
    """Return an array from a mapping with ``data``, nested lists, or a list of numbers.

    Args:
        key: for messages.
        node: the value in the file.
        shape: what is expected; None for any number of numbers, (N,).

    Raises:
        FormatError: where the numbers are others, or not finite.
    """
    data = node.get("data") if isinstance(node, Mapping) else node
    try:
        values = np.array(data, np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    stated = (node.get("rows"), node.get("cols")) if isinstance(node, Mapping) else (None, None)
    # Coefficients are written as one row, or as one column.
    fits = values.size > 0 if shape is None else values.size == np.prod(shape) and stated in ((None, None), shape)
    if not (fits and np.isfinite(values).all()):
        expected = "a list of finite numbers"
        if shape is not None:
            of_matrix = f"a {' x '.join(map(str, shape))} matrix of " if len(shape) > 1 else ""
            expected = f"{of_matrix}{np.prod(shape)} finite numbers"
        raise FormatError(f"{key}: expected {expected}, got {shown(node, _SHOWN)}")
    return values.reshape(-1 if shape is None else shape)


def rotation(key: str, node: Any) -> Matrix:  # noqa: ANN401 - any YAML value
    """Return a rotation (3, 3); raises FormatError where it is not one."""
    matrix = numbers(key, node, (3, 3))
    if not np.allclose(matrix @ matrix.T, np.eye(3), atol=_ROTATION_ERROR) or np.linalg.det(matrix) < 0:
        raise FormatError(f"{key}: expected a rotation, whose rows are unit vectors, got {matrix.tolist()}")
    return matrix


def checked_size(size: object) -> Size | None:
    """Return a width and a height as a size, None for none; raises FormatError where a side cannot be one."""
    # OpenCV writes 0 0 for an unknown size.
    if size is None or size in ([0, 0], (0, 0)):
        return None
    if not isinstance(size, list | tuple) or len(size) != _SIDES:
        raise FormatError(f"expected a width and a height, got {shown(size)}")
    try:
        width_px, height_px = int(size[0]), int(size[1])
    except (TypeError, ValueError, OverflowError):
        width_px = height_px = 0
    came = f"{shown(size[0])} x {shown(size[1])}"
    if width_px < 1 or height_px < 1:
        raise FormatError(f"expected a width and height of at least 1 pixel, got {came}")
    if max(width_px, height_px) > _LARGEST_SIDE_PX:
        raise FormatError(f"expected a width and height of at most {_LARGEST_SIDE_PX} pixels, got {came}")
    return Size(width_px, height_px)


def stated_size(values: Mapping[str, Any]) -> Size | None:
    """Return the size of images that a file states under one of the known keys; None if it states none."""
    for width, height in _SIZES:
        if width in values and height in values:
            return checked_size([values[width], values[height]])
    for key in _SIZE_PAIRS:
        value = values.get(key)
        if isinstance(value, Mapping) and "width" in value and "height" in value:
            return checked_size([value["width"], value["height"]])
        if isinstance(value, list) and len(value) == 2:
            return checked_size(value)
    return None
