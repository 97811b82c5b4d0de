"""Disparity maps of anyone's: PFM of any kind, NumPy's arrays, 16-bit PNG."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.read.error import ReadError, read_bytes
from semisynth_gl.read.pfm import decode_pfm
from semisynth_gl.read.png import decode_grey16

KITTI_PNG_SCALE = 256.0
"""Levels of KITTI's 16-bit PNG per pixel of disparity."""

MAP_EXTENSIONS = (".pfm", ".npy", ".png")
"""What names of such maps end in."""


def read_disparity(path: Path, png_scale: float = KITTI_PNG_SCALE) -> NDArray[np.float32]:
    """Read a disparity map as it is: what counts as no value is for the caller to say.

    Args:
        path: .pfm, .npy or 16-bit grey .png; what it is, its first bytes say.
        png_scale: levels of a PNG per pixel of disparity.

    Returns:
        (H, W) float32, px, inf where a PNG has 0.

    Raises:
        ReadError: where it is none of these, or not one value per pixel.
    """
    data = read_bytes(path)
    if data.startswith(b"\x93NUMPY"):
        return _npy(path)
    if data.startswith(b"\x89PNG"):
        levels = decode_grey16(data, path)
        return np.where(levels > 0, levels.astype(np.float32) / np.float32(png_scale), np.float32(np.inf))
    return decode_pfm(data, path, any_scale=True)


def _npy(path: Path) -> NDArray[np.float32]:
    try:
        values = np.load(path, allow_pickle=False)
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
