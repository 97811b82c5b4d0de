"""The base class of all codecs, and checks that they share."""

import io
import struct
import zlib
from abc import ABC, abstractmethod
from math import inf
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.inputs.user_files import read_file

Value = TypeVar("Value")


class Codec(ABC, Generic[Value]):
    """One file format: `encode` makes a file's bytes from a value, and `decode` makes the value from the bytes.

    Attributes:
        suffix: the ending of the format's files, with the dot.
        description: the format in a few words.
        error_px: largest rounding error of a stored value, px.
        limit_px: largest magnitude of a stored value, px.
        signed: whether values of 0 and below can be stored.
        lossless: whether `decode` returns the encoded value bit for bit.
    """

    suffix: str
    description: str
    error_px: float = 0.0
    limit_px: float = inf
    signed: bool = True
    lossless: bool = True

    @abstractmethod
    def encode(self, value: Value) -> bytes:
        """Return the bytes of a file that holds the value."""

    @abstractmethod
    def decode(self, data: bytes, path: Path) -> Value:
        """Return the value that a file's bytes hold; the path is for messages.

        Raises:
            ReadError: where the bytes are cut off, or have another format.
        """

    def exceeds_limit(self, value: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return where a value, (H, W) or (H, W, C), is finite but cannot be stored, (H, W) bool."""
        return np.zeros(value.shape[:2], np.bool_)

    def read(self, path: Path) -> Value:
        """Read and decode a file; raises ReadError also where the file cannot be read."""
        return self.decode(read_bytes(path), path)


def read_bytes(path: Path, most_bytes: int | None = None) -> bytes:
    """Return a file's bytes; raises ReadError if it is missing, over ``most_bytes`` or unreadable."""
    try:
        return read_file(path, most_bytes)
    except FileNotFoundError:
        raise ReadError(path, "is missing") from None
    except OSError as error:
        raise ReadError(path, f"cannot be read: {error.strerror}") from None


def decode_image(
    data: bytes, path: Path, kind: str, end: bytes, raw_mode: str | None = None
) -> tuple[str, NDArray[Any]]:
    """Decode an image with Pillow; return Pillow's mode, and the pixels, (H, W) or (H, W, C).

    ``kind`` is Pillow's name of the format. ``end`` is its end marker: Pillow may decode a cut-off file and fill the
    rest with black. ``raw_mode`` says how the decoder reads the stored bytes. Raises ReadError where the bytes are cut
    off or have another format.
    """
    try:
        with Image.open(io.BytesIO(data), formats=[kind]) as image:
            if raw_mode is not None:
                image.tile = [tile._replace(args=raw_mode) for tile in image.tile]
            mode, pixels = image.mode, np.asarray(image)
    except (ArithmeticError, OSError, SyntaxError, ValueError, struct.error, zlib.error) as error:
        raise ReadError(path, f"cannot be decoded: {error}") from None
    except Image.DecompressionBombError:
        raise ReadError(path, "claims too many pixels") from None
    if not data.endswith(end):
        raise ReadError(path, f"does not end as a {kind} does: cut off, or something follows")
    return mode, pixels


def check_size(data: bytes, header_bytes: int, pixel_bytes: int, width: int, height: int, path: Path) -> None:
    """Raise ReadError if a side is below 1, or the number of bytes after the header does not fit width and height."""
    if width < 1 or height < 1:
        raise ReadError(path, f"expected a width and height of 1 or more, got {width} x {height}")
    expected, present = pixel_bytes * width * height, len(data) - header_bytes
    if present != expected:
        raise ReadError(path, f"expected {expected} bytes of {width} x {height} pixels, got {present}")


def check_numbers(values: NDArray[np.float32], path: Path) -> None:
    """Raise ReadError if (H, W, C) values have a NaN; inf is allowed and means "no value"."""
    if np.isnan(values).any():
        raise ReadError(path, "expected a number at each pixel, or inf for none, got NaN")
