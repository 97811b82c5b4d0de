"""PNG of one bit depth and colour type. Other types are rejected, since many loaders misread them silently."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from semisynth_gl.codecs.codec import Codec, decode_image
from semisynth_gl.inputs.errors import ReadError

# PNG's filter that stores the difference to the pixel above. With one filter for all rows, a 1500 x 1000 pair takes a
# seventh of the time of Pillow's fastest level, at the same file size.
_FILTER_UP = 2
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_END = b"\x00\x00\x00\x00IEND\xaeB\x60\x82"
# ISA-L's second fastest level.
_LEVEL = 1
# Number of bytes that ISA-L buffers ahead of its position.
_AHEAD = 288
_GREY, _RGB = 0, 2  # colour types of the PNG specification
_COLOURS = {_GREY: "grey", _RGB: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGB with alpha"}


class Png(Codec[NDArray[Any]]):
    """PNG of uint8 or uint16: (H, W) grey if ``components`` is 1, (H, W, 3) RGB if it is 3."""

    suffix = ".png"

    def __init__(self, dtype: type[np.uint8 | np.uint16], components: int) -> None:
        self._bits = 8 * np.dtype(dtype).itemsize
        self._colour = _GREY if components == 1 else _RGB
        self.description = f"{self._bits}-bit {_COLOURS[self._colour]} PNG"

    def encode(self, value: NDArray[Any]) -> bytes:
        """Encode an image without loss."""
        height, width = value.shape[:2]
        # PNG stores the high byte first.
        rows = np.ascontiguousarray(value, value.dtype.newbyteorder(">")).reshape(height, -1).view(np.uint8)
        filtered = np.empty((height, rows.shape[1] + 1), np.uint8)
        filtered[:, 0] = _FILTER_UP
        filtered[0, 1:] = rows[0]
        np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
        header = struct.pack(">IIBBBBB", width, height, self._bits, self._colour, 0, 0, 0)
        return b"".join([_SIGNATURE, *_chunk(b"IHDR", header), *_chunk(b"IDAT", deflate(filtered)), _END])

    def decode(self, data: bytes, path: Path) -> NDArray[Any]:
        """Decode an image; see `Codec.decode`."""
        # The header is read here because Pillow opens 16-bit RGB as 8-bit RGB.
        if data[:8] != _SIGNATURE or len(data) < 26:
            raise ReadError(path, f"expected a PNG, got {data[:8]!r}")
        bits, colour = data[24:26]
        if (bits, colour) != (self._bits, self._colour):
            kind = f"{bits}-bit {_COLOURS.get(colour, f'colour type {colour}')}"
            raise ReadError(path, f"expected {self._bits}-bit {_COLOURS[self._colour]}, got {kind}")
        if self._bits == 16 and self._colour == _RGB:
            # Pillow keeps only one byte of each value: the high byte, or the low byte if told that bytes are swapped.
            high, low = (decode_image(data, path, "PNG", _END, mode)[1] for mode in ("RGB;16B", "RGB;16L"))
            return np.asarray((high.astype(np.uint16) << np.uint16(8)) | low)
        pixels = decode_image(data, path, "PNG", _END)[1]
        # Pillow's version decides whether it opens 16-bit grey as 16-bit or 32-bit integers.
        return pixels if self._bits == 8 else pixels.astype(np.uint16)


class GreyAsRgb(Codec[NDArray[np.uint8]]):
    """(H, W) uint8 grey, stored by the codec ``rgb`` as three equal channels; `decode` returns the first."""

    def __init__(self, rgb: Codec[NDArray[np.uint8]]) -> None:
        self.rgb = rgb
        self.suffix = rgb.suffix
        self.description = f"{rgb.description}, three equal channels"
        self.lossless = rgb.lossless

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


RGB8, RGB16 = Png(np.uint8, 3), Png(np.uint16, 3)
GREY8, GREY16 = Png(np.uint8, 1), Png(np.uint16, 1)


def _chunk(kind: bytes, data: bytes) -> tuple[bytes, ...]:
    """Return a chunk in parts, so that its data is copied only once, into the file."""
    return struct.pack(">I", len(data)), kind, data, struct.pack(">I", isal_zlib.crc32(data, isal_zlib.crc32(kind)))


def deflate(content: NDArray[np.uint8]) -> bytes:
    """Compress a contiguous array's bytes as a zlib stream, whose bytes do not depend on addresses in memory.

    After the first byte of a stream, ISA-L 2.32 reads the hash of the third byte from a register that holds the
    stream's address, so the address decides whether a match is found. To avoid this, the first call gets one byte more
    than ISA-L buffers, and so compresses only one byte; the second call sets all registers anew. Shorter content is
    stored uncompressed.
    """
    flat = content.reshape(-1)
    if len(flat) <= _AHEAD:
        return zlib.compress(flat.tobytes(), 0)
    compressor = isal_zlib.compressobj(_LEVEL)
    first, rest = flat[: _AHEAD + 1], flat[_AHEAD + 1 :]
    return b"".join([compressor.compress(first), compressor.compress(rest), compressor.flush()])
