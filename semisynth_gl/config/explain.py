"""The keys of a config with their documentation, and a config in full as YAML."""

import textwrap
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from inspect import cleandoc
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from semisynth_gl.config.fields import Range, written_range
from semisynth_gl.config.model import RECIPE_KEYS, Config
from semisynth_gl.config.yaml_values import write_yaml

_WIDTH = 100


@dataclass(frozen=True, slots=True)
class ConfigKey:
    """A key of a config, outside of lists and of the forms of a target.

    ``dotted`` is the key as ``--set`` takes it, and ``meaning`` its docstring. ``default`` is YAML, "required", or ""
    where the default is None or empty.
    """

    dotted: str
    meaning: str
    default: str = ""
    is_section: bool = False
    is_range: bool = False


@cache
def config_keys() -> tuple[ConfigKey, ...]:
    """Return the keys outside of sections, and then each section followed by its keys, in the config's order."""
    return tuple(_keys_of(Config, ""))


def _keys_of(section: type[BaseModel], above: str) -> Iterator[ConfigKey]:
    inner = list[tuple[str, type[BaseModel]]]()
    for name, field in section.model_fields.items():
        if (below := _section_of(field)) is not None:
            inner.append((f"{above}{name}", below))
        else:
            is_range = Range in _types(field.annotation)
            yield ConfigKey(f"{above}{name}", _meaning(field), _default(field), is_range=is_range)
    for name, below in inner:
        yield ConfigKey(name, cleandoc(below.__doc__ or ""), is_section=True)
        yield from _keys_of(below, f"{name}.")


def _types(annotation: Any) -> list[Any]:  # noqa: ANN401 - any annotation
    """Return the types that an annotation allows, besides None."""
    match get_origin(annotation):
        case typing.Union | types.UnionType:
            return [each for part in get_args(annotation) for each in _types(part)]
        case typing.Annotated:
            return _types(get_args(annotation)[0])
    return [] if annotation is types.NoneType else [annotation]


def _section_of(field: FieldInfo) -> type[BaseModel] | None:
    """Return a key's section; None where the key has a plain value, or takes one of several forms."""
    found = _types(field.annotation)
    is_section = len(found) == 1 and isinstance(found[0], type) and issubclass(found[0], BaseModel)
    return found[0] if is_section else None


def _meaning(field: FieldInfo) -> str:
    section = _section_of(field)
    return " ".join((field.description or (section.__doc__ if section else None) or "").split())


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    # A target's default is told by its text.
    return "" if value in (None, (), {}) or isinstance(value, BaseModel) else write_yaml(_short(value))


def _short(value: Any) -> Any:  # noqa: ANN401 - any value of a config
    if isinstance(value, Range):
        value = written_range(value)
    if isinstance(value, list | tuple):
        return [_short(each) for each in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


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
        meaning = _meaning(field).replace("``", "")
        yield from textwrap.wrap(meaning, _WIDTH, initial_indent=mark, subsequent_indent=mark)
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
