"""Image files: finds the files of a source, names them in a dataset, and lists the photographs of scikit-image."""

import fnmatch
import glob
import os
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

from ruamel.yaml import YAML

from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.inputs.resources import data_root
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.textures.images import image_extensions

# Images that phones and cameras write, and Pillow does not read without further packages.
_OF_CAMERAS = frozenset(
    {".heic", ".heif", ".hif", ".cr2", ".cr3", ".nef", ".arw", ".dng", ".orf", ".raf", ".rw2", ".pef", ".srw", ".raw"}
)
_MASKS = frozenset({"mask0nocc.png", "mask1nocc.png"})
KITTI_2015_MAPS = ("disp_occ_0", "disp_noc_0", "disp_occ_1", "disp_noc_1")
"""KITTI 2015's folders of disparity maps: two for the left view, then two for the right view."""
KITTI_2012_MAPS = ("disp_occ", "disp_noc")
_BESIDE = ("disp_refl_occ", "disp_refl_noc", "obj_map", "flow_occ", "flow_noc")
_NO_PHOTOGRAPHS = frozenset((*KITTI_2015_MAPS, *KITTI_2012_MAPS, *_BESIDE))


def find_images(sources: Sequence[str | Path]) -> list[Path]:
    """Return the image files that the sources name, as `find_files` finds them with `image_extensions`.

    Masks and maps that lie `beside_photographs` are left out, even where a source names them in full.

    Raises:
        InputError: where a source matches no image.
    """
    for source in sources:
        found = (Path(path) for path, _ in _expand(source, image_extensions()))
        if all(map(beside_photographs, found)):
            raise InputError(
                f"no image matches {str(source)!r}: expected an image file, a folder with images "
                f"(.jpg, .png, .tif, .webp, ...) in it, or a glob such as 'photos/**/*.jpg'"
                + "".join(f"; {unread}" for unread in [unread_photographs([source])] if unread)
            )
    return [path for path in find_files(sources, image_extensions()) if not beside_photographs(path)]


def unread_photographs(sources: Sequence[str | Path]) -> str:
    """Return a sentence on the files of cameras, such as HEIC, that sources name and Pillow cannot read; "" if none."""
    kinds = _OF_CAMERAS - image_extensions()
    files = [path for path in find_files(sources, kinds) if path.suffix.lower() in kinds]
    if not files:
        return ""
    found = ", ".join(sorted({path.suffix.lower() for path in files}))
    return f"left out {counted(len(files), 'file')} ({found}), such as {files[0]}: save them as JPEG, PNG or TIFF"


def beside_photographs(path: Path) -> bool:
    """Return whether a file is a mask or a map that lies beside the photographs of Middlebury, ETH3D or KITTI.

    The name tells: ``mask0nocc.png``, or a folder of KITTI's for disparities, objects or flow.
    """
    return path.name in _MASKS or path.parent.name in _NO_PHOTOGRAPHS


def find_files(sources: Sequence[str | Path], extensions: Collection[str]) -> list[Path]:
    """Return the files that the sources name, sorted by path; a file that is reached twice, or by a link, appears once.

    A source is a file, a folder (searched recursively, symbolic links followed) or a glob, in which ``**`` stands for
    any folders and a matching folder is searched as well. ``~`` is the home folder. A file that is named in full is
    returned whatever its extension is. In folders and globs only files with one of ``extensions`` are found; these are
    given in lower case with their dot, and upper case in a file's name matches too. A source that matches nothing adds
    no file.
    """
    real_paths = dict(chain.from_iterable(_expand(source, extensions) for source in sources))
    unique: dict[str, str] = {}
    # Of several paths to a file the shortest is kept: a link to a folder above would make endless longer paths.
    for path in sorted(real_paths, key=lambda path: (path.count("/"), path)):
        unique.setdefault(real_paths[path], path)
    return [Path(path) for path in sorted(unique.values())]


def relative_names(images: Sequence[Path]) -> dict[Path, str]:
    """Return the name of each image: its path relative to the folder that all share, wherever that folder lies."""
    if not images:
        return {}
    absolute = [os.path.abspath(path) for path in images]  # noqa: PTH100  # links keep the user's names
    folders = {os.path.dirname(path) for path in absolute}  # noqa: PTH120  # of strings: there may be thousands
    start = len(os.path.join(os.path.commonpath(folders), ""))  # noqa: PTH118
    return {path: name[start:] for path, name in zip(images, absolute, strict=True)}


def printable(name: str) -> str:
    """Return a name with ``?`` for each unprintable letter: file names may hold line breaks and undecodable bytes."""
    return "".join(letter if letter.isprintable() else "?" for letter in name)


def builtin_licences() -> dict[str, str]:
    """Return the licence of each photograph of `builtin_photographs`, by file name."""
    listed = YAML(typ="safe", pure=True).load(data_root("assets").joinpath("photographs.yaml").read_text("utf-8"))
    return {photograph["file"]: photograph["licence"] for photograph in listed["photographs"]}


def builtin_photographs() -> list[Path]:
    """Return the photographs of the installed scikit-image package that ``assets/photographs.yaml`` lists, in order.

    The package is found without importing it, and nothing is ever downloaded.

    Raises:
        InputError: where scikit-image is not installed, or lacks a listed file.
    """
    spec = find_spec("skimage")
    if spec is None or not spec.submodule_search_locations:
        raise InputError(
            "no photographs: scikit-image, whose photographs are used where none are given, is not installed; "
            "name your photographs in textures.images, or install it: pip install scikit-image"
        )
    folder = Path(spec.submodule_search_locations[0]) / "data"
    paths = [folder / name for name in builtin_licences()]
    missing = [path.name for path in paths if not path.is_file()]
    if missing:
        raise InputError(
            f"the installed scikit-image lacks {', '.join(missing)}: expected them in {folder}; "
            "name your photographs in textures.images, or reinstall: pip install --force-reinstall scikit-image"
        )
    return paths


def _expand(source: str | Path, extensions: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yield the path of each file under a source, and its real path.

    A folder may hold thousands of files, so paths are strings here, and the real path of each folder is looked up once.
    """
    source = str(expanded(source))
    # A source that exists is a path, not a glob: "[" and "*" may stand in a real file name. A pipe or device that is
    # named in full is refused when it is opened.
    if os.path.isdir(source):  # noqa: PTH112
        yield from _files_below(source, extensions)
    elif os.path.exists(source):  # noqa: PTH110
        yield source, os.path.realpath(source)
    elif glob.has_magic(source):
        for path in _matches(source):
            if os.path.isdir(path):  # noqa: PTH112
                yield from _files_below(path, extensions)
            elif _has_extension(path, extensions) and os.path.exists(path):  # noqa: PTH110
                yield path, os.path.realpath(path)


def _matches(pattern: str) -> Iterator[str]:
    """Yield the paths that a glob matches; ``**`` enters each folder once, whatever links lead to it."""
    top = "/" if pattern.startswith("/") else ""
    found: dict[str, None] = {top: None}
    parts = pattern.split("/")
    for number, part in enumerate(parts):
        if part == "**" and number == len(parts) - 1:
            break  # a folder is searched with all below it
        if part == "**":
            found = dict.fromkeys(folder for path in found for folder, _, _ in folders_below(path, hidden=False))
        elif glob.has_magic(part):
            # As in a shell, only a pattern that begins with a dot matches names that begin with a dot.
            names = ((path, entry.name) for path in found for entry in _entries(path or "."))
            found = dict.fromkeys(
                os.path.join(path, name)  # noqa: PTH118
                for path, name in names
                if fnmatch.fnmatchcase(name, part) and (part.startswith(".") or not name.startswith("."))
            )
        elif part:
            found = dict.fromkeys(os.path.join(path, part) for path in found)  # noqa: PTH118
    yield from (path or "." for path in found)


def folders_below(top: str, *, hidden: bool) -> Iterator[tuple[str, str, list[os.DirEntry[str]]]]:
    """Yield a folder and all folders below it, breadth first: path, real path, and entries sorted by name.

    Each folder is entered once, whatever links lead to it. Folders whose names begin with a dot are entered only where
    ``hidden`` is set. An empty ``top`` is the current folder.
    """
    entered: set[str] = set()
    folders = [top]
    for folder in folders:  # the list grows in the loop
        real = os.path.realpath(folder)
        if real in entered:
            continue
        entered.add(real)
        entries = _entries(folder or ".")
        yield folder, real, entries
        for entry in entries:
            with suppress(OSError):
                if entry.is_dir() and (hidden or not entry.name.startswith(".")):
                    folders.append(os.path.join(folder, entry.name))  # noqa: PTH118


def _files_below(top: str, extensions: Collection[str]) -> Iterator[tuple[str, str]]:
    for folder, real, entries in folders_below("" if top == "." else top, hidden=True):
        for entry in entries:
            path = os.path.join(folder, entry.name)  # noqa: PTH118
            with suppress(OSError):
                if not entry.is_dir() and _has_extension(path, extensions) and os.path.exists(path):  # noqa: PTH110 - not a broken link
                    yield path, os.path.realpath(path) if entry.is_symlink() else f"{real}/{entry.name}"


def _entries(folder: str) -> list[os.DirEntry[str]]:
    """Return the entries of a folder, sorted by name; none where it may not be read, or is not a folder."""
    try:
        return sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:
        return []


def _has_extension(path: str, extensions: Collection[str]) -> bool:
    name = path[path.rfind("/") + 1 :]
    dot = name.rfind(".")
    return dot > 0 and name[dot:].lower() in extensions
