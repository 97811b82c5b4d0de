"""Ways to store a disparity map: each an encoder and its decoder, measured through a round trip."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.bench.timing import alternated, compared, front
from semisynth_gl.bench.ways import ErrorStats, error_stats
from semisynth_gl.read.pfm import decode_pfm
from semisynth_gl.write.pfm import encode_pfm
from semisynth_gl.write.png import encode_png

DEFAULT_STORE = "pfm"

_Map = NDArray[np.float32]
_PNG_STEPS = 256  # per px, as KITTI has it
_GRID_STEPS = 1024
_NOTHING = -1  # on the grid, where the disparity is inf
_LARGEST_GRID_PX = (2**31 - 1) // _GRID_STEPS


@dataclass(frozen=True, slots=True)
class Store:
    """A way to store one map.

    Attributes:
        name: short.
        text: what it does.
        encode: (H, W) float32, inf where there is no truth, to bytes.
        decode: bytes and (H, W) to the map.
    """

    name: str
    text: str
    encode: Callable[[_Map], bytes]
    decode: Callable[[bytes, tuple[int, int]], _Map]


@dataclass(frozen=True, slots=True)
class StoreRow:
    """One way to store.

    Attributes:
        name: of the store.
        text: what it does.
        seconds_per_pair: encoding both maps of a pair.
        time_ratio: to the default's.
        read_seconds_per_pair: decoding both.
        bytes_per_pair: both maps.
        error: of what comes back, against what was stored.
        on_front: whether no other way is as small, as fast to write and as exact (at worst), and better in one.
    """

    name: str
    text: str
    seconds_per_pair: float
    time_ratio: float
    read_seconds_per_pair: float
    bytes_per_pair: float
    error: ErrorStats
    on_front: bool


def stores() -> list[Store]:
    """List the ways to store; blosc2 only where it is installed."""
    found = [
        Store("pfm", "float32, PFM", encode_pfm, lambda data, _: decode_pfm(data, Path("memory.pfm"))),
        Store("half", "half float, NPY", _encode_half, lambda data, _: _decode_half(data)),
        Store("png16", "16-bit PNG, x256, 0 for no truth", _encode_png16, lambda data, _: _decode_png16(data)),
        Store("deflate", "float32, bytes shuffled, deflate", _encode_shuffled, _decode_shuffled),
        Store("delta", "float32, difference of bits to the left, shuffled, deflate", _encode_delta, _decode_delta),
        Store("grid", "float32 rounded to 1/1024 px, shuffled, deflate", _encode_grid, _decode_shuffled),
        Store(
            "grid-delta",
            "multiple of 1/1024 px, difference to the left, shuffled, deflate",
            _encode_grid_delta,
            _decode_grid_delta,
        ),
    ]
    try:
        import_module("blosc2")
    except ImportError:
        return found
    found.append(Store("blosc2", "float32, blosc2, shuffled, LZ4", _encode_blosc2, _decode_blosc2))
    return found


def measure_stores(maps: Sequence[_Map], repeats: int) -> list[StoreRow]:
    """Encode, decode and compare.

    Args:
        maps: both maps of each pair, one after the other.
        repeats: how often each store encodes and decodes all of them, in turns.
    """
    found = stores()
    coded = {store.name: [store.encode(one) for one in maps] for store in found}

    def encode(store: Store) -> None:
        for one in maps:
            store.encode(one)

    def decode(store: Store) -> list[_Map]:
        pieces = zip(coded[store.name], maps, strict=True)
        return [store.decode(data, (one.shape[0], one.shape[1])) for data, one in pieces]

    pairs = len(maps) / 2
    writing = alternated({store.name: partial(encode, store) for store in found}, repeats)
    reading = alternated({store.name: partial(decode, store) for store in found}, repeats)
    times = compared(writing, DEFAULT_STORE, 1)
    truth = np.concatenate([one.ravel() for one in maps]).astype(np.float64)
    errors = {store.name: error_stats(np.concatenate([one.ravel() for one in decode(store)]), truth) for store in found}
    sizes = {name: sum(map(len, pieces)) / pairs for name, pieces in coded.items()}
    # What loses pixels is not as exact as what keeps them.
    best = front({n: (times[n].ratio, sizes[n], np.inf if errors[n].missing else errors[n].worst_px) for n in sizes})
    return [
        StoreRow(
            store.name,
            store.text,
            times[store.name].seconds / pairs,
            times[store.name].ratio,
            float(np.median(reading[store.name])) / pairs,
            sizes[store.name],
            errors[store.name],
            store.name in best,
        )
        for store in found
    ]


def _encode_half(disparity: _Map) -> bytes:
    file = io.BytesIO()
    np.save(file, disparity.astype(np.float16))
    return file.getvalue()


def _decode_half(data: bytes) -> _Map:
    loaded: NDArray[np.float16] = np.load(io.BytesIO(data))
    return loaded.astype(np.float32)


def _encode_png16(disparity: _Map) -> bytes:
    steps = np.rint(disparity * _PNG_STEPS)
    # 0 means no truth, so the smallest disparity is one step; what lies beyond the last one cannot be said.
    stored = np.where(steps <= np.iinfo(np.uint16).max, np.maximum(steps, 1), 0)
    return encode_png(stored.astype(np.uint16))


def _decode_png16(data: bytes) -> _Map:
    with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
        steps = np.asarray(image).astype(np.float32)
    return np.where(steps > 0, steps / np.float32(_PNG_STEPS), np.float32(np.inf))


def _shuffled(values: NDArray[np.float32] | NDArray[np.uint32]) -> bytes:
    """First all first bytes, then all second ones and so on, deflated: the high bytes of neighbours are alike."""
    planes = np.ascontiguousarray(values).view(np.uint8).reshape(-1, 4).T
    packed: bytes = isal_zlib.compress(np.ascontiguousarray(planes), 1)
    return packed


def _unshuffled(data: bytes) -> NDArray[np.uint8]:
    planes = np.frombuffer(isal_zlib.decompress(data), np.uint8).reshape(4, -1)
    return np.ascontiguousarray(planes.T)


def _encode_shuffled(disparity: _Map) -> bytes:
    return _shuffled(disparity)


def _decode_shuffled(data: bytes, shape: tuple[int, int]) -> _Map:
    return _unshuffled(data).view(np.float32).reshape(shape)


def _differences(values: NDArray[np.uint32]) -> NDArray[np.uint32]:
    result = values.copy()
    result[:, 1:] -= values[:, :-1]
    return result


def _sums(data: bytes, shape: tuple[int, int]) -> NDArray[np.uint32]:
    return np.cumsum(_unshuffled(data).view(np.uint32).reshape(shape), axis=1, dtype=np.uint32)


def _encode_delta(disparity: _Map) -> bytes:
    return _shuffled(_differences(np.ascontiguousarray(disparity).view(np.uint32)))


def _decode_delta(data: bytes, shape: tuple[int, int]) -> _Map:
    return _sums(data, shape).view(np.float32)


def _encode_grid(disparity: _Map) -> bytes:
    return _shuffled(np.rint(disparity * np.float32(_GRID_STEPS)) / np.float32(_GRID_STEPS))


def _encode_grid_delta(disparity: _Map) -> bytes:
    kept = disparity < _LARGEST_GRID_PX
    steps = np.rint(np.where(kept, disparity, 0).astype(np.float64) * _GRID_STEPS).astype(np.int32)
    return _shuffled(_differences(np.where(kept, steps, np.int32(_NOTHING)).view(np.uint32)))


def _decode_grid_delta(data: bytes, shape: tuple[int, int]) -> _Map:
    steps = _sums(data, shape).view(np.int32)
    return np.where(steps == _NOTHING, np.float32(np.inf), (steps / _GRID_STEPS).astype(np.float32))


def _encode_blosc2(disparity: _Map) -> bytes:
    blosc2 = import_module("blosc2")
    blosc2.set_nthreads(1)
    packed: bytes = blosc2.compress(
        np.ascontiguousarray(disparity), typesize=4, clevel=5, filter=blosc2.Filter.SHUFFLE, codec=blosc2.Codec.LZ4
    )
    return packed


def _decode_blosc2(data: bytes, shape: tuple[int, int]) -> _Map:
    return np.frombuffer(import_module("blosc2").decompress(data), np.float32).reshape(shape)
