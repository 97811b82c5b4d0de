"""Disparity maps from any source: PFM of any kind, NumPy arrays, 16-bit PNG."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from semisynth_gl.codecs.codec import read_bytes
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png16 import KITTI_DISPARITY, SIGNED_DISPARITY, DisparityPng16
from semisynth_gl.inputs.errors import ReadError

MAP_EXTENSIONS = (".pfm", ".npy", ".png")
"""Endings of the files that may be disparity maps."""


def read_disparity_map(
    path: Path, png_steps: float = KITTI_DISPARITY.steps, *, signed: bool = False
) -> NDArray[np.float32]:
    """Read a disparity map as (H, W) float32 px. The first bytes tell a NumPy array, a 16-bit grey PNG and a PFM apart.

    The value v of a PNG means v / ``png_steps`` px or, if ``signed``, (v - 32768) / 256 px; the value 0 becomes inf.
    The caller has to know which other values mean "no disparity".

    Raises:
        ReadError: where the file cannot be read, has another format, or does not have one value per pixel.
    """
    data = read_bytes(path)
    if data.startswith(b"\x93NUMPY"):
        return _read_npy(data, path)
    png = SIGNED_DISPARITY if signed else DisparityPng16(png_steps)
    return (png if data.startswith(b"\x89PNG") else PFM).decode(data, path)


def is_disparity_map(path: Path) -> bool:
    """Return whether a file with an ending of `MAP_EXTENSIONS` may be a disparity map: a .png must be 16-bit grey.

    Raises ReadError where a PNG is damaged.
    """
    if path.suffix.lower() != ".png":
        return True
    try:
        with Image.open(path, formats=["PNG"]) as image:
            return image.mode.startswith("I")
    except UnidentifiedImageError:
        return False
    except (OSError, Image.DecompressionBombError) as error:
        raise ReadError(path, f"cannot be read: {error}") from None


def _read_npy(data: bytes, path: Path) -> NDArray[np.float32]:
    try:
        values = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError, MemoryError) as error:
        raise ReadError(path, f"cannot be read as an array: {error}") from None
    shape = values.shape
    if values.dtype.kind not in "fiu":
        raise ReadError(path, f"expected numbers, got {values.dtype}")
    # Arrays that networks saved may have axes for batch and channel.
    while values.ndim > 2 and 1 in (values.shape[0], values.shape[-1]):
        values = values[0] if values.shape[0] == 1 else values[..., 0]
    if values.ndim != 2 or values.size == 0:
        raise ReadError(path, f"expected one value per pixel, (H, W), got an array of shape {shape}")
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)
