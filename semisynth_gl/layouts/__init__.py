"""Layouts: the folders and names of a dataset's files, the program's own and those of plug-ins."""

from functools import cache

from semisynth_gl.codecs import Encodings
from semisynth_gl.config.dataset_sections import LAYOUTS
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.layouts.builtin import BUILT_IN
from semisynth_gl.layouts.layout import Key, Layout, view_stems
from semisynth_gl.plugins import find_plugin, names_of_group
from semisynth_gl.seeds.splits import SPLITS

__all__ = ["LAYOUTS", "Key", "Layout", "find_layout", "layout_names", "view_stems"]

# Roles without which no pair can be read back.
_NEEDED = {"left", "right", "disparity_left", "provenance"}


def layout_names() -> tuple[str, ...]:
    """Return the names of all layouts, plug-ins included, sorted."""
    return tuple(names_of_group("layouts"))


@cache
def find_layout(name: str) -> Layout:
    """Return the layout with a name.

    Raises:
        InputError: where no layout has the name, or `check_layout` refuses a plug-in's layout.
    """
    if name in BUILT_IN:
        return BUILT_IN[name]
    layout: Layout = find_plugin("layouts", name).value
    check_layout(name, layout)
    return layout


def check_layout(name: str, layout: Layout) -> None:
    """Raise InputError where a layout gives two files of a few pairs one path, or a needed role none."""
    if lacking := sorted(_NEEDED - layout.stems.keys()):
        raise InputError(f"layout {name}: stems must name a file for {', '.join(lacking)}")
    encodings, paths = layout.encodings or Encodings(), list[str]()
    for split in SPLITS:
        # Tars of different splits may hold files with the same path.
        folder = f"{split}/" if layout.packed else layout.folder(split, SPLITS)
        keys = [Key("config", split, index, 3) for index in (0, 1, 3, 10, 11)]
        names = [path for key in keys for path in layout.files(key, encodings).values()]
        paths += [f"{folder}{path}" for path in (*names, *layout.lists_of(keys, encodings))]
    if twice := sorted({path for path in paths if paths.count(path) > 1}):
        raise InputError(f"layout {name}: expected a path for each file, got several files {twice[0]}")
