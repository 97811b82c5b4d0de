"""Images of monochrome cameras, for formats and loaders that need three channels."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.codec import Codec
from semisynth_gl.inputs.errors import ReadError

# Size of images with three equal channels over that of RGB images, measured over the packaged configs.
_SHARE_OF_BYTES = 0.65


class ThreeEqual(Codec[NDArray[np.uint8]]):
    """(H, W) uint8 grey, stored by the codec ``rgb`` as three equal channels; `decode` returns one of them."""

    def __init__(self, rgb: Codec[NDArray[np.uint8]]) -> None:
        self.rgb = rgb
        self.name = rgb.name
        self.description = f"{rgb.description}, three equal channels"
        self.is_image = rgb.is_image
        self.lossless = rgb.lossless
        self.pixel_bytes = _SHARE_OF_BYTES * rgb.pixel_bytes

    @property
    def suffix(self) -> str:
        """The ending of the format's files, with the dot."""
        return self.rgb.suffix

    def encode(self, value: NDArray[np.uint8]) -> bytes:
        """Encode an image, (H, W)."""
        return self.rgb.encode(np.repeat(value[..., np.newaxis], 3, axis=2))

    def decode(self, data: bytes, path: Path) -> NDArray[np.uint8]:
        """Decode an image, (H, W); see `Codec.decode`."""
        image = self.rgb.decode(data, path)
        grey = np.ascontiguousarray(image[..., 0])
        if not (image == grey[..., np.newaxis]).all():
            raise ReadError(path, "expected the image of a monochrome camera, got channels that differ")
        return grey
