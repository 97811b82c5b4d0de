"""Types in the reference, without what pydantic's fields add to them for checks."""

from dataclasses import fields
from typing import Any

from griffe import Attribute, Expr, ExprSubscript, ExprTuple, Extension


def plain(annotation: Any) -> Any:  # noqa: ANN401 - an expression of griffe's, or a part of one
    """Return the annotation with ``Annotated[T, ...]`` as ``T``, wherever it stands."""
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
    """Makes the annotations of attributes plain."""

    def on_attribute(self, *, attr: Attribute, **_: object) -> None:
        """Change one attribute."""
        attr.annotation = plain(attr.annotation)
