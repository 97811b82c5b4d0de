"""What encodes an image or a disparity, by the names of `semisynth_gl.encodings`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.encodings import DisparityEncoding, ImageEncoding, codecs
from semisynth_gl.write.pfm import encode_pfm
from semisynth_gl.write.png import encode_png
from semisynth_gl.write.png16 import BEYOND_PX, encode_png16
from semisynth_gl.write.tiff import encode_tiff

# The fastest: the next one takes ten times as long for a tenth of the bytes.
_JXL_EFFORT = 1


@dataclass(frozen=True, slots=True)
class DisparityEncoder:
    """What encodes a disparity.

    Attributes:
        encode: (H, W) float32 px, inf where there is no truth, to a file's bytes.
        beyond_px: disparities from here on cannot be said.
    """

    encode: Callable[[NDArray[np.float32]], bytes]
    beyond_px: float = inf


def encode_qoi(image: NDArray[np.uint8]) -> bytes:
    """Encode (H, W, 3) RGB as QOI; needs imagecodecs."""
    data: bytes = codecs("qoi").qoi_encode(np.ascontiguousarray(image))
    return data


def encode_jxl(image: NDArray[np.uint8]) -> bytes:
    """Encode (H, W, 3) RGB as lossless JPEG XL, in one thread as all encoders; needs imagecodecs."""
    data: bytes = codecs("jxl").jpegxl_encode(
        np.ascontiguousarray(image), lossless=True, effort=_JXL_EFFORT, numthreads=1
    )
    return data


IMAGE_ENCODERS: Mapping[ImageEncoding, Callable[[NDArray[np.uint8]], bytes]] = {
    "png": encode_png,
    "qoi": encode_qoi,
    "jxl": encode_jxl,
}
"""Each takes (H, W, 3) uint8 RGB."""

DISPARITY_ENCODERS: Mapping[DisparityEncoding, DisparityEncoder] = {
    "pfm": DisparityEncoder(encode_pfm),
    "png16": DisparityEncoder(encode_png16, BEYOND_PX),
    "tiff": DisparityEncoder(encode_tiff),
}
