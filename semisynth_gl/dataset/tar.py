"""Tars of shards: their members stand one behind the other, each a header and its padded content."""

import tarfile
from collections.abc import Iterable

HEADER = tarfile.BLOCKSIZE
"""Bytes of a member's header, right before its content."""


def tar_member(name: str, data: bytes) -> tuple[bytes, int]:
    """Encode a file as a member of a tar, header and padded content, and return the content's offset in it too.

    It has no time, no owner and rights 0644. Its name has at most 100 characters: every reader knows the headers of
    1988, which have so many.
    """
    info = tarfile.TarInfo(name)
    info.size = len(data)
    header = info.tobuf(tarfile.USTAR_FORMAT)
    return b"".join((header, data, bytes(-len(data) % tarfile.BLOCKSIZE))), len(header)


def tar_end(length: int) -> bytes:
    """Return the end of an archive of ``length`` bytes: two empty blocks, and the blocks that fill up a record."""
    end = 2 * tarfile.BLOCKSIZE
    return bytes(end + -(length + end) % tarfile.RECORDSIZE)


def content_offsets(sizes: Iterable[int]) -> tuple[list[int], int]:
    """Return where the contents of members of these sizes begin, and the size of the whole tar, in bytes."""
    offsets, end = [], 0
    for size in sizes:
        offsets.append(end + HEADER)
        end += HEADER + size + -size % tarfile.BLOCKSIZE
    return offsets, end + len(tar_end(end))


def header_fault(header: bytes, name: str, size: int) -> str | None:
    """Return why a header is not that of a plain file of this name and size; None where it is."""
    try:
        info = tarfile.TarInfo.frombuf(header, "utf-8", "surrogateescape")
    except tarfile.TarError as error:
        return f"has no header of {name}: {error}"
    if (info.name, info.size, info.isreg()) == (name, size, True):
        return None
    kind = "a file" if info.isreg() else "no plain file"
    return f"expected {name} of {size} bytes, got {kind} named {info.name!r} of {info.size} bytes"
