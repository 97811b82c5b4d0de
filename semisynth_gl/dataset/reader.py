"""A dataset as a sequence of pairs. The arrays of a pair have the same names in every layout."""

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from typing import cast

from upath import UPath

from semisynth_gl.dataset.documents import INDEX, PLAN, DatasetIndex, DatasetPlan, Shard, ShardRecord, parse
from semisynth_gl.dataset.pair_files import StoredFrame, assemble_frame, decode_file, wrong_sizes
from semisynth_gl.dataset.root import open_root, read_if_there, read_part, read_whole, shown_path
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError, ReadError, counted, shown
from semisynth_gl.seeds.splits import SplitName

# Maximum number of records in memory, which the records of a million pairs would fill.
_MOST_RECORDS = 1000


@dataclass(frozen=True, slots=True)
class StoredIndex:
    """A dataset's folder or address, and the content of its index or, if it is unfinished, of its plan."""

    address: str
    plan: DatasetPlan

    @property
    def root(self) -> UPath:
        """The dataset's root, opened at each use: a forked process must not use its parent's connections."""
        return open_root(self.address)

    @property
    def finished_index(self) -> DatasetIndex | None:
        """The plan as index; None for an unfinished dataset."""
        return self.plan if isinstance(self.plan, DatasetIndex) else None

    @property
    def fault(self) -> str | None:
        """What an unfinished dataset lacks; None for a finished one."""
        return None if self.finished_index else f"it has no {INDEX}: it is not finished; run its generate command again"


def read_index(address: str | PathLike[str]) -> StoredIndex:
    """Read the index of a dataset, or the plan of an unfinished one, from a folder or an address that fsspec knows.

    Raises:
        InputError: where the address has no dataset, or a dataset of a newer format.
        ReadError: where the index, or the plan of a dataset without index, is damaged.
    """
    address = fspath(address)
    root = open_root(address)
    for name, model in ((INDEX, DatasetIndex), (PLAN, DatasetPlan)):
        data = read_if_there(root, name)
        if data is not None:
            try:
                return StoredIndex(address, parse(model, data, shown_path(root, name)))
            except ReadError as error:
                remedy = "; remove it and run generate again" if name == INDEX and (root / PLAN).exists() else ""
                raise ReadError(error.path, error.reason + remedy) from None
    advice = next(
        (f": give the dataset's folder, {each}" for each in root.absolute().parents if (each / PLAN).exists()), ""
    )
    fault = f"it has neither {INDEX} nor {PLAN}{advice}" if root.exists() else "there is no such folder"
    raise InputError(f"{address}: not a dataset: {fault}")


class Dataset:
    """A finished dataset, or one of its splits: ``dataset[i]`` is a pair with its truth.

    Without a split, these are all pairs, in the order train, validation, test. No file stays open between reads, so
    threads and processes, forked or spawned, may share a dataset.

    Raises InputError where the dataset is not finished, or lacks the split.
    """

    def __init__(self, index: StoredIndex, split: SplitName | None = None) -> None:
        plan = index.plan
        if index.fault is not None:
            raise InputError(f"{index.address}: {index.fault}")
        if split is not None and split not in plan.pairs:
            raise InputError(f"{index.address}: expected a split of {', '.join(plan.pairs)}, got {shown(split)}")
        self.index = index
        """Content and address of the dataset's index."""
        self._counts = {name: count for name, count in plan.pairs.items() if split in (None, name)}
        self._shards = {(shard.split, shard.first): shard for shard in plan.shards}
        self._records: dict[Shard, ShardRecord] = {}

    def __len__(self) -> int:
        return sum(self._counts.values())

    def __getitem__(self, number: int) -> StoredFrame:
        """Read a pair; raises as `pair` does.

        Raises ReadError where a file is missing, cut off, unreadable, or not of the size of the dataset's images, or a
        record does not describe its shard.
        """
        plan, root, (split, pair) = self.index.plan, self.index.root, self.pair(number)
        layout, names = plan.layout, plan.files(split, pair)
        if layout.packed:
            shard = self._shards[split, pair - pair % plan.shard_pairs]
            files = read_members(root, shard, self._record(shard), pair, list(names.values()))
        else:
            files = {name: read_whole(root, name) for name in names.values()}
        values = {
            role: decode_file(layout, role, files[name], shown_path(root, name), plan.encodings)
            for role, name in names.items()
        }
        for role, fault in wrong_sizes(values, plan.size):
            raise ReadError(shown_path(root, names[role]), fault)
        return assemble_frame(plan.key(split, pair), values, plan.encodings)

    def pair(self, number: int) -> tuple[SplitName, int]:
        """Return the split of a pair, and the pair's number in the split.

        Raises IndexError if the dataset has fewer pairs, and InputError if the number is not a whole number.
        """
        position = to_whole("the number of a pair", number)
        position += len(self) if position < 0 else 0
        for split, count in self._counts.items():
            if 0 <= position < count:
                return split, position
            position -= count
        raise IndexError(f"{self.index.address}: expected one of {counted(len(self), 'pair')}, got number {number}")

    def _record(self, shard: Shard) -> ShardRecord:
        if shard not in self._records:
            if len(self._records) >= _MOST_RECORDS:
                self._records.clear()
            self._records[shard] = read_record(self.index.root, shard, packed=True)
        return self._records[shard]


def open_dataset(address: str | PathLike[str], split: SplitName | None = None) -> Dataset:
    """Open a finished dataset, or one of its splits, in any layout; ``open_dataset(path)[i]`` is a `StoredFrame`.

    ``address`` is the dataset's folder, or an address that fsspec knows.

    Raises:
        InputError: where the address has no dataset, or the dataset is not finished.
        ReadError: where the dataset's index is damaged.
    """
    return Dataset(read_index(address), split)


def read_record(root: UPath, shard: Shard, *, packed: bool) -> ShardRecord:
    """Read the record of a shard; raises ReadError where it is missing, or does not describe the shard."""
    path = shown_path(root, shard.record)
    record = parse(ShardRecord, read_whole(root, shard.record), path)
    if not record.describes(shard) or [each.pair for each in record.samples] != list(range(shard.first, shard.end)):
        raise ReadError(path, f"expected {shard.name} with the pairs {shard.first} to {shard.end - 1}")
    files = (file for sample in record.samples for file in sample.files.values())
    if packed and (record.tar != shard.tar or any(file.offset is None for file in files)):
        raise ReadError(path, f"expected tar {shard.tar}, and the offset of each file in it")
    return record


def read_members(root: UPath, shard: Shard, record: ShardRecord, pair: int, names: Sequence[str]) -> dict[str, bytes]:
    """Read files of a pair from its shard's tar, with one request, and return their bytes by name inside the tar.

    Raises ReadError where the shard's record lacks a file, or the tar ends too early.
    """
    listed = record.samples[pair - shard.first].files
    for name in names:
        if name not in listed:
            raise ReadError(shown_path(root, shard.record), f"has no entry for {name}")
    spans = {name: (cast("int", listed[name].offset), listed[name].bytes) for name in names}
    begin = min(offset for offset, _ in spans.values())
    end = max(offset + size for offset, size in spans.values())
    data = read_part(root, shard.tar, begin, end - begin)
    if len(data) < end - begin:
        raise ReadError(shown_path(root, shard.tar), f"is cut off: its record lists files up to byte {end}")
    return {name: data[offset - begin : offset - begin + size] for name, (offset, size) in spans.items()}
