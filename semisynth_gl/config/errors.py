"""Messages on the faults of a config: where its keys were set, what was expected and what came."""

from collections.abc import Collection
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from semisynth_gl.config.fields import ConfigError, reason_of
from semisynth_gl.config.keys import config_keys, sections_in
from semisynth_gl.config.layers import Layer, dotted
from semisynth_gl.config.model import RECIPE_KEYS, Config
from semisynth_gl.config.yaml_values import Key
from semisynth_gl.inputs.errors import counted, did_you_mean, near, shown

_FAULTS_SHOWN, _KEYS_SHOWN = 20, 3
# The similarity of keys that differ by a letter or two.
_BY_A_LETTER = 0.9


def explained(error: ValidationError, layer: Layer) -> str:
    """Return a line for each fault that pydantic found in a layer's values.

    While the config by itself has faults, those of its recipes' whole configs are left out. A fault of all recipes is
    the config's.
    """
    faults = error.errors(include_url=False)
    own = [fault for fault in faults if fault["loc"][2:3] != ("config",)]
    recipes_of: dict[str, list[Key]] = {}
    for fault in own or faults:
        line, recipe = _line(fault, layer)
        recipes_of.setdefault(line, []).extend([recipe] if recipe else [])
    lines = [
        f"{line}; in {', '.join(map(dotted, recipes))}" if 0 < len(recipes) < len(layer.values["scenes"]) else line
        for line, recipes in recipes_of.items()
    ]
    more = [f"and {counted(len(lines) - _FAULTS_SHOWN, 'more fault')}"] if len(lines) > _FAULTS_SHOWN else []
    return "\n".join(lines[:_FAULTS_SHOWN] + more)


def _line(fault: ErrorDetails, layer: Layer) -> tuple[str, Key]:
    """Return the message on a fault, and the key of the recipe that has it; () where its own keys name the recipe."""
    location, trees = fault["loc"], [layer.values]
    recipe: Key = ()
    if location[2:3] == ("config",):
        recipe, location = location[:2], location[3:]
        trees = [layer.values["scenes"][recipe[1]], layer.values]
    key = _key(location, trees)
    error = fault.get("ctx", {}).get("error")
    keys = [key]
    if isinstance(error, ConfigError) and error.keys:
        keys = [(*key, *(int(part) if part.isdigit() else part for part in each.split("."))) for each in error.keys]
    line = layer.said(_reason(fault, key, location, recipe), keys, recipe)
    return line, () if any((*recipe, *each) in layer.places for each in keys) else recipe


def _reason(fault: ErrorDetails, key: Key, location: Key, recipe: Key) -> str:
    value = fault["input"]
    match fault["type"]:
        case "missing":
            return f"{location[-1]} is missing; this key has no default"
        case "extra_forbidden":
            return f"unknown key; {_hint(key, _siblings(location), value, recipe)}"
        case "model_type" | "model_attributes_type":
            return f"expected a section with keys of its own, got {shown(value)}"
    is_whole = isinstance(value, dict | BaseModel) or isinstance(fault.get("ctx", {}).get("error"), ConfigError)
    return reason_of(fault) + ("" if is_whole else f", got {shown(value)}")


def _key(location: Key, trees: list[Any]) -> Key:
    """Return the key in a config for one of pydantic's locations, which also name forms, types and validators."""
    key = list[str | int]()
    for part in location:
        below = [
            tree[part]  # type: ignore[index]
            for tree in trees
            if (isinstance(tree, dict) and part in tree)
            or (isinstance(tree, list) and isinstance(part, int) and part < len(tree))
        ]
        if below:
            key.append(part)
            trees = below
    return tuple(key)


def _siblings(location: Key) -> set[str]:
    """Return the names of the keys that the section of an unknown key has."""
    sections: list[type[BaseModel]] = [Config]
    for part in location[:-1]:
        fields = [section.model_fields for section in sections]
        of_form = [
            section
            for section, known in zip(sections, fields, strict=True)
            if "form" in known and part in get_args(known["form"].annotation)
        ]
        inner = [each for known in fields if part in known for each in sections_in(known[str(part)].annotation)]
        sections = of_form or inner or sections
    return {name for section in sections for name in section.model_fields}


def _hint(key: Key, siblings: Collection[str], value: object, recipe: Key) -> str:
    """Return a question with the keys that an unknown key may have been meant for, in its section or another.

    If a misspelt section holds a single key, that key helps to find it.
    """
    *above, last = map(str, key)
    if recipe:
        siblings = [*siblings, *RECIPE_KEYS] if not above else siblings
        alike = [dotted((*recipe, *above, name)) for name in near(last, siblings)]
        return did_you_mean(alike, f"expected one of: {', '.join(sorted(siblings))}")
    alike = [dotted((*above, name)) for name in near(last, siblings)]
    whole = dotted(key)
    while isinstance(value, dict) and len(value) == 1:
        ((name, value),) = value.items()
        whole += f".{name}"
    known = [each.dotted for each in config_keys()]
    if whole != dotted(key):
        alike = near(whole, known) or alike
    # The same key of another section, unless a sibling differs from it by a letter or two.
    leaf = whole.rpartition(".")[2]
    if elsewhere := [name for name in known if name.rpartition(".")[2] == leaf and name != whole][:_KEYS_SHOWN]:
        alike = list(dict.fromkeys([*near(whole, alike, least_ratio=_BY_A_LETTER), *elsewhere]))
    return did_you_mean(alike, f"expected one of: {', '.join(sorted(siblings))}")
