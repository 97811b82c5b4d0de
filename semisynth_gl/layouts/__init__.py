"""Layouts: the folders and names of a dataset's files, the program's own and those of plug-ins."""

from collections import Counter
from functools import cache

from semisynth_gl.codecs import Encodings
from semisynth_gl.config.dataset_sections import LAYOUTS
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.layouts.builtin import BUILT_IN
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import Layout, view_stems
from semisynth_gl.plugins import find_plugin, plugin_names
from semisynth_gl.seeds.splits import SPLITS

__all__ = ["LAYOUTS", "Key", "Layout", "find_layout", "layout_names", "view_stems"]

# Roles without which no pair can be read back.
_NEEDED = {"left", "right", "disparity_left", "provenance"}


def layout_names() -> tuple[str, ...]:
    """Return the names of all layouts, plug-ins included, sorted."""
    return tuple(sorted([*LAYOUTS, *plugin_names("layouts")]))


@cache
def find_layout(name: str) -> Layout:
    """Return the layout with a name.

    Raises:
        MissingPluginError: where no layout has the name.
        InputError: where `check_layout` refuses a plug-in's layout.
    """
    if name in BUILT_IN:
        return BUILT_IN[name]
    layout: Layout = find_plugin("layouts", name).value
    check_layout(name, layout)
    return layout


def check_layout(name: str, layout: Layout) -> None:
    """Raise InputError where a layout gives two files of a few pairs one path, or a needed role none."""
    encodings = layout.encodings or Encodings()
    for length in (None, 3):
        paths = Counter[str]()
        for split in SPLITS:
            # Tars of different splits may hold files with the same path.
            folder = f"{split}/" if layout.packed else layout.folder(split, SPLITS)
            keys = [Key("config", split, index, length) for index in (0, 1, 3, 10, 11)]
            for files in (layout.files(key, encodings) for key in keys):
                if lacking := sorted(_NEEDED - files.keys()):
                    raise InputError(f"layout {name}: stems must name a file for {', '.join(lacking)}")
                paths.update(f"{folder}{path}" for path in files.values())
            paths.update(f"{folder}{path}" for path in layout.lists_of(keys, encodings))
        path, count = paths.most_common(1)[0]
        if count > 1:
            raise InputError(f"layout {name}: expected a path for each file, got {counted(count, 'file')} {path}")
