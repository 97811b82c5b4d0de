"""QOI, through imagecodecs."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.codec import Codec, check_rgb, import_imagecodecs
from semisynth_gl.errors import ReadError

_END = bytes(7) + b"\x01"


class Qoi(Codec[NDArray[np.uint8]]):
    """QOI of (H, W, 3) uint8 RGB."""

    name = "qoi"
    suffix = ".qoi"
    media_type = "https://qoiformat.org/qoi-specification.pdf"
    description = "QOI, 8-bit RGB, lossless"

    def check_installed(self) -> None:
        """Raise InputError where imagecodecs is not installed."""
        import_imagecodecs(self.name)

    def encode(self, value: NDArray[np.uint8]) -> bytes:
        """Encode an image."""
        data: bytes = import_imagecodecs(self.name).qoi_encode(np.ascontiguousarray(value))
        return data

    def decode(self, data: bytes, path: Path) -> NDArray[np.uint8]:
        """Decode an image; see `Codec.decode`."""
        # Decoders make up what is missing at the end.
        if data[:4] == b"qoif" and not data.endswith(_END):
            raise ReadError(path, "does not end as a QOI does: cut off, or something follows")
        try:
            return check_rgb(np.asarray(import_imagecodecs(self.name).qoi_decode(data)), path)
        except (RuntimeError, ValueError, LookupError) as error:
            raise ReadError(path, f"cannot be decoded: {error}") from None
