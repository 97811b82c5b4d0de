"""Ways to store a disparity map, or an image: each an encoder and its decoder, measured through a round trip.

What the program offers stands here with the encoders that write it and the decoders that verify reads it with.
"""

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
from semisynth_gl.encodings import DISPARITY_ENCODINGS, IMAGE_ENCODINGS, DisparityEncoding, Encodings, ImageEncoding
from semisynth_gl.errors import InputError
from semisynth_gl.read.encodings import DISPARITY_DECODERS, IMAGE_DECODERS
from semisynth_gl.write.encodings import DISPARITY_ENCODERS, IMAGE_ENCODERS

DEFAULT_STORE = Encodings().disparity
DEFAULT_IMAGE_STORE = Encodings().image

_Map = NDArray[np.float32]
_Image = NDArray[np.uint8]
_OFFERED: dict[DisparityEncoding, str] = {
    "pfm": "float32, PFM",
    "png16": "16-bit PNG, x256, 0 for no truth",
    "tiff": "float32, TIFF, floating point predictor, deflate",
}
_OFFERED_IMAGES: dict[ImageEncoding, str] = {
    "png": "PNG, one filter, ISA-L's deflate",
    "qoi": "QOI, libqoi",
    "jxl": "lossless JPEG XL, libjxl, effort 1",
}
# For messages of decoders, which want a file's name.
_MEMORY = Path("memory")
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


@dataclass(frozen=True, slots=True)
class ImageStore:
    """A way to store one image.

    Attributes:
        name: short.
        text: what it does.
        encode: (H, W, 3) uint8 RGB to bytes.
        decode: bytes to the image.
    """

    name: str
    text: str
    encode: Callable[[_Image], bytes]
    decode: Callable[[bytes], _Image]


@dataclass(frozen=True, slots=True)
class ImageStoreRow:
    """One way to store images.

    Attributes:
        name: of the store.
        text: what it does.
        seconds_per_pair: encoding both images of a pair.
        time_ratio: to the default's.
        read_seconds_per_pair: decoding both.
        bytes_per_pair: both images.
        lossless: whether what comes back is what was stored.
        on_front: whether no other way is as small and as fast to write and to read, and better in one.
    """

    name: str
    text: str
    seconds_per_pair: float
    time_ratio: float
    read_seconds_per_pair: float
    bytes_per_pair: float
    lossless: bool
    on_front: bool


def stores() -> list[Store]:
    """List the ways to store; blosc2 only where it is installed."""
    found = [
        *(_offered(name) for name in DISPARITY_ENCODINGS),
        Store("half", "half float, NPY", _encode_half, lambda data, _: _decode_half(data)),
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


def _offered(name: DisparityEncoding) -> Store:
    decode = DISPARITY_DECODERS[name].decode
    return Store(name, _OFFERED[name], DISPARITY_ENCODERS[name].encode, lambda data, _: decode(data, _MEMORY))


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


def image_stores() -> tuple[list[ImageStore], dict[str, str]]:
    """List the ways to store images, and those that are left out with the reason."""
    found: list[ImageStore] = []
    left_out: dict[str, str] = {}
    for name in IMAGE_ENCODINGS:
        try:
            Encodings(image=name).check()
        except InputError as error:
            left_out[name] = str(error)
        else:
            found.append(_offered_image(name))
    found.append(ImageStore("png-pillow", "PNG by Pillow, zlib's level 1", _encode_by_pillow, found[0].decode))
    return found, left_out


def _offered_image(name: ImageEncoding) -> ImageStore:
    decode = IMAGE_DECODERS[name]
    return ImageStore(name, _OFFERED_IMAGES[name], IMAGE_ENCODERS[name], lambda data: decode(data, _MEMORY))


def measure_image_stores(images: Sequence[_Image], repeats: int) -> tuple[list[ImageStoreRow], dict[str, str]]:
    """Encode, decode and compare.

    Args:
        images: both images of each pair, one after the other.
        repeats: how often each store encodes and decodes all of them, in turns.

    Returns:
        A row for each store, and the reasons of those that are left out.
    """
    found, left_out = image_stores()
    coded = {store.name: [store.encode(image) for image in images] for store in found}

    def encode(store: ImageStore) -> None:
        for image in images:
            store.encode(image)

    def decode(store: ImageStore) -> list[_Image]:
        return [store.decode(data) for data in coded[store.name]]

    pairs = len(images) / 2
    writing = alternated({store.name: partial(encode, store) for store in found}, repeats)
    reading = alternated({store.name: partial(decode, store) for store in found}, repeats)
    written, read = compared(writing, DEFAULT_IMAGE_STORE, 1), compared(reading, DEFAULT_IMAGE_STORE, 1)
    sizes = {name: sum(map(len, pieces)) / pairs for name, pieces in coded.items()}
    best = front({name: (written[name].ratio, sizes[name], read[name].ratio) for name in sizes})
    rows = [
        ImageStoreRow(
            store.name,
            store.text,
            written[store.name].seconds / pairs,
            written[store.name].ratio,
            read[store.name].seconds / pairs,
            sizes[store.name],
            all(np.array_equal(came, image) for came, image in zip(decode(store), images, strict=True)),
            store.name in best,
        )
        for store in found
    ]
    return rows, left_out


def _encode_by_pillow(image: _Image) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", compress_level=1)
    return file.getvalue()


def _encode_half(disparity: _Map) -> bytes:
    file = io.BytesIO()
    np.save(file, disparity.astype(np.float16))
    return file.getvalue()


def _decode_half(data: bytes) -> _Map:
    loaded: NDArray[np.float16] = np.load(io.BytesIO(data))
    return loaded.astype(np.float32)


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
