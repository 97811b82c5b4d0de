"""JPEG of the highest quality, for CREStereo's loaders."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.codecs.codec import Codec
from semisynth_gl.inputs.errors import ReadError

_BEGIN, _END = b"\xff\xd8", b"\xff\xd9"


class Jpeg(Codec[NDArray[np.uint8]]):
    """JPEG of (H, W, 3) uint8 RGB or, if ``grey``, (H, W) uint8: quality 100, colour at full resolution."""

    name = "jpg"
    lossless = False

    def __init__(self, *, grey: bool = False) -> None:
        self._grey = grey
        self.description = f"{'grey ' if grey else ''}JPEG of quality 100"

    def encode(self, value: NDArray[np.uint8]) -> bytes:
        """Encode an image."""
        data = io.BytesIO()
        Image.fromarray(value).save(data, "JPEG", quality=100, subsampling="4:4:4")
        return data.getvalue()

    def decode(self, data: bytes, path: Path) -> NDArray[np.uint8]:
        """Decode an image; see `Codec.decode`."""
        if data[:2] == _BEGIN and not data.endswith(_END):
            raise ReadError(path, "does not end as a JPEG does: cut off, or something follows")
        try:
            with Image.open(io.BytesIO(data), formats=["JPEG"]) as image:
                mode, pixels = image.mode, np.asarray(image)
        except (RuntimeError, ValueError, LookupError, OSError, SyntaxError) as error:
            raise ReadError(path, f"cannot be decoded: {error}") from None
        if mode != ("L" if self._grey else "RGB"):
            raise ReadError(path, f"expected 8-bit {'grey' if self._grey else 'RGB'}, got a JPEG of the mode {mode}")
        return pixels
