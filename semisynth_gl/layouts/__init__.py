"""Layouts: under which names a dataset's files stand. The program's own are a module each; plug-ins have others."""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from semisynth_gl.layouts.foreign import checked_layout
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import Layout, scene_stems, view_stems
from semisynth_gl.plugins import find_plugin, plugin_names, refuse_clash

__all__ = ["Key", "Layout", "built_in_layouts", "find_layout", "layout_names", "scene_stems", "view_stems"]

_NO_LAYOUTS = ("foreign", "key", "layout", "roles")


@cache
def built_in_layouts() -> tuple[str, ...]:
    """Return the names of the program's own layouts, sorted: those of this package's modules, with hyphens."""
    return tuple(sorted(each.name.replace("_", "-") for each in iter_modules(__path__) if each.name not in _NO_LAYOUTS))


def layout_names() -> tuple[str, ...]:
    """Return the names of all layouts, those of plug-ins among them, sorted."""
    return tuple(sorted({*built_in_layouts(), *plugin_names("layouts")}))


def find_layout(name: str) -> Layout:
    """Return the layout of a name.

    Raises:
        MissingPluginError: where there is none.
        InputError: where the layout of a plug-in cannot be used, see `checked_layout`, or has a built-in one's name.
    """
    if name not in built_in_layouts():
        return checked_layout(find_plugin("layouts", name, built_in_layouts()))
    refuse_clash("layouts", name)
    layout: Layout = import_module(f"{__name__}.{name.replace('-', '_')}").LAYOUT
    return layout
