"""JSON files that hold one object."""

import json
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from semisynth_gl.codecs.codec import Codec
from semisynth_gl.inputs.errors import ReadError, cut


class JsonObject(Codec[Mapping[str, Any]]):
    """A mapping in JSON's types, indented, with a line break at the end."""

    name = "json"
    description = "JSON"

    def encode(self, value: Mapping[str, Any]) -> bytes:
        """Encode a mapping."""
        return (json.dumps(value, indent=1) + "\n").encode()

    def decode(self, data: bytes, path: Path) -> dict[str, Any]:
        """Decode a mapping; raises ReadError also where a number does not fit into a float64."""
        try:
            values = json.loads(data, parse_float=_real, parse_int=_whole, parse_constant=_real)
        except ValueError as error:
            raise ReadError(path, f"is not JSON: {error}") from None
        except RecursionError:
            raise ReadError(path, "is not JSON that can be read: its objects or lists are nested too deeply") from None
        if not isinstance(values, dict):
            raise ReadError(path, f"expected a JSON object, got {type(values).__name__}")
        return values


def _real(text: str) -> float:
    if not isfinite(float(text)):
        raise ValueError(f"expected finite numbers, got {cut(text)}")
    return float(text)


def _whole(text: str) -> int:
    _real(text)
    return int(text)


JSON_OBJECT = JsonObject()
