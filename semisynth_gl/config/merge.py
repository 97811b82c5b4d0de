"""Merging the values of configs key by key: a file over the file that it extends, an override over a file."""

from dataclasses import dataclass, field
from typing import Any

from semisynth_gl.config.yaml_values import Key

# Alternative keys for the same property: a key that is set later removes the keys that it replaces.
_REPLACES = {
    "focal_px": ("focal_mm", "sensor_width_mm"),
    "focal_mm": ("focal_px",),
    "doffs_px": ("cx_right_px",),
    "cx_right_px": ("doffs_px",),
    "layers": ("density",),
    "density": ("layers",),
    "ground_height_m": ("ground_disparity_px",),
    "ground_disparity_px": ("ground_height_m",),
}


@dataclass(slots=True)
class Document:
    """Plain values of a file, or of several merged files, and the places where keys were set.

    ``places`` has ``file:line``, or the name of an override, for each key whose place is known; ``files`` lists each
    file before the file that extends it.
    """

    values: dict[str, Any] = field(default_factory=dict)
    places: dict[Key, str] = field(default_factory=dict)
    files: tuple[str, ...] = ()


def merged(base: Document, own: Document) -> Document:
    """Return a new document with the values of ``own`` merged over those of ``base``.

    Mappings are merged key by key; all other values, and mappings with a key ``form``, are replaced whole.
    """
    # The place of a replaced value is forgotten, so that no message sends the user there.
    places = dict(base.places)

    def forget(key: Key, value: Any) -> None:  # noqa: ANN401 - any YAML value
        for below in keys_of(value, key):
            places.pop(below, None)

    def merge(below: dict[str, Any], above: dict[str, Any], at: Key) -> dict[str, Any]:
        replaced = {name for key in above for name in _REPLACES.get(key, ()) if name not in above}
        result = dict(below)
        for name in replaced & below.keys():
            forget((*at, name), below[name])
            del result[name]
        for name, value in above.items():
            key = (*at, name)
            # A mapping with a form states all keys of that form; keys of another form must not remain.
            if isinstance(value, dict) and isinstance(below.get(name), dict) and "form" not in value:
                result[name] = merge(below[name], value, key)
            else:
                forget(key, below.get(name))
                # A key that was set through a key below it gets the place of that lower key.
                through = next((own.places[set_key] for set_key in keys_of(value, key) if set_key in own.places), None)
                if through is not None:
                    places[key] = through
                result[name] = value
        return result

    values = merge(base.values, own.values, ())
    return Document(values, places | own.places, base.files + own.files)


def keys_of(value: Any, key: Key) -> list[Key]:  # noqa: ANN401 - any YAML value
    """Return ``key``, whose value is ``value``, and the keys of all values inside that value."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [key, *(below for part, child in parts for below in keys_of(child, (*key, part)))]
