"""A dataset as a sequence of pairs, whose arrays have the same names in every layout."""

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, cast, overload

from pydantic import ValidationError

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.config.dataset_sections import ImperfectionsSection
from semisynth_gl.dataset.contents import Contents, Shard
from semisynth_gl.dataset.documents import (
    CHANGED_INDEX,
    IndexDocument,
    PlanDocument,
    RecordDocument,
    parse_beginning,
    parse_record,
)
from semisynth_gl.dataset.places import Place, open_place
from semisynth_gl.dataset.sample import StoredFrame, assemble_frame, camera_size, decode_file, wrong_sizes
from semisynth_gl.dataset.schema import INDEX, PLAN, PROGRAM, record_path, tar_path
from semisynth_gl.dataset.stored_config import StoredConfig
from semisynth_gl.dataset.tar import HEADER, header_fault
from semisynth_gl.inputs.arguments import check_type, to_whole
from semisynth_gl.inputs.errors import InputError, ReadError, shown
from semisynth_gl.seeds.splits import SplitName

_MISSING = "is missing"


@dataclass(frozen=True, slots=True)
class Index(Contents):
    """The index of a dataset, or the plan of an unfinished one.

    Attributes:
        place: the dataset's root.
        document: the content of index.json, or of plan.json where the index cannot be used.
        fault: the reason why index.json cannot be used, with advice; None where it can be used.
    """

    config: StoredConfig
    place: Place
    document: PlanDocument
    fault: str | None = None

    @property
    def made(self) -> IndexDocument | None:
        """The content of index.json; None for an unfinished dataset."""
        return self.document if isinstance(self.document, IndexDocument) else None

    @property
    def signed(self) -> bool:
        """Whether disparities of 0 and below are valid."""
        return self.config.disparity.signed

    @property
    def imperfect(self) -> bool:
        """Whether a lens or imperfections of a rig change the images, differently in the two views."""
        try:
            return (
                self.config.lens is not None
                or not ImperfectionsSection.model_validate(self.config.imperfections or {}).none()
            )
        except ValidationError:  # a config of another version
            return True


class DamagedIndexError(InputError):
    """A folder has an index or plan of this program, but neither can be used; ``faults`` has a reason for each file."""

    def __init__(self, address: str, faults: Sequence[str]) -> None:
        super().__init__(f"{address}: not a dataset that can be read: {'; '.join(faults)}")
        self.faults = tuple(faults)


def read_index(address: str | PathLike[str]) -> Index:
    """Read the index or the plan of a dataset, by the dataset's folder or an address that fsspec knows.

    Raises:
        InputError: where the address has no dataset of this program, or a dataset of a newer format.
        DamagedIndexError: where the address has a dataset of this program whose index and plan cannot be used: each is
            missing, cut off, or has values that no dataset has.
    """
    place = open_place(address)
    if place.local is not None and not place.local.is_dir():
        reason = "expected a folder, got a file" if place.local.exists() else "there is no such folder"
        raise InputError(f"{address}: {reason}")
    faults: list[str] = []
    advice, ours = "the dataset is not finished; run its generate command again", False
    for name in (INDEX, PLAN):
        try:
            values = _read_json(place, name)
        except ReadError as error:
            faults.append(f"{name} {error.reason}")
            ours |= name == PLAN and error.reason != _MISSING
            continue
        if values.get("program") != PROGRAM:
            raise InputError(f"{address}: {name} is not of {PROGRAM}: program is {shown(values.get('program'))}")
        ours = True
        try:
            document = parse_beginning(values, name, place.path(name))
        except ReadError as error:
            faults.append(f"{name}: {error.reason}")
            advice = CHANGED_INDEX
            continue
        return make_index(place, document, f"{faults[0]}: {advice}" if faults else None)
    if ours:
        raise DamagedIndexError(str(address), faults)
    raise InputError(f"{address}: not a dataset: {'; '.join(faults)}")


def make_index(place: Place, document: PlanDocument, fault: str | None = None) -> Index:
    """Make an `Index` from the content of a dataset's index or plan."""
    contents = document.contents
    described = document.config_values, contents.layout_name, contents.pairs, contents.shard_pairs, contents.views
    return Index(*described, place, document, fault)


class Dataset(Sequence[StoredFrame]):
    """A finished dataset, or one of its splits: ``dataset[i]`` is a pair with its truth.

    Indexing reads the files of a pair and closes them again, so threads and processes, forked or spawned, may share a
    dataset. The length and the header of each file in a tar are checked against the shard's record.

    Args:
        index: the index of the dataset.
        split: a split of the dataset; None for all pairs, in the order train, validation, test.

    Attributes:
        about: the index of the dataset.

    Raises:
        InputError: where the dataset is not finished, or lacks the split.
    """

    def __init__(self, index: Index, split: SplitName | None = None) -> None:
        if index.fault is not None:
            raise InputError(f"{index.place.address}: {index.fault}")
        if split is not None and not (isinstance(split, str) and split in index.pairs):
            raise InputError(f"{index.place.address}: expected a split of {', '.join(index.pairs)}, got {shown(split)}")
        self.about = index
        self._counts = {name: count for name, count in index.pairs.items() if split in (None, name)}
        self._shards = {(shard.split, shard.first): shard for shard in index.shards}
        self._records: dict[Shard, RecordDocument] = {}

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
            InputError: where the number is not a whole number, or a codec needs a package that is not installed.
        """
        if isinstance(number, slice):
            return [self[position] for position in range(*number.indices(len(self)))]
        index, (split, pair) = self.about, self.pair(number)
        layout, place, encodings = index.layout, index.place, index.encodings
        names = index.files(split, pair)
        if layout.packed:
            files = self._read_members(split, pair, list(names.values()))
        else:
            files = {name: read_whole(place, name) for name in names.values()}
        values = {
            role: decode_file(layout, role, files[name], place.path(name), encodings) for role, name in names.items()
        }
        size = index.config.size or camera_size(values["provenance"])
        for role, fault in wrong_sizes(values, size) if size is not None else ():
            raise ReadError(place.path(names[role]), fault)
        return assemble_frame(index.key(split, pair), values, encodings)

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
        place, shard = self.about.place, self._shards[split, pair - pair % self.about.shard_pairs]
        record = self._records.get(shard)
        if record is None:
            record = read_record(place, shard, packed=True)
            size, path = place.size(tar_path(shard.name)), place.path(tar_path(shard.name))
            if size != record.bytes:
                fault = _MISSING if size is None else f"has {size} bytes, but its record says {record.bytes}"
                raise ReadError(path, fault)
            self._records[shard] = record
        return read_members(place, shard, record, pair, names)


def open_dataset(address: str | PathLike[str], split: SplitName | None = None) -> Dataset:
    """Open a finished dataset in any layout; ``open_dataset(path)[i]`` is a `StoredFrame`.

    Args:
        address: the dataset's folder, or an address that fsspec knows.
        split: a split of the dataset; None for all pairs.

    Raises:
        InputError: where the address has no dataset, or the dataset is not finished.
    """
    check_type("address", address, str | PathLike)
    return Dataset(read_index(address), split)


def read_record(place: Place, shard: Shard, *, packed: bool) -> RecordDocument:
    """Read the record of a shard; raises ReadError where it is missing, or does not describe the shard."""
    name = record_path(shard.name)
    return parse_record(_read_json(place, name), shard, place.path(name), packed=packed)


def read_members(
    place: Place, shard: Shard, record: RecordDocument, pair: int, names: Sequence[str]
) -> dict[str, bytes]:
    """Read files of a pair from its shard's tar, with one request, and return their bytes by name.

    ``record`` is the shard's from `read_record`, ``pair`` the pair's number in its split, and ``names`` are one or more
    names inside the tar. Raises ReadError where the record lacks a file, or the tar has something else in its place.
    """
    path = place.path(tar_path(shard.name))
    listed = record.samples[pair - shard.first].files
    for name in names:
        if name not in listed:
            raise ReadError(place.path(record_path(shard.name)), f"has no entry for {name}")
    # `parse_record` refuses a packed record that lacks an offset.
    spans = {name: (cast("int", listed[name].offset), listed[name].bytes) for name in names}
    begin = min(offset for offset, _ in spans.values()) - HEADER
    end = max(offset + size for offset, size in spans.values())
    try:
        data = place.read_part(tar_path(shard.name), begin, end - begin)
    except (FileNotFoundError, NotADirectoryError):
        raise ReadError(path, _MISSING) from None
    except OSError as error:
        raise ReadError(path, f"cannot be read: {error.strerror}") from None
    contents = {}
    for name, (offset, size) in spans.items():
        at = offset - begin
        if len(data) < at + size:
            raise ReadError(path, f"ends before {name} does")
        if fault := header_fault(data[at - HEADER : at], name, size):
            raise ReadError(path, f"at byte {begin + at - HEADER}: {fault}")
        contents[name] = data[at : at + size]
    return contents


def read_whole(place: Place, name: str) -> bytes:
    """Read a file of a dataset; raises ReadError where it is missing, no plain file, or cannot be read."""
    try:
        return place.read(name)
    except (FileNotFoundError, NotADirectoryError):
        raise ReadError(place.path(name), _MISSING) from None
    except OSError as error:
        raise ReadError(place.path(name), f"cannot be read: {error.strerror}") from None


def _read_json(place: Place, name: str) -> dict[str, Any]:
    return JSON_OBJECT.decode(read_whole(place, name), place.path(name))
