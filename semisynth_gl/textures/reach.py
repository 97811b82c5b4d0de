"""Predicts whether a file that is yet to be written would later be found as a photograph."""

import glob
import os
from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.textures.image_files import folders_below


def photograph_sources(section: TexturesSection) -> tuple[str, ...]:
    """Return the files, folders and globs of the user's photographs in a config; none where its source is another."""
    return section.images if section.source == "images" else ()


def reaching_source(path: Path, sources: Sequence[str], extensions: Collection[str] | None = None) -> str | None:
    """Return the first source by which `find_files` would find a file, or None.

    Neither the file nor its folder need exist. Links in its path are followed. Without ``extensions``, a file with any
    extension counts.
    """
    real = Path(os.path.realpath(path))
    fits = extensions is None or real.suffix.lower() in extensions
    return next((source for source in sources if _reaches(str(expanded(source)), real, fits=fits)), None)


def _reaches(source: str, path: Path, *, fits: bool) -> bool:
    if os.path.isfile(source):  # noqa: PTH113 - strings, as in `find_files`
        return Path(os.path.realpath(source)) == path
    if not fits:
        return False
    if os.path.isdir(source):  # noqa: PTH112
        return _folder_reaches(source, path)
    # A link that a pattern matches may lead to the folder that the path is in.
    matches = [] if "**" in source else glob.glob(source)  # noqa: PTH207 - Path.glob takes no absolute pattern
    return _glob_reaches(source, path) or any(_folder_reaches(match, path) for match in matches if os.path.isdir(match))  # noqa: PTH112


def _folder_reaches(folder: str, path: Path) -> bool:
    """Return whether a search below a folder, which follows links, reaches a path."""
    if path.is_relative_to(os.path.realpath(folder)):
        return True
    existing = next(above for above in path.parents if above.is_dir())
    return any(str(existing) == real for _, real, _ in folders_below(folder, hidden=True))


def _glob_reaches(pattern: str, path: Path) -> bool:
    parts = (Path.cwd() / pattern).parts
    plain = next((number for number, part in enumerate(parts) if glob.has_magic(part)), len(parts))
    start = os.path.realpath(Path(*parts[:plain]))
    return path.is_relative_to(start) and _matches(parts[plain:], path.relative_to(start).parts)


def _matches(pattern: Sequence[str], path: Sequence[str]) -> bool:
    """Return whether a pattern matches a path, or a folder above it, below which files would be searched.

    Pattern and path are split into their parts.
    """
    if not pattern:
        return True
    if not path:
        return all(part == "**" for part in pattern)
    first, rest = pattern[0], pattern[1:]
    hidden = path[0].startswith(".")
    if first == "**":
        return _matches(rest, path) or (not hidden and _matches(pattern, path[1:]))
    return hidden <= first.startswith(".") and fnmatchcase(path[0], first) and _matches(rest, path[1:])
