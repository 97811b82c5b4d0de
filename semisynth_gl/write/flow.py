"""Flow as files: Middlebury's .flo, SceneFlow's PFM of three channels, KITTI's 16-bit PNG."""

import struct

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.write.pfm import encode_pfm
from semisynth_gl.write.png import encode_png

_FLO_TAG = 202021.25  # its bytes are PIEH
_FLO_LARGEST = 1e9
_FLO_UNKNOWN = np.float32(1e10)
_KITTI_STEPS = 64
_KITTI_ZERO = 2**15
_KITTI_LARGEST = 65535


def encode_flo(flow: NDArray[np.float32]) -> bytes:
    """Encode as Middlebury's .flo: tag, width and height, then u and v of each pixel, little-endian, top row first.

    Args:
        flow: (H, W, 2) float32 px, u to the right and v downwards; where either is not finite, or above 1e9 as no
            reader takes it, both become 1e10, which says that there is none.
    """
    height, width = flow.shape[:2]
    known = (np.abs(flow) <= np.float32(_FLO_LARGEST)).all(axis=2, keepdims=True)
    header = struct.pack("<fii", _FLO_TAG, width, height)
    return header + np.where(known, flow, _FLO_UNKNOWN).astype("<f4").tobytes()


def encode_flow_pfm(flow: NDArray[np.float32]) -> bytes:
    """Encode (H, W, 2) float32 px as PFM of three channels: u, v and 0; inf stays inf."""
    return encode_pfm(np.concatenate([flow, np.zeros_like(flow[..., :1])], axis=2))


def encode_flow_png16(flow: NDArray[np.float32]) -> bytes:
    """Encode as KITTI's 16-bit RGB PNG: 64 u + 2^15, 64 v + 2^15, each rounded, and 1.

    Args:
        flow: (H, W, 2) float32 px; where either is not finite, or `beyond_flow_png16`, all three channels are 0.
    """
    counted = _counted(flow)
    valid = _fits(counted)[..., None]
    stored = np.concatenate([np.where(valid, counted, 0), valid], axis=2)
    return encode_png(stored.astype(np.uint16))


def beyond_flow_png16(flow: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return where KITTI's PNG cannot say a flow that is there: below -512 px or from 512 px on, but for rounding.

    Args:
        flow: (H, W, 2) float32 px.

    Returns:
        (H, W) bool.
    """
    there = np.isfinite(flow).all(axis=2)
    beyond: NDArray[np.bool_] = there & ~_fits(_counted(flow))
    return beyond


def _counted(flow: NDArray[np.float32]) -> NDArray[np.float64]:
    # In float64 the sum is exact, so that it is rounded once.
    counted: NDArray[np.float64] = np.rint(flow.astype(np.float64) * _KITTI_STEPS + _KITTI_ZERO)
    return counted


def _fits(counted: NDArray[np.float64]) -> NDArray[np.bool_]:
    fits: NDArray[np.bool_] = np.all((counted >= 0) & (counted <= _KITTI_LARGEST), axis=2)
    return fits
