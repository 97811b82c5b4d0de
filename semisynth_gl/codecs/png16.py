"""Disparity and flow as 16-bit PNG that counts fractions of a pixel."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.codec import Codec
from semisynth_gl.codecs.png import GREY16, RGB16

_LARGEST = 65535
_MIDDLE = 2**15
_KITTI_STEPS = 256
_FLOW_STEPS = 64


class DisparityPng16(Codec[NDArray[np.float32]]):
    """Disparity d, (H, W) float32 px, as 16-bit grey PNG of ``steps * d + middle``; 0 means inf.

    With a ``middle`` above 0, disparities may be signed.
    """

    suffix = ".png"
    lossless = False

    def __init__(self, steps: float, middle: int = 0) -> None:
        self.steps = steps
        self.signed = middle > 0
        self.error_px = 1 / (2 * steps)
        self.limit_px = (_LARGEST - middle) / steps
        self.description = f"16-bit PNG that counts 1/{steps} px{f' from {middle} on' if middle else ''}"
        self._middle = middle

    def encode(self, value: NDArray[np.float32]) -> bytes:
        """Encode a disparity, rounded to whole steps; values that are not finite or out of range become 0.

        Since 0 means "no disparity", an unsigned disparity below half a step becomes one step, as by KITTI's own tools.
        """
        counts = _counts(value, self.steps, self._middle)
        valid = (counts <= _LARGEST) & (counts >= 1 if self.signed else value > 0)
        return GREY16.encode(np.where(valid, np.maximum(counts, 1), 0).astype(np.uint16))

    def decode(self, data: bytes, path: Path) -> NDArray[np.float32]:
        """Decode a disparity; see `Codec.decode`."""
        counts = GREY16.decode(data, path)
        return np.where(counts > 0, _values(counts, self.steps, self._middle), np.float32(np.inf))

    def exceeds_limit(self, value: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return where a finite disparity is out of the format's range, (H, W) bool."""
        counts = _counts(value, self.steps, self._middle)
        return np.isfinite(value) & ((counts > _LARGEST) | ((counts < 1) & self.signed))


class FlowPng16(Codec[NDArray[np.float32]]):
    """KITTI's flow, (H, W, 2) float32 px, as 16-bit RGB PNG: 64 u + 2^15, 64 v + 2^15 and 1; three zeros mean inf."""

    suffix = ".png"
    description = "16-bit RGB PNG of 64 u + 32768, 64 v + 32768 and 1"
    lossless = False
    error_px = 1 / (2 * _FLOW_STEPS)
    limit_px = (_LARGEST - _MIDDLE) / _FLOW_STEPS

    def encode(self, value: NDArray[np.float32]) -> bytes:
        """Encode a flow, rounded to 1/64 px; three zeros where either component is not finite or out of range."""
        counts = _counts(value, _FLOW_STEPS, _MIDDLE)
        valid = _fits(counts)[..., None]
        return RGB16.encode(np.concatenate([np.where(valid, counts, 0), valid], axis=2).astype(np.uint16))

    def decode(self, data: bytes, path: Path) -> NDArray[np.float32]:
        """Decode a flow; see `Codec.decode`."""
        channels = RGB16.decode(data, path)
        flow = _values(channels[..., :2], _FLOW_STEPS, _MIDDLE)
        return np.where(channels[..., 2:] > 0, flow, np.float32(np.inf))

    def exceeds_limit(self, value: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return where both components are finite, but one is out of the format's range, (H, W) bool."""
        return np.isfinite(value).all(axis=2) & ~_fits(_counts(value, _FLOW_STEPS, _MIDDLE))


def _counts(value: NDArray[np.float32], steps: float, middle: int) -> NDArray[np.float64]:
    # The sum is exact in float64, so `rint` is the only rounding.
    return np.asarray(np.rint(value.astype(np.float64) * steps + middle))


def _values(counts: NDArray[np.uint16], steps: float, middle: int) -> NDArray[np.float32]:
    return (counts.astype(np.float32) - np.float32(middle)) / np.float32(steps)


def _fits(counts: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.all((counts >= 0) & (counts <= _LARGEST), axis=2))


KITTI_DISPARITY = DisparityPng16(_KITTI_STEPS)
CRESTEREO_DISPARITY = DisparityPng16(32)
SIGNED_DISPARITY = DisparityPng16(_KITTI_STEPS, _MIDDLE)
