"""Pairs as the page holds them: images to look at, and disparities and masks to the last bit."""

import io
import zlib
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.dataset.stored import StoredFrame

JPEG_QUALITY = 90
MOST_BYTES = 22_000_000
"""What all pairs of a page may take, in base64; the rest of it takes well below 1 MB."""
# A higher one takes three times as long for 1 % less.
_DEFLATE_LEVEL = 6
# A thing or two close by would leave all else one colour.
_COLOURED = (0.01, 0.99)
_THUMBNAIL_PX = 160
_THUMBNAIL_QUALITY = 80


@dataclass(frozen=True, slots=True)
class Picture:
    """One pair.

    Attributes:
        step: every which pixel, along each axis; pixel (x, y) is the pair's (x step + step // 2, y step + step // 2).
        width_px: of the picture.
        height_px: likewise.
        left: JPEG in base64; averaged over step x step pixels.
        right: likewise.
        thumbnail: of the left image, likewise.
        disparity: of the left view; see `pack_floats`.
        visibility: of the left view, bytes row by row, deflated and in base64; None without a mask.
        low_px: disparity that 1 % of the whole left view's pixels lie below, where colours begin; None without any.
        high_px: disparity that 99 % lie below, where they end.
        focal_baseline: focal length times baseline, px m, of the pair's own pixels.
        doffs_px: see `StereoCamera.doffs_px`.
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
    focal_baseline: float
    doffs_px: float

    @property
    def size(self) -> int:
        """Number of characters."""
        return sum(map(len, (self.left, self.right, self.thumbnail, self.disparity, self.visibility or "")))


def make_pictures(positions: Sequence[int], read: Callable[[int], StoredFrame]) -> list[Picture]:
    """Make pictures of pairs, all with the smallest step with which they fit into `MOST_BYTES`.

    Args:
        positions: which pairs.
        read: reads one of them.
    """
    step = 1
    while True:
        pictures: list[Picture] = []
        for position in positions:
            frame = read(position)
            pictures.append(make_picture(frame, step))
            # Pairs of one dataset are alike: the mean so far tells early that they will not fit.
            expected = sum(picture.size for picture in pictures) * len(positions) / len(pictures)
            if expected > MOST_BYTES and min(pictures[-1].width_px, pictures[-1].height_px) > 1:
                break
        else:
            return pictures
        step += 1


def make_picture(frame: StoredFrame, step: int) -> Picture:
    """Make a picture of every ``step``-th pixel of a pair."""
    half = step // 2
    disparity = frame.disparity_left[half::step, half::step]
    height, width = disparity.shape
    valid = frame.disparity_left[np.isfinite(frame.disparity_left)]
    mask = frame.visibility_left
    return Picture(
        step=step,
        width_px=width,
        height_px=height,
        left=_base64(_jpeg(_reduced(frame.left, step, width, height), JPEG_QUALITY)),
        right=_base64(_jpeg(_reduced(frame.right, step, width, height), JPEG_QUALITY)),
        thumbnail=_base64(_thumbnail(frame.left)),
        disparity=_base64(pack_floats(disparity)),
        visibility=None
        if mask is None
        else _base64(zlib.compress(mask[half::step, half::step].tobytes(), _DEFLATE_LEVEL)),
        low_px=float(np.quantile(valid, _COLOURED[0])) if valid.size else None,
        high_px=float(np.quantile(valid, _COLOURED[1])) if valid.size else None,
        focal_baseline=frame.camera.focal_baseline,
        doffs_px=frame.camera.doffs_px,
    )


def pack_floats(values: NDArray[np.float32]) -> bytes:
    """Deflate (H, W) float32 without loss.

    The bits of each value, taken as a 32-bit number, have those of the value to its left subtracted; then all lowest
    bytes come first, row by row, and all highest last. That takes half of what the values themselves take deflated.
    """
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32)
    differences = bits.copy()
    differences[:, 1:] -= bits[:, :-1]
    planes = differences.astype("<u4").view(np.uint8).reshape(-1, 4).T
    return zlib.compress(planes.tobytes(), _DEFLATE_LEVEL)


def _reduced(image: NDArray[np.uint8], step: int, width: int, height: int) -> NDArray[np.uint8]:
    """Average over squares of ``step``; what sticks out at the right and lower border is averaged as far as it goes."""
    if step == 1:
        return image
    reduced = np.asarray(Image.fromarray(image).reduce(step))
    # A part of a square that does not reach its middle has no pixel of the picture.
    return np.ascontiguousarray(reduced[:height, :width])


def _thumbnail(image: NDArray[np.uint8]) -> bytes:
    picture = Image.fromarray(image)
    picture.thumbnail((_THUMBNAIL_PX, _THUMBNAIL_PX))
    return _jpeg(np.asarray(picture), _THUMBNAIL_QUALITY)


def _jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    data = io.BytesIO()
    Image.fromarray(image).save(data, "JPEG", quality=quality, subsampling=0, optimize=True)
    return data.getvalue()


def _base64(data: bytes) -> str:
    return b64encode(data).decode("ascii")
