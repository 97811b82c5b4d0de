"""Reading an image file of any kind as 8-bit RGB, or refusing it with a reason."""

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, lru_cache
from io import BufferedReader
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, ImageOps, UnidentifiedImageError

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.user_files import IS_LFS_POINTER, LFS_POINTER
from semisynth_gl.seeds.spread import spread

MAX_PIXELS = 178_956_970
"""Most pixels of an image; a larger image is refused before anything is decoded. It is Pillow's own limit. The RGB that
`read_image` returns at this size takes 537 MB, and reading it takes up to `MAX_MEMORY`."""

MAX_MEMORY = 1_800_000_000
"""Most bytes of memory that reading an image may take at its peak; an image that would take more is not decoded."""

OUT_OF_MEMORY = "does not fit into memory"
"""The only reason for skipping an image that may be gone the next time; results with it are not cached."""

# Pillow opens these formats but does not decode them, or starts another program to do so (Ghostscript for EPS).
_FORMATS_WITHOUT_PIXELS = frozenset({"BUFR", "GRIB", "HDF5", "MPEG", "EPS", "WMF"})

# Bytes per pixel at the peak of `read_image`: Pillow's image of 4 bytes, and once more where it is turned upright.
_BYTES_PER_PIXEL = 8
# Bytes per pixel of decoders that need more: a fixed number, and a number for each band of the image; measured.
_DECODERS = {"AVIF": (16, 0), "JPEG2000": (5, 5), "WEBP": (17, 0)}
_PROGRESSIVE_JPEG = (4, 2)  # all coefficients are in memory at once, 2 bytes each

_OF_SENSORS, _OF_16_BITS = (255, 1023, 4095, 16383), 65535
"""White in 16-bit files of cameras with 8, 10, 12 and 14 bits, and with 16 bits."""

_SAMPLED = 8
"""Files of a folder by which the bits of its images are told."""

_LOG = logging.getLogger(__name__)

_STRIP_PIXELS = 1 << 20
"""Pixels that are converted at a time, so that the memory for intermediate steps does not grow with the image."""

_REASONS: dict[type[Exception], str] = {
    FileNotFoundError: "does not exist",
    IsADirectoryError: "is a folder",
    PermissionError: "must not be read (permission denied)",
    UnidentifiedImageError: "is not an image that Pillow can read",
    MemoryError: OUT_OF_MEMORY,
}


class ImageError(InputError):
    """An image file that cannot be used, with a reason such as ``"is truncated or damaged"``."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason

    def __reduce__(self) -> tuple[type[Self], tuple[Path, str]]:
        return type(self), (self.path, self.reason)


@cache
def _formats() -> tuple[str, ...]:
    Image.init()
    return tuple(name for name in Image.OPEN if name not in _FORMATS_WITHOUT_PIXELS)


@cache
def image_extensions() -> frozenset[str]:
    """Return the file name extensions of images, in lower case and with their dot: all that Pillow decodes except .pfm.

    PFM files are left out because stereo datasets store disparity in them.
    """
    formats = frozenset(_formats())
    return frozenset(end for end, name in Image.registered_extensions().items() if name in formats and end != ".pfm")


def stored_size(path: Path) -> tuple[int, int]:
    """Return (height, width) in pixels as in the file's header, before EXIF orientation; nothing is decoded.

    Raises:
        ImageError: where the header cannot be read, or the image is empty or exceeds `MAX_PIXELS` or `MAX_MEMORY`.
    """
    with _opened(path) as image:
        return image.height, image.width


def check_opaque(path: Path) -> None:
    """Refuse an image with transparent pixels, whose colour `read_image` makes up.

    Raises:
        ImageError: where the header cannot be read, or the image has transparency.
    """
    with _opened(path) as image:
        if image.has_transparency_data:
            raise ImageError(path, "has transparent pixels: save it without transparency")


def read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image file as upright 8-bit RGB.

    - 8-bit RGB comes out bit for bit; colour profiles are not applied.
    - Grey, palette, 1-bit, CMYK, YCbCr and LAB are converted by Pillow; of several frames the first is read.
    - 16-bit grey is scaled so that 65535 becomes 255, rounded; or 255, 1023, 4095 or 16383, if neither the image nor
      others of its kind in the folder have larger values, as of 10-bit to 14-bit sensors. 32-bit integers are taken for
      16-bit ones.
    - Floating point is taken as 0..1 where no value exceeds 1, else as 0..255 where none exceeds 255, else as 0..65535.
    - Transparent pixels get the mean colour of the visible pixels, and half-transparent pixels are blended with it. The
      colour stored under transparency is arbitrary (often what an editor erased) and was never meant to be seen. The
      mean is one flat colour, so crops of it are rejected as flat, and it makes a weaker artificial edge around a
      cut-out than black or white would.

    Returns:
        (H, W, 3) uint8 RGB, C-contiguous, EXIF orientation applied.

    Raises:
        ImageError: where the file is missing, unreadable, truncated, empty, wholly transparent, out of range, has more
            than `MAX_PIXELS` pixels, or needs more than `MAX_MEMORY` bytes.
    """
    with _opened(path) as image:
        # Asked for before the pixels are decoded, so that only one image is in memory.
        level = _folder_level(path.parent, path.suffix) if _has_16_bits(image) else 0
        ImageOps.exif_transpose(image, in_place=True)  # decodes the pixels first
        if image.mode == "F" or _has_16_bits(image):
            convert = _grey_conversion(path, image, level)
        elif image.has_transparency_data:
            convert = _opaque_conversion(path, image)
        else:
            convert = _as_rgb
        pixels = np.empty((image.height, image.width, 3), np.uint8)
        for top, strip in _strips(image):
            pixels[top : top + strip.height] = convert(strip)
        return pixels


def _strips(image: Image.Image) -> Iterator[tuple[int, Image.Image]]:
    """Yield successive strips of an image, each with the number of its first row."""
    rows = max(1, _STRIP_PIXELS // image.width)
    for top in range(0, image.height, rows):
        yield top, image.crop((0, top, image.width, min(top + rows, image.height)))


def _as_rgb(strip: Image.Image) -> NDArray[np.uint8]:
    return np.asarray(strip if strip.mode == "RGB" else strip.convert("RGB"))


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open an image and check its size; any error in the ``with`` block becomes an `ImageError`."""
    tolerant = ImageFile.LOAD_TRUNCATED_IMAGES
    # Another part of the process may have set this flag, with which a truncated photograph comes out half grey.
    ImageFile.LOAD_TRUNCATED_IMAGES = False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about metadata, and about sizes that are decided here
            # A file object, not a name: given a name, Pillow maps uncompressed TIFF into memory, and where EXIF turns
            # the image by a quarter it takes the turned width for the stored width (seen in 13.0), which slants it.
            with path.open("rb") as file:
                _check_fetched(path, file)
                with Image.open(file, formats=_formats()) as image:
                    _check_size(path, image)
                    yield image
    except ImageError:
        raise
    except Exception as error:  # decoders of hostile files raise anything
        raise ImageError(path, _reason(error)) from error
    finally:
        ImageFile.LOAD_TRUNCATED_IMAGES = tolerant


def _check_fetched(path: Path, file: BufferedReader) -> None:
    if file.peek(len(LFS_POINTER)).startswith(LFS_POINTER):
        raise ImageError(path, IS_LFS_POINTER)


def _check_size(path: Path, image: Image.Image) -> None:
    width, height = image.size
    if min(width, height) < 1:
        raise ImageError(path, f"is empty ({width} x {height} pixels)")
    if width * height > MAX_PIXELS:
        raise ImageError(path, f"has {width} x {height} pixels, more than the limit of {MAX_PIXELS}")
    needed = width * height * _bytes_per_pixel(image)
    if needed > MAX_MEMORY:
        raise ImageError(
            path,
            f"has {width} x {height} pixels, which take {needed / 1e9:.1f} GB of memory to read as {image.format}; "
            f"the limit is {MAX_MEMORY / 1e9:.1f} GB: save it as PNG, or make it smaller",
        )


def _bytes_per_pixel(image: Image.Image) -> int:
    decoder = _DECODERS.get(image.format or "", (_BYTES_PER_PIXEL, 0))
    if image.format in {"JPEG", "MPO"} and image.info.get("progressive"):
        decoder = _PROGRESSIVE_JPEG
    return max(_BYTES_PER_PIXEL, decoder[0] + decoder[1] * len(image.getbands()))


def _reason(error: Exception) -> str:
    if isinstance(error, Image.DecompressionBombError):
        return f"has more pixels than are decoded: {error}".split(", could")[0]
    detail = " ".join(str(error).split()) or type(error).__name__
    reasons = (reason for kind, reason in _REASONS.items() if isinstance(error, kind))
    return next(reasons, f"is truncated or damaged ({detail})")


_Conversion = Callable[[Image.Image], NDArray[np.uint8]]
"""Converts a strip to RGB, (H, W, 3), or to grey levels, (H, W, 1)."""


def _has_16_bits(image: Image.Image) -> bool:
    return image.mode == "I" or image.mode.startswith("I;16")


def _grey_conversion(path: Path, image: Image.Image, level: int) -> _Conversion:
    # NumPy's extremes, not Python's: they are NaN where any value is NaN.
    extremes = [(values.min(), values.max()) for values in (np.asarray(strip) for _, strip in _strips(image))]
    low, high = np.min([low for low, _ in extremes]), np.max([high for _, high in extremes])
    if not (low >= 0 and high <= np.iinfo(np.uint16).max):  # also where an extreme is NaN
        raise ImageError(path, f"has grey values from {low} to {high}, expected 0 to 65535")
    is_whole = _has_16_bits(image)
    whites = (*_OF_SENSORS, _OF_16_BITS) if is_whole else (1, 255, _OF_16_BITS)
    brightest = next(white for white in whites if max(high, level) <= white)

    def convert(strip: Image.Image) -> NDArray[np.uint8]:
        values: NDArray[Any] = np.asarray(strip)
        if is_whole:
            grey = (values.astype(np.uint32) * 510 + brightest) // (2 * brightest)
        else:
            grey = np.floor(values * (255.0 / brightest) + 0.5)
        return grey.astype(np.uint8)[..., np.newaxis]

    return convert


@lru_cache
def _folder_level(folder: Path, suffix: str) -> int:
    """Return the highest level of a folder's 16-bit grey images, by a few of those with a suffix."""
    files = sorted(path for path in folder.iterdir() if path.suffix == suffix)
    highest = 0
    for path in (files[number] for number in spread(len(files), _SAMPLED)):
        with suppress(ImageError), _opened(path) as image:
            if _has_16_bits(image):
                highest = max(highest, *(int(np.asarray(strip).max()) for _, strip in _strips(image)))
    if highest <= _OF_SENSORS[-1]:
        white = next(white for white in _OF_SENSORS if highest <= white)
        _LOG.info("%s: 16-bit images have values up to %d only: %d counts as white", folder, highest, white)
    return highest


def _opaque_conversion(path: Path, image: Image.Image) -> _Conversion:
    total, count = np.zeros(3, np.int64), 0
    for _, strip in _strips(image):
        levels = np.asarray(strip.convert("RGBA"))
        visible = levels[levels[..., 3] > 0]
        total += visible[:, :3].sum(axis=0, dtype=np.int64)
        count += len(visible)
    if not count:
        raise ImageError(path, "is wholly transparent")
    mean = tuple(int(level + 0.5) for level in total / count)

    def convert(strip: Image.Image) -> NDArray[np.uint8]:
        with_alpha = strip.convert("RGBA")
        blended = Image.new("RGB", strip.size, mean)
        blended.paste(with_alpha.convert("RGB"), mask=with_alpha.getchannel("A"))
        return np.asarray(blended)

    return convert
