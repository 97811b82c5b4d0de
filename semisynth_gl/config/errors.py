"""Messages on faults of a config: where the keys were set, what was expected, and what was found."""

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from semisynth_gl.config.explain import config_keys
from semisynth_gl.config.fields import ConfigError, ConfigSection
from semisynth_gl.config.layers import ConfigLayer, dotted, holds, merged, undotted
from semisynth_gl.config.yaml_values import KeyPath
from semisynth_gl.inputs.errors import did_you_mean, near, shown


def reason_of(fault: ErrorDetails) -> str:
    """Return pydantic's or a validator's message on a fault; its first letter is small."""
    if fault["type"] == "tuple_type":
        return "expected a list, such as [a, b]"
    reason = fault["msg"].removeprefix("Value error, ")
    return f"{reason[0].lower()}{reason[1:]}"


def fault_lines(error: ValidationError, layer: ConfigLayer) -> str:
    """Return a line for each fault that pydantic found in a layer's values, once if it is also in recipes."""
    faults = error.errors(include_url=False)
    own = [fault for fault in faults if fault["loc"][2:3] != ("config",)]
    return "\n".join(dict.fromkeys(_line(fault, layer) for fault in own or faults))


def _line(fault: ErrorDetails, layer: ConfigLayer) -> str:
    location, values, recipe = fault["loc"], layer.values, KeyPath()
    if location[2:3] == ("config",):
        recipe, location = location[:2], location[3:]
        values = merged(values, values["scenes"][recipe[1]])
    # Pydantic's locations also contain forms of targets and types, which are not keys.
    key = KeyPath()
    for part in location:
        key = (*key, part) if holds(values, (*key, part)) else key
    error = fault.get("ctx", {}).get("error")
    keys = [(*key, *undotted(each)) for each in error.keys] if isinstance(error, ConfigError) else [key]
    match fault["type"]:
        case "missing":
            reason = f"{location[-1]} is missing; this key has no default"
        case "extra_forbidden":
            reason = f"unknown key; {_hint(key)}"
        case _:
            is_rule = isinstance(error, ConfigError) or isinstance(fault["input"], dict | BaseModel)
            reason = reason_of(fault) + ("" if is_rule else f", got {shown(fault['input'])}")
    # If the recipe sets the key, blame the recipe's key, else the config's.
    return layer.message(reason, [(*recipe, *each) if holds(layer.values, (*recipe, *each)) else each for each in keys])


def _hint(key: KeyPath) -> str:
    """Return a "did you mean" with similar keys of the same section, and with keys of this name in other sections."""
    elsewhere = [each for each in config_keys() if each.rpartition(".")[2] == key[-1]]
    section = dotted(key[:-1])
    beside = [each for each in config_keys() if each.rpartition(".")[0] == section]
    if not beside:  # in a target, or in a list
        beside = [f"{section}.{name}" for each in ConfigSection.__subclasses__() for name in each.model_fields]
    names = dict.fromkeys([*near(dotted(key), beside), *elsewhere[:2]])
    return did_you_mean(names, "`semisynth-gl configs NAME` lists all keys of a config")
