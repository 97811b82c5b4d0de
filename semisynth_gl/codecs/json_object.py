"""JSON files that hold one object."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from semisynth_gl.codecs.codec import Codec
from semisynth_gl.inputs.errors import ReadError


class JsonObject(Codec[Mapping[str, Any]]):
    """A mapping in JSON's types, indented, with a line break at the end."""

    suffix = ".json"
    description = "JSON"

    def encode(self, value: Mapping[str, Any]) -> bytes:
        """Encode a mapping; raises ValueError where it has NaN or infinity."""
        return (json.dumps(value, indent=1, allow_nan=False) + "\n").encode()

    def decode(self, data: bytes, path: Path) -> dict[str, Any]:
        """Decode a mapping; raises ReadError also where it has NaN or infinity."""
        try:
            values = json.loads(data, parse_constant=_refuse)
        except (ValueError, RecursionError) as error:
            raise ReadError(path, f"is not JSON: {error}") from None
        if not isinstance(values, dict):
            raise ReadError(path, f"expected a JSON object, got {type(values).__name__}")
        return values


def _refuse(name: str) -> None:
    raise ValueError(f"expected finite numbers, got {name}")


JSON_OBJECT = JsonObject()
