"""What decodes an image, a disparity or a flow, by the names of `semisynth_gl.encodings`."""

import io
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import inf
from pathlib import Path
from typing import Any, TypeVar

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
from semisynth_gl.read.error import ReadError, read_bytes
from semisynth_gl.read.flow import decode_flo, decode_flow_pfm, decode_flow_png16
from semisynth_gl.read.pfm import decode_pfm
from semisynth_gl.read.png import decode_grey16, decode_rgb

_QOI_END = bytes(7) + b"\x01"
_JPG_BEGIN, _JPG_END = b"\xff\xd8", b"\xff\xd9"
_STRIP_OFFSETS, _STRIP_SIZES = 273, 279  # tags of the TIFF specification
_KITTI_STEPS = 256
_Array = TypeVar("_Array")


@dataclass(frozen=True, slots=True)
class DisparityDecoder:
    """What decodes a disparity, and what its format loses.

    Attributes:
        decode: a file's bytes, and its path for messages, to (H, W) float32 px, inf where there is no truth.
        error_px: the most that a disparity is off by.
        largest_px: the largest that can be said.
    """

    decode: Callable[[bytes, Path], NDArray[np.float32]]
    error_px: float = 0.0
    largest_px: float = inf


@dataclass(frozen=True, slots=True)
class FlowDecoder:
    """What decodes a flow, and what its format loses.

    Attributes:
        decode: a file's bytes, and its path for messages, to (H, W, 2) float32 px, inf where there is none.
        error_px: the most that either component is off by.
        largest_px: the largest component that can be said, in whatever direction.
    """

    decode: Callable[[bytes, Path], NDArray[np.float32]]
    error_px: float = 0.0
    largest_px: float = inf


def read_with(decode: Callable[[bytes, Path], _Array]) -> Callable[[Path], _Array]:
    """Return what reads a file and decodes it."""
    return lambda path: decode(read_bytes(path), path)


def decode_qoi(data: bytes, path: Path) -> NDArray[np.uint8]:
    """Decode a QOI of RGB as (H, W, 3) uint8.

    Raises:
        ReadError: where it is cut off, or another kind of image.
        InputError: where imagecodecs is not installed.
    """
    # Decoders make up what is missing at the end.
    if data[:4] == b"qoif" and not data.endswith(_QOI_END):
        raise ReadError(path, "does not end as a QOI does: cut off, or something follows")
    return _rgb(codecs("qoi").qoi_decode, data, path)


def decode_jxl(data: bytes, path: Path) -> NDArray[np.uint8]:
    """Decode a JPEG XL of RGB as (H, W, 3) uint8; raises like `decode_qoi`."""
    return _rgb(codecs("jxl").jpegxl_decode, data, path)


def decode_jpg(data: bytes, path: Path) -> NDArray[np.uint8]:
    """Decode a JPEG of RGB as (H, W, 3) uint8.

    Raises:
        ReadError: where it is cut off, or another kind of image.
    """
    if data[:2] == _JPG_BEGIN and not data.endswith(_JPG_END):
        raise ReadError(path, "does not end as a JPEG does: cut off, or something follows")
    return _rgb(lambda held: Image.open(io.BytesIO(held), formats=["JPEG"]), data, path)


def decode_png16(data: bytes, path: Path, steps: int = _KITTI_STEPS) -> NDArray[np.float32]:
    """Decode disparity as 16-bit PNG: (H, W) float32 px, inf where it has 0.

    Args:
        data: the file's bytes.
        path: the file's name, for messages.
        steps: how many make a pixel; 256 in KITTI.

    Raises:
        ReadError: where it is cut off, or another kind of image.
    """
    counted = decode_grey16(data, path)
    return np.where(counted > 0, counted / np.float32(steps), np.float32(np.inf))


def decode_tiff(data: bytes, path: Path) -> NDArray[np.float32]:
    """Decode a TIFF of one float32 channel as (H, W) float32; raises like `decode_png16`."""
    try:
        with Image.open(io.BytesIO(data), formats=["TIFF"]) as image:
            if image.mode != "F":
                raise ReadError(path, f"expected one channel of float32, got mode {image.mode}")
            # libtiff is content with a strip whose check sum is missing.
            parts = zip(image.tag_v2[_STRIP_OFFSETS], image.tag_v2[_STRIP_SIZES], strict=True)  # type: ignore[attr-defined]
            if any(begin + size > len(data) for begin, size in parts):
                raise ReadError(path, "ends before its last strip does")
            return np.asarray(image, np.float32)
    except (OSError, SyntaxError, ValueError, KeyError, TypeError, struct.error, zlib.error) as error:
        raise ReadError(path, f"cannot be decoded: {error}") from None


def _rgb(decode: Callable[[bytes], Any], data: bytes, path: Path) -> NDArray[np.uint8]:
    try:
        image = np.asarray(decode(data))
    except (RuntimeError, ValueError, LookupError, OSError, SyntaxError) as error:
        raise ReadError(path, f"cannot be decoded: {error}") from None
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise ReadError(path, f"expected 8-bit RGB, got {image.dtype} of shape {image.shape}")
    return image


IMAGE_DECODERS: Mapping[ImageEncoding, Callable[[bytes, Path], NDArray[np.uint8]]] = {
    "png": decode_rgb,
    "qoi": decode_qoi,
    "jxl": decode_jxl,
}
"""Those that a config may choose. Each gives (H, W, 3) uint8 RGB."""

DISPARITY_DECODERS: Mapping[DisparityEncoding, DisparityDecoder] = {
    "pfm": DisparityDecoder(decode_pfm),
    "png16": DisparityDecoder(decode_png16, error_px=1 / 512, largest_px=65535 / 256),
    "tiff": DisparityDecoder(decode_tiff),
}
"""Those that a config may choose."""

FLOW_DECODERS: Mapping[FlowEncoding, FlowDecoder] = {
    "flo": FlowDecoder(decode_flo),
    "pfm": FlowDecoder(decode_flow_pfm),
    "png16": FlowDecoder(decode_flow_png16, error_px=1 / 128, largest_px=32767 / 64),
}
"""Those that a config or a layout may choose."""

_CRESTEREOS = DisparityDecoder(partial(decode_png16, steps=32), error_px=1 / 64, largest_px=65535 / 32)


def image_decoder(
    encoding: ImageEncoding | LayoutImageEncoding,
) -> Callable[[bytes, Path], NDArray[np.uint8]]:
    """Return what decodes images, whether a config or a layout has chosen it."""
    return decode_jpg if encoding == "jpg" else IMAGE_DECODERS[encoding]


def disparity_decoder(encoding: DisparityEncoding | LayoutDisparityEncoding) -> DisparityDecoder:
    """Return what decodes disparities, whether a config or a layout has chosen it."""
    return _CRESTEREOS if encoding == "png16-32" else DISPARITY_DECODERS[encoding]
