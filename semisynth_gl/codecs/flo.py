"""Middlebury's .flo, for flow."""

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.codec import Codec, check_numbers, check_size
from semisynth_gl.inputs.errors import ReadError

_TAG = b"PIEH"  # the float32 202021.25
_HEADER_BYTES = 12
_LARGEST = 1e9
_UNKNOWN = np.float32(1e10)


class Flo(Codec[NDArray[np.float32]]):
    """Flow, (H, W, 2) float32 px: tag, width, height, then u and v of each pixel, little-endian; 1e10 means inf."""

    suffix = ".flo"
    description = "Middlebury's .flo, float32"

    def encode(self, value: NDArray[np.float32]) -> bytes:
        """Encode a flow; both components become 1e10, unknown, where either is not finite or above 1e9."""
        height, width = value.shape[:2]
        known = (np.abs(value) <= np.float32(_LARGEST)).all(axis=2, keepdims=True)
        header = _TAG + struct.pack("<ii", width, height)
        return header + np.where(known, value, _UNKNOWN).astype("<f4").tobytes()

    def decode(self, data: bytes, path: Path) -> NDArray[np.float32]:
        """Decode a flow, with inf in both components where either is above 1e9; see `Codec.decode`."""
        if len(data) < _HEADER_BYTES or data[:4] != _TAG:
            raise ReadError(path, f"expected a .flo (it begins with {_TAG!r}, width and height), got {data[:12]!r}")
        width, height = struct.unpack("<ii", data[4:_HEADER_BYTES])
        check_size(data, _HEADER_BYTES, 8, width, height, path)
        flow = np.frombuffer(data, "<f4", offset=_HEADER_BYTES).reshape(height, width, 2)
        check_numbers(flow, path)
        unknown = (np.abs(flow) > np.float32(_LARGEST)).any(axis=2, keepdims=True)
        return np.where(unknown, np.float32(np.inf), flow)
