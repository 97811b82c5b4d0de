"""Pairs as the page embeds them: compressed images, and disparities and masks without loss."""

import io
import zlib
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import StereoCamera

JPEG_QUALITY = 90
MOST_BYTES = 22_000_000
"""Largest size of the base64 text of all pairs of a page; the rest of the page takes well below 1 MB."""
# A higher level takes three times as long and saves 1 %.
_DEFLATE_LEVEL = 6
# Quantiles of disparity between which the colours run: a small near object would otherwise use up most of them.
_COLOURED = (0.01, 0.99)
_THUMBNAIL_PX = 160
_THUMBNAIL_QUALITY = 80


@dataclass(frozen=True, slots=True)
class EncodedPair:
    """The images and arrays of one pair, in base64.

    Attributes:
        step: pixel (x, y) of the picture is the pair's pixel (x step + step // 2, y step + step // 2).
        width_px: width of the picture.
        height_px: height of the picture.
        left: the left image as JPEG, averaged over step x step pixels.
        right: the right image in the same form.
        thumbnail: the left image as JPEG of at most 160 x 160 px.
        disparity: the left view's disparity, float32 px; see `pack_floats`.
        visibility: the left view's mask, bytes row by row, deflated; None without a mask.
        low_px: disparity at which the colours begin, above 1 % of the left view's valid pixels; None where no pixel has
            a disparity.
        high_px: disparity at which the colours end, above 99 % of the valid pixels; None as ``low_px``.
        camera: the pair's camera, in the pair's own pixels rather than the picture's.
    """

    step: int
    width_px: int
    height_px: int
    left: str
    right: str
    thumbnail: str
    disparity: str
    visibility: str | None
    low_px: float | None
    high_px: float | None
    camera: StereoCamera

    @property
    def size(self) -> int:
        """Number of characters of all base64 text."""
        return sum(map(len, (self.left, self.right, self.thumbnail, self.disparity, self.visibility or "")))


def make_pictures(positions: Sequence[int], read: Callable[[int], StoredFrame]) -> list[EncodedPair]:
    """Return pictures of pairs, in order, with the smallest common step with which all fit into `MOST_BYTES`.

    ``read`` returns the pair at a position; it may be called several times for each.
    """
    step = 1
    while True:
        pictures: list[EncodedPair] = []
        for position in positions:
            picture = make_picture(read(position), step)
            pictures.append(picture)
            # Pairs of one dataset are alike, so the mean of the first pictures shows early that not all will fit.
            expected = sum(picture.size for picture in pictures) * len(positions) / len(pictures)
            if expected > MOST_BYTES and min(picture.width_px, picture.height_px) > 1:
                break
        else:
            return pictures
        step += 1


def make_picture(frame: StoredFrame, step: int) -> EncodedPair:
    """Return a picture of every ``step``-th pixel of a pair, which must have a disparity."""
    grid = np.s_[step // 2 :: step, step // 2 :: step]
    disparity = frame.left.disparity[grid]
    valid = frame.left.disparity[np.isfinite(frame.left.disparity)]
    low, high = map(float, np.quantile(valid, _COLOURED)) if valid.size else (None, None)
    height, width = disparity.shape
    images = [Image.fromarray(image) for image in (frame.left.image, frame.right.image)]
    thumbnail = images[0].copy()
    thumbnail.thumbnail((_THUMBNAIL_PX, _THUMBNAIL_PX))
    # The last row and column may average incomplete squares; they are cropped where the square lacks its middle pixel.
    left, right = (image if step == 1 else image.reduce(step).crop((0, 0, width, height)) for image in images)
    mask = frame.left.get("visibility")
    return EncodedPair(
        step=step,
        width_px=width,
        height_px=height,
        left=_jpeg(left, JPEG_QUALITY),
        right=_jpeg(right, JPEG_QUALITY),
        thumbnail=_jpeg(thumbnail, _THUMBNAIL_QUALITY),
        disparity=_base64(pack_floats(disparity)),
        visibility=None if mask is None else _base64(zlib.compress(mask[grid].tobytes(), _DEFLATE_LEVEL)),
        low_px=low,
        high_px=high,
        camera=frame.camera,
    )


def pack_floats(values: NDArray[np.float32]) -> bytes:
    """Return (H, W) float32 values, deflated without loss.

    The bits of a value are taken as a 32-bit number, from which the number of the value to its left is subtracted. The
    lowest bytes of all differences come first, row by row, and the highest bytes last. This makes the result half as
    long as the plain values would be, deflated.
    """
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32)
    differences = bits.copy()
    differences[:, 1:] -= bits[:, :-1]
    planes = differences.astype("<u4").view(np.uint8).reshape(-1, 4).T
    return zlib.compress(planes.tobytes(), _DEFLATE_LEVEL)


def _jpeg(image: Image.Image, quality: int) -> str:
    data = io.BytesIO()
    # Pillow's buffer for optimized JPEG has one byte for each pixel; images of noise need more.
    ImageFile.MAXBLOCK = max(ImageFile.MAXBLOCK, 4 * image.width * image.height)
    image.save(data, "JPEG", quality=quality, subsampling=0, optimize=True)
    return _base64(data.getvalue())


def _base64(data: bytes) -> str:
    return b64encode(data).decode("ascii")
