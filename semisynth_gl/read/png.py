"""PNG of exactly one kind: a loader that gets another kind reads nonsense without a word."""

import io
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.read.error import ReadError, read_bytes

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_END = b"\x00\x00\x00\x00IEND\xaeB\x60\x82"
_GREY, _RGB = 0, 2  # colour types of the PNG specification
_COLOURS = {_GREY: "grey", _RGB: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGB with alpha"}
# Far above any camera, and far below what fills the memory when a header lies.
_MOST_PIXELS = 178_956_970  # as Pillow


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """Read an 8-bit RGB PNG as (H, W, 3) uint8.

    Raises:
        ReadError: where it is missing, cut off, or another kind of image.
    """
    return decode_rgb(read_bytes(path), path)


def read_grey(path: Path) -> NDArray[np.uint8]:
    """Read an 8-bit PNG of one channel as (H, W) uint8; raises like `read_rgb`."""
    return decode_grey(read_bytes(path), path)


def read_grey16(path: Path) -> NDArray[np.uint16]:
    """Read a 16-bit PNG of one channel as (H, W) uint16; raises like `read_rgb`."""
    return decode_grey16(read_bytes(path), path)


def decode_rgb(data: bytes, path: Path) -> NDArray[np.uint8]:
    """Decode what `read_rgb` reads; the path is for messages."""
    return _decode(data, path, 8, _RGB)


def decode_grey(data: bytes, path: Path) -> NDArray[np.uint8]:
    """Decode what `read_grey` reads; the path is for messages."""
    return _decode(data, path, 8, _GREY)


def decode_grey16(data: bytes, path: Path) -> NDArray[np.uint16]:
    """Decode what `read_grey16` reads; the path is for messages."""
    # Pillow opens 16-bit grey as 16 or 32-bit integers, depending on its version.
    return np.asarray(_decode(data, path, 16, _GREY)).astype(np.uint16)


def decode_rgb16(data: bytes, path: Path) -> NDArray[np.uint16]:
    """Decode a 16-bit RGB PNG as (H, W, 3) uint16; the path is for messages, and it raises like `read_rgb`."""
    # Pillow keeps the higher byte of each value; where it takes the bytes to be swapped, that is the lower one.
    high, low = (_decode(data, path, 16, _RGB, raw_mode).astype(np.uint16) for raw_mode in ("RGB;16B", "RGB;16L"))
    return (high << np.uint16(8)) | low


def _decode(data: bytes, path: Path, bits: int, colour: int, raw_mode: str | None = None) -> NDArray[np.uint8]:
    # The header is read here because Pillow opens 16-bit RGB as 8-bit RGB.
    if data[:8] != _SIGNATURE or len(data) < 33 or data[12:16] != b"IHDR":
        raise ReadError(path, f"expected a PNG, got {data[:8]!r}")
    width, height, has_bits, has_colour = struct.unpack(">IIBB", data[16:26])
    if (has_bits, has_colour) != (bits, colour):
        kind = _COLOURS.get(has_colour, f"colour type {has_colour}")
        raise ReadError(path, f"expected {bits}-bit {_COLOURS[colour]}, got {has_bits}-bit {kind}")
    if width * height > _MOST_PIXELS:
        raise ReadError(path, f"claims {width} x {height} pixels")
    if not data.endswith(_END):
        raise ReadError(path, "does not end as a PNG does: cut off, or something follows")
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            if raw_mode is not None:
                image.tile = [tile._replace(args=raw_mode) for tile in image.tile]
            return np.asarray(image)
    except (OSError, SyntaxError, ValueError, struct.error, zlib.error) as error:
        raise ReadError(path, f"cannot be decoded: {error}") from None
