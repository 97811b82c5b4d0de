"""Reads image files of any kind as 8-bit RGB, or refuses them with a reason."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.inputs.user_files import IS_LFS_POINTER, LFS_POINTER
from semisynth_gl.seeds.seeds import spread

MAX_PIXELS = 178_956_970
"""Maximum number of pixels of an image, Pillow's own limit. A larger image is refused before it is decoded."""

# Pillow opens these formats but cannot decode them, or needs an external program for it (Ghostscript for EPS).
_FORMATS_WITHOUT_PIXELS = frozenset({"BUFR", "GRIB", "HDF5", "MPEG", "EPS", "WMF"})

_WHITES = (255, 1023, 4095, 16383, 65535)
"""The level of white in 16-bit files from cameras with 8, 10, 12, 14 and 16 bits."""

_SAMPLES = 8
"""Number of files that are read to find the bit depth of a folder's 16-bit images."""


class ImageError(ReadError):
    """An image file that cannot be used, with a reason such as ``"is truncated or damaged"``."""


@cache
def _formats() -> tuple[str, ...]:
    Image.init()
    return tuple(name for name in Image.OPEN if name not in _FORMATS_WITHOUT_PIXELS)


@cache
def image_extensions() -> frozenset[str]:
    """Return the file name extensions of images that Pillow decodes, in lower case and with their dot.

    .pfm is left out, since stereo datasets store disparity in PFM files.
    """
    formats = frozenset(_formats())
    return frozenset(end for end, name in Image.registered_extensions().items() if name in formats and end != ".pfm")


def stored_size(path: Path) -> tuple[int, int]:
    """Return (height, width) in pixels from the file's header, before EXIF orientation; nothing is decoded.

    Raises:
        ImageError: where the header cannot be read, or the image is empty or exceeds `MAX_PIXELS`.
    """
    with _opened(path) as image:
        return image.height, image.width


def read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image file as upright 8-bit RGB.

    - 8-bit RGB comes out bit for bit; colour profiles are not applied.
    - Pillow converts grey, palette, 1-bit, CMYK, YCbCr and LAB. Only the first of several frames is read.
    - 16-bit grey is scaled so that white becomes 255, rounded. White is the smallest of 255, 1023, 4095, 16383 and
      65535 that no 16-bit image of the folder exceeds (8 files are sampled). 32-bit integers are read as 16-bit.
    - Transparent pixels become mid grey, since the colour stored under transparency is not meant to be visible.

    Returns:
        (H, W, 3) uint8 RGB, C-contiguous, EXIF orientation applied.

    Raises:
        ImageError: where the file is missing, unreadable, truncated, empty, out of range, of floating point, or has
            more than `MAX_PIXELS` pixels.
    """
    with _opened(path) as image:
        # Find the level before this image is decoded, so that only one image is in memory.
        level = _folder_level(path.parent, path.suffix) if _has_16_bits(image) else 0
        ImageOps.exif_transpose(image, in_place=True)
        if image.mode == "F":
            raise ImageError(path, "has floating-point values, expected 8 or 16 bits")
        if _has_16_bits(image):
            return np.repeat(_grey(path, image, level)[..., np.newaxis], 3, axis=2)
        if image.has_transparency_data:
            grey = Image.new("RGBA", image.size, "grey")
            return np.array(Image.alpha_composite(grey, image.convert("RGBA")).convert("RGB"))
        return np.array(image.convert("RGB"))


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open an image and check its size; any error in the ``with`` block becomes an `ImageError`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about metadata, and about large images, which `_check_size` refuses
            # Pass a file object: given a path, Pillow 13.0 memory-maps uncompressed TIFF, with the wrong row length if
            # EXIF rotates the image by 90 degrees.
            with path.open("rb") as file:
                pointer = file.peek(len(LFS_POINTER)).startswith(LFS_POINTER)
                with Image.open(file, formats=_formats()) as image:
                    _check_size(path, image)
                    yield image
    except ImageError:
        raise
    except UnidentifiedImageError as error:
        raise ImageError(path, IS_LFS_POINTER if pointer else "is not an image that Pillow can read") from error
    except Exception as error:  # decoders of hostile files raise anything
        if isinstance(error, OSError) and error.strerror:
            raise ImageError(path, f"cannot be read: {error.strerror}") from error
        detail = " ".join(str(error).split()) or type(error).__name__
        raise ImageError(path, f"is truncated, damaged or too large ({detail})") from error


def _check_size(path: Path, image: Image.Image) -> None:
    if not 0 < image.width * image.height <= MAX_PIXELS:
        raise ImageError(path, f"has {image.width} x {image.height} pixels, expected 1 to {MAX_PIXELS} in all")


def _has_16_bits(image: Image.Image) -> bool:
    return image.mode == "I" or image.mode.startswith("I;16")


def _grey(path: Path, image: Image.Image, level: int) -> NDArray[np.uint8]:
    """Return an image of more than 8 bits as 8-bit grey, (H, W), given the result ``level`` of `_folder_level`."""
    values: NDArray[Any] = np.asarray(image)
    low, high = values.min(), values.max()
    if not (low >= 0 and high <= _WHITES[-1]):
        raise ImageError(path, f"has grey values from {low} to {high}, expected 0 to {_WHITES[-1]}")
    white = next((white for white in _WHITES if max(high, level) <= white), _WHITES[-1])
    return ((values.astype(np.uint32) * 510 + white) // (2 * white)).astype(np.uint8)


@lru_cache
def _folder_level(folder: Path, suffix: str) -> int:
    """Return the highest level in a sample of a folder's 16-bit grey images with this suffix."""
    files = sorted(path for path in folder.iterdir() if path.suffix == suffix)
    highest = 0
    for path in (files[number] for number in spread(len(files), _SAMPLES)):
        with suppress(ImageError), _opened(path) as image:
            if _has_16_bits(image):
                highest = max(highest, int(np.asarray(image).max()))
    return highest
