"""JPEG XL, lossless, through imagecodecs."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.codec import Codec, check_rgb, import_imagecodecs
from semisynth_gl.errors import ReadError

# The fastest effort: the next one takes ten times as long for a tenth of the bytes.
_EFFORT = 1


class Jxl(Codec[NDArray[np.uint8]]):
    """JPEG XL of (H, W, 3) uint8 RGB."""

    name = "jxl"
    suffix = ".jxl"
    media_type = "image/jxl"
    description = "JPEG XL, 8-bit RGB, lossless"

    def check_installed(self) -> None:
        """Raise InputError where imagecodecs is not installed."""
        import_imagecodecs(self.name)

    def encode(self, value: NDArray[np.uint8]) -> bytes:
        """Encode an image, in one thread as all codecs do."""
        data: bytes = import_imagecodecs(self.name).jpegxl_encode(
            np.ascontiguousarray(value), lossless=True, effort=_EFFORT, numthreads=1
        )
        return data

    def decode(self, data: bytes, path: Path) -> NDArray[np.uint8]:
        """Decode an image; see `Codec.decode`."""
        try:
            return check_rgb(np.asarray(import_imagecodecs(self.name).jpegxl_decode(data)), path)
        except (RuntimeError, ValueError, LookupError) as error:
            raise ReadError(path, f"cannot be decoded: {error}") from None
