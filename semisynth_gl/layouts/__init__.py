"""Layouts: the folders and names of a dataset's files. Each built-in layout is a module; plug-ins bring others."""

from importlib import import_module

from semisynth_gl.config.dataset_sections import LAYOUTS
from semisynth_gl.layouts.foreign import checked_layout
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import Layout, scene_stems, view_stems
from semisynth_gl.plugins import find_plugin, plugin_names, refuse_clash

__all__ = ["LAYOUTS", "Key", "Layout", "find_layout", "layout_names", "scene_stems", "view_stems"]


def layout_names() -> tuple[str, ...]:
    """Return the names of all layouts, plug-ins included, sorted."""
    return tuple(sorted({*LAYOUTS, *plugin_names("layouts")}))


def find_layout(name: str) -> Layout:
    """Return the layout with a name.

    Raises:
        MissingPluginError: where no layout has the name.
        InputError: where a plug-in's layout cannot be used, see `checked_layout`, or has the name of a built-in one.
    """
    if name not in LAYOUTS:
        return checked_layout(find_plugin("layouts", name, LAYOUTS))
    refuse_clash("layouts", name)
    layout: Layout = import_module(f"{__name__}.{name.replace('-', '_')}").LAYOUT
    return layout
