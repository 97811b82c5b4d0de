"""Encodings of disparities and of images, measured by a round trip: time to write and to read, bytes, error.

The encodings are the codecs that a config may choose.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.summary import error_stats, front
from semisynth_gl.bench.timing import alternated, compare_times
from semisynth_gl.codecs import Codec, Encodings
from semisynth_gl.inputs.errors import InputError

DEFAULT_DISPARITY_ENCODING = Encodings().disparity.name
DEFAULT_IMAGE_ENCODING = Encodings().image.name

# Decoders want the name of a file for their messages.
_MEMORY = Path("memory")


@dataclass(frozen=True, slots=True)
class Encoding:
    """An encoder with its decoder.

    Attributes:
        name: short.
        text: a description.
        encode: (H, W) float32 disparity, inf where there is no truth, or (H, W, 3) uint8 RGB or (H, W) uint8 grey, to
            bytes.
        decode: bytes and the array's shape to the array.
    """

    name: str
    text: str
    encode: Callable[[NDArray[Any]], bytes]
    decode: Callable[[bytes, tuple[int, ...]], NDArray[Any]]


def usable_encodings(codecs: Mapping[str, Codec[Any]]) -> tuple[list[Encoding], dict[str, str]]:
    """List the encodings of codecs that are installed and, by name, why the others cannot be measured here."""
    usable: list[Encoding] = []
    left_out: dict[str, str] = {}
    for name, codec in codecs.items():
        try:
            codec.check_installed()
        except InputError as error:
            left_out[name] = str(error)
        else:
            usable.append(Encoding(name, codec.description, codec.encode, partial(_decode_file, codec)))
    return usable, left_out


def _decode_file(codec: Codec[Any], data: bytes, _: tuple[int, ...]) -> NDArray[Any]:
    """Decode a file, which has its array's shape in it."""
    array: NDArray[Any] = codec.decode(data, _MEMORY)
    return array


def measure_encodings(
    arrays: Sequence[NDArray[Any]], encodings: Sequence[Encoding], default: str, repeats: int
) -> list[dict[str, Any]]:
    """Encode and decode arrays and compare the result with them.

    Args:
        arrays: (H, W) float32 disparities or uint8 images, both of a pair one after the other.
        encodings: the alternatives.
        default: name of the encoding whose time to write is 1.
        repeats: how often each encoding encodes and decodes all arrays, in turns.

    Returns:
        A row of each encoding. "error" is that of decoded disparities, None for images; "on_front" says that no other
        encoding dominates this one in time to write, time to read, bytes and worst error.
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
        {
            "name": name,
            "text": encoding.text,
            "seconds_per_pair": writing[name].seconds,
            "time_ratio": writing[name].ratio,
            "read_seconds_per_pair": reading[name].seconds,
            "bytes_per_pair": sizes[name],
            "lossless": lossless[name],
            "error": errors[name],
            "on_front": name in best,
        }
        for encoding in encodings
        for name in [encoding.name]
    ]


def _error(decoded: Sequence[NDArray[Any]], arrays: Sequence[NDArray[Any]]) -> dict[str, Any] | None:
    if arrays[0].dtype != np.float32:
        return None
    values, truth = (np.concatenate([array.ravel() for array in part]) for part in (decoded, arrays))
    return error_stats(values, truth.astype(np.float64))


def _worst_px(error: Mapping[str, Any] | None) -> float:
    """Return the error that the front weighs: an encoding that drops pixels is worse than one that keeps them."""
    if error is None:
        return 0.0
    return np.inf if error["missing"] else float(error["worst_px"])
