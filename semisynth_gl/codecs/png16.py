"""Disparity and flow as 16-bit PNG that counts fractions of a pixel."""

from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.codec import Codec
from semisynth_gl.codecs.png import GREY16, RGB16

_LARGEST = 65535
_MIDDLE = 2**15
_KITTI_STEPS = 256


class DisparityPng16(Codec[NDArray[np.float32]]):
    """Disparity, (H, W) float32 px, as 16-bit grey PNG that counts steps of 1/``steps`` px; 0 stands for inf."""

    suffix = ".png"
    nothing = "0"
    signed = False
    lossless = False
    pixel_bytes = 2.0

    def __init__(self, steps: float) -> None:
        self.steps = steps
        self.name = "png16" if steps == _KITTI_STEPS else f"png16-{steps}"
        self.error_px = 1 / (2 * steps)
        self.limit_px = _LARGEST / steps
        self.description = f"16-bit PNG that counts 1/{steps} px"

    def encode(self, value: NDArray[np.float32]) -> bytes:
        """Encode a disparity, rounded to whole steps; values that are not positive, not finite or too large become 0.

        A disparity below half a step is stored as one step, as KITTI's own tools do, since 0 means "no disparity".
        """
        valid = (value > 0) & (value < self._end_px)
        counts = np.rint(np.where(valid, value * np.float32(self.steps), np.float32(0)))
        return GREY16.encode(np.maximum(counts, valid).astype(np.uint16))

    def decode(self, data: bytes, path: Path) -> NDArray[np.float32]:
        """Decode a disparity; see `Codec.decode`."""
        counts = GREY16.decode(data, path)
        return np.where(counts > 0, counts / np.float32(self.steps), np.float32(np.inf))

    def exceeds_limit(self, value: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return where a finite disparity is too large for 16 bits, (H, W) bool."""
        exceeding: NDArray[np.bool_] = np.isfinite(value) & (value >= self._end_px)
        return exceeding

    @property
    def _end_px(self) -> np.float32:
        return np.float32((_LARGEST + 0.5) / self.steps)


class _AboutMiddle(Codec[NDArray[np.float32]]):
    """Signed values, (H, W) or (H, W, C) float32 px, as 16-bit PNG: steps per pixel times the value, plus 2^15."""

    name = "png16"
    suffix = ".png"
    lossless = False

    _steps: ClassVar[int]
    _least_count: ClassVar[int]

    def exceeds_limit(self, value: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return where all components are finite, but one of them is out of the format's range, (H, W) bool."""
        exceeding: NDArray[np.bool_] = _all_components(np.isfinite(value)) & ~self._fits(self._counts(value))
        return exceeding

    def _counts(self, value: NDArray[np.float32]) -> NDArray[np.float64]:
        # The sum is exact in float64, so `rint` is the only rounding.
        counts: NDArray[np.float64] = np.rint(value.astype(np.float64) * self._steps + _MIDDLE)
        return counts

    def _values(self, counts: NDArray[np.uint16]) -> NDArray[np.float32]:
        return (counts.astype(np.float32) - np.float32(_MIDDLE)) / np.float32(self._steps)

    def _fits(self, counts: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return where all components can be stored, (H, W) bool."""
        return _all_components((counts >= self._least_count) & (counts <= _LARGEST))


class SignedDisparityPng16(_AboutMiddle):
    """Signed disparity d, (H, W) float32 px, as 16-bit grey PNG of 256 d + 2^15; 0 stands for inf."""

    description = "16-bit PNG that counts 1/256 px from 32768 on"
    nothing = "0"
    error_px = 1 / (2 * _KITTI_STEPS)
    pixel_bytes = 2.0
    limit_px = (2**15 - 1) / _KITTI_STEPS

    _steps = _KITTI_STEPS
    _least_count = 1

    def encode(self, value: NDArray[np.float32]) -> bytes:
        """Encode a disparity, rounded to 1/256 px; values that are not finite or out of range become 0."""
        counts = self._counts(value)
        return GREY16.encode(np.where(self._fits(counts), counts, 0).astype(np.uint16))

    def decode(self, data: bytes, path: Path) -> NDArray[np.float32]:
        """Decode a disparity; see `Codec.decode`."""
        counts = GREY16.decode(data, path)
        return np.where(counts > 0, self._values(counts), np.float32(np.inf))


class FlowPng16(_AboutMiddle):
    """KITTI's flow, (H, W, 2) float32 px, as 16-bit RGB PNG: 64 u + 2^15, 64 v + 2^15 and 1; three zeros mean inf."""

    description = "16-bit RGB PNG of 64 u + 32768, 64 v + 32768 and 1"
    nothing = "0 in the third channel"
    is_image = False
    error_px = 1 / 128
    pixel_bytes = 4.0
    limit_px = 32767 / 64

    _steps = 64
    _least_count = 0

    def encode(self, value: NDArray[np.float32]) -> bytes:
        """Encode a flow, rounded to 1/64 px; three zeros where either component is not finite or out of range."""
        counts = self._counts(value)
        valid = self._fits(counts)[..., None]
        return RGB16.encode(np.concatenate([np.where(valid, counts, 0), valid], axis=2).astype(np.uint16))

    def decode(self, data: bytes, path: Path) -> NDArray[np.float32]:
        """Decode a flow; see `Codec.decode`."""
        channels = RGB16.decode(data, path)
        return np.where(channels[..., 2:] > 0, self._values(channels[..., :2]), np.float32(np.inf))


def _all_components(where: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where all components of a pixel are true, (H, W), from (H, W) or (H, W, C) bool."""
    return np.all(where, axis=2) if where.ndim > 2 else where


KITTI_DISPARITY = DisparityPng16(_KITTI_STEPS)
CRESTEREO_DISPARITY = DisparityPng16(32)
SIGNED_DISPARITY = SignedDisparityPng16()
