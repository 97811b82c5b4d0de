"""The keys of a config with their documentation, and a config in full as YAML."""

import textwrap
from collections.abc import Iterator, Mapping
from functools import cache
from typing import get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from semisynth_gl.config.model import RECIPE_KEYS, Config
from semisynth_gl.config.yaml_values import write_yaml

_WIDTH = 100


@cache
def config_keys() -> Mapping[str, FieldInfo]:
    """Return the keys outside of sections by their names, and then each section and its keys, by dotted name.

    Keys in lists and in the forms of a target are left out.
    """
    return dict(_keys_of(Config, ""))


def _keys_of(section: type[BaseModel], above: str) -> Iterator[tuple[str, FieldInfo]]:
    fields = section.model_fields.items()
    yield from ((f"{above}{name}", field) for name, field in fields if section_of(field) is None)
    for name, field in fields:
        if (below := section_of(field)) is not None:
            yield f"{above}{name}", field
            yield from _keys_of(below, f"{above}{name}.")


def section_of(field: FieldInfo) -> type[BaseModel] | None:
    """Return the section that a key takes; None if it takes a plain value, or one of several forms."""
    found = [each for each in get_args(field.annotation) or (field.annotation,) if each is not type(None)]
    match found:
        case [type() as section] if issubclass(section, BaseModel):
            return section
    return None


def meaning(field: FieldInfo) -> str:
    """Return the docstring of a key, or of its section."""
    return " ".join((field.description or getattr(section_of(field), "__doc__", None) or "").split())


def explain(config: Config) -> str:
    """Return a config as YAML of the same digest, with all its keys, defaults included, and a comment on each."""
    return "\n".join(_section(config, "")) + "\n"


def _section(section: BaseModel, indent: str) -> Iterator[str]:
    """Yield the lines of a section; a key without a value is commented out."""
    values = section.model_dump(mode="json")
    for key, field in type(section).model_fields.items():
        inner = getattr(section, key)
        # Some keys are left out of the values where they are empty.
        value = values.get(key, inner)
        mark = f"{indent}# "
        text = meaning(field).replace("``", "")
        yield from textwrap.wrap(text, _WIDTH, initial_indent=mark, subsequent_indent=mark)
        if value is None:
            yield f"{indent}# {key}:"
        elif key == "scenes" and value:
            yield "scenes:"
            for recipe in value:
                head = {name: recipe[name] for name in RECIPE_KEYS if name in recipe}
                lines = [f"{name}: {write_yaml(each)}" for name, each in (head | recipe).items()]
                yield "  - " + "\n    ".join(lines)
        elif isinstance(inner, BaseModel) and not indent:
            yield f"{key}:"
            yield from _section(inner, "  ")
        else:
            yield f"{indent}{key}: {write_yaml(value)}"
        if not indent:
            yield ""
