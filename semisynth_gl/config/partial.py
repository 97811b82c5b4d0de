"""Sections from which any keys may be left out: the changes that a recipe makes to a config."""

from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar, get_type_hints

from pydantic import SerializerFunctionWrapHandler, create_model, model_serializer

from semisynth_gl.config.fields import Section


class Partial(Section):
    """Base of partial sections: keys that were not given are absent from the serialised values, even with a default.

    ``source`` is the whole section's class and the keys that the partial section lacks.
    """

    source: ClassVar[tuple[type[Section], tuple[str, ...]]]

    def __reduce__(self) -> tuple[Callable[..., "Partial"], tuple[type[Section], tuple[str, ...]], dict[Any, Any]]:
        # The class is created at run time and is in no module, so unpickling has to create it again.
        return _unfilled, self.source, self.__getstate__()

    @model_serializer(mode="wrap")
    def _given(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in serialise(self).items() if key in self.model_fields_set}


@cache
def partial_section(section: type[Section], without: tuple[str, ...] = ()) -> type[Partial]:
    """Return a class with the keys of ``section`` except those in ``without``, all of them optional.

    Each value is checked as in the whole section; rules between keys are checked after merging, in the whole section.
    """
    types = get_type_hints(section, include_extras=True)
    fields: dict[str, Any] = {}
    for key, field in section.model_fields.items():
        if key not in without:
            default = None if field.is_required() else field.get_default(call_default_factory=True)
            fields[key] = (types[key] | None if field.is_required() else types[key], default)
    made = create_model(f"Partial{section.__name__}", __base__=Partial, __doc__=section.__doc__, **fields)
    made.source = section, without
    return made


def _unfilled(section: type[Section], without: tuple[str, ...]) -> Partial:
    made = partial_section(section, without)
    return made.__new__(made)
