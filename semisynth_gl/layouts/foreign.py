"""Layouts of plug-ins, each checked once: a few pairs in the layout must make a dataset that can be read back."""

import os
import re
from collections.abc import Iterator
from functools import cache
from itertools import product
from pathlib import PurePosixPath

from semisynth_gl.codecs import Encodings
from semisynth_gl.frame.channels import OUTPUTS
from semisynth_gl.inputs.errors import InputError, did_you_mean, near, shown
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.layout import Layout
from semisynth_gl.layouts.roles import ROLES
from semisynth_gl.plugins import Plugin
from semisynth_gl.seeds.splits import SPLITS, SplitName

# Roles without which no pair can be read back.
_NEEDED = ("left", "right", "disparity_left", "provenance")
# Numbers of pairs below and above powers of ten, tried with and without sequences, in one and in all splits.
_INDICES = (0, 1, 9, 10, 11, 100, 999_999)
_LENGTHS = (None, 3)
_SPLITS: tuple[tuple[SplitName, ...], ...] = (("train",), SPLITS)
# Printable ASCII without blanks and slashes, which every shell, loader and store accepts in names.
_PART = re.compile(r"(?!\.{1,2}$)[!-.0-~]+")


@cache
def checked_layout(plugin: Plugin) -> Layout:
    """Return the layout of a plug-in, which refers to an instance of `Layout`, or to a subclass without parameters.

    Raises:
        InputError: where the plug-in cannot be imported or is no layout, `check_layout` refuses the layout, or the
            layout's own code fails.
    """
    value = plugin.value
    if isinstance(value, type) and issubclass(value, Layout):
        with plugin.blamed("cannot be made"):
            value = value()
    if not isinstance(value, Layout):
        kind = value.__name__ if isinstance(value, type) else type(value).__name__
        raise plugin.fault(f"expected an instance or a subclass of semisynth_gl.layouts.Layout, got {kind}")
    with plugin.blamed("cannot be used"):
        check_layout(value)
    return value


def check_layout(layout: Layout) -> None:
    """Check a layout's names for a few pairs; the layout's own code may raise any other error.

    Raises:
        InputError: where a dataset in this layout could not be written or read back: the layout names an unknown role
            or lacks one that reading a pair needs, gives two files one path, or gives a path that not every system has.
    """
    if not isinstance(layout.packed, bool):
        raise InputError(f"packed: expected True or False, got {shown(layout.packed)}")
    if not (layout.encodings is None or isinstance(layout.encodings, Encodings)):
        raise InputError(f"encodings: expected None or Encodings, got {shown(layout.encodings)}")
    for name, outputs in (("needs", layout.needs), ("lacks", layout.lacks)):
        if unknown := sorted(set(outputs) - set(OUTPUTS)):
            raise InputError(f"{name}: expected some of {', '.join(OUTPUTS)}, got {', '.join(unknown)}")
    for splits, length in product(_SPLITS, _LENGTHS):
        owners: dict[str, str] = {}
        for split in splits:
            keys = [Key("config", split, index, length) for index in _INDICES]
            for path, owner in _paths(layout, keys, "" if layout.packed else layout.folder(split, splits)):
                if not path.isascii() or not all(map(_PART.fullmatch, path.split("/"))):
                    raise InputError(
                        f"{owner}: expected a path below the dataset's folder, in ASCII without blanks, got {path!r}"
                    )
                # Tars of different splits may hold files with the same path.
                owner_before = owners.setdefault(f"{split}:{path}" if layout.packed else path, owner)
                if owner_before != owner:
                    raise InputError(
                        f"expected a path of its own for each file, got {path!r} for {owner_before} and for {owner}"
                    )


def _paths(layout: Layout, keys: list[Key], folder: str) -> Iterator[tuple[str, str]]:
    """Yield the path of each file, list, link and folder of pairs of one split, and a description for messages."""
    encodings, split = layout.encodings or Encodings(), keys[0].split
    for key in keys:
        stems = layout.stems(key)
        if lacking := [role for role in _NEEDED if role not in stems]:
            raise InputError(f"stems: expected the roles {', '.join(_NEEDED)} and others, got no {', '.join(lacking)}")
        for role in stems:
            try:
                layout.role(role)
            except KeyError:
                hint = did_you_mean(near(role, ROLES), f"expected some of {', '.join(ROLES)}")
                raise InputError(f"stems: there is no role {shown(role)}; {hint}") from None
        files = layout.files(key, encodings)
        yield from ((f"{folder}{path}", f"{role} of pair {key.index} of {split}") for role, path in files.items())
    for path, data in layout.lists(keys, encodings).items():
        if not isinstance(data, bytes):
            raise InputError(f"lists: expected bytes for {path}, got {type(data).__name__}")
        yield f"{folder}{path}", f"list of {split}"
    for path, target in layout.links(keys).items():
        yield f"{folder}{path}", "link"
        if os.path.normpath(PurePosixPath(path).parent / target).startswith(("..", "/")):
            raise InputError(f"links: expected targets below the dataset's folder, got {target!r} for {path}")
    yield from ((f"{folder}{path}", "folder") for path in layout.folders())
