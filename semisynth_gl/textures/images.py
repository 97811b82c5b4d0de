"""Reading an image file of any kind as 8-bit RGB, or refusing it with a reason."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, ImageOps, UnidentifiedImageError

from semisynth_gl.errors import InputError
from semisynth_gl.user_files import NotOnDiskError, open_file

MAX_PIXELS = 178_956_970
"""Most pixels of an image; a header with more is refused before anything is decoded. Pillow itself refuses at this
size; an RGB image of this size takes 537 MB."""

OUT_OF_MEMORY = "does not fit into memory"
"""The one reason for skipping an image that may not hold the next time."""

# Pillow opens these formats but does not decode them, or starts another program to do so (Ghostscript for EPS).
_FORMATS_WITHOUT_PIXELS = frozenset({"BUFR", "GRIB", "HDF5", "MPEG", "EPS", "WMF"})

_REASONS: dict[type[Exception], str] = {
    FileNotFoundError: "does not exist",
    IsADirectoryError: "is a folder",
    PermissionError: "must not be read (permission denied)",
    UnidentifiedImageError: "is not an image that Pillow can read",
    MemoryError: OUT_OF_MEMORY,
}


class ImageError(InputError):
    """An image file that cannot be used.

    Attributes:
        path: the file.
        reason: a clause such as ``"is truncated or damaged"``.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(path, reason)  # both arguments, so that the error survives pickling between processes
        self.path = path
        self.reason = reason

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"


@cache
def _formats() -> tuple[str, ...]:
    Image.init()
    return tuple(name for name in Image.OPEN if name not in _FORMATS_WITHOUT_PIXELS)


@cache
def image_extensions() -> frozenset[str]:
    """Return the file name extensions of images, in lower case and with their dot: all that Pillow decodes but .pfm.

    PFM files beside stereo images hold their disparity.
    """
    formats = frozenset(_formats())
    return frozenset(end for end, name in Image.registered_extensions().items() if name in formats and end != ".pfm")


def stored_size(path: Path) -> tuple[int, int]:
    """Return (height, width) in pixels as the header has them, before EXIF orientation; nothing is decoded.

    Raises:
        ImageError: where the header cannot be read, is empty or has more than `MAX_PIXELS`.
    """
    with _opened(path) as image:
        return image.height, image.width


def read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image file as upright 8-bit RGB.

    - 8-bit RGB comes out bit for bit; colour profiles are not applied.
    - Grey, palette, 1-bit, CMYK, YCbCr and LAB are converted by Pillow; of several frames the first is read.
    - 16-bit grey is scaled so that 65535 becomes 255, rounded. 32-bit integers are taken for 16-bit ones.
    - Floating point is taken as 0..1 where no value exceeds 1, else as 0..255 where none exceeds 255, else as 0..65535.
    - Transparent pixels get the mean colour of the visible ones, half-transparent ones are blended with it. The colour
      stored under transparency is arbitrary (often what an editor erased) and was never meant to be seen. One flat
      colour has no texture, so crops that lie in it are left out like any flat crop; and the mean makes a weaker
      artificial edge around a cut-out than black or white would.

    Args:
        path: a file of any format that Pillow decodes.

    Returns:
        (H, W, 3) uint8 RGB, C-contiguous, EXIF orientation applied.

    Raises:
        ImageError: where the file is missing, unreadable, truncated, empty, wholly transparent, out of range, or has
            more than `MAX_PIXELS` pixels.
    """
    with _opened(path) as image:
        ImageOps.exif_transpose(image, in_place=True)
        if image.mode in ("I", "F") or image.mode.startswith("I;16"):
            grey = _grey_levels(path, np.asarray(image))
            return np.repeat(grey[..., np.newaxis], 3, axis=2)
        if image.has_transparency_data:
            return _blend_transparent(path, image)
        return np.array(image if image.mode == "RGB" else image.convert("RGB"))


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open an image and check its header; any error of a decoder in the block becomes an `ImageError`."""
    tolerant = ImageFile.LOAD_TRUNCATED_IMAGES
    # Another part of the process may have set it: with it, a truncated photograph comes out half grey without a word.
    ImageFile.LOAD_TRUNCATED_IMAGES = False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about metadata, and about sizes that are decided here
            # A file object, not a name: given a name, Pillow maps uncompressed TIFF into memory, and where EXIF turns
            # one by a quarter it takes the turned width for the stored one (seen in 13.0): slanted pixels.
            with open_file(path) as file, Image.open(file, formats=_formats()) as image:
                _check_size(path, *image.size)
                yield image
    except ImageError:
        raise
    except Exception as error:  # decoders of hostile files raise anything
        raise ImageError(path, _reason(error)) from error
    finally:
        ImageFile.LOAD_TRUNCATED_IMAGES = tolerant


def _check_size(path: Path, width: int, height: int) -> None:
    if min(width, height) < 1:
        raise ImageError(path, f"is empty ({width} x {height} pixels)")
    if width * height > MAX_PIXELS:
        raise ImageError(path, f"has {width} x {height} pixels, more than the limit of {MAX_PIXELS}")


def _reason(error: Exception) -> str:
    if isinstance(error, Image.DecompressionBombError):
        return f"has more pixels than are decoded: {error}".split(", could")[0]
    if isinstance(error, NotOnDiskError):
        return f"cannot be read: {error.strerror}"
    detail = " ".join(str(error).split()) or type(error).__name__
    reasons = (reason for kind, reason in _REASONS.items() if isinstance(error, kind))
    return next(reasons, f"is truncated or damaged ({detail})")


def _grey_levels(path: Path, values: NDArray[Any]) -> NDArray[np.uint8]:
    low, high = values.min(), values.max()
    if not (low >= 0 and high <= np.iinfo(np.uint16).max):  # also where one is NaN
        raise ImageError(path, f"has grey values from {low} to {high}, expected 0 to 65535")
    if np.issubdtype(values.dtype, np.integer):
        return ((values.astype(np.uint32) + 128) // 257).astype(np.uint8)
    brightest = next(white for white in (1, 255, 65535) if high <= white)
    return np.floor(values * (255.0 / brightest) + 0.5).astype(np.uint8)


def _blend_transparent(path: Path, image: Image.Image) -> NDArray[np.uint8]:
    with_alpha = image.convert("RGBA")
    alpha = with_alpha.getchannel("A")
    colours = with_alpha.convert("RGB")
    visible = np.asarray(alpha) > 0
    if not visible.any():
        raise ImageError(path, "is wholly transparent")
    mean = np.asarray(colours)[visible].mean(axis=0)
    blended = Image.new("RGB", image.size, tuple(int(level + 0.5) for level in mean))
    blended.paste(colours, mask=alpha)
    return np.array(blended)
