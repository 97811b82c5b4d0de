"""What encodes an image, a disparity or a flow, by the names of `semisynth_gl.encodings`."""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import inf

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.encodings import (
    DisparityEncoding,
    FlowEncoding,
    ImageEncoding,
    LayoutDisparityEncoding,
    LayoutImageEncoding,
    codecs,
)
from semisynth_gl.write.flow import beyond_flow_png16, encode_flo, encode_flow_pfm, encode_flow_png16
from semisynth_gl.write.pfm import encode_pfm
from semisynth_gl.write.png import encode_png
from semisynth_gl.write.png16 import beyond_px, encode_png16
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


@dataclass(frozen=True, slots=True)
class FlowEncoder:
    """What encodes a flow.

    Attributes:
        encode: (H, W, 2) float32 px, inf where there is none, to a file's bytes.
        beyond: from such a flow to (H, W) bool, where it cannot be said; None where all of it can be.
    """

    encode: Callable[[NDArray[np.float32]], bytes]
    beyond: Callable[[NDArray[np.float32]], NDArray[np.bool_]] | None = None


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


def encode_jpg(image: NDArray[np.uint8]) -> bytes:
    """Encode (H, W, 3) RGB as JPEG that loses as little as JPEG can: quality 100, colour at full size."""
    data = io.BytesIO()
    Image.fromarray(image).save(data, "JPEG", quality=100, subsampling="4:4:4")
    return data.getvalue()


IMAGE_ENCODERS: Mapping[ImageEncoding, Callable[[NDArray[np.uint8]], bytes]] = {
    "png": encode_png,
    "qoi": encode_qoi,
    "jxl": encode_jxl,
}
"""Those that a config may choose. Each takes (H, W, 3) uint8 RGB."""

DISPARITY_ENCODERS: Mapping[DisparityEncoding, DisparityEncoder] = {
    "pfm": DisparityEncoder(encode_pfm),
    "png16": DisparityEncoder(encode_png16, beyond_px()),
    "tiff": DisparityEncoder(encode_tiff),
}
"""Those that a config may choose."""

FLOW_ENCODERS: Mapping[FlowEncoding, FlowEncoder] = {
    "flo": FlowEncoder(encode_flo),
    "pfm": FlowEncoder(encode_flow_pfm),
    "png16": FlowEncoder(encode_flow_png16, beyond_flow_png16),
}
"""Those that a config or a layout may choose."""

_CRESTEREOS = DisparityEncoder(partial(encode_png16, steps=32), beyond_px(32))


def image_encoder(encoding: ImageEncoding | LayoutImageEncoding) -> Callable[[NDArray[np.uint8]], bytes]:
    """Return what encodes images, whether a config or a layout has chosen it."""
    return encode_jpg if encoding == "jpg" else IMAGE_ENCODERS[encoding]


def disparity_encoder(encoding: DisparityEncoding | LayoutDisparityEncoding) -> DisparityEncoder:
    """Return what encodes disparities, whether a config or a layout has chosen it."""
    return _CRESTEREOS if encoding == "png16-32" else DISPARITY_ENCODERS[encoding]
