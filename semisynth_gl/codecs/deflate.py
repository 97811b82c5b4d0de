"""Deflate by ISA-L."""

import zlib

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

# ISA-L's fastest but one.
_LEVEL = 1
# ISA-L keeps so many bytes ahead of those that it works on.
_AHEAD = 288


def deflate(content: NDArray[np.uint8]) -> bytes:
    """Compress a contiguous array's bytes as a zlib stream, the same ones wherever the stream is in memory.

    Behind the first byte of a stream, ISA-L 2.32 takes the hash of the third one from a register that holds the
    stream's address, and then finds matches with it or not. So it gets the first byte alone, after which it reads all
    registers anew; content too short for that is stored.
    """
    flat = content.reshape(-1)
    if len(flat) <= _AHEAD:
        return zlib.compress(flat.tobytes(), 0)
    compressor = isal_zlib.compressobj(_LEVEL)
    first, rest = flat[: _AHEAD + 1], flat[_AHEAD + 1 :]
    return b"".join([compressor.compress(first), compressor.compress(rest), compressor.flush()])
