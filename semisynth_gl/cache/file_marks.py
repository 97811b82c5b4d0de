"""Whether a file still holds what it held: told by its size and times where those are the same, else by its content."""

import hashlib
import time
from pathlib import Path
from typing import NamedTuple

# A file that changes again within the same tick of its file system's clock (two seconds on some) keeps its times. So
# times are no proof where they were this young when the content was read.
_YOUNG_NS = 2_000_000_000
_NO_PROOF = -1


class Mark(NamedTuple):
    """What a file was, in JSON's types.

    Attributes:
        size: in bytes.
        changed_ns: time of the last change of its content, or -1 where that proves nothing.
        status_ns: time of the last change of its content, name or rights, which programs cannot set back; or -1.
        sha256: of its content; empty where it was not read.
    """

    size: int
    changed_ns: int
    status_ns: int
    sha256: str


def glance(path: Path) -> Mark:
    """Return a file's mark without reading it.

    Raises:
        OSError: where it is not there.
    """
    status = path.stat()
    return Mark(status.st_size, status.st_mtime_ns, status.st_ctime_ns, "")


def mark(path: Path, before: Mark) -> Mark | None:
    """Return a file's mark with its content, or None where it is not what it was at a `glance` before.

    Raises:
        OSError: where it cannot be read.
    """
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    if glance(path) != before:
        return None
    if max(before.changed_ns, before.status_ns) > time.time_ns() - _YOUNG_NS:
        return Mark(before.size, _NO_PROOF, _NO_PROOF, sha256)
    return before._replace(sha256=sha256)


def renewed(path: Path, known: Mark) -> Mark | None:
    """Return the mark under which a file can be known from now on, or None where its content is another.

    Raises:
        OSError: where it cannot be read.
    """
    now = glance(path)
    if now._replace(sha256=known.sha256) == known:
        return known
    if now.size != known.size:
        return None
    fresh = mark(path, now)
    return fresh if fresh is not None and fresh.sha256 == known.sha256 else None
