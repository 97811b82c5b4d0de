"""One shard on its way to disk: pairs are added one by one, and a record written last says that it is whole.

What is whole already when a run ends is kept: a journal has a line for each pair, with what proves it. A rerun takes up
the shard where the journal and the files agree no longer.
"""

import hashlib
import json
import tarfile
import tempfile
import zlib
from collections.abc import Mapping
from contextlib import suppress
from io import BufferedRandom
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from semisynth_gl.dataset.locks import lock
from semisynth_gl.dataset.places import Place, sync
from semisynth_gl.dataset.plan import Shard
from semisynth_gl.dataset.schema import PARTIAL, journal_name, record_path, tar_path

_ONLY_IN_JOURNAL = frozenset({"end", "crc32", "renderer", "seconds"})


_BLOCK = tarfile.BLOCKSIZE
_RECORD = tarfile.RECORDSIZE


class ShardBusyError(Exception):
    """Another run is making this shard."""


class ShardWriter:
    """Writes one shard. Use it in a ``with`` block.

    Files that stand by themselves appear as soon as their pair is whole; a tar appears when all of it is.

    Args:
        place: the dataset's.
        shard: which.
        packed: whether it is one tar.
        folder: of files that stand by themselves, "" or ending in a slash.

    Attributes:
        shard: which.
        samples: entries of the pairs that are whole, in their order.

    Raises:
        ShardBusyError: where another run has it in hand.
        OSError: where the disk refuses.
    """

    def __init__(self, place: Place, shard: Shard, *, packed: bool, folder: str) -> None:
        self.shard = shard
        self._place = place
        self._name = name = shard.name
        self._indices = range(shard.first, shard.end)
        self._folder = folder
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        if place.local is None:
            # What is half done stays here, and is lost with this run: a store shows whole files only.
            self._temporary = tempfile.TemporaryDirectory(prefix="semisynth-gl-")
            self._work = Path(self._temporary.name)
        else:
            self._work = place.local / PARTIAL
            self._work.mkdir(parents=True, exist_ok=True)
        try:
            self._journal = _locked(self._work / journal_name(name))
        except BaseException:
            self._clean()
            raise
        self._tar: BufferedRandom | None = None
        self._tar_path = self._work / f"{name}.tar"
        self.samples: list[dict[str, Any]] = []
        try:
            if packed:
                self._tar = _reopened(self._tar_path, place, tar_path(name))
            self._take_up()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the shard, finished or not."""
        if self._tar is not None:
            with suppress(OSError):
                self._tar.close()
            self._tar = None
        self._journal.close()
        self._clean()

    def _clean(self) -> None:
        if self._temporary is not None:
            self._temporary.cleanup()

    def add(self, files: Mapping[str, bytes], facts: Mapping[str, Any]) -> None:
        """Add the next pair.

        Args:
            files: its files, by path below the split's folder, or inside the tar.
            facts: what the shard's record shall say of it, in JSON's types.

        Raises:
            OSError: where the disk is full or refuses; nothing of the pair is left then.
        """
        index = self._indices[len(self.samples)]
        entry: dict[str, Any] = {"pair": index} | dict(facts)
        entry |= self._add_files(files) if self._tar is None else self._add_members(self._tar, files)
        self._journal.write(json.dumps(entry).encode() + b"\n")
        self._journal.flush()
        self.samples.append(entry)

    def finish(self, facts: Mapping[str, Any]) -> dict[str, Any]:
        """Make the shard whole, once all its pairs are there.

        Args:
            facts: what the record shall say beside its pairs, in JSON's types.

        Returns:
            The record.
        """
        record: dict[str, Any] = {"shard": self._name} | dict(facts)
        if self._tar is None:
            record |= self._finish_files()
        else:
            record |= self._finish_tar(self._tar)
        record["samples"] = [
            {key: value for key, value in entry.items() if key not in _ONLY_IN_JOURNAL} for entry in self.samples
        ]
        self._place.write(record_path(self._name), (json.dumps(record) + "\n").encode())
        (self._work / journal_name(self._name)).unlink(missing_ok=True)
        return record

    def _add_files(self, files: Mapping[str, bytes]) -> dict[str, Any]:
        written: list[tuple[Path, str]] = []
        described: dict[str, Any] = {}
        local = self._place.local
        try:
            for path, data in files.items():
                name = f"{self._folder}{path}"
                described[name] = {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
                if local is None:
                    self._place.write(name, data)
                    continue
                partial = self._work / f"{self._name}.{len(written)}"
                written.append((partial, name))
                partial.write_bytes(data)
            for partial, name in written:
                destination = self._place.path(name)
                destination.parent.mkdir(parents=True, exist_ok=True)
                partial.replace(destination)
        except BaseException:
            for partial, _ in written:
                with suppress(OSError):
                    partial.unlink(missing_ok=True)
            raise
        return {"files": described}

    def _add_members(self, tar: BufferedRandom, files: Mapping[str, bytes]) -> dict[str, Any]:
        begin = at = tar.tell()
        described: dict[str, Any] = {}
        checksum = 0
        try:
            for name, data in files.items():
                member, offset = tar_member(name, data)
                tar.write(member)
                checksum = zlib.crc32(member, checksum)
                described[name] = {"bytes": len(data), "offset": at + offset}
                at += len(member)
            tar.flush()
        except BaseException:
            with suppress(OSError):
                tar.truncate(begin)
                tar.seek(begin)
            raise
        return {"files": described, "end": at, "crc32": checksum}

    def _finish_files(self) -> dict[str, Any]:
        digest = hashlib.sha256()
        size = 0
        folders: set[Path] = set()
        for entry in self.samples:
            for name, file in entry["files"].items():
                # As `sha256sum` writes it.
                digest.update(f"{file['sha256']}  {name}\n".encode())
                size += file["bytes"]
                if self._place.local is not None:
                    path = self._place.path(name)
                    sync(path)
                    folders.add(path.parent)
        for folder in folders:
            sync(folder)
        return {"bytes": size, "sha256": digest.hexdigest()}

    def _finish_tar(self, tar: BufferedRandom) -> dict[str, Any]:
        tar.write(tar_end(tar.tell()))
        tar.flush()
        size = tar.tell()
        tar.seek(0)
        digest = hashlib.file_digest(tar, "sha256").hexdigest()
        tar.close()
        self._tar = None
        name = tar_path(self._name)
        self._place.put(name, self._tar_path)
        return {"tar": name, "bytes": size, "sha256": digest}

    def _take_up(self) -> None:
        """Keep the pairs of an earlier run that are whole, and drop what follows them."""
        kept = 0
        self._journal.seek(0)
        for index, line in zip(self._indices, self._journal, strict=False):
            try:
                entry = json.loads(line)
                whole = entry["pair"] == index and line.endswith(b"\n") and self._is_whole(entry)
            except (ValueError, KeyError, TypeError):
                whole = False
            if not whole:
                break
            self.samples.append(entry)
            kept += len(line)
        self._journal.truncate(kept)
        self._journal.seek(kept)
        if self._tar is not None:
            end = self.samples[-1]["end"] if self.samples else 0
            self._tar.truncate(end)
            self._tar.seek(end)

    def _is_whole(self, entry: Mapping[str, Any]) -> bool:
        if self._tar is None:
            try:
                return all(
                    hashlib.sha256(self._place.read(name)).hexdigest() == file["sha256"]
                    for name, file in entry["files"].items()
                )
            except FileNotFoundError:
                return False
        begin = self.samples[-1]["end"] if self.samples else 0
        self._tar.seek(begin)
        data = self._tar.read(entry["end"] - begin)
        return len(data) == entry["end"] - begin and zlib.crc32(data) == int(entry["crc32"])


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


def _locked(path: Path) -> BufferedRandom:
    """Open a journal and lock it: the lock goes when this process does, however it ends."""
    path.touch()
    file = path.open("r+b")
    try:
        lock(file.fileno(), shared=False)
    except BlockingIOError:
        file.close()
        raise ShardBusyError(path.stem) from None
    except BaseException:
        file.close()
        raise
    return file


def _reopened(path: Path, place: Place, name: str) -> BufferedRandom:
    """Open the tar of a shard that has no record; one that was renamed already comes back."""
    if place.local is not None and not path.exists() and place.size(name) is not None:
        place.path(name).replace(path)
    path.touch()
    return path.open("r+b")
