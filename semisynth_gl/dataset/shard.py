"""The writer of a shard: pairs are added one after the other, and the record, written last, says that it is complete.

Complete pairs survive when a run is ended: a journal has a line for each pair, with the digests of its files. The next
run resumes the shard at the first pair whose files do not agree with the journal.
"""

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from io import BufferedRandom
from pathlib import Path
from typing import Any, BinaryIO, Self

from isal import isal_zlib

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.dataset.begun import complete_record
from semisynth_gl.dataset.contents import Shard
from semisynth_gl.dataset.documents import JournalEntry, parse_document
from semisynth_gl.dataset.locks import lock, open_locked
from semisynth_gl.dataset.places import Folder, Place, sync
from semisynth_gl.dataset.schema import FORMAT, PARTIAL, UNLOCKED, journal_name, log_path, record_path, tar_path
from semisynth_gl.dataset.tar import tar_end, tar_member
from semisynth_gl.inputs.errors import ReadError

_ONLY_IN_JOURNAL = frozenset({"end", "crc32", "renderer", "seconds"})


class ShardBusyError(Exception):
    """Another run is making this shard."""


class ShardWriter:
    """Writes one shard. Use it in a ``with`` block.

    If ``packed``, the files go into one tar, which appears when all pairs of the shard are complete. Otherwise a pair's
    files appear below ``folder``, "" or ending in a slash, as soon as the pair is complete.

    Attributes:
        complete: whether the shard was complete already; the writer then changes nothing and takes no pairs.
        samples: journal entries of the pairs written so far, in their order; empty where ``complete`` is true.

    Raises:
        ShardBusyError: where another run is making the shard.
        InputError: where a link would lead files out of the place; `add` and `finish` raise it too.
        OSError: where the disk cannot be written to.
    """

    def __init__(self, place: Place, shard: Shard, *, packed: bool, folder: str) -> None:
        self._place = place
        self._name = name = shard.name
        self._indices = range(shard.first, shard.end)
        self._folder = folder
        self._resources = ExitStack()
        self._tar: BufferedRandom | None = None
        self.samples: list[JournalEntry] = []
        try:
            self._work, self._journal = self._begin()
            # Another run may have completed the shard since this run found that it is missing.
            self.complete = complete_record(place, shard) is not None
            if self.complete:
                return
            self._tar_path = self._work / f"{name}.tar"
            if packed:
                if isinstance(place, Folder) and self._work.name == PARTIAL:
                    place.own_path(f"{PARTIAL}/{name}.tar", in_place=True)
                    if not self._tar_path.exists() and place.size(tar_path(name)) is not None:
                        # The shard has no record: its tar is not complete, though it was renamed already.
                        place.own_path(tar_path(name)).replace(self._tar_path)
                self._tar_path.touch()
                # On a full disk, closing the tar fails again.
                self._resources.enter_context(suppress(OSError))
                self._tar = self._resources.enter_context(self._tar_path.open("r+b"))
            self._resume()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close and unlock the shard, finished or not."""
        self._resources.close()

    def add(self, files: Mapping[str, bytes], facts: Mapping[str, Any]) -> None:
        """Add the next pair.

        ``files`` are the files' bytes by path, below the split's folder or inside the tar, and ``facts`` the further
        values of the pair's `JournalEntry`, in JSON's types.

        Raises:
            OSError: where the disk is full or cannot be written to; no file of the pair remains then.
        """
        index = self._indices[len(self.samples)]
        entry: dict[str, Any] = {"pair": index} | dict(facts)
        entry |= self._add_files(files) if self._tar is None else self._add_members(self._tar, files)
        self._journal.write(json.dumps(entry).encode() + b"\n")
        self._journal.flush()
        self.samples.append(JournalEntry.model_validate(entry))

    def finish(self, facts: Mapping[str, Any], log: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the shard after its last pair, and return its record.

        ``facts`` go into the record and ``log`` into the shard's log, both in JSON's types.
        """
        record: dict[str, Any] = {"shard": self._name, "format": FORMAT} | dict(facts)
        record |= self._finish_files() if self._tar is None else self._finish_tar(self._tar)
        record["samples"] = [
            {key: value for key, value in entry.values.items() if key not in _ONLY_IN_JOURNAL} for entry in self.samples
        ]
        self._place.write(log_path(self._name), (json.dumps(log) + "\n").encode())
        self._place.write(record_path(self._name), (json.dumps(record) + "\n").encode())
        (self._work / journal_name(self._name)).unlink(missing_ok=True)
        return record

    def _begin(self) -> tuple[Path, BinaryIO]:
        """Return a folder in which no other run works on the shard, and the journal in it."""
        name, partial = journal_name(self._name), None
        if isinstance(self._place, Folder):
            path = self._place.own_path(f"{PARTIAL}/{name}", in_place=True)
            try:
                # The run that completes the shard removes its journal: `open_locked` checks that it is still there.
                opened = open_locked(path, lambda: False, patient=False)
            except BlockingIOError:
                raise ShardBusyError(self._name) from None
            partial, journal = path.parent, self._resources.enter_context(opened)
            if lock(journal.fileno(), shared=False):
                return partial, journal
        # Stores must show complete files only, and without locks another run may be making the shard: this run keeps
        # its unfinished files in a folder of its own, and removes them when it ends.
        temporary = tempfile.TemporaryDirectory(prefix=UNLOCKED, dir=partial)
        work = Path(self._resources.enter_context(temporary))
        return work, self._resources.enter_context((work / name).open("a+b"))

    def _add_files(self, files: Mapping[str, bytes]) -> dict[str, Any]:
        named = {f"{self._folder}{path}": data for path, data in files.items()}
        if isinstance(self._place, Folder):
            self._write_together(self._place, named)
        else:
            for name, data in named.items():
                self._place.write(name, data)
        return {
            "files": {
                name: {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()} for name, data in named.items()
            }
        }

    def _write_together(self, place: Folder, files: Mapping[str, bytes]) -> None:
        """Write a pair's files under other names, and rename them once all are written."""
        written: list[tuple[Path, Path]] = []
        try:
            for name, data in files.items():
                partial = self._work / f"{self._name}.{len(written)}"
                written.append((partial, place.own_path(name)))
                # A file there is a killed run's; a link there may lead to somebody else's file.
                partial.unlink(missing_ok=True)
                partial.write_bytes(data)
            for partial, destination in written:
                destination.parent.mkdir(parents=True, exist_ok=True)
                partial.replace(destination)
        except BaseException:
            for partial, _ in written:
                with suppress(OSError):
                    partial.unlink(missing_ok=True)
            raise

    def _add_members(self, tar: BufferedRandom, files: Mapping[str, bytes]) -> dict[str, Any]:
        begin = at = tar.tell()
        described: dict[str, Any] = {}
        checksum = 0
        try:
            for name, data in files.items():
                member, offset = tar_member(name, data)
                tar.write(member)
                checksum = isal_zlib.crc32(member, checksum)
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
        files = [file for entry in self.samples for file in entry.files.items()]
        if isinstance(self._place, Folder):
            paths = [self._place.path(name) for name, _ in files]
            for path in (*paths, *{path.parent for path in paths}):
                sync(path)
        # The shard's digest is that of the lines that `sha256sum` writes.
        lines = "".join(f"{file.sha256}  {name}\n" for name, file in files)
        size = sum(file.bytes for _, file in files)
        return {"bytes": size, "sha256": hashlib.sha256(lines.encode()).hexdigest()}

    def _finish_tar(self, tar: BufferedRandom) -> dict[str, Any]:
        tar.write(tar_end(tar.tell()))
        tar.flush()
        size = tar.tell()
        tar.seek(0)
        digest = hashlib.file_digest(tar, "sha256").hexdigest()
        tar.close()
        name = tar_path(self._name)
        self._place.put(name, self._tar_path)
        return {"tar": name, "bytes": size, "sha256": digest}

    def _resume(self) -> None:
        """Keep the complete pairs of an earlier run, and cut off the rest of the journal and the tar."""
        end, path = 0, Path(journal_name(self._name))
        self._journal.seek(0)
        for index, line in zip(self._indices, self._journal, strict=False):
            try:
                entry = parse_document(JSON_OBJECT.decode(line, path), JournalEntry, path)
                complete = entry.pair == index and line.endswith(b"\n") and self._is_complete(entry)
            except ReadError:
                complete = False
            if not complete:
                break
            self.samples.append(entry)
            end += len(line)
        self._journal.truncate(end)
        self._journal.seek(end)
        if self._tar is not None:
            self._tar.truncate(self._tar_end)
            self._tar.seek(self._tar_end)

    @property
    def _tar_end(self) -> int:
        """The byte of the tar at which the complete pairs end."""
        return self.samples[-1].end if self.samples else 0

    def _is_complete(self, entry: JournalEntry) -> bool:
        if self._tar is None:
            try:
                return all(
                    hashlib.sha256(self._place.read(name)).hexdigest() == file.sha256
                    for name, file in entry.files.items()
                )
            except FileNotFoundError:
                return False
        begin, end = self._tar_end, entry.end
        if not begin < end <= os.fstat(self._tar.fileno()).st_size:
            return False
        self._tar.seek(begin)
        return isal_zlib.crc32(self._tar.read(end - begin)) == entry.crc32
