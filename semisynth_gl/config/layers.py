"""Merging the values of configs key by key: a config over the one that it extends, a recipe over its config."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from semisynth_gl.config.yaml_values import Key

Values = dict[str, Any]

OVERRIDE = "override"
"""The place of a key that ``--set`` or the argument ``overrides`` has set."""

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


def merged(
    below: Values, above: Mapping[str, Any], changed: set[Key] | None = None, at: Key = (), *, replacing: bool = True
) -> Values:
    """Return the values ``above`` over those ``below``, and add the keys that are set or removed to ``changed``.

    Mappings are merged key by key; all other values, and mappings with a key ``form``, are replaced whole. ``at`` is
    the key of both mappings. With ``replacing``, a key removes those below that state the same property.
    """
    changed = set() if changed is None else changed
    replaced = {name for key in above for name in _REPLACES.get(key, ()) if name not in above} if replacing else set()
    changed |= {(*at, key) for key in replaced}
    result = {key: value for key, value in below.items() if key not in replaced}
    for key, value in above.items():
        old = result.get(key)
        # A mapping with a form states all keys of that form; keys of another form must not remain.
        if isinstance(old, dict) and isinstance(value, dict) and "form" not in value:
            result[key] = merged(old, value, changed, (*at, key), replacing=replacing)
        else:
            result[key] = value
            changed.add((*at, key))
    return result


@dataclass(slots=True)
class Layer:
    """Plain values of a config, and the place where each key was set: ``file:line``, or `OVERRIDE`.

    A place that was set later comes later in ``places``. The place of the key () is the file.
    """

    values: Values = field(default_factory=dict)
    places: dict[Key, str] = field(default_factory=dict)

    def over(self, below: "Layer", *, replacing: bool = True) -> "Layer":
        """Return this layer merged over another one; see `merged`."""
        changed: set[Key] = set()
        values = merged(below.values, self.values, changed, replacing=replacing)

        def is_changed(key: Key) -> bool:
            return any(key[:n] in changed for n in range(1, len(key) + 1))

        kept = {key: place for key, place in below.places.items() if not is_changed(key)}
        return Layer(values, kept | {key: place for key, place in self.places.items() if not key or is_changed(key)})

    def place(self, key: Key, recipe: Key = ()) -> tuple[Key, str]:
        """Return the place of a key, or of the nearest key above it, with the key as it is written there.

        In the config of a recipe, whose own key is ``recipe``, the recipe's keys come before those of the config.
        """
        for n in range(len(key), -1, -1):
            for start in dict.fromkeys([recipe, ()]):
                if (*start, *key[:n]) in self.places:
                    return (*start, *key), self.places[*start, *key[:n]]
        return key, ""

    def said(self, text: str, keys: Iterable[Key], recipe: Key = ()) -> str:
        """Return a message on a fault of some keys, each with its place.

        The key that was set last is at fault: without it, the others went together.
        """
        keys = list(keys) or [()]
        is_set = [key for key in keys if {key, (*recipe, *key)} & self.places.keys()]
        found = dict(self.place(key, recipe) for key in is_set or keys[:1])
        order = list(self.places)
        *others, last = sorted(found, key=lambda key: order.index(key) if key in order else -1)
        behind = [
            f"{OVERRIDE} {dotted(key)}" if found[key] == OVERRIDE else f"{dotted(key)} of {found[key]}"
            for key in others
            if found[key] != found[last]
        ]
        return f"{named(last, found[last])}: {text}" + (f" (with {', '.join(behind)})" if behind else "")


def dotted(key: Key) -> str:
    """Return a key as ``--set`` takes it."""
    return ".".join(map(str, key))


def named(key: Key, place: str) -> str:
    """Return a key after its place, such as ``a.yaml:3: camera.focal_px`` or ``override camera.focal_px``."""
    return f"{OVERRIDE} {dotted(key)}" if place == OVERRIDE else ": ".join(filter(None, (place, dotted(key))))
