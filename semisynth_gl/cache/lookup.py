"""Cache lookup: a result is built once, and loaded as long as its key and its files are the same.

The key of a result holds everything that decides it: the builder's version, values, versions of packages. The files
that went into a result are compared by their fingerprints; files that the build did not open do not count.

The code of a builder is not part of the key. Its module has a `VERSION`; increase it with each change of what the
builder makes of the same inputs, or of how it packs the result. tests/built.py finds changes without an increase.
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
from semisynth_gl.cache.store import Entry, cache_folder, is_writable, read_entry, write_entry
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
    """Return a result from the cache, or build it and put it into the cache; errors of ``build`` are passed on.

    Args:
        kind: the sort of result, the first part of the entry's name.
        version: the builder's version, the second part of the name.
        key: returns, in JSON's types, everything that decides the result except the content of files. Where it raises
            OSError or ImportError, the cache is not used.
        work: what ``build`` does, such as "making models", logged as INFO before it begins; None where it is quick.
        files: all files that the build may open. Entries refer to them by number, so the key must tell which file has
            which number.
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
        # A result whose entry is unfit is built again.
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
        _LOG.info("%s%s", work, f"; later runs find them in {folder}" if folder and is_writable(folder) else "")
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
    """Return the versions of packages by name; raises ImportError where a package is not installed."""
    return {package: version(package) for package in packages}


def installed_packages() -> list[str]:
    """Return the metadata folders of all installed packages, which have name and version, such as "x-1.0.dist-info".

    They are for the keys of results that any package may change.
    """
    names = {path.name for folder in map(Path, sys.path) if folder.is_dir() for path in folder.iterdir()}
    return sorted(name for name in names if name.endswith((".dist-info", ".egg-info")))


def _with_fingerprints(entry: Entry, fingerprints: Mapping[int, FileFingerprint | None]) -> Entry:
    return Entry(entry.values | {"files": {str(index): values for index, values in fingerprints.items()}}, entry.arrays)
