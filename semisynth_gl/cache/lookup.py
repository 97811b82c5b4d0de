"""Results that are made once and found again, as long as all that decided them is the same.

What decides a result is its key: values, versions of packages, the program's own sources. The files that it was made
of are told apart by their content (`file_marks`), and only those that were opened count.
"""

import hashlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from semisynth_gl.cache.entries import Entry, cache_folder, read_entry, write_entry
from semisynth_gl.cache.file_marks import Mark, glance, mark, renewed
from semisynth_gl.errors import SemisynthError

_Result = TypeVar("_Result")
_PACKAGE = Path(__file__).resolve().parents[1]


def remembered(
    kind: str,
    decided_by: Callable[[], Mapping[str, Any]],
    *,
    files: Sequence[Path] = (),
    make: Callable[[], tuple[_Result, Sequence[Path]]],
    pack: Callable[[_Result], Entry | None],
    unpack: Callable[[Entry], _Result],
) -> _Result:
    """Return what ``make`` returns, from the cache where it was made before of the same.

    Args:
        kind: begins the name of the entry.
        decided_by: tells, in JSON's types, all that decides the result but the content of files. Where it raises
            OSError or ImportError, nothing is kept.
        files: those that may be opened. ``decided_by`` must tell of their number and order.
        make: returns the result, and which of the files were opened for it.
        pack: turns a result into an entry; None where it must not be kept.
        unpack: turns an entry back into a result that equals the first one in every value.

    Raises:
        SemisynthError: what ``make`` raises.
    """
    if cache_folder() is None:
        return make()[0]
    try:
        decisive = json.dumps(decided_by(), sort_keys=True)
    except (OSError, ImportError):
        return make()[0]
    name = f"{kind}-{hashlib.sha256(decisive.encode()).hexdigest()[:32]}"
    entry = read_entry(name)
    if entry is not None:
        with suppress(LookupError, TypeError, ValueError, OSError, SemisynthError):  # then it is made again
            known = {int(index): Mark(*values) for index, values in entry.values["files"].items()}
            fresh = {index: renewed(files[index], known[index]) for index in known}
            if None not in fresh.values():
                result = unpack(entry)
                if fresh != known:
                    write_entry(name, _with_marks(entry, fresh))
                return result
    before = [_glance(path) for path in files]
    result, opened = make()
    packed = pack(result)
    if packed is not None:
        marks = _marks(files, before, opened)
        if marks is not None:
            write_entry(name, _with_marks(packed, marks))
    return result


def own_sources(*names: str) -> str:
    """Return the SHA-256 of modules and folders of this package, so that another program finds nothing of this one.

    Raises:
        OSError: where they are not there as files.
    """
    digest = hashlib.sha256()
    for name in names:
        path = _PACKAGE / name
        for source in sorted(path.rglob("*.py")) or [path]:
            content = source.read_bytes()
            digest.update(f"{source.relative_to(_PACKAGE).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()


def versions(*packages: str) -> dict[str, str]:
    """Return the versions of installed packages by their names.

    Raises:
        ImportError: where one is not installed as a package is.
    """
    return {package: version(package) for package in packages}


def all_versions() -> list[str]:
    """Return what stands for all installed packages and their versions, for results that any of them may change."""
    folders = {Path(folder) for folder in sys.path}
    names = {path.name for folder in folders if folder.is_dir() for path in folder.iterdir()}
    return sorted(name for name in names if name.endswith((".dist-info", ".egg-info")))


def _glance(path: Path) -> Mark | None:
    try:
        return glance(path)
    except OSError:
        return None


def _marks(files: Sequence[Path], before: Sequence[Mark | None], opened: Sequence[Path]) -> dict[int, Mark] | None:
    """Marks of the files that were opened, by their index; None where one cannot be read or has changed meanwhile."""
    chosen = frozenset(opened)
    marks = {}
    for index, (path, seen) in enumerate(zip(files, before, strict=True)):
        if path not in chosen:
            continue
        try:
            found = mark(path, seen) if seen is not None else None
        except OSError:
            return None
        if found is None:
            return None
        marks[index] = found
    return marks


def _with_marks(entry: Entry, marks: Mapping[int, Mark | None]) -> Entry:
    return Entry(entry.values | {"files": {str(index): values for index, values in marks.items()}}, entry.arrays)
