"""Finds the image files of a source, names them in a dataset, and lists the photographs of scikit-image."""

import glob
import os
import re
from collections.abc import Collection, Sequence
from importlib.util import find_spec
from itertools import takewhile
from pathlib import Path

from ruamel.yaml import YAML

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.resources import data_root
from semisynth_gl.inputs.user_files import expanded, files_below
from semisynth_gl.textures.images import image_extensions

# Names of Middlebury's and ETH3D's masks, and of KITTI's folders of maps.
_MASKS = ("mask0nocc.png", "mask1nocc.png")
_MAPS = re.compile(r"(disp|disp_refl|flow)_(occ|noc)(_[01])?|obj_map")


def find_images(sources: Sequence[str | Path]) -> list[Path]:
    """Return the image files of the sources (see `find_files`), without masks and maps of stereo datasets.

    Raises:
        InputError: where a source matches no image.
    """
    for source in sources:
        if all(map(_is_mask_or_map, find_files([source], image_extensions()))):
            raise InputError(
                f"no image matches {str(source)!r}: expected an image file, a folder with images in it, or a glob such "
                "as 'photos/**/*.jpg'. Convert HEIC and camera raw files to JPEG, PNG or TIFF first"
            )
    return [path for path in find_files(sources, image_extensions()) if not _is_mask_or_map(path)]


def _is_mask_or_map(path: Path) -> bool:
    """Return whether a file has the name of a mask, or is in a folder with the name of KITTI's maps."""
    return path.name in _MASKS or _MAPS.fullmatch(path.parent.name) is not None


def find_files(sources: Sequence[str | Path], extensions: Collection[str]) -> list[Path]:
    """Return the files of the sources, sorted by path; a file that is found twice, or through a link, appears once.

    A source is a file, a folder (searched recursively, symbolic links followed) or a glob, in which ``**`` matches any
    folders; folders that match are searched as well. ``~`` is the home folder. A source that is a file is returned with
    any extension. In folders and globs, only files with one of ``extensions`` are found. Extensions are given in lower
    case with their dot, but may have any case in a file's name. A source that matches nothing adds no file.
    """
    found: set[Path] = set()
    for source in map(expanded, sources):
        # A source that exists is a path, not a glob: real file names may contain "[" and "*".
        exists = os.path.exists(source)  # noqa: PTH110  # pathlib raises where a name is too long, or may not be seen
        for path in [source] if exists else map(Path, glob.glob(str(source), recursive=True)):  # noqa: PTH207
            if os.path.isdir(path):  # noqa: PTH112
                found.update(below for below in files_below(path) if below.suffix.lower() in extensions)
            elif exists or (path.suffix.lower() in extensions and os.path.exists(path)):  # noqa: PTH110
                found.add(path)
    # Keep the shortest of several paths to a file: a link to a parent folder makes endlessly longer paths.
    unique: dict[str, Path] = {}
    for path in sorted(found, key=lambda path: (len(path.parts), path.as_posix())):
        unique.setdefault(os.path.realpath(path), path)
    return sorted(unique.values(), key=Path.as_posix)


def reaching_source(folder: Path, sources: Sequence[str]) -> str | None:
    """Return the first source in which images of a future output folder would be found; None if there is none."""
    real = Path(os.path.realpath(folder))
    return next((source for source in sources if _reaches(expanded(source), real)), None)


def _reaches(source: Path, folder: Path) -> bool:
    parts = source.absolute().parts
    plain = list(takewhile(lambda part: not glob.has_magic(part), parts))
    base, rest = Path(os.path.realpath(Path(*plain))), parts[len(plain) :]
    if not rest or "**" in rest:
        return folder.is_relative_to(base)
    pattern = base.joinpath(*rest)
    # A folder that matches a pattern is searched.
    return Path(*folder.parts[: len(pattern.parts)]).match(str(pattern))


def relative_names(images: Sequence[Path]) -> dict[Path, str]:
    """Return the name of each image: its path relative to the folder that all images share."""
    if not images:
        return {}
    absolute = [os.path.abspath(path) for path in images]  # noqa: PTH100  # links keep the user's names
    folders = {os.path.dirname(path) for path in absolute}  # noqa: PTH120
    start = len(os.path.join(os.path.commonpath(folders), ""))  # noqa: PTH118
    return {path: name[start:] for path, name in zip(images, absolute, strict=True)}


def printable(name: str) -> str:
    """Replace unprintable characters of a name by ``?``: file names may contain line breaks and undecodable bytes."""
    return "".join(letter if letter.isprintable() else "?" for letter in name)


def builtin_licences() -> dict[str, str]:
    """Return the licence of each photograph of `builtin_photographs`, by file name."""
    listed = YAML(typ="safe", pure=True).load(data_root("assets").joinpath("photographs.yaml").read_text("utf-8"))
    return {photograph["file"]: photograph["licence"] for photograph in listed["photographs"]}


def builtin_photographs() -> list[Path]:
    """Return the photographs of the installed scikit-image package that ``assets/photographs.yaml`` lists, sorted.

    The package is found without importing it. Nothing is downloaded.

    Raises:
        InputError: where scikit-image is not installed, or lacks a listed file.
    """
    spec = find_spec("skimage")
    folders = spec.submodule_search_locations if spec else None
    paths = [Path(folders[0], "data", name) for name in sorted(builtin_licences())] if folders else []
    missing = [str(path) for path in paths if not path.is_file()]
    if missing or not paths:
        raise InputError(
            f"no photographs are given, and built-in ones are missing ({', '.join(missing) or 'scikit-image'}): set "
            "textures.images, or install them: pip install --force-reinstall scikit-image"
        )
    return paths
