"""Merges configs key by key: a config over the config that it extends, and a recipe over the config."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from semisynth_gl.config.yaml_values import KeyPath

Values = dict[str, Any]

OVERRIDE = "override"
"""The place of a key that ``--set`` or the argument ``overrides`` has set."""

# Alternative keys for one property: a key removes these keys from the layers below it.
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


def merged(below: Values, above: Mapping[str, Any]) -> Values:
    """Return the values ``above`` over those ``below``.

    Mappings are merged key by key. All other values, and mappings with a key ``form``, replace the value below. A key
    also removes alternative keys of the same property from ``below``.
    """
    replaced = {name for key in above for name in _REPLACES.get(key, ())}
    result = {key: value for key, value in below.items() if key not in replaced}
    for key, value in above.items():
        old = result.get(key)
        # A mapping with a form is complete; keys of a different form must not remain.
        if isinstance(old, dict) and isinstance(value, dict) and "form" not in value:
            result[key] = merged(old, value)
        else:
            result[key] = value
    return result


@dataclass(frozen=True, slots=True)
class ConfigLayer:
    """The values of one source of a config, and the place where each key was set: ``file:line``, or `OVERRIDE`.

    ``places`` is in the order in which keys were set. The place of the key () is the file.
    """

    values: Values
    places: dict[KeyPath, str]

    def over(self, below: "ConfigLayer") -> "ConfigLayer":
        """Return this layer merged over the layer ``below``; see `merged`."""
        kept = {key: place for key, place in below.places.items() if key not in self.places}
        return ConfigLayer(merged(below.values, self.values), kept | self.places)

    def message(self, text: str, keys: Sequence[KeyPath]) -> str:
        """Return a message on a fault of several keys with their places; the key that was set last comes first."""
        stated = [key for key in keys if holds(self.values, key)] or keys[:1]
        places = {key: self._place(key) for key in stated}
        last, *others = sorted(stated, key=places.__getitem__, reverse=True)
        place = places[last][1]
        notes = [f"{dotted(key)} of {places[key][1]}" for key in others if places[key][1] != place]
        start = (" " if place == OVERRIDE else ": ").join(filter(None, (place, dotted(last))))
        return f"{start}: {text}" + (f" (with {', '.join(notes)})" if notes else "")

    def _place(self, key: KeyPath) -> tuple[int, str]:
        """Return when a key was set, as a number that increases, and the place.

        A key without a place has that of the nearest section around it, of a key in it, or of the file.
        """
        around = (key[:n] for n in range(len(key), 0, -1) if key[:n] in self.places)
        placed = next(around, next((each for each in self.places if key and each[: len(key)] == key), ()))
        return [(), *self.places].index(placed), self.places.get(placed, "")


def holds(values: Any, key: KeyPath) -> bool:  # noqa: ANN401 - any YAML value
    """Return whether nested mappings and lists contain a key."""
    try:
        for part in key:
            values = values[part]
    except (LookupError, TypeError):
        return False
    return True


def dotted(key: KeyPath) -> str:
    """Return a key as messages show it, such as scenes.0.weight."""
    return ".".join(map(str, key))


def undotted(text: str) -> KeyPath:
    """Return the key of a dotted text; a number is an index into a list."""
    return tuple(int(part) if part.isdecimal() else part for part in text.split("."))
