"""Fingerprints of files: equal sizes and times prove equal content; where they differ, the content is hashed."""

import hashlib
import time
from pathlib import Path
from typing import NamedTuple

from semisynth_gl.inputs.user_files import open_file

# A file that changes twice within one tick of its file system's clock (up to two seconds) keeps its times. So the times
# of a file that changed less than this before it was read are not trusted.
_YOUNG_NS = 2_000_000_000


class FileFingerprint(NamedTuple):
    """The state of a file, in JSON's types: its size in bytes, its times, and the SHA-256 of its content.

    ``mtime_ns`` is the time of the last change of the content. ``ctime_ns`` is the time of the last change of content,
    name or rights, which programs cannot set back. Both are -1 where they prove nothing. ``sha256`` is empty where the
    content was not read.
    """

    size: int
    mtime_ns: int
    ctime_ns: int
    sha256: str


def stat_fingerprint(path: Path) -> FileFingerprint | None:
    """Return a file's fingerprint without reading its content, or None where the file cannot be looked up."""
    try:
        status = path.stat()
    except OSError:
        return None
    return FileFingerprint(status.st_size, status.st_mtime_ns, status.st_ctime_ns, "")


def read_fingerprint(path: Path, before: FileFingerprint | None) -> FileFingerprint | None:
    """Return a file's fingerprint with the hash of its content.

    ``before`` is the file's `stat_fingerprint` from before a result was made of it. Returns None if ``before``
    is None, or if the file has changed since or cannot be read.
    """
    try:
        with open_file(path) as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
    if before is None or stat_fingerprint(path) != before:
        return None
    if max(before.mtime_ns, before.ctime_ns) > time.time_ns() - _YOUNG_NS:
        return FileFingerprint(before.size, -1, -1, sha256)
    return before._replace(sha256=sha256)


def revalidated(path: Path, known: FileFingerprint) -> FileFingerprint | None:
    """Return a file's fingerprint with its present times, or None where its content is no longer that of ``known``."""
    now = stat_fingerprint(path)
    if now is None or now.size != known.size:
        return None
    if now._replace(sha256=known.sha256) == known:
        return known
    fresh = read_fingerprint(path, now)
    return fresh if fresh is not None and fresh.sha256 == known.sha256 else None
