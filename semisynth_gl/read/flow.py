"""Flow from files: Middlebury's .flo, SceneFlow's PFM of three channels, KITTI's 16-bit PNG."""

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.read.error import ReadError
from semisynth_gl.read.pfm import decode_pfm_of_three
from semisynth_gl.read.png import decode_rgb16

_FLO_TAG = b"PIEH"
_FLO_HEADER = 12
_FLO_LARGEST = 1e9
_KITTI_STEPS = 64
_KITTI_ZERO = 2**15


def decode_flo(data: bytes, path: Path) -> NDArray[np.float32]:
    """Decode Middlebury's .flo.

    Args:
        data: the file's bytes.
        path: the file's name, for messages.

    Returns:
        (H, W, 2) float32 px, u to the right and v downwards; both inf where either is above 1e9, which says unknown.

    Raises:
        ReadError: where the tag is another, there are fewer or more values than it says, or one is not a number.
    """
    if len(data) < _FLO_HEADER or data[:4] != _FLO_TAG:
        raise ReadError(path, f"expected a .flo (it begins with {_FLO_TAG!r}, width and height), got {data[:12]!r}")
    width, height = struct.unpack("<ii", data[4:_FLO_HEADER])
    if width < 1 or height < 1:
        raise ReadError(path, f"expected a width and height of 1 or more, got {width} x {height}")
    expected, held = 8 * width * height, len(data) - _FLO_HEADER
    if held < expected:
        raise ReadError(path, f"ends after {held} of {expected} bytes of {width} x {height} pixels")
    if held > expected:
        raise ReadError(path, f"has {held - expected} bytes after its {width} x {height} pixels")
    flow = np.frombuffer(data, "<f4", offset=_FLO_HEADER).reshape(height, width, 2)
    _check_numbers(flow, path)
    unknown = (np.abs(flow) > np.float32(_FLO_LARGEST)).any(axis=2, keepdims=True)
    return np.where(unknown, np.float32(np.inf), flow)


def decode_flow_pfm(data: bytes, path: Path) -> NDArray[np.float32]:
    """Decode a PFM of u, v and 0 as (H, W, 2) float32 px, inf where it has that.

    Raises:
        ReadError: where it is another PFM, cut off, has another third channel, or one of its values is not a number.
    """
    channels = decode_pfm_of_three(data, path)
    _check_numbers(channels, path)
    others = int(np.count_nonzero(channels[..., 2]))
    if others:
        raise ReadError(path, f"expected u, v and 0 of each pixel, got a third value that is not 0 at {others} pixels")
    return np.ascontiguousarray(channels[..., :2])


def decode_flow_png16(data: bytes, path: Path) -> NDArray[np.float32]:
    """Decode KITTI's 16-bit RGB PNG as (H, W, 2) float32 px, both inf where its third channel is 0.

    Raises:
        ReadError: where it is cut off, or another kind of image.
    """
    channels = decode_rgb16(data, path)
    flow = (channels[..., :2].astype(np.float32) - np.float32(_KITTI_ZERO)) / np.float32(_KITTI_STEPS)
    return np.where(channels[..., 2:] > 0, flow, np.float32(np.inf))


def _check_numbers(values: NDArray[np.float32], path: Path) -> None:
    wrong = int(np.isnan(values).any(axis=2).sum())
    if wrong:
        raise ReadError(path, f"expected a number, or inf for none, of each pixel, got NaN at {wrong} pixels")
