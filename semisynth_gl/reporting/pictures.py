"""Pairs as the page embeds them: images for the eye, and disparities and masks to the last bit."""

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
"""Limit of the base64 text of all pairs of a page; the rest of a page takes well below 1 MB."""
# A higher level takes three times as long and saves 1 %.
_DEFLATE_LEVEL = 6
# A small near object would take most colours from everything behind it.
_COLOURED = (0.01, 0.99)
_THUMBNAIL_PX = 160
_THUMBNAIL_QUALITY = 80


@dataclass(frozen=True, slots=True)
class EncodedPair:
    """The images and arrays of one pair, in base64.

    Attributes:
        step: pixel (x, y) of the picture is the pair's pixel (x step + step // 2, y step + step // 2).
        left: JPEG, averaged over step x step pixels, as ``right``.
        disparity: of the left view; see `pack_floats`.
        visibility: of the left view, bytes row by row, deflated; None without a mask.
        low_px: disparity with 1 % of the left view's pixels below it, where the colours begin; None without any.
        high_px: disparity with 99 % of the left view's pixels below it, where the colours end.
        camera: in the pair's own pixels.
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
        """Number of characters."""
        return sum(map(len, (self.left, self.right, self.thumbnail, self.disparity, self.visibility or "")))


def make_pictures(positions: Sequence[int], read: Callable[[int], StoredFrame]) -> list[EncodedPair]:
    """Make pictures of pairs, read by their numbers, with the smallest step that fits all into `MOST_BYTES`."""
    step = 1
    while True:
        pictures: list[EncodedPair] = []
        for position in positions:
            picture = make_picture(read(position), step)
            pictures.append(picture)
            # Pairs of one dataset are alike: the mean so far shows early that the pictures will not fit.
            expected = sum(picture.size for picture in pictures) * len(positions) / len(pictures)
            if expected > MOST_BYTES and min(picture.width_px, picture.height_px) > 1:
                break
        else:
            return pictures
        step += 1


def make_picture(frame: StoredFrame, step: int) -> EncodedPair:
    """Make a picture of every ``step``-th pixel of a pair."""
    grid = np.s_[step // 2 :: step, step // 2 :: step]
    disparity = frame.left.disparity[grid]
    valid = frame.left.disparity[np.isfinite(frame.left.disparity)]
    low, high = map(float, np.quantile(valid, _COLOURED)) if valid.size else (None, None)
    height, width = disparity.shape
    images = [Image.fromarray(image) for image in (frame.left.image, frame.right.image)]
    thumbnail = images[0].copy()
    thumbnail.thumbnail((_THUMBNAIL_PX, _THUMBNAIL_PX))
    # The last rows and columns average incomplete squares; they go where the square lacks its middle.
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
    """Deflate (H, W) float32 without loss.

    The bits of each value, taken as a 32-bit number, have the bits of the value to its left subtracted; then all
    lowest bytes come first, row by row, and all highest bytes last. The result is half as long as the deflated values.
    """
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32)
    differences = bits.copy()
    differences[:, 1:] -= bits[:, :-1]
    planes = differences.astype("<u4").view(np.uint8).reshape(-1, 4).T
    return zlib.compress(planes.tobytes(), _DEFLATE_LEVEL)


def _jpeg(image: Image.Image, quality: int) -> str:
    data = io.BytesIO()
    # Pillow's buffer for that has a byte a pixel, and noise takes more.
    ImageFile.MAXBLOCK = max(ImageFile.MAXBLOCK, 4 * image.width * image.height)
    image.save(data, "JPEG", quality=quality, subsampling=0, optimize=True)
    return _base64(data.getvalue())


def _base64(data: bytes) -> str:
    return b64encode(data).decode("ascii")
