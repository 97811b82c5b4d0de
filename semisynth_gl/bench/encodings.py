"""Encodings of disparities and of images, measured by encoding and decoding: time to write and to read, bytes, error.

All installed codecs that a config may choose are measured.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.summary import alternative_rows, error_stats
from semisynth_gl.bench.timing import alternated, compare_times
from semisynth_gl.codecs import Codec, Encodings
from semisynth_gl.inputs.errors import InputError

DEFAULT_DISPARITY_ENCODING = Encodings().disparity.name
DEFAULT_IMAGE_ENCODING = Encodings().image.name

# Decoders take the name of a file for their messages.
_MEMORY = Path("memory")


@dataclass(frozen=True, slots=True)
class Encoding:
    """An encoder and its decoder.

    Attributes:
        name: its name in reports.
        text: its description in reports.
        encode: turns an array into bytes: either disparity, (H, W) float32 with inf where there is no truth, or an
            image, (H, W, 3) uint8 RGB or (H, W) uint8 grey.
        decode: turns the bytes and the array's shape into an array again.
    """

    name: str
    text: str
    encode: Callable[[NDArray[Any]], bytes]
    decode: Callable[[bytes, tuple[int, ...]], NDArray[Any]]


def usable_encodings(codecs: Mapping[str, Codec[Any]]) -> tuple[list[Encoding], dict[str, str]]:
    """Return the encodings whose codecs are installed, and the reason why each other codec is left out, by its name."""
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
    """Decode a file; a file says the shape of its array."""
    array: NDArray[Any] = codec.decode(data, _MEMORY)
    return array


def measure_encodings(
    arrays: Sequence[NDArray[Any]], encodings: Sequence[Encoding], default: str, repeats: int
) -> list[dict[str, Any]]:
    """Encode and decode arrays with each encoding in turn, and compare the decoded arrays with the originals.

    Args:
        arrays: the left and right disparities, or images, of each pair, one pair after the other.
        encodings: the encodings; the ``default`` one must be among them.
        default: the name of the encoding to which times are relative.
        repeats: how often each encoding is timed.

    Returns:
        A row of `alternative_rows` for each encoding. "error" has the `error_stats` of decoded disparities, and is None
        for images. The Pareto front weighs time to write, time to read, bytes and worst error.
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
    figures, weighed = {}, {}
    for encoding in encodings:
        name, decoded = encoding.name, decode(encoding)
        size, error = sum(map(len, encoded[name])) / pairs, _error(decoded, arrays)
        figures[name] = {
            "read_seconds_per_pair": reading[name].seconds,
            "bytes_per_pair": size,
            "lossless": all(map(np.array_equal, decoded, arrays)),
            "error": error,
        }
        weighed[name] = reading[name].ratio, size, _worst_px(error)
    return alternative_rows({each.name: each.text for each in encodings}, writing, figures, weighed)


def _error(decoded: Sequence[NDArray[Any]], arrays: Sequence[NDArray[Any]]) -> dict[str, Any] | None:
    if arrays[0].dtype != np.float32:
        return None
    values, truth = (np.concatenate([array.ravel() for array in part]) for part in (decoded, arrays))
    return error_stats(values, truth.astype(np.float64))


def _worst_px(error: Mapping[str, Any] | None) -> float:
    """Return the error that the front weighs: the worst error, or infinity for an encoding that loses pixels."""
    if error is None:
        return 0.0
    return np.inf if error["missing"] else float(error["worst_px"])
