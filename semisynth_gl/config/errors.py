"""Turns pydantic's errors about a config into messages with the place of each key."""

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from semisynth_gl.config.explain import config_keys
from semisynth_gl.config.fields import ConfigError, ConfigSection
from semisynth_gl.config.layers import ConfigLayer, holds, merged, undotted
from semisynth_gl.config.yaml_values import KeyPath
from semisynth_gl.inputs.errors import did_you_mean, most_similar, shown

# Our messages for errors in whose messages pydantic names Python types or tags, which a writer of YAML does not know.
_YAML_TYPES = {
    "dict_type": "expected keys and values",
    "model_type": "expected keys and values",
    "tuple_type": "expected a list",
    "union_tag_invalid": "expected one of {expected_tags}",
    "union_tag_not_found": "expected a key {discriminator}",
}


def reason_of(fault: ErrorDetails) -> str:
    """Return what was expected instead of a faulty value."""
    if fault["type"] in _YAML_TYPES:
        return _YAML_TYPES[fault["type"]].format_map(fault.get("ctx", {}))
    return fault["msg"].removeprefix("Value error, ").replace("Input should be", "expected")


def fault_lines(error: ValidationError, layer: ConfigLayer) -> str:
    """Return a line for each fault that pydantic found in a layer's values.

    Recipes inherit the faults of the config, so their faults are reported only if the config has none.
    """
    faults = error.errors(include_url=False)
    outside_recipes = [fault for fault in faults if fault["loc"][2:3] != ("config",)]
    return "\n".join(dict.fromkeys(_line(fault, layer) for fault in outside_recipes or faults))


def _line(fault: ErrorDetails, layer: ConfigLayer) -> str:
    location, values, recipe, found = fault["loc"], layer.values, KeyPath(), fault["input"]
    if location[2:3] == ("config",):
        recipe, location = location[:2], location[3:]
        values = merged(values, values["scenes"][recipe[1]])
    # Pydantic's locations also contain type names and tags of unions, such as the form of a target: these are no keys.
    key = KeyPath()
    for part in location:
        key = (*key, part) if holds(values, (*key, part)) else key
    if fault["type"] == "union_tag_invalid":
        key, found = (*key, fault["ctx"]["discriminator"].strip("'")), fault["ctx"]["tag"]
    error = fault.get("ctx", {}).get("error")
    keys = [(*key, *undotted(each)) for each in error.keys] if isinstance(error, ConfigError) else [key]
    match fault["type"]:
        case "missing":
            reason = f"{location[-1]} is missing; this key has no default"
        case "extra_forbidden":
            reason = f"unknown key; {_hint(key)}"
        case _:
            is_rule = isinstance(error, ConfigError) or isinstance(found, dict | BaseModel)
            reason = reason_of(fault) + ("" if is_rule else f", got {shown(found)}")
    # If the recipe sets the key, blame the recipe's key, else the config's.
    return layer.message(reason, [(*recipe, *each) if holds(layer.values, (*recipe, *each)) else each for each in keys])


def _hint(key: KeyPath) -> str:
    """Return a question such as "did you mean X?" about keys with similar names."""
    fields = {name for section in ConfigSection.__subclasses__() for name in section.model_fields}
    fields -= {"given", "config"}  # fields of recipes that are no keys
    similar = most_similar(str(key[-1]), fields)
    found = [each for each in config_keys() if each.rpartition(".")[2] in similar]
    return did_you_mean(found or similar, "`semisynth-gl configs NAME` lists all keys of a config")
