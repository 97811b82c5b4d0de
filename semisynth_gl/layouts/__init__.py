"""Layouts: the folders and names of a dataset's files, the program's own and those of plug-ins."""

from functools import cache

from semisynth_gl.config.dataset_sections import LAYOUTS
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.layouts.builtin import BUILT_IN
from semisynth_gl.layouts.layout import Layout, PairKey, view_stems
from semisynth_gl.plugins import find_plugin, installed_plugins

__all__ = ["LAYOUTS", "Layout", "PairKey", "find_layout", "layout_names", "view_stems"]

# Roles without which no pair can be read back.
_NEEDED = {"left", "right", "disparity_left", "provenance"}


def layout_names() -> tuple[str, ...]:
    """Return the names of all layouts, plug-ins included, sorted."""
    return tuple(sorted([*BUILT_IN, *installed_plugins()["layouts"]]))


@cache
def find_layout(name: str) -> Layout:
    """Return the layout with a name; raises InputError if there is none, or a plug-in's layout lacks a needed file."""
    if name in BUILT_IN:
        return BUILT_IN[name]
    layout: Layout = find_plugin("layouts", name).value
    if lacking := sorted(_NEEDED - layout.stems.keys()):
        raise InputError(f"layout {name}: stems must name a file for {', '.join(lacking)}")
    return layout
