"""JSON files that hold one object."""

import json
from pathlib import Path
from typing import Any

from semisynth_gl.read.error import ReadError, read_bytes


def decode_json(data: bytes, path: Path) -> dict[str, Any]:
    """Decode a JSON object; the path is for messages.

    Raises:
        ReadError: where it is something else.
    """
    try:
        values = json.loads(data)
    except ValueError as error:
        raise ReadError(path, f"is not JSON: {error}") from None
    if not isinstance(values, dict):
        raise ReadError(path, f"expected a JSON object, got {type(values).__name__}")
    return values


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file; raises like `decode_json`, and where it is missing."""
    return decode_json(read_bytes(path), path)
