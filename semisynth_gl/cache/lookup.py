"""Cache lookup: a result is built once, and loaded as long as its key and its files are the same.

The key of a result holds all that decides it: the builder's version, values, versions of packages. The files that went
into a result are compared by their fingerprints; files that the build did not open do not count.

The code of a builder is not part of the key. Its module has a `VERSION`, which is raised with each change of what it
makes of the same inputs, and of how it packs that; tests/built.py finds changes that were made without.
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
from semisynth_gl.inputs.errors import SemisynthError

_LOG = logging.getLogger(__name__)
_Result = TypeVar("_Result")


def cached(
    kind: str,
    version: int,
    key: Callable[[], Mapping[str, Any]],
    *,
    work: str | None = None,
    files: Sequence[Path] = (),
    build: Callable[[], tuple[_Result, Sequence[Path]]],
    pack: Callable[[_Result], Entry | None],
    unpack: Callable[[Entry], _Result],
) -> _Result:
    """Return a result from the cache, or build it and put it there; errors of ``build`` are passed on.

    Args:
        kind: the first part of the entry's name.
        version: the builder's, the second part.
        key: returns, in JSON's types, all that decides the result except the content of files. Where it raises OSError
            or ImportError, the cache is not used.
        work: what ``build`` does, where it takes seconds: logged as INFO before it begins.
        files: all files that the build may open. The key must hold their number and order.
        build: returns the result, and the files that it opened.
        pack: turns a result into an entry; None keeps the result out of the cache.
        unpack: turns an entry into a result that equals the built one in every value.
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
    name = f"{kind}-{version}-{hashlib.sha256(text.encode()).hexdigest()[:32]}"
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
        numbered = enumerate(zip(files, before, strict=True))
        fingerprints = {index: read_fingerprint(path, state) for index, (path, state) in numbered if path in counting}
        if None not in fingerprints.values():
            write_entry(name, _with_fingerprints(packed, fingerprints))
    return result


def package_versions(*packages: str) -> dict[str, str]:
    """Return the versions of installed packages by name; raises ImportError where one has no metadata."""
    return {package: version(package) for package in packages}


def installed_packages() -> list[str]:
    """Return names and versions of all installed packages, for results that any package may change."""
    names = {path.name for folder in map(Path, sys.path) if folder.is_dir() for path in folder.iterdir()}
    return sorted(name for name in names if name.endswith((".dist-info", ".egg-info")))


def _with_fingerprints(entry: Entry, fingerprints: Mapping[int, FileFingerprint | None]) -> Entry:
    return Entry(entry.values | {"files": {str(index): values for index, values in fingerprints.items()}}, entry.arrays)
