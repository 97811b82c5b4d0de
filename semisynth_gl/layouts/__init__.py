"""Layouts: the folders and names of a dataset's files. Built-in layouts and those of plug-ins have names."""

from functools import cache

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.layouts.builtin import BUILT_IN
from semisynth_gl.layouts.layout import Layout, PairKey, view_stems
from semisynth_gl.layouts.roles import NEEDED_ROLES
from semisynth_gl.plugins import find_plugin, installed_plugins

__all__ = ["Layout", "PairKey", "find_layout", "layout_names", "view_stems"]


def layout_names() -> tuple[str, ...]:
    """Return the names of all layouts, plug-ins included, sorted."""
    return tuple(sorted([*BUILT_IN, *installed_plugins()["layouts"]]))


@cache
def find_layout(name: str) -> Layout:
    """Return the layout with a name; raises InputError if there is none, or a plug-in's layout lacks a needed role."""
    if name in BUILT_IN:
        return BUILT_IN[name]
    layout: Layout = find_plugin("layouts", name).value
    if lacking := sorted(NEEDED_ROLES - layout.stems.keys()):
        raise InputError(f"layout {name}: stems must name a file for {', '.join(lacking)}")
    return layout
