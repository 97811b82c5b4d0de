"""Encodings of disparities and of images, measured by a round trip: time to write and to read, bytes, error.

The encodings are those that the program offers, with the encoders that write them and the decoders that verify uses.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.summary import ErrorStats, error_stats, front
from semisynth_gl.bench.timing import alternated, compare_times
from semisynth_gl.encodings import DISPARITY_ENCODINGS, IMAGE_ENCODINGS, DisparityEncoding, Encodings, ImageEncoding
from semisynth_gl.errors import InputError
from semisynth_gl.read.encodings import DISPARITY_DECODERS, IMAGE_DECODERS
from semisynth_gl.write.encodings import DISPARITY_ENCODERS, IMAGE_ENCODERS

DEFAULT_DISPARITY_ENCODING = Encodings().disparity
DEFAULT_IMAGE_ENCODING = Encodings().image

_DISPARITY_TEXTS: Mapping[DisparityEncoding, str] = {
    "pfm": "float32, PFM",
    "png16": "16-bit PNG, x256, 0 for no truth",
    "tiff": "float32, TIFF, floating point predictor, deflate",
}
_IMAGE_TEXTS: Mapping[ImageEncoding, str] = {
    "png": "PNG, one filter, ISA-L's deflate",
    "qoi": "QOI, libqoi",
    "jxl": "lossless JPEG XL, libjxl, effort 1",
}
# Decoders want the name of a file for their messages.
_MEMORY = Path("memory")


@dataclass(frozen=True, slots=True)
class Encoding:
    """An encoder with its decoder.

    Attributes:
        name: short.
        text: a description.
        encode: (H, W) float32 disparity, inf where there is no truth, or (H, W, 3) uint8 RGB, to bytes.
        decode: bytes and the array's shape to the array.
    """

    name: str
    text: str
    encode: Callable[[NDArray[Any]], bytes]
    decode: Callable[[bytes, tuple[int, ...]], NDArray[Any]]


@dataclass(frozen=True, slots=True)
class EncodingRow:
    """Measurements of one encoding.

    Attributes:
        name: the encoding's name.
        text: its description.
        seconds_per_pair: time to encode both arrays of a pair.
        time_ratio: that time relative to the default's.
        read_seconds_per_pair: time to decode both.
        bytes_per_pair: size of both.
        lossless: the decoded arrays are equal to the encoded ones.
        error: of decoded disparities; None for images.
        on_front: no other encoding dominates it in time to write, time to read, bytes and worst error.
    """

    name: str
    text: str
    seconds_per_pair: float
    time_ratio: float
    read_seconds_per_pair: float
    bytes_per_pair: float
    lossless: bool
    error: ErrorStats | None
    on_front: bool


def disparity_encodings() -> list[Encoding]:
    """List the encodings of disparity that a config may choose."""
    return [
        Encoding(
            name, _DISPARITY_TEXTS[name], DISPARITY_ENCODERS[name].encode, _whole_file(DISPARITY_DECODERS[name].decode)
        )
        for name in DISPARITY_ENCODINGS
    ]


def image_encodings() -> tuple[list[Encoding], dict[str, str]]:
    """List the encodings of images that a config may choose and, by name, why others cannot be measured here."""
    usable: list[Encoding] = []
    left_out: dict[str, str] = {}
    for name in IMAGE_ENCODINGS:
        try:
            Encodings(image=name).check()
        except InputError as error:
            left_out[name] = str(error)
            continue
        usable.append(Encoding(name, _IMAGE_TEXTS[name], IMAGE_ENCODERS[name], _whole_file(IMAGE_DECODERS[name])))
    return usable, left_out


def measure_encodings(
    arrays: Sequence[NDArray[Any]], encodings: Sequence[Encoding], default: str, repeats: int
) -> list[EncodingRow]:
    """Encode and decode arrays and compare the result with them.

    Args:
        arrays: (H, W) float32 disparities or (H, W, 3) uint8 images, both of a pair one after the other.
        encodings: the alternatives.
        default: name of the encoding whose time to write is 1.
        repeats: how often each encoding encodes and decodes all arrays, in turns.
    """
    encoded = {encoding.name: [encoding.encode(array) for array in arrays] for encoding in encodings}

    def encode(encoding: Encoding) -> None:
        for array in arrays:
            encoding.encode(array)

    def decode(encoding: Encoding) -> list[NDArray[Any]]:
        files = zip(encoded[encoding.name], arrays, strict=True)
        return [encoding.decode(data, array.shape) for data, array in files]

    pairs = len(arrays) / 2
    seconds = alternated({encoding.name: partial(encode, encoding) for encoding in encodings}, repeats)
    read_seconds = alternated({encoding.name: partial(decode, encoding) for encoding in encodings}, repeats)
    writing, reading = compare_times(seconds, default, pairs), compare_times(read_seconds, default, pairs)
    sizes = {name: sum(map(len, files)) / pairs for name, files in encoded.items()}
    lossless, errors = {}, {}
    for encoding in encodings:
        decoded = decode(encoding)
        lossless[encoding.name] = all(map(np.array_equal, decoded, arrays))
        errors[encoding.name] = _error(decoded, arrays)
    best = front(
        {name: (writing[name].ratio, reading[name].ratio, sizes[name], _worst_px(errors[name])) for name in sizes}
    )
    return [
        EncodingRow(
            name, encoding.text, writing[name].seconds, writing[name].ratio, reading[name].seconds, sizes[name],
            lossless[name], errors[name], name in best,
        )
        for encoding in encodings
        for name in [encoding.name]
    ]  # fmt: skip


def _whole_file(decode: Callable[[bytes, Path], NDArray[Any]]) -> Callable[[bytes, tuple[int, ...]], NDArray[Any]]:
    """Adapt a decoder of files, which hold their shape."""
    return lambda data, _: decode(data, _MEMORY)


def _error(decoded: Sequence[NDArray[Any]], arrays: Sequence[NDArray[Any]]) -> ErrorStats | None:
    if arrays[0].dtype != np.float32:
        return None
    truth = np.concatenate([array.ravel() for array in arrays]).astype(np.float64)
    return error_stats(np.concatenate([array.ravel() for array in decoded]), truth)


def _worst_px(error: ErrorStats | None) -> float:
    """Return the error that the front weighs: an encoding that drops pixels is worse than one that keeps them."""
    if error is None:
        return 0.0
    return np.inf if error.missing else error.worst_px
