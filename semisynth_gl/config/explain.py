"""The keys of a config with their documentation, and a config as YAML with all keys."""

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
    """Return all keys by dotted name: first keys outside of sections, then each section and its keys.

    Keys inside lists and targets are omitted.
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
    """Return the class of a key's section; None if the key has a plain value, or a value with several forms."""
    found = [each for each in get_args(field.annotation) or (field.annotation,) if each is not type(None)]
    match found:
        case [type() as section] if issubclass(section, BaseModel):
            return section
    return None


def meaning(field: FieldInfo) -> str:
    """Return the docstring of a key, or of its section."""
    return " ".join((field.description or getattr(section_of(field), "__doc__", None) or "").split())


def explain(config: Config) -> str:
    """Return a config as YAML with all keys, including defaults, and a comment on each; its digest is the same."""
    return "\n".join(_section(config, "")) + "\n"


def _section(section: BaseModel, indent: str) -> Iterator[str]:
    """Yield the lines of a section; a key without a value is commented out."""
    values = section.model_dump(mode="json")
    for key, field in type(section).model_fields.items():
        inner = getattr(section, key)
        # model_dump leaves out some empty keys.
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
