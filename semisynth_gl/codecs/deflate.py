"""Deflate with ISA-L."""

import zlib

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

# ISA-L's second fastest level.
_LEVEL = 1
# Number of bytes that ISA-L buffers ahead of the position at which it works.
_AHEAD = 288


def deflate(content: NDArray[np.uint8]) -> bytes:
    """Compress a contiguous array's bytes as a zlib stream, whose bytes do not depend on addresses in memory.

    After the first byte of a stream, ISA-L 2.32 takes the hash of the third byte from a register that holds the
    stream's address, so the address decides whether it finds a match. Therefore the first call lets ISA-L compress only
    the first byte, and the second call reads all registers anew. Content too short for that is stored uncompressed.
    """
    flat = content.reshape(-1)
    if len(flat) <= _AHEAD:
        return zlib.compress(flat.tobytes(), 0)
    compressor = isal_zlib.compressobj(_LEVEL)
    first, rest = flat[: _AHEAD + 1], flat[_AHEAD + 1 :]
    return b"".join([compressor.compress(first), compressor.compress(rest), compressor.flush()])
