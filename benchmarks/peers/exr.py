"""Reads OpenEXR files of one float channel as Blender writes them: scanlines, uncompressed or ZIP."""

import struct
import zlib
from pathlib import Path

import numpy as np

_ROWS_OF_A_BLOCK = {0: 1, 3: 16}  # for the compressions none and ZIP
_FLOAT = 2


def read_exr(path: Path) -> np.ndarray:
    """Read the first channel, (H, W) float32, top row first."""
    data = path.read_bytes()
    attributes, at = _header(data)
    if attributes["compression"][0] not in _ROWS_OF_A_BLOCK:
        raise ValueError(f"{path}: compression {attributes['compression'][0]} is not supported: expected none or ZIP")
    rows_of_a_block = _ROWS_OF_A_BLOCK[attributes["compression"][0]]
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    channels = _channel_kinds(attributes["channels"])
    if set(channels) != {_FLOAT}:
        raise ValueError(f"{path}: expected channels of 32-bit floats, got kinds {channels}")
    blocks = -(-height // rows_of_a_block)
    offsets = struct.unpack_from(f"<{blocks}Q", data, at)
    image = np.empty((height, len(channels), width), "<f4")
    for offset in offsets:
        first, size = struct.unpack_from("<ii", data, offset)
        rows = image[first - top : first - top + rows_of_a_block]
        block = data[offset + 8 : offset + 8 + size]
        # A block that compression does not make smaller is stored uncompressed.
        block = block if size == rows.nbytes else _unzipped(block)
        rows[:] = np.frombuffer(block, "<f4").reshape(rows.shape)
    return np.ascontiguousarray(image[:, 0])


def _header(data: bytes) -> tuple[dict[str, bytes], int]:
    """Return the header's attributes by name, and the position of its end."""
    attributes, at = {}, 8
    while data[at]:
        name, _, rest = data[at : at + 512].partition(b"\0")
        kind, _, _ = rest.partition(b"\0")
        at += len(name) + len(kind) + 2
        [size] = struct.unpack_from("<i", data, at)
        attributes[name.decode()] = data[at + 4 : at + 4 + size]
        at += 4 + size
    return attributes, at + 1


def _channel_kinds(listed: bytes) -> list[int]:
    kinds = []
    while listed[0]:
        _, _, rest = listed.partition(b"\0")
        kinds.append(struct.unpack_from("<i", rest)[0])
        listed = rest[16:]
    return kinds


def _unzipped(block: bytes) -> bytes:
    """Undo ZIP: the even bytes, then the odd bytes, as differences of successive bytes."""
    steps = np.frombuffer(zlib.decompress(block), np.uint8).copy()
    steps[1:] -= 128
    halves = np.cumsum(steps, dtype=np.uint8)
    merged = np.empty_like(halves)
    middle = (len(halves) + 1) // 2
    merged[0::2], merged[1::2] = halves[:middle], halves[middle:]
    return merged.tobytes()
