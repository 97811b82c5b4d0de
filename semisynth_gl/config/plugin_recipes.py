"""Recipes of scenes from plug-ins: each is a recipe's keys under a name."""

import json
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from semisynth_gl.config.fields import reason_of
from semisynth_gl.config.model import RecipeSection
from semisynth_gl.plugins import find_plugin

_EXPECTED = "expected a mapping of a config's sections to their keys, or a function that returns one"


def plugin_recipe(name: str) -> dict[str, Any]:
    """Return the keys of the plug-in's recipe ``name``, by section, in JSON's types.

    Raises InputError where there is no such plug-in, or its recipe is not valid.
    """
    plugin = find_plugin("recipes", name)
    value = plugin.value
    if callable(value):
        with plugin.blamed("fails"):
            value = value()
    if not isinstance(value, Mapping):
        raise plugin.fault(f"{_EXPECTED}, got {type(value).__name__}")
    with plugin.blamed("has values that YAML cannot hold"):
        keys: dict[str, Any] = json.loads(json.dumps(dict(value), allow_nan=False))
    own = keys.keys() & {"recipe", "weight", "extends"}
    if own:
        raise plugin.fault(f"{_EXPECTED}, got the key {min(own)}, which only a config that uses the recipe may set")
    try:
        RecipeSection.model_validate({"recipe": plugin.name} | keys)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        dotted = ".".join(map(str, fault["loc"]))
        reason = "a recipe cannot change this key" if fault["type"] == "extra_forbidden" else reason_of(fault)
        raise plugin.fault(f"{dotted}: {reason}") from None
    return keys
