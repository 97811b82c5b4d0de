"""Sections of which any keys may be left out: what a recipe changes of a config."""

from collections.abc import Collection
from typing import Any, get_type_hints

from pydantic import SerializerFunctionWrapHandler, create_model, model_serializer

from semisynth_gl.config.fields import Section


class Partial(Section):
    """Base of partial sections: keys that were not given are absent from its values, whatever their default is."""

    @model_serializer(mode="wrap")
    def _given(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in serialise(self).items() if key in self.model_fields_set}


def partial_section(section: type[Section], without: Collection[str] = ()) -> type[Partial]:
    """Return a section that takes the keys of another one, but for some, and needs none of them.

    Values are checked as those of the other section are, one by one: rules between keys hold for merged sections.

    Args:
        section: the other section.
        without: its keys to leave out.
    """
    types = get_type_hints(section, include_extras=True)
    fields: dict[str, Any] = {}
    for key, field in section.model_fields.items():
        if key not in without:
            default = field.get_default(call_default_factory=True)
            fields[key] = (types[key] | None, None) if field.is_required() else (types[key], default)
    return create_model(f"Partial{section.__name__}", __base__=Partial, __doc__=section.__doc__, **fields)
