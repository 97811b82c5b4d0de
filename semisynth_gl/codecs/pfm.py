"""PFM, the benchmarks' format for float disparity, and SceneFlow's for flow."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.codec import Codec, check_numbers, check_size
from semisynth_gl.inputs.errors import ReadError

_HEADER = re.compile(rb"P[Ff]\s+([0-9]{1,9})\s+([0-9]{1,9})\s+([-+]?)[0-9.eE+-]{1,32}(?:\r\n|\s)")


class Pfm(Codec[NDArray[np.float32]]):
    """PFM of (H, W) float32, or of (H, W, 3) float32 with 3 ``components``; inf means "no value".

    `decode` also reads other programs' PFM: big-endian, with any white space in the header and any scale, of which only
    the sign is used, as by benchmarks.
    """

    suffix = ".pfm"
    description = "PFM, float32"

    def __init__(self, components: int = 1) -> None:
        self._components = components
        self._type = "Pf" if components == 1 else "PF"

    def encode(self, value: NDArray[np.float32]) -> bytes:
        """Encode an image: little-endian, rows from bottom to top, as all stereo loaders expect.

        The scale is -1.0: its sign means little-endian, and its magnitude is 1 since OpenCV multiplies by it.
        """
        height, width = value.shape[:2]
        header = f"{self._type}\n{width} {height}\n-1.0\n".encode()
        # Join the rows one by one, so that the pixels are copied only once.
        return b"".join([header, *np.ascontiguousarray(value, "<f4")[::-1]])

    def decode(self, data: bytes, path: Path) -> NDArray[np.float32]:
        """Decode an image, top row first; see `Codec.decode`."""
        header = _HEADER.match(data)
        if header is None or not data.startswith(self._type.encode()):
            raise ReadError(path, f"expected a PFM header ({self._type}, width, height, scale), got {data[:24]!r}")
        width, height = int(header[1]), int(header[2])
        check_size(data, header.end(), 4 * self._components, width, height, path)
        rows = np.frombuffer(data, "<f4" if header[3] == b"-" else ">f4", offset=header.end())
        shape = (height, width) if self._components == 1 else (height, width, self._components)
        return np.ascontiguousarray(rows.reshape(shape)[::-1], np.float32)


class FlowPfm(Codec[NDArray[np.float32]]):
    """SceneFlow's flow as PFM of three channels u, v and 0, from (H, W, 2) float32 px; inf means no flow."""

    suffix = ".pfm"
    description = "PFM of three channels, u, v and 0, float32"

    def encode(self, value: NDArray[np.float32]) -> bytes:
        """Encode a flow."""
        return PFM3.encode(np.concatenate([value, np.zeros_like(value[..., :1])], axis=2))

    def decode(self, data: bytes, path: Path) -> NDArray[np.float32]:
        """Decode a flow; raises ReadError also where the third channel is not 0 or a value is NaN."""
        channels = PFM3.decode(data, path)
        check_numbers(channels, path)
        if channels[..., 2].any():
            raise ReadError(path, "expected u, v and 0 at each pixel, got third values that are not 0")
        return np.ascontiguousarray(channels[..., :2])


PFM, PFM3 = Pfm(), Pfm(3)
