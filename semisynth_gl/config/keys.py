"""All keys of a config, found by walking through its sections and the forms of its targets."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel

from semisynth_gl.config.model import Config


@dataclass(frozen=True, slots=True)
class ConfigKey:
    """A key of a config, outside of lists.

    ``parts`` are its names from the top down. A key ``of_form`` exists only in some forms of the section above it.
    """

    parts: tuple[str, ...]
    is_section: bool
    of_form: bool

    @property
    def dotted(self) -> str:
        """The key as ``--set`` takes it."""
        return ".".join(self.parts)


@cache
def config_keys() -> tuple[ConfigKey, ...]:
    """Return all keys of a config, in the order of its sections; a key that several forms share is listed once."""
    return tuple(dict.fromkeys(_keys_of(Config, (), of_form=False)))


def _keys_of(section: type[BaseModel], above: tuple[str, ...], *, of_form: bool) -> Iterator[ConfigKey]:
    for name, field in section.model_fields.items():
        parts = (*above, name)
        forms = by_form(field.annotation)
        sections = [] if forms else sections_of(field.annotation)
        yield ConfigKey(parts, bool(sections), of_form)
        for below in (*forms.values(), *sections):
            yield from _keys_of(below, parts, of_form=of_form or bool(forms))


def members_of(annotation: Any) -> list[Any]:  # noqa: ANN401 - any annotation
    """Return the types that an annotation allows, with unions and ``Annotated`` unpacked and None left out."""
    if get_origin(annotation) is Annotated:
        return members_of(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [member for part in get_args(annotation) for member in members_of(part)]
    return [] if annotation in (None, NoneType) else [annotation]


def sections_of(annotation: Any) -> list[type[BaseModel]]:  # noqa: ANN401 - any annotation
    """Return the classes of sections that an annotation allows."""
    return [each for each in members_of(annotation) if isinstance(each, type) and issubclass(each, BaseModel)]


def by_form(annotation: Any) -> dict[str, type[BaseModel]]:  # noqa: ANN401 - any annotation
    """Return the classes of sections in a union, by the values of their key ``form``; {} for any other annotation."""
    sections = sections_of(annotation)
    if len(sections) < 2 or len(sections) < len(members_of(annotation)):
        return {}
    return {get_args(section.model_fields["form"].annotation)[0]: section for section in sections}
