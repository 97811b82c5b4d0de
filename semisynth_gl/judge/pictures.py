"""Encodes pairs for the report's page: images and overlays as data URIs, and disparities as deflated float32."""

import io
import zlib
from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.frame.frame import as_rgb
from semisynth_gl.judge.interpolation import interpolate, pixels_around

COLOUR_MAP = "inferno"
"""The colour map of disparities: perceptually uniform, and dark at small disparities."""
WIDEST_PX = 1024
"""Wider pairs are embedded at 1/2, 1/3 ... of their size, so that they are at most this wide."""
MASKS = {
    "occluded in the right view": (230, 97, 0),
    "outside the right view": (93, 58, 155),
    "no disparity": (64, 96, 192),
}
"""The colours of masks, RGB. Colour-blind readers can distinguish them, and the colour map has no similar blue."""

# The colours cover disparities between these quantiles: otherwise a small near object would use up most colours.
_COLOURED = (0.01, 0.99)
# Grey level where the right image does not show the point.
_UNSEEN = 119


def embed_pair(frame: StoredFrame) -> dict[str, Any]:
    """Return the pictures of a pair in JSON's types, for report.js.

    Pixel (x, y) of a picture is the pair's pixel (x step + step // 2, y step + step // 2). ``colours`` are the
    disparities of the overlay's first and last colour, px. ``values`` is the left view's disparity: float32 px row by
    row, deflated, in base64. The pictures are data URIs: ``left``, ``right`` and ``warped`` (the right image warped to
    the left view) are means over step x step pixels; the overlays ``disparity`` and ``masks`` are not averaged.
    """
    step = -(-frame.camera.width_px // WIDEST_PX)
    grid = np.s_[step // 2 :: step, step // 2 :: step]
    disparity = frame.left.disparity[grid]
    height, width = disparity.shape
    known = disparity[np.isfinite(disparity)]
    low, high = map(float, np.quantile(known, _COLOURED)) if known.size else (0.0, 0.0)
    embedded: dict[str, Any] = {"step": step, "width": width, "height": height, "colours": [low, high]}
    embedded |= {"focal_baseline": frame.camera.focal_baseline, "doffs": frame.camera.doffs_px}
    for name, array in (("left", frame.left.image), ("right", frame.right.image), ("warped", _warped(frame))):
        # `reduce` also averages incomplete squares at the border. Drop those whose centre is outside the image.
        embedded[name] = _uri(Image.fromarray(array).reduce(step).crop((0, 0, width, height)), "JPEG", quality=90)
    shares = (np.nan_to_num(disparity, posinf=low) - low) / ((high - low) or 1.0)
    colours = colormaps[COLOUR_MAP](np.linspace(0, 1, 255), bytes=True)[:, :3].tolist()
    numbers = np.where(np.isfinite(disparity), np.rint(254 * shares.clip(0, 1)), 255)
    embedded["disparity"] = _overlay(numbers, [*colours, MASKS["no disparity"]])
    masks = np.zeros(disparity.shape)
    if "visibility" in frame.left:
        masks += (frame.left.visibility[grid] == OCCLUDED) + 2 * (frame.left.visibility[grid] == OUTSIDE)
    masks[~np.isfinite(disparity)] = 3
    embedded["masks"] = _overlay(masks, [(0, 0, 0), *MASKS.values()], transparency=0)
    data = zlib.compress(np.ascontiguousarray(disparity, "<f4").tobytes())
    return embedded | {"values": b64encode(data).decode("ascii")}


def _warped(frame: StoredFrame) -> NDArray[np.uint8]:
    """Return the right image warped to the left view by the left disparity, (H, W, 3); grey where nothing is seen."""
    height, width = frame.left.disparity.shape
    row, column = np.mgrid[:height, :width]
    vectors = frame.correspondences("left")
    x, y = column + vectors[..., 0], row + vectors[..., 1]
    seen = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    if "visibility" in frame.left:
        seen &= frame.left.visibility == VISIBLE
    warped = np.full((height, width, 3), _UNSEEN, np.uint8)
    right, x, y = as_rgb(frame.right.image).astype(np.float32), x[seen], y[seen]
    warped[seen] = np.rint(interpolate(pixels_around(right, x, y), x, y))
    return warped


def _overlay(numbers: NDArray[np.floating], colours: Sequence[Sequence[int]], **options: int) -> str:
    image = Image.fromarray(numbers.astype(np.uint8), "P")
    image.putpalette([level for colour in colours for level in colour])
    return _uri(image, "PNG", **options)


def _uri(image: Image.Image, kind: str, **options: int) -> str:
    data = io.BytesIO()
    image.save(data, kind, **options)
    return f"data:image/{kind.lower()};base64,{b64encode(data.getvalue()).decode('ascii')}"
