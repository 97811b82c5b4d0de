"""A dataset as a sequence of pairs, with the same names in every layout."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, overload

from pydantic import ValidationError

from semisynth_gl.codecs import Encodings
from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.config.dataset_sections import ImperfectionsSection
from semisynth_gl.dataset.documents import CHANGED_INDEX, check_index, check_plan, check_record
from semisynth_gl.dataset.places import Place, open_place
from semisynth_gl.dataset.plan import Shard, list_shards
from semisynth_gl.dataset.sample import StoredFrame, assemble_frame, camera_size, decode_file, wrong_sizes
from semisynth_gl.dataset.schema import INDEX, PLAN, PROGRAM, record_path, tar_path
from semisynth_gl.dataset.tar import HEADER, header_fault
from semisynth_gl.frame.frame import DEFAULT_OUTPUTS, OUTPUTS, TruthViews
from semisynth_gl.inputs.arguments import check_type, to_whole
from semisynth_gl.inputs.errors import InputError, ReadError, shown
from semisynth_gl.layouts import Key, Layout, find_layout
from semisynth_gl.layouts.key import sequence_length
from semisynth_gl.seeds.splits import SPLITS, SplitName

_MISSING = "is missing"
_UNFINISHED = "the dataset is not finished; run its generate command again"


@dataclass(frozen=True, slots=True)
class Index:
    """The index of a dataset, or the plan of an unfinished one.

    Attributes:
        place: the dataset's root.
        values: all values of index.json, or of an unfinished dataset's plan, as `semisynth_gl.dataset.documents` has
            checked them.
        fault: why index.json cannot be used and what to do about it, or None.
    """

    place: Place
    values: Mapping[str, Any]
    fault: str | None = None

    @property
    def layout(self) -> Layout:
        """The layout of the files."""
        return find_layout(self.values["layout"])

    @property
    def config(self) -> Mapping[str, Any]:
        """The config's values in JSON's types; empty where the index has none."""
        values = self.values.get("config_values")
        return values if isinstance(values, dict) else {}

    @property
    def encodings(self) -> Encodings:
        """The codecs of the files."""
        default = Encodings()
        keys = ("image", "disparity", "flow")
        names = (self.value("files", key) or getattr(default, key).name for key in keys)
        chosen = Encodings.from_names(*names, signed=self.signed)
        return self.layout.encodings_of(chosen, self.value("camera", "colour", "rgb"))

    @property
    def size(self) -> tuple[int, int] | None:
        """Height and width of the images, px; None where the config has no numbers there."""
        height, width = self.number("camera", "height_px"), self.number("camera", "width_px")
        return None if height is None or width is None else (int(height), int(width))

    @property
    def signed(self) -> bool:
        """Whether disparities of 0 and below are valid."""
        return self.value("disparity", "signed") is True

    @property
    def outputs(self) -> tuple[str, ...]:
        """The outputs beside images and disparities."""
        outputs = self.config.get("outputs")
        return tuple(name for name in OUTPUTS if name in outputs) if isinstance(outputs, list) else DEFAULT_OUTPUTS

    @property
    def truth(self) -> TruthViews:
        """The views that have truth."""
        return "left" if self.config.get("truth") == "left" else "both"

    @property
    def pairs(self) -> dict[SplitName, int]:
        """The number of pairs of each split."""
        pairs = self.values.get("pairs")
        return {name: int(pairs[name]) for name in SPLITS if pairs.get(name)} if isinstance(pairs, dict) else {}

    @property
    def imperfect(self) -> bool:
        """Whether the config puts imperfections of a rig on the images, differently in each view."""
        section = self.config.get("imperfections", {})
        try:
            return not ImperfectionsSection.model_validate(section).none()
        except ValidationError:  # a config of another version
            return True

    @property
    def sequence_length(self) -> int:
        """Number of frames of each sequence."""
        return max(int(self.number("sequence", "length") or 1), 1)

    @property
    def views(self) -> int:
        """Number of pairs that show each scene; see `semisynth_gl.config.Config.views`."""
        return int(self.values.get("views", 1))

    def number(self, section: str, key: str) -> float | None:
        """Return a number of the config, or None where the config has no number there."""
        value = self.value(section, key)
        return value if isinstance(value, int | float) else None

    def value(self, section: str, key: str, default: object = None) -> Any:  # noqa: ANN401 - any JSON
        """Return a value of the config in JSON's types, or the default where the config has none there."""
        keys = self.config.get(section)
        return keys.get(key, default) if isinstance(keys, dict) else default

    def folder(self, split: SplitName) -> str:
        """Return the folder of a split's files, "" or ending in a slash."""
        return self.layout.folder(split, tuple(self.pairs))

    def key(self, split: SplitName, index: int) -> Key:
        """Return the key of a pair, which names its files."""
        length = sequence_length(self.outputs, self.sequence_length)
        return Key(str(self.values.get("config")), split, index, length, self.views)

    def files(self, split: SplitName, index: int) -> dict[str, str]:
        """Return the path of each file of a pair by role: below the dataset's folder, or inside a tar."""
        files = self.layout.files(self.key(split, index), self.encodings, self.outputs, self.truth)
        if self.layout.packed:
            return files
        folder = self.folder(split)
        return {role: f"{folder}{path}" for role, path in files.items()}

    @property
    def shards(self) -> list[Shard]:
        """All shards of the complete dataset, by number."""
        return list_shards(self.values["config"], self.pairs, int(self.values["shard_pairs"]))


class DamagedIndexError(InputError):
    """A folder has an index or a plan of this program, and neither can be used.

    Args:
        address: the dataset.
        faults: what is wrong with each of the two files.

    Attributes:
        faults: as given.
    """

    def __init__(self, address: str, faults: Sequence[str]) -> None:
        super().__init__(f"{address}: not a dataset that can be read: {'; '.join(faults)}")
        self.faults = tuple(faults)


def read_index(address: str | PathLike[str]) -> Index:
    """Open a dataset, finished or not.

    Args:
        address: the dataset's folder, or an address that fsspec knows.

    Raises:
        InputError: where the address has no dataset of this program, or one of a newer format.
        DamagedIndexError: where both index and plan are cut off, or have values that no dataset has.
    """
    place = open_place(address)
    if place.local is not None and not place.local.is_dir():
        reason = "expected a folder, got a file" if place.local.exists() else "there is no such folder"
        raise InputError(f"{address}: {reason}")
    faults: list[str] = []
    advice, ours = _UNFINISHED, False
    for name, check in ((INDEX, check_index), (PLAN, check_plan)):
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
            check(values, place.path(name))
        except ReadError as error:
            faults.append(f"{name}: {error.reason}")
            advice = CHANGED_INDEX
            continue
        return Index(place, values, f"{faults[0]}: {advice}" if faults else None)
    if ours:
        raise DamagedIndexError(str(address), faults)
    raise InputError(f"{address}: not a dataset: {'; '.join(faults)}")


class Dataset(Sequence[StoredFrame]):
    """A finished dataset, or one of its splits: ``dataset[i]`` is a pair with its truth.

    Files are read when a pair is asked for, and none stays open: processes, forked or spawned, and threads may share a
    dataset. The length of each file in a tar, and its header, are checked against the shard's record.

    Args:
        index: the index of the dataset.
        split: a split of the dataset; None for all pairs, training pairs first.

    Attributes:
        about: the index of the dataset.

    Raises:
        InputError: where the dataset is not finished, or has no such split.
    """

    def __init__(self, index: Index, split: SplitName | None = None) -> None:
        if index.fault is not None:
            raise InputError(f"{index.place.address}: {index.fault}")
        if split is not None and not (isinstance(split, str) and split in index.pairs):
            raise InputError(f"{index.place.address}: expected a split of {', '.join(index.pairs)}, got {shown(split)}")
        self.about = index
        self._counts = {name: count for name, count in index.pairs.items() if split in (None, name)}
        self._shards = {(shard.split, shard.first): shard for shard in index.shards}
        self._records: dict[Shard, Mapping[str, Any]] = {}

    def __len__(self) -> int:
        return sum(self._counts.values())

    @overload
    def __getitem__(self, number: int) -> StoredFrame: ...

    @overload
    def __getitem__(self, number: slice) -> list[StoredFrame]: ...

    def __getitem__(self, number: int | slice) -> StoredFrame | list[StoredFrame]:
        """Read a pair.

        Raises:
            IndexError: where the dataset has fewer pairs.
            ReadError: where a file is missing, cut off, of another size than the dataset's images or cannot be read,
                or a shard's record is not its own.
            InputError: where the number is no whole number, or a codec needs a package that is not installed.
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
        size = index.size or camera_size(values["provenance"])
        for role, fault in wrong_sizes(values, size) if size is not None else ():
            raise ReadError(place.path(names[role]), fault)
        return assemble_frame(index.key(split, pair), values, encodings)

    def pair(self, number: int) -> tuple[SplitName, int]:
        """Return the split of a pair, and the pair's number in the split.

        Raises:
            IndexError: where the dataset has fewer pairs.
            InputError: where the number is no whole number.
        """
        position = range(len(self))[to_whole("the number of a pair", number)]
        for split, count in self._counts.items():
            if position < count:
                return split, position
            position -= count
        raise IndexError(number)

    def _read_members(self, split: SplitName, pair: int, names: Sequence[str]) -> dict[str, bytes]:
        """Read a pair's files from the tar of its shard, at their offsets in the shard's record."""
        shard_pairs = self.about.values["shard_pairs"]
        shard = self._shards[split, pair // shard_pairs * shard_pairs]
        place = self.about.place
        if shard not in self._records:
            self._records[shard] = self._open_record(shard)
        return read_members(place, shard, self._records[shard], pair, names)

    def _open_record(self, shard: Shard) -> Mapping[str, Any]:
        """Read a shard's record, and check the size of its tar."""
        place, name = self.about.place, tar_path(shard.name)
        record = read_record(place, shard, packed=True)
        size = place.size(name)
        if size is None:
            raise ReadError(place.path(name), _MISSING)
        if size != record["bytes"]:
            raise ReadError(place.path(name), f"has {size} bytes, its record says {record['bytes']}")
        return record


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


def read_record(place: Place, shard: Shard, *, packed: bool) -> dict[str, Any]:
    """Read the record of a shard.

    Args:
        place: the dataset's root.
        shard: the shard.
        packed: whether the layout packs shards into tars.

    Raises:
        ReadError: where the record is missing, cut off, or not the shard's; see `check_record`.
    """
    name = record_path(shard.name)
    record = _read_json(place, name)
    check_record(record, shard, place.path(name), packed=packed)
    return record


def read_members(
    place: Place, shard: Shard, record: Mapping[str, Any], pair: int, names: Sequence[str]
) -> dict[str, bytes]:
    """Read files of a pair from its shard's tar, at once.

    Args:
        place: the dataset's root.
        shard: the shard.
        record: the shard's record, as `read_record` returns it.
        pair: the pair's number in its split.
        names: names of the files in the tar.

    Raises:
        ReadError: where the record lacks a file, or the tar has something else where the file should be.
    """
    path = place.path(tar_path(shard.name))
    listed = record["samples"][pair - shard.first]["files"]
    for name in names:
        if name not in listed:
            raise ReadError(place.path(record_path(shard.name)), f"has no entry of {name}")
    files = {name: listed[name] for name in names}
    begin = min(file["offset"] for file in files.values()) - HEADER
    end = max(file["offset"] + file["bytes"] for file in files.values())
    try:
        data = place.read_part(tar_path(shard.name), begin, end - begin)
    except (FileNotFoundError, NotADirectoryError):
        raise ReadError(path, _MISSING) from None
    except OSError as error:
        raise ReadError(path, f"cannot be read: {error.strerror}") from None
    contents = {}
    for name, file in files.items():
        at, size = file["offset"] - begin, file["bytes"]
        if len(data) < at + size:
            raise ReadError(path, f"ends before {name} does")
        if fault := header_fault(data[at - HEADER : at], name, size):
            raise ReadError(path, f"at byte {begin + at - HEADER}: {fault}")
        contents[name] = data[at : at + size]
    return contents


def read_whole(place: Place, name: str) -> bytes:
    """Read a file of a dataset.

    Raises:
        ReadError: where it is missing, no plain file, or cannot be read.
    """
    try:
        return place.read(name)
    except (FileNotFoundError, NotADirectoryError):
        raise ReadError(place.path(name), _MISSING) from None
    except OSError as error:
        raise ReadError(place.path(name), f"cannot be read: {error.strerror}") from None


def _read_json(place: Place, name: str) -> dict[str, Any]:
    return JSON_OBJECT.decode(read_whole(place, name), place.path(name))
