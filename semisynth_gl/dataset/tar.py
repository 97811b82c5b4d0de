"""Tars of shards: members follow each other, each with a header and its padded content."""

import tarfile

HEADER = tarfile.BLOCKSIZE
"""Size of a member's header, which stands right before the content, in bytes."""


def tar_member(name: str, data: bytes) -> tuple[bytes, int]:
    """Encode a file as a member of a tar.

    Return the member, which is header and padded content, and the content's offset in it. The header has no time and no
    owner, and mode 0644. ``name`` should have at most 100 characters: such names fit into the header of 1988, which
    every reader knows.
    """
    info = tarfile.TarInfo(name)
    info.size = len(data)
    header = info.tobuf(tarfile.USTAR_FORMAT)
    return b"".join((header, data, bytes(-len(data) % tarfile.BLOCKSIZE))), len(header)


def tar_end(length: int) -> bytes:
    """Return the end of an archive of ``length`` bytes: two empty blocks, and padding to whole tar records."""
    end = 2 * tarfile.BLOCKSIZE
    return bytes(end + -(length + end) % tarfile.RECORDSIZE)


def header_fault(header: bytes, name: str, size: int) -> str | None:
    """Return why a header does not describe a plain file of this name and size in bytes; None where it does."""
    try:
        info = tarfile.TarInfo.frombuf(header, "utf-8", "surrogateescape")
    except tarfile.TarError as error:
        return f"has no header of {name}: {error}"
    if (info.name, info.size, info.isreg()) == (name, size, True):
        return None
    other = "" if info.isreg() else ", which is no plain file"
    return f"expected the file {name} of {size} bytes, got {info.name!r} of {info.size} bytes{other}"
