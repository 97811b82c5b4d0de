"""Disparity maps from any source: PFM of any kind, NumPy's arrays, 16-bit PNG."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.codec import read_bytes
from semisynth_gl.codecs.pfm import ANY_PFM
from semisynth_gl.codecs.png import GREY16, HEAD_BYTES
from semisynth_gl.codecs.png16 import KITTI_DISPARITY, SIGNED_DISPARITY, DisparityPng16
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.inputs.user_files import NotOnDiskError, open_file

MAP_EXTENSIONS = (".pfm", ".npy", ".png")
"""Endings of the names of disparity maps."""


def read_disparity_map(
    path: Path, png_steps: float = KITTI_DISPARITY.steps, *, signed: bool = False
) -> NDArray[np.float32]:
    """Read a PFM, NumPy array or 16-bit grey PNG, told apart by its first bytes, as (H, W) float32 px.

    A PNG has ``png_steps`` values per pixel of disparity, or signed disparities, 1/256 px from 32768 on. Its 0 becomes
    inf; which other values mean "none" is for the caller to say.

    Raises:
        ReadError: where the file has another format, or not one value per pixel.
    """
    data = read_bytes(path)
    if data.startswith(b"\x93NUMPY"):
        return _read_npy(data, path)
    if data.startswith(b"\x89PNG"):
        return (SIGNED_DISPARITY if signed else DisparityPng16(png_steps)).decode(data, path)
    return ANY_PFM.decode(data, path)


def is_disparity_map(path: Path) -> bool:
    """Return whether a file of `MAP_EXTENSIONS` may be a disparity map; raises ReadError where it cannot be read.

    Only a PNG is opened to tell: a picture, which is not 16-bit grey, is no disparity map, nor is a pipe.
    """
    if path.suffix.lower() != ".png":
        return True
    try:
        with open_file(path) as file:
            return GREY16.is_kind_of(file.read(HEAD_BYTES))
    except NotOnDiskError:
        return False
    except OSError as error:
        raise ReadError(path, f"cannot be read: {error.strerror}") from None


def _read_npy(data: bytes, path: Path) -> NDArray[np.float32]:
    try:
        values = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError, MemoryError) as error:
        raise ReadError(path, f"cannot be read as an array: {error}") from None
    shape = values.shape
    if values.dtype.kind not in "fiu":
        raise ReadError(path, f"expected numbers, got {values.dtype}")
    # Networks keep axes of batch and channel.
    while values.ndim > 2 and 1 in (values.shape[0], values.shape[-1]):
        values = values[0] if values.shape[0] == 1 else values[..., 0]
    if values.ndim != 2 or values.size == 0:
        raise ReadError(path, f"expected one disparity per pixel, (H, W), got an array of shape {shape}")
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)
