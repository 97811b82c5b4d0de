"""JPEG of the highest quality, for CREStereo's loaders."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.codecs.codec import Codec, decode_image
from semisynth_gl.inputs.errors import ReadError


class Jpeg(Codec[NDArray[np.uint8]]):
    """JPEG of (H, W, 3) uint8 RGB or, if ``grey``, (H, W) uint8: quality 100, colour at full resolution."""

    suffix = ".jpg"
    lossless = False

    def __init__(self, *, grey: bool = False) -> None:
        self._mode = "L" if grey else "RGB"
        self.description = f"{'grey ' if grey else ''}JPEG of quality 100"

    def encode(self, value: NDArray[np.uint8]) -> bytes:
        """Encode an image."""
        data = io.BytesIO()
        Image.fromarray(value).save(data, "JPEG", quality=100, subsampling="4:4:4")
        return data.getvalue()

    def decode(self, data: bytes, path: Path) -> NDArray[np.uint8]:
        """Decode an image; see `Codec.decode`."""
        mode, pixels = decode_image(data, path, "JPEG", b"\xff\xd9")
        if mode != self._mode:
            raise ReadError(path, f"expected a JPEG of the mode {self._mode}, got {mode}")
        return pixels


JPEG, GREY_JPEG = Jpeg(), Jpeg(grey=True)
