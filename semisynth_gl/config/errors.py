"""Messages on faults of a config: where the keys were set, what was expected, and what was found."""

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from semisynth_gl.config.explain import config_keys
from semisynth_gl.config.fields import ConfigError, ConfigSection
from semisynth_gl.config.layers import ConfigLayer, dotted, holds, merged, undotted
from semisynth_gl.config.model import RECIPE_KEYS
from semisynth_gl.config.yaml_values import KeyPath
from semisynth_gl.inputs.errors import did_you_mean, shown

# Our words for pydantic's errors, by their type; braces stand for values of the error's context.
_EXPECTED = {
    "bool_type": "expected true or false",
    "float_type": "expected a number",
    "greater_than": "expected more than {gt:g}",
    "greater_than_equal": "expected {ge:g} or more",
    **dict.fromkeys(("int_from_float", "int_type"), "expected a whole number"),
    "less_than": "expected less than {lt:g}",
    "less_than_equal": "expected at most {le:g}",
    "literal_error": "expected {expected}",
    **dict.fromkeys(("dict_type", "model_type"), "expected keys and values"),
    "string_type": "expected a text",
    "tuple_type": "expected a list, such as [a, b]",
    "union_tag_invalid": "expected one of {expected_tags}",
    "union_tag_not_found": "expected a key {discriminator}",
}


def reason_of(fault: ErrorDetails) -> str:
    """Return what a fault's key should have had, or a validator's message; its first letter is small."""
    reason = fault["msg"].removeprefix("Value error, ")
    if fault["type"] in _EXPECTED:
        reason = _EXPECTED[fault["type"]].format(**fault.get("ctx", {})).replace("'", "")
    return f"{reason[0].lower()}{reason[1:]}"


def fault_lines(error: ValidationError, layer: ConfigLayer) -> str:
    """Return a line for each fault that pydantic found in a layer's values, once if it is also in recipes."""
    faults = error.errors(include_url=False)
    own = [fault for fault in faults if fault["loc"][2:3] != ("config",)]
    return "\n".join(dict.fromkeys(_line(fault, layer) for fault in own or faults))


def _line(fault: ErrorDetails, layer: ConfigLayer) -> str:
    location, values, recipe, found = fault["loc"], layer.values, KeyPath(), fault["input"]
    if location[2:3] == ("config",):
        recipe, location = location[:2], location[3:]
        values = merged(values, values["scenes"][recipe[1]])
    # Pydantic's locations also contain forms of targets and types, which are not keys.
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
            reason = f"unknown key; {_hint(key, RECIPE_KEYS if recipe else ())}"
        case _:
            is_rule = isinstance(error, ConfigError) or isinstance(found, dict | BaseModel)
            reason = reason_of(fault) + ("" if is_rule else f", got {shown(found)}")
    # If the recipe sets the key, blame the recipe's key, else the config's.
    return layer.message(reason, [(*recipe, *each) if holds(layer.values, (*recipe, *each)) else each for each in keys])


def _hint(key: KeyPath, others: tuple[str, ...]) -> str:
    """Return a "did you mean": similar keys of its section or of ``others``, and keys of this name elsewhere."""
    elsewhere = [each for each in config_keys() if each.rpartition(".")[2] == key[-1]]
    section = dotted(key[:-1])
    beside = [each for each in config_keys() if each.rpartition(".")[0] == section]
    if not beside:  # in a target, or in a list
        beside = [f"{section}.{name}" for each in ConfigSection.__subclasses__() for name in each.model_fields]
    known = () if str(key[-1]).isdecimal() else (*beside, *others)
    return did_you_mean(dotted(key), known, "`semisynth-gl configs NAME` lists all keys of a config", elsewhere[:2])
