"""PFM, the benchmarks' format for float disparity, and SceneFlow's for flow."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.read.error import ReadError, read_bytes

# The strict form is the one that every loader of the field reads: with CRLF OpenCV returns nothing.
_STRICT = re.compile(rb"P[Ff]\n([0-9]{1,9}) ([0-9]{1,9})\n(-1\.0)\n")
_ANY = re.compile(rb"P[Ff]\s+([0-9]{1,9})\s+([0-9]{1,9})\s+([-+0-9.eE]{1,32})(?:\r\n|\s)")
_ONE, _THREE = b"Pf", b"PF"


def decode_pfm(data: bytes, path: Path, *, any_scale: bool = False) -> NDArray[np.float32]:
    """Decode a one-channel PFM.

    Args:
        data: the file's bytes.
        path: the file's name, for messages.
        any_scale: accept other people's PFM too: big-endian, any scale (its magnitude is ignored, as benchmarks do) and
            any white space in the header. Otherwise only ``Pf``, ``W H`` and ``-1.0``, a line each.

    Returns:
        (H, W) float32, top row first.

    Raises:
        ReadError: where the header is another, or there are fewer or more values than it says.
    """
    return _decode(data, path, _ONE, any_scale=any_scale)[..., 0]


def decode_pfm_of_three(data: bytes, path: Path) -> NDArray[np.float32]:
    """Decode a PFM of three channels as (H, W, 3) float32, top row first: of ``PF``, ``W H`` and ``-1.0`` alone.

    Args:
        data: the file's bytes.
        path: the file's name, for messages.

    Raises:
        ReadError: where the header is another, or there are fewer or more values than it says.
    """
    return _decode(data, path, _THREE, any_scale=False)


def _decode(data: bytes, path: Path, kind: bytes, *, any_scale: bool) -> NDArray[np.float32]:
    header = (_ANY if any_scale else _STRICT).match(data)
    if header is None or not data.startswith(kind):
        name = kind.decode()
        wanted = f"{name}, width and height, scale" if any_scale else rf"{name}\nW H\n-1.0\n"
        raise ReadError(path, f"expected a PFM header ({wanted}), got {data[:24]!r}")
    width, height = int(header[1]), int(header[2])
    if width == 0 or height == 0:
        raise ReadError(path, f"holds no pixel: {width} x {height}")
    channels = 1 if kind == _ONE else 3
    expected, held = 4 * channels * width * height, len(data) - header.end()
    if held < expected:
        raise ReadError(path, f"ends after {held} of {expected} bytes of {width} x {height} pixels")
    if held > expected:
        raise ReadError(path, f"has {held - expected} bytes after its {width} x {height} pixels")
    try:
        little = float(header[3]) < 0
    except ValueError:
        raise ReadError(path, f"expected a number as the scale, got {header[3]!r}") from None
    rows = np.frombuffer(data, "<f4" if little else ">f4", offset=header.end())
    return np.ascontiguousarray(rows.reshape(height, width, channels)[::-1], np.float32)


def read_pfm(path: Path, *, any_scale: bool = False) -> NDArray[np.float32]:
    """Read a one-channel PFM as (H, W) float32, top row first; see `decode_pfm`."""
    return decode_pfm(read_bytes(path), path, any_scale=any_scale)
