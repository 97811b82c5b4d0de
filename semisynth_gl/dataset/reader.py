"""A dataset as a sequence of pairs, whose arrays have the same names in every layout."""

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from typing import cast, overload

from upath import UPath

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.dataset.documents import Index, Plan, Record, Shard, parse_record, parse_values
from semisynth_gl.dataset.names import INDEX, PLAN, PROGRAM, record_path, tar_path
from semisynth_gl.dataset.root import (
    MISSING,
    clear_errors,
    is_local,
    open_root,
    path_of,
    read_part,
    read_whole,
)
from semisynth_gl.dataset.sample import StoredFrame, assemble_frame, decode_file, wrong_sizes
from semisynth_gl.dataset.tar import HEADER, header_fault
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError, ReadError, shown
from semisynth_gl.seeds.splits import SplitName

# A reader keeps this many records of tars; the records of a million pairs would fill memory.
_RECORDS_KEPT = 1000


@dataclass(frozen=True, slots=True)
class StoredIndex:
    """The index of a dataset, or the plan of an unfinished one, and the dataset's place.

    Attributes:
        address: the dataset's folder or address.
        plan: the content of index.json, or of plan.json where the index cannot be used.
        fault: the reason why index.json cannot be used, with advice; None where it can be used.
    """

    address: str
    plan: Plan
    fault: str | None = None

    @property
    def root(self) -> UPath:
        """The dataset's root. Each use makes it anew: a forked process must not use the connections of its parent."""
        return open_root(self.address)

    @property
    def made(self) -> Index | None:
        """The content of index.json; None for an unfinished dataset."""
        return self.plan if isinstance(self.plan, Index) else None

    @property
    def signed(self) -> bool:
        """Whether disparities of 0 and below are valid."""
        return self.plan.config.disparity.signed

    @property
    def imperfect(self) -> bool:
        """Whether a lens or imperfections of a rig change the images, differently in the two views."""
        return not self.plan.config.images_as_rendered


class DamagedIndexError(InputError):
    """A folder has an index or plan of this program, but neither can be used; ``faults`` has a reason for each file."""

    def __init__(self, address: str, faults: Sequence[str]) -> None:
        super().__init__(f"{address}: not a dataset that can be read: {'; '.join(faults)}")
        self.faults = tuple(faults)


def read_index(address: str | PathLike[str]) -> StoredIndex:
    """Read the index or the plan of a dataset, by the dataset's folder or an address that fsspec knows.

    Raises:
        InputError: where the address has no dataset of this program, or a dataset of a newer format.
        DamagedIndexError: where the address has a dataset of this program whose index and plan cannot be used: each is
            missing, cut off, or has values that no dataset has.
    """
    address = fspath(address)
    root = open_root(address)
    if is_local(root) and not root.is_dir():
        reason = "expected a folder, got a file" if root.exists() else "there is no such folder"
        raise InputError(f"{address}: {reason}")
    faults: dict[str, str] = {}
    for name, model in ((INDEX, Index), (PLAN, Plan)):
        path = path_of(root, name)
        try:
            with clear_errors(root):
                values = JSON_OBJECT.decode(read_whole(root, name), path)
            if values.get("program") != PROGRAM:
                raise InputError(f"{address}: {name} is not of {PROGRAM}: program is {shown(values.get('program'))}")
            plan = parse_values(model, values, path)
            if isinstance(plan, Index):
                plan.check(path)
        except ReadError as error:
            faults[name] = error.reason
            continue
        if name == INDEX:
            return StoredIndex(address, plan)
        advice = f"it was changed; without {INDEX}, the dataset's generate command goes on from {PLAN}"
        if faults[INDEX] == MISSING:
            advice = "the dataset is not finished; run its generate command again"
        return StoredIndex(address, plan, f"{INDEX}: {faults[INDEX]}: {advice}")
    texts = [f"{name}: {reason}" for name, reason in faults.items()]
    if {*faults.values()} == {MISSING}:
        raise InputError(f"{address}: not a dataset: {'; '.join(texts)}")
    raise DamagedIndexError(address, texts)


class Dataset(Sequence[StoredFrame]):
    """A finished dataset, or one of its splits: ``dataset[i]`` is a pair with its truth.

    Indexing reads the files of a pair and closes them again, so threads and processes, forked or spawned, may share a
    dataset. The header of each file in a tar is checked against the shard's record.

    Args:
        index: the index of the dataset.
        split: a split of the dataset; None for all pairs, in the order train, validation, test.

    Attributes:
        about: the index of the dataset.

    Raises:
        InputError: where the dataset is not finished, or lacks the split.
    """

    def __init__(self, index: StoredIndex, split: SplitName | None = None) -> None:
        plan = index.plan
        if index.fault is not None:
            raise InputError(f"{index.address}: {index.fault}")
        if split is not None and split not in plan.pairs:
            raise InputError(f"{index.address}: expected a split of {', '.join(plan.pairs)}, got {shown(split)}")
        self.about = index
        self._counts = {name: count for name, count in plan.pairs.items() if split in (None, name)}
        self._shards = {(shard.split, shard.first): shard for shard in plan.shards}
        self._records: dict[Shard, Record] = {}

    def __len__(self) -> int:
        return sum(self._counts.values())

    @overload
    def __getitem__(self, number: int) -> StoredFrame: ...

    @overload
    def __getitem__(self, number: slice) -> list[StoredFrame]: ...

    def __getitem__(self, number: int | slice) -> StoredFrame | list[StoredFrame]:
        """Read a pair, or the list of pairs that a slice selects.

        Raises:
            IndexError: where the dataset has fewer pairs.
            ReadError: where a file is missing, cut off, cannot be read, or has another size than the dataset's images,
                or a record does not describe its shard.
            InputError: where the number is not a whole number.
        """
        if isinstance(number, slice):
            return [self[position] for position in range(*number.indices(len(self)))]
        plan, root, (split, pair) = self.about.plan, self.about.root, self.pair(number)
        layout, names = plan.layout, plan.files(split, pair)
        if layout.packed:
            files = self._read_members(split, pair, list(names.values()))
        else:
            files = {name: read_whole(root, name) for name in names.values()}
        values = {
            role: decode_file(layout, role, files[name], path_of(root, name), plan.encodings)
            for role, name in names.items()
        }
        for role, fault in wrong_sizes(values, plan.size):
            raise ReadError(path_of(root, names[role]), fault)
        return assemble_frame(plan.key(split, pair), values, plan.encodings)

    def pair(self, number: int) -> tuple[SplitName, int]:
        """Return the split of a pair, and the pair's number in the split.

        Raises:
            IndexError: where the dataset has fewer pairs.
            InputError: where the number is not a whole number.
        """
        position = range(len(self))[to_whole("the number of a pair", number)]
        for split, count in self._counts.items():
            if position < count:
                return split, position
            position -= count
        raise IndexError(number)

    def _read_members(self, split: SplitName, pair: int, names: Sequence[str]) -> dict[str, bytes]:
        """Read a pair's files from the tar of its shard, at their offsets in the shard's record."""
        root, shard = self.about.root, self._shards[split, pair - pair % self.about.plan.shard_pairs]
        record = self._records.get(shard)
        if record is None:
            record = read_record(root, shard, packed=True)
            if len(self._records) >= _RECORDS_KEPT:
                self._records.clear()
            self._records[shard] = record
        return read_members(root, shard, record, pair, names)


def open_dataset(address: str | PathLike[str], split: SplitName | None = None) -> Dataset:
    """Open a finished dataset in any layout; ``open_dataset(path)[i]`` is a `StoredFrame`.

    Args:
        address: the dataset's folder, or an address that fsspec knows.
        split: a split of the dataset; None for all pairs.

    Raises:
        InputError: where the address has no dataset, or the dataset is not finished.
    """
    return Dataset(read_index(address), split)


def read_record(root: UPath, shard: Shard, *, packed: bool) -> Record:
    """Read the record of a shard; raises ReadError where it is missing, or does not describe the shard."""
    name = record_path(shard.name)
    return parse_record(read_whole(root, name), shard, path_of(root, name), packed=packed)


def read_members(root: UPath, shard: Shard, record: Record, pair: int, names: Sequence[str]) -> dict[str, bytes]:
    """Read files of a pair from its shard's tar, with one request, and return their bytes by name.

    ``record`` is the shard's from `read_record`, ``pair`` the pair's number in its split, and ``names`` are one or more
    names inside the tar. Raises ReadError where the record lacks a file, or the tar has something else in its place.
    """
    tar = tar_path(shard.name)
    path = path_of(root, tar)
    listed = record.samples[pair - shard.first].files
    for name in names:
        if name not in listed:
            raise ReadError(path_of(root, record_path(shard.name)), f"has no entry for {name}")
    # `parse_record` refuses the record of a tar without an offset.
    spans = {name: (cast("int", listed[name].offset), listed[name].bytes) for name in names}
    begin = min(offset for offset, _ in spans.values()) - HEADER
    end = max(offset + size for offset, size in spans.values())
    data = read_part(root, tar, begin, end - begin)
    contents = {}
    for name, (offset, size) in spans.items():
        at = offset - begin
        if len(data) < at + size:
            raise ReadError(path, f"ends before {name} does")
        if fault := header_fault(data[at - HEADER : at], name, size):
            raise ReadError(path, f"at byte {begin + at - HEADER}: {fault}")
        contents[name] = data[at : at + size]
    return contents
