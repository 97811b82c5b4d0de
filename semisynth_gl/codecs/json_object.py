"""JSON files that hold one object."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from semisynth_gl.codecs.codec import Codec
from semisynth_gl.errors import ReadError


class JsonObject(Codec[Mapping[str, Any]]):
    """A mapping in JSON's types, readable, with a line break at the end."""

    name = "json"
    media_type = "application/json"
    description = "JSON"
    is_image = False

    def encode(self, value: Mapping[str, Any]) -> bytes:
        """Encode a mapping."""
        return (json.dumps(value, indent=1) + "\n").encode()

    def decode(self, data: bytes, path: Path) -> dict[str, Any]:
        """Decode a mapping; see `Codec.decode`."""
        try:
            values = json.loads(data)
        except ValueError as error:
            raise ReadError(path, f"is not JSON: {error}") from None
        if not isinstance(values, dict):
            raise ReadError(path, f"expected a JSON object, got {type(values).__name__}")
        return values


JSON_OBJECT = JsonObject()
