"""Encodings of disparities, measured by encoding and decoding: time to write and to read, bytes, error."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from timing import alternated, alternative_rows, compare_times

from semisynth_gl.bench.summary import error_stats
from semisynth_gl.codecs import DISPARITY_CODECS, Codec, Encodings

DEFAULT_DISPARITY_ENCODING = Encodings().disparity.name

# Decoders take the name of a file for their messages.
_MEMORY = Path("memory")


@dataclass(frozen=True, slots=True)
class Encoding:
    """An encoder and its decoder.

    Attributes:
        name: its name in reports.
        text: its description in reports.
        encode: turns disparities, (H, W) float32 with inf where there is no truth, into bytes.
        decode: turns the bytes and the array's shape into an array again.
    """

    name: str
    text: str
    encode: Callable[[NDArray[Any]], bytes]
    decode: Callable[[bytes, tuple[int, ...]], NDArray[Any]]


def offered_encodings(*, signed: bool = False) -> list[Encoding]:
    """Return the encodings that a config may choose; ``signed`` says whether its disparities are signed."""
    codecs = {name: Encodings.from_names(disparity=name, signed=signed).disparity for name in DISPARITY_CODECS}
    return [
        Encoding(name, codec.description, codec.encode, partial(_decode_file, codec)) for name, codec in codecs.items()
    ]


def _decode_file(codec: Codec[Any], data: bytes, _: tuple[int, ...]) -> NDArray[Any]:
    """Decode a file; a file says the shape of its array."""
    array: NDArray[Any] = codec.decode(data, _MEMORY)
    return array


def measure_encodings(
    arrays: Sequence[NDArray[Any]], encodings: Sequence[Encoding], default: str, repeats: int
) -> list[dict[str, Any]]:
    """Encode and decode arrays with each encoding in turn, and compare the decoded arrays with the originals.

    Args:
        arrays: the left and right disparities of each pair, one pair after the other.
        encodings: the encodings; the ``default`` one must be among them.
        default: the name of the encoding to which times are relative.
        repeats: how often each encoding is timed.

    Returns:
        A row of `alternative_rows` for each encoding; "error" has the `error_stats`. The Pareto front weighs
        time to write, time to read, bytes and worst error.
    """

    def encode(encoding: Encoding) -> list[bytes]:
        return [encoding.encode(array) for array in arrays]

    def decode(encoding: Encoding) -> list[NDArray[Any]]:
        files = zip(encoded[encoding.name], arrays, strict=True)
        return [encoding.decode(data, array.shape) for data, array in files]

    encoded = {encoding.name: encode(encoding) for encoding in encodings}
    pairs = len(arrays) / 2
    writing, reading = (
        compare_times(alternated({each.name: partial(work, each) for each in encodings}, repeats), default, pairs)
        for work in (encode, decode)
    )
    figures: dict[str, Any] = {}
    weighed: dict[str, Sequence[float]] = {}
    for encoding in encodings:
        name, decoded = encoding.name, decode(encoding)
        size = sum(map(len, encoded[name])) / pairs
        values, truth = (np.concatenate([array.ravel() for array in part]) for part in (decoded, arrays))
        error = error_stats(values, truth.astype(np.float64))
        figures[name] = {
            "read_seconds_per_pair": reading[name].seconds,
            "bytes_per_pair": size,
            "lossless": all(map(np.array_equal, decoded, arrays)),
            "error": error,
        }
        # An encoding that loses pixels is the worst.
        weighed[name] = reading[name].ratio, size, np.inf if error["missing"] else float(error["worst_px"])
    return alternative_rows({each.name: each.text for each in encodings}, writing, figures, weighed)
