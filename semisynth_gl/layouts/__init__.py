"""Layouts: under which names a dataset's files stand, one module each."""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from semisynth_gl.errors import InputError
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import Layout

__all__ = ["Key", "Layout", "find_layout", "layout_names"]

_NO_LAYOUTS = ("key", "layout", "roles")


@cache
def layout_names() -> tuple[str, ...]:
    """Return the names of all layouts, sorted: those of this package's modules, with hyphens."""
    return tuple(sorted(each.name.replace("_", "-") for each in iter_modules(__path__) if each.name not in _NO_LAYOUTS))


def find_layout(name: str) -> Layout:
    """Return the layout of a name.

    Raises:
        InputError: where there is none.
    """
    if name not in layout_names():
        raise InputError(f"layout: expected one of {', '.join(layout_names())}, got {name!r}")
    layout: Layout = import_module(f"{__name__}.{name.replace('-', '_')}").LAYOUT
    return layout
