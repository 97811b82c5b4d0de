"""Tar archives whose bytes follow from names and contents alone."""

import tarfile

_BLOCK = tarfile.BLOCKSIZE
_RECORD = tarfile.RECORDSIZE


def tar_member(name: str, data: bytes) -> tuple[bytes, int]:
    """Encode one file as tar has it: header and padded content; no time, no owner, rights 0644.

    Args:
        name: at most 100 characters, as the headers of 1988 hold them, which every reader knows.
        data: the content.

    Returns:
        The bytes, and where in them the content begins.
    """
    info = tarfile.TarInfo(name)
    info.size = len(data)
    header = info.tobuf(tarfile.USTAR_FORMAT)
    return b"".join((header, data, bytes(-len(data) % _BLOCK))), len(header)


def tar_end(length: int) -> bytes:
    """Return what ends an archive of so many bytes: at least two empty blocks, and as many as fill a record."""
    return bytes(2 * _BLOCK + -(length + 2 * _BLOCK) % _RECORD)
