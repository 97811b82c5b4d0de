"""Pairs as the page embeds them: compressed images and overlays, and disparities without loss."""

import io
import zlib
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image, ImageFile

from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.frame.frame import as_rgb
from semisynth_gl.judge.agreement import Points

COLOUR_MAP = "inferno"
"""The colour map of disparities: perceptually uniform, and dark at small disparities."""
JPEG_QUALITY = 90
MOST_BYTES = 22_000_000
"""Largest size of the base64 text of all pairs of a page; the rest of the page takes well below 1 MB."""
NO_DISPARITY, HIDDEN, BEYOND = (64, 96, 192), (230, 97, 0), (93, 58, 155)
"""Colours of pixels without disparity, of occluded pixels, and of pixels outside the right view, RGB. The colour map
has no blue, and readers of any colour vision can tell the masks apart."""

# Quantiles of disparity between which the colours run: a small near object would otherwise use up most of them.
_COLOURED = (0.01, 0.99)
_THUMBNAIL_PX = 160
_UNSEEN = 119


@dataclass(frozen=True, slots=True)
class EncodedPair:
    """The pictures of one pair, in base64.

    Attributes:
        step: pixel (x, y) of a picture is the pair's pixel (x step + step // 2, y step + step // 2).
        width_px: width of the pictures.
        height_px: height of the pictures.
        texts: by name: ``left``, ``right``, and ``warped``, the right image seen from the left, as JPEG, averaged over
            step x step pixels; ``thumbnail``, the left image as JPEG of at most 160 x 160 px; the overlays
            ``disparity`` and ``masks`` as PNG; ``values``, the left view's disparity, float32 px row by row, deflated.
        low_px: disparity at which the colours begin, above 1 % of the left view's valid pixels; None where no pixel has
            a disparity.
        high_px: disparity at which the colours end, above 99 % of the valid pixels; None as ``low_px``.
        camera: the pair's camera, in the pair's own pixels.
    """

    step: int
    width_px: int
    height_px: int
    texts: dict[str, str]
    low_px: float | None
    high_px: float | None
    camera: StereoCamera

    @property
    def size(self) -> int:
        """Number of characters of all base64 text."""
        return sum(map(len, self.texts.values()))


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
    images = {"left": frame.left.image, "right": frame.right.image, "warped": _warped(frame)}
    texts = {}
    for name, array in images.items():
        image = Image.fromarray(array)
        # The last row and column may average incomplete squares; they are cropped where the square lacks its middle.
        texts[name] = _jpeg(image if step == 1 else image.reduce(step).crop((0, 0, width, height)))
    thumbnail = Image.fromarray(frame.left.image)
    thumbnail.thumbnail((_THUMBNAIL_PX, _THUMBNAIL_PX))
    texts["thumbnail"] = _jpeg(thumbnail)
    texts["disparity"] = _disparity_overlay(disparity, low or 0.0, high or 0.0)
    mask = frame.left.get("visibility")
    texts["masks"] = _mask_overlay(disparity, None if mask is None else mask[grid])
    texts["values"] = _base64(zlib.compress(np.ascontiguousarray(disparity, "<f4").tobytes()))
    return EncodedPair(step, width, height, texts, low, high, frame.camera)


def _warped(frame: StoredFrame) -> NDArray[np.uint8]:
    """Return the right image where each left pixel's disparity leads, (H, W, 3); grey where the right eye sees none."""
    height, width = frame.left.disparity.shape
    way = frame.correspondences("left")
    row, column = (axis.ravel() for axis in np.mgrid[:height, :width])
    x, y = column + way[..., 0].ravel(), row + way[..., 1].ravel()
    seen = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    if "visibility" in frame.left:
        seen &= frame.left.visibility.ravel() == VISIBLE
    points = Points(row, column, x, y, frame.camera.rectified).select(seen)
    warped = np.full((height, width, 3), _UNSEEN, np.uint8)
    right = as_rgb(frame.right.image).astype(np.float32)
    warped[points.row, points.column] = np.rint(points.between(points.corners(right)))
    return warped


def _disparity_overlay(disparity: NDArray[np.float32], low_px: float, high_px: float) -> str:
    colours = colormaps[COLOUR_MAP](np.linspace(0, 1, 255), bytes=True)[:, :3].tolist()
    valid = np.isfinite(disparity)
    share = (np.where(valid, disparity, low_px) - low_px) / ((high_px - low_px) or 1.0)
    numbers = np.where(valid, np.rint(254 * share.clip(0, 1)), 255)
    return _png(numbers, [*colours, NO_DISPARITY])


def _mask_overlay(disparity: NDArray[np.float32], mask: NDArray[np.uint8] | None) -> str:
    numbers = np.zeros(disparity.shape, np.uint8)
    if mask is not None:
        numbers[mask == OCCLUDED], numbers[mask == OUTSIDE] = 1, 2
    numbers[~np.isfinite(disparity)] = 3
    return _png(numbers, [(0, 0, 0), HIDDEN, BEYOND, NO_DISPARITY], transparency=0)


def _png(numbers: NDArray[np.generic], colours: Sequence[Sequence[int]], **options: int) -> str:
    image = Image.fromarray(numbers.astype(np.uint8), "P")
    image.putpalette([level for colour in colours for level in colour])
    data = io.BytesIO()
    image.save(data, "PNG", **options)
    return _base64(data.getvalue())


def _jpeg(image: Image.Image) -> str:
    data = io.BytesIO()
    # Pillow's buffer for optimized JPEG has one byte for each pixel; images of noise need more.
    ImageFile.MAXBLOCK = max(ImageFile.MAXBLOCK, 4 * image.width * image.height)
    image.save(data, "JPEG", quality=JPEG_QUALITY, subsampling=0, optimize=True)
    return _base64(data.getvalue())


def _base64(data: bytes) -> str:
    return b64encode(data).decode("ascii")
