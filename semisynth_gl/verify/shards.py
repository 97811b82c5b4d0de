"""The shards of a dataset as they are stored: what holds each file, and whether it is what the record says."""

import hashlib
import tarfile
from collections.abc import Iterator, Mapping
from io import BufferedReader
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self, cast

from semisynth_gl.dataset.reader import RECORDS, Index, read_record
from semisynth_gl.errors import InputError
from semisynth_gl.read.error import ReadError
from semisynth_gl.splits import SplitName
from semisynth_gl.verify.finding import Verdict


class StoredShard:
    """One shard. Use it in a ``with`` block.

    Args:
        index: the dataset's.
        split: whose pairs it holds.
        name: its own.
        numbers: those of its pairs.

    Attributes:
        split: whose pairs it holds.
        name: its own.
        numbers: those of its pairs.
    """

    def __init__(self, index: Index, split: SplitName, name: str, numbers: range) -> None:
        self.split = split
        self.name = name
        self.numbers = numbers
        self._index = index
        self._record: Mapping[str, Any] = {}
        self._fault: str | None = None
        self._samples: Mapping[int, Mapping[str, Any]] = {}
        try:
            self._record = read_record(index.place, name)
            self._samples = {sample.get("pair"): sample["files"] for sample in self._record["samples"]}
        except ReadError as error:
            self._fault = f"{RECORDS}/{name}.json {error.reason}: the shard is not finished"
        self._tar: BinaryIO | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._tar is not None:
            self._tar.close()
            self._tar = None

    @property
    def recorded(self) -> bool:
        """Whether there is a record of it."""
        return self._fault is None

    def check(self, verdict: Verdict) -> None:
        """Check the record against the index, and the tar as a whole against the record."""
        if self._fault is not None:
            verdict.add("shard", self._fault)
            return
        record = self._record
        listed = {
            entry.get("shard"): entry for entry in self._index.values.get("shards", ()) if isinstance(entry, dict)
        }
        entry = listed.get(self.name)
        if entry is not None:
            for key in ("bytes", "sha256", "first", "end"):
                if entry.get(key) != record.get(key):
                    verdict.add(
                        "shard",
                        f"{self.name}: {key} is {record.get(key)!r} in its record, {entry.get(key)!r} in the index",
                    )
        elif self._index.fault is None:
            verdict.add("shard", f"{self.name} is not in the index")
        if list(self._samples) != list(self.numbers):
            verdict.add(
                "shard",
                f"{self.name}: expected the pairs {self.numbers.start} to {self.numbers.stop - 1}, its record lists "
                f"{len(self._samples)}",
            )
        if "tar" in record:
            self._check_tar(verdict)

    def _check_tar(self, verdict: Verdict) -> None:
        place, name = self._index.place, str(self._record["tar"])
        try:
            with place.open(name) as file:
                digest = hashlib.file_digest(cast("BufferedReader", file), "sha256").hexdigest()
                file.seek(0)
                with tarfile.open(fileobj=file) as tar:
                    held = [member.name for member in tar]
        except FileNotFoundError:
            verdict.add("shard", f"{name} is missing")
            return
        except (OSError, tarfile.TarError) as error:
            verdict.add("shard", f"{name} cannot be read as a tar: {error}")
            return
        if digest != self._record.get("sha256"):
            verdict.add("shard", f"{name} has the sha256 {digest[:12]}, its record {self._record.get('sha256')!s:.12}")
        wanted = [file for files in self._samples.values() for file in files]
        if held != wanted:
            differing = sorted(set(held) ^ set(wanted))
            verdict.add("shard", f"{name} holds {len(held)} files, its record lists {len(wanted)}; the first that "
                        f"differs is {(differing or ['their order'])[0]}")  # fmt: skip

    def listed(self, number: int) -> set[str] | None:
        """Return the files that the record lists of a pair; None without a record."""
        files = self._samples.get(number)
        return None if files is None else set(files)

    def read(self, number: int, name: str) -> bytes:
        """Read a pair's file, and compare it with the record.

        Raises:
            ReadError: where it is missing or cut off.
        """
        place = self._index.place
        if self._index.layout.packed:
            return self._member(number, name)
        try:
            return place.read(name)
        except (FileNotFoundError, NotADirectoryError):
            raise ReadError(Path(name), "is missing") from None
        except OSError as error:
            raise ReadError(Path(name), f"cannot be read: {error.strerror}") from None

    def check_digest(self, number: int, name: str, data: bytes, verdict: Verdict) -> None:
        """Compare a file that stands by itself with the record; those in a tar are judged with it."""
        file = self._samples.get(number, {}).get(name)
        if file is None or "sha256" not in file:
            return
        digest = hashlib.sha256(data).hexdigest()
        if digest != file["sha256"]:
            verdict.add("sha256", f"{name} has {digest[:12]}, its shard's record {file['sha256']!s:.12}")

    def _member(self, number: int, name: str) -> bytes:
        file = self._samples.get(number, {}).get(name)
        if file is None:
            raise ReadError(Path(name), "is missing")
        try:
            if self._tar is None:
                self._tar = self._index.place.open(str(self._record["tar"]))
            self._tar.seek(int(file["offset"]))
            data = self._tar.read(int(file["bytes"]))
        except FileNotFoundError:
            raise ReadError(Path(name), f"is missing, with its shard {self.name}") from None
        except (KeyError, TypeError, ValueError, OSError) as error:
            raise ReadError(Path(name), f"cannot be read from its shard {self.name}: {error!r}") from None
        if len(data) < file["bytes"]:
            raise ReadError(Path(name), f"is cut off: its shard {self.name} ends before it does")
        return data


def open_shards(index: Index) -> Iterator[StoredShard]:
    """Open all shards that a dataset should have, one after the other.

    Raises:
        InputError: where the index does not say how many there are.
    """
    each = index.values.get("shard_pairs")
    if not isinstance(each, int) or each < 1:
        raise InputError(f"{index.place.address}: the index has no shard_pairs, so its shards are not known")
    names = iter(index.shard_names())
    for split, pairs in index.pairs.items():
        for first in range(0, pairs, each):
            yield StoredShard(index, split, next(names), range(first, min(first + each, pairs)))
