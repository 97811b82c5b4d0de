"""JSON files that hold one object."""

import json
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from semisynth_gl.codecs.codec import Codec
from semisynth_gl.inputs.errors import ReadError, shown

# Limit of whole numbers, so that each of them fits into a float64.
_LARGEST = 10**300


class JsonObject(Codec[Mapping[str, Any]]):
    """A mapping in JSON's types, indented, with a line break at the end."""

    name = "json"
    description = "JSON"

    def encode(self, value: Mapping[str, Any]) -> bytes:
        """Encode a mapping."""
        return (json.dumps(value, indent=1) + "\n").encode()

    def decode(self, data: bytes, path: Path) -> dict[str, Any]:
        """Decode a mapping; raises ReadError also where a key occurs twice or a number is not finite."""
        try:
            values = json.loads(data, object_pairs_hook=_object)
        except ValueError as error:
            raise ReadError(path, f"is not JSON: {error}") from None
        except RecursionError:
            raise ReadError(path, "is not JSON that can be read: its objects or lists are nested too deeply") from None
        if not isinstance(values, dict):
            raise ReadError(path, f"expected a JSON object, got {type(values).__name__}")
        return values


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"the key {next(key for key in keys if keys.count(key) > 1)!r} occurs twice in one object")
    for key, value in pairs:
        _check_numbers(key, value)
    return values


def _check_numbers(key: str, value: object) -> None:
    """Raise ValueError where a number, also in a list, is no finite float64; inner objects are already checked."""
    if isinstance(value, float | int):
        if not (isfinite(value) if isinstance(value, float) else -_LARGEST < value < _LARGEST):
            raise ValueError(f"expected a finite number at the key {key!r}, got {shown(value)}")
    elif isinstance(value, list):
        for item in value:
            _check_numbers(key, item)


JSON_OBJECT = JsonObject()
