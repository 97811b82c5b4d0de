"""All keys of a config with their documentation."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from inspect import cleandoc
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from semisynth_gl.config.fields import Range, written_range
from semisynth_gl.config.model import Config
from semisynth_gl.config.yaml_values import write_yaml


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
        if (below := section_of(field.annotation)) is not None:
            inner.append((f"{above}{name}", below))
        else:
            meaning, is_range = (field.description or "").replace("\n", " "), Range in _members(field.annotation)
            yield ConfigKey(f"{above}{name}", meaning, _default(field), is_range=is_range)
    for name, below in inner:
        yield ConfigKey(name, cleandoc(below.__doc__ or ""), is_section=True)
        yield from _keys_of(below, f"{name}.")


def section_of(annotation: Any) -> type[BaseModel] | None:  # noqa: ANN401 - any annotation
    """Return the section that a key holds; None where the key holds a value, or may have several forms."""
    members = _members(annotation)
    return members[0] if len(members) == 1 and _is_section(members[0]) else None


def _members(annotation: Any) -> list[Any]:  # noqa: ANN401 - any annotation
    """Return the types that an annotation allows, besides None."""
    if get_origin(annotation) in (Union, UnionType):
        return [each for part in get_args(annotation) for each in _members(part)]
    if get_origin(annotation) is Annotated:
        return _members(get_args(annotation)[0])
    return [] if annotation is NoneType else [annotation]


def sections_in(annotation: Any) -> list[type[BaseModel]]:  # noqa: ANN401 - any annotation
    """Return all sections that an annotation names, also in lists and among several forms."""
    if _is_section(annotation):
        return [annotation]
    return [section for part in get_args(annotation) for section in sections_in(part)]


def _is_section(annotation: object) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    # A target's default is told by its text.
    return "" if value in (None, (), {}) or isinstance(value, BaseModel) else write_yaml(_short(value)).strip()


def _short(value: Any) -> Any:  # noqa: ANN401 - any value of a config
    if isinstance(value, Range):
        value = written_range(value)
    if isinstance(value, list | tuple):
        return [_short(each) for each in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value
