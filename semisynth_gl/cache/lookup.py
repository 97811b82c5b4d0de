"""Cache lookup: a result is built once, and loaded as long as its key and its files are the same.

The key of a result holds all that decides it: values, versions of packages, the program's own sources. The files that
went into a result are compared by their fingerprints; files that the build did not open do not count.
"""

import hashlib
import json
import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from semisynth_gl.cache.file_fingerprint import FileFingerprint, read_fingerprint, revalidated, stat_fingerprint
from semisynth_gl.cache.store import Entry, cache_folder, read_entry, write_entry
from semisynth_gl.errors import SemisynthError

_LOG = logging.getLogger(__name__)
_Result = TypeVar("_Result")
_PACKAGE = Path(__file__).resolve().parents[1]


def cached(
    kind: str,
    key: Callable[[], Mapping[str, Any]],
    *,
    work: str | None = None,
    files: Sequence[Path] = (),
    build: Callable[[], tuple[_Result, Sequence[Path]]],
    pack: Callable[[_Result], Entry | None],
    unpack: Callable[[Entry], _Result],
) -> _Result:
    """Return a result from the cache, or build it and put it there.

    Args:
        kind: the first part of the entry's name.
        work: what ``build`` does, where it takes seconds: logged as INFO before it begins.
        key: returns, in JSON's types, all that decides the result except the content of files. Where it raises OSError
            or ImportError, the cache is not used.
        files: all files that the build may open. The key must hold their number and order.
        build: returns the result, and the files that it opened.
        pack: turns a result into an entry; None keeps the result out of the cache.
        unpack: turns an entry into a result that equals the built one in every value.

    Raises:
        SemisynthError: raised by ``build``.
    """
    folder = cache_folder()
    try:
        text = None if folder is None else json.dumps(key(), sort_keys=True)
    except (OSError, ImportError):
        text = None
    if text is None:
        if work is not None:
            _LOG.info("%s", work)
        return build()[0]
    name = f"{kind}-{hashlib.sha256(text.encode()).hexdigest()[:32]}"
    entry = read_entry(name)
    if entry is not None:
        # An unfit entry is built again.
        with suppress(LookupError, TypeError, ValueError, AttributeError, OverflowError, OSError, SemisynthError):
            known = {int(index): FileFingerprint(*values) for index, values in entry.values["files"].items()}
            current = {index: revalidated(files[index], fingerprint) for index, fingerprint in known.items()}
            if None not in current.values():
                result = unpack(entry)
                if current != known:
                    write_entry(name, _with_fingerprints(entry, current))
                return result
    before = [stat_fingerprint(path) for path in files]
    if work is not None:
        _LOG.info("%s; later runs find them in %s", work, folder)
    result, opened = build()
    packed = pack(result)
    if packed is not None:
        counting = frozenset(opened)
        indices = [index for index, path in enumerate(files) if path in counting]
        fingerprints = {index: read_fingerprint(files[index], before[index]) for index in indices}
        if None not in fingerprints.values():
            write_entry(name, _with_fingerprints(packed, fingerprints))
    return result


def source_digest(sources: Sequence[str | Path]) -> str:
    """Return the SHA-256 of modules and folders of this package or of others, so that a changed program builds anew.

    Args:
        sources: paths relative to this package, such as ``"geometry"`` or ``"seeds.py"``; absolute ones of others.

    Raises:
        OSError: where a source is not a file on disk.
    """
    digest = hashlib.sha256()
    for name in sources:
        path = _PACKAGE / name
        for source in sorted(path.rglob("*.py")) or [path]:
            content = source.read_bytes()
            digest.update(f"{source.relative_to(path.parent).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()


def package_versions(*packages: str) -> dict[str, str]:
    """Return the versions of installed packages by their names.

    Raises:
        ImportError: where a package has no metadata of an installation.
    """
    return {package: version(package) for package in packages}


def installed_packages() -> list[str]:
    """Return names and versions of all installed packages, for results that any package may change."""
    folders = {Path(folder) for folder in sys.path}
    names = {path.name for folder in folders if folder.is_dir() for path in folder.iterdir()}
    return sorted(name for name in names if name.endswith((".dist-info", ".egg-info")))


def _with_fingerprints(entry: Entry, fingerprints: Mapping[int, FileFingerprint | None]) -> Entry:
    return Entry(entry.values | {"files": {str(index): values for index, values in fingerprints.items()}}, entry.arrays)
