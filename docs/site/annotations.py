"""Removes pydantic's checks from the types in the reference."""

from dataclasses import fields
from typing import Any

from griffe import Attribute, Expr, ExprSubscript, ExprTuple, Extension


def plain(annotation: Any) -> Any:  # noqa: ANN401 - an expression of griffe's, or a part of one
    """Return an annotation in which each ``Annotated[T, ...]`` is replaced by ``T``."""
    if isinstance(annotation, ExprSubscript) and annotation.canonical_name == "Annotated":
        inner = annotation.slice
        return plain(inner.elements[0] if isinstance(inner, ExprTuple) else inner)
    if isinstance(annotation, Expr):
        for field in fields(annotation):
            value = getattr(annotation, field.name)
            changed = [plain(each) for each in value] if isinstance(value, list) else plain(value)
            setattr(annotation, field.name, changed)
    return annotation


class PlainAnnotations(Extension):
    """Simplifies the annotations of attributes."""

    def on_attribute(self, *, attr: Attribute, **_: object) -> None:
        """Simplify the annotation of an attribute."""
        attr.annotation = plain(attr.annotation)
