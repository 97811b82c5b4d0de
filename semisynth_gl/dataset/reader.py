"""A dataset as a sequence of pairs, with the same names in every layout."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from os import PathLike
from typing import Any, BinaryIO, overload

from semisynth_gl.codecs import Encodings
from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.dataset.places import Place, open_place
from semisynth_gl.dataset.plan import Shard, list_shards
from semisynth_gl.dataset.sample import StoredFrame, assemble_frame, decode_file
from semisynth_gl.dataset.schema import INDEX, PLAN, PROGRAM, record_path, shard_name, tar_path
from semisynth_gl.errors import InputError, ReadError
from semisynth_gl.frame import DEFAULT_OUTPUTS, OUTPUTS, TruthViews
from semisynth_gl.layouts import Key, Layout, find_layout, layout_names
from semisynth_gl.layouts.key import sequence_length
from semisynth_gl.splits import SPLITS, SplitName


@dataclass(frozen=True, slots=True)
class Index:
    """The index of a dataset, or the plan of an unfinished one.

    Attributes:
        place: the dataset's root.
        values: all values of index.json, or of an unfinished dataset's plan.
        fault: why index.json could not be read, or None.
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
        """The codecs of the files.

        Raises:
            InputError: where this version lacks one of the codecs.
        """
        if self.layout.encodings is not None:
            return self.layout.encodings
        default = Encodings()
        names = [self.value("files", key, getattr(default, key).name) for key in ("image", "disparity", "flow")]
        try:
            return Encodings.from_names(*names)
        except (KeyError, TypeError):
            raise InputError(
                f"{self.place.address}: expected encodings that this version knows in {INDEX}, got files.image "
                f"{names[0]!r}, files.disparity {names[1]!r} and files.flow {names[2]!r}"
            ) from None

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
        section = self.config.get("imperfections")
        neutral = {"gamma": 1.0}
        return isinstance(section, dict) and any(
            end != neutral.get(key, 0.0)
            for key, ends in section.items()
            for end in (ends if isinstance(ends, list) else [ends])
        )

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
        length = max(int(self.number("sequence", "length") or 1), 1)
        return Key(str(self.values.get("config")), split, index, sequence_length(self.outputs, length))

    def files(self, split: SplitName, index: int) -> dict[str, str]:
        """Return the path of each file of a pair by role: below the dataset's folder, or inside a tar."""
        files = self.layout.files(self.key(split, index), self.encodings, self.outputs, self.truth)
        return files if self.layout.packed else {role: f"{self.folder(split)}{path}" for role, path in files.items()}

    @property
    def shards(self) -> list[Shard]:
        """All shards of the complete dataset, by number."""
        return list_shards(self.values["config"], self.pairs, int(self.values["shard_pairs"]))


def read_index(address: str | PathLike[str]) -> Index:
    """Open a dataset, finished or not.

    Args:
        address: the dataset's folder, or an address that fsspec knows.

    Raises:
        InputError: where the address has no dataset of this program.
    """
    place = open_place(address)
    if place.local is not None and not place.local.is_dir():
        reason = "expected a folder, got a file" if place.local.exists() else "there is no such folder"
        raise InputError(f"{address}: {reason}")
    fault = None
    for name in (INDEX, PLAN):
        try:
            values = _read_json(place, name)
        except ReadError as error:
            fault = fault or f"{INDEX} {error.reason}"
            continue
        if values.get("program") != PROGRAM:
            raise InputError(f"{address}: {name} is not of {PROGRAM}: program is {values.get('program')!r}")
        if values.get("layout") not in layout_names():
            raise InputError(
                f"{address}: expected a layout of {', '.join(layout_names())} in {name}, got {values.get('layout')!r}"
            )
        return Index(place, values, fault if name == PLAN else None)
    raise InputError(f"{address}: not a dataset: {fault}, and there is no {PLAN} of an unfinished one")


class Dataset(Sequence[StoredFrame]):
    """A finished dataset, or one of its splits: ``dataset[i]`` is a pair with its truth.

    Files are read when a pair is asked for. A dataset can be sent to other processes, such as a DataLoader's workers.

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
            raise InputError(
                f"{index.place.address}: {index.fault}: the dataset is not finished; run its generate command again"
            )
        if split is not None and split not in index.pairs:
            raise InputError(f"{index.place.address}: expected a split of {', '.join(index.pairs)}, got {split!r}")
        self.about = index
        self._pairs = [
            (name, number) for name, count in index.pairs.items() if split in (None, name) for number in range(count)
        ]
        self._records: dict[str, Mapping[str, Any]] = {}
        self._tars: dict[str, BinaryIO] = {}

    def __getstate__(self) -> dict[str, Any]:
        # Open files do not travel to other processes.
        return self.__dict__ | {"_tars": {}}

    def __len__(self) -> int:
        return len(self._pairs)

    @overload
    def __getitem__(self, number: int) -> StoredFrame: ...

    @overload
    def __getitem__(self, number: slice) -> list[StoredFrame]: ...

    def __getitem__(self, number: int | slice) -> StoredFrame | list[StoredFrame]:
        """Read a pair.

        Raises:
            IndexError: where the dataset has fewer pairs.
            ReadError: where a file is missing or cannot be read.
            InputError: where a codec needs a package that is not installed.
        """
        if isinstance(number, slice):
            return [self[position] for position in range(*number.indices(len(self)))]
        index, (split, pair) = self.about, self._pairs[number]
        layout, place, encodings = index.layout, index.place, index.encodings
        values = {}
        for role, path in index.files(split, pair).items():
            data = self._read_member(split, pair, path) if layout.packed else _read(place, path)
            values[role] = decode_file(layout, role, data, place.path(path), encodings)
        return assemble_frame(index.key(split, pair), values, encodings)

    def pair(self, number: int) -> tuple[SplitName, int]:
        """Return the split of a pair, and the pair's number in the split."""
        return self._pairs[number]

    def _read_member(self, split: SplitName, pair: int, name: str) -> bytes:
        """Read a file from the tar of its shard, at the offset in the shard's record."""
        shard_pairs = int(self.about.values["shard_pairs"])
        shard = shard_name(self.about.values["config"], split, pair // shard_pairs)
        place, tar_file = self.about.place, tar_path(shard)
        if shard not in self._records:
            self._records[shard] = read_record(place, shard)
        if shard not in self._tars:
            try:
                self._tars[shard] = place.open(tar_file)
            except FileNotFoundError:
                raise ReadError(place.path(tar_file), "is missing") from None
        try:
            file = self._records[shard]["samples"][pair % shard_pairs]["files"][name]
        except (KeyError, IndexError, TypeError):
            raise ReadError(place.path(record_path(shard)), f"has no entry of {name}") from None
        tar = self._tars[shard]
        tar.seek(file["offset"])
        data = tar.read(file["bytes"])
        if len(data) < file["bytes"]:
            raise ReadError(place.path(tar_file), f"ends before {name} does")
        return data

    def close(self) -> None:
        """Close the open tars."""
        for tar in self._tars.values():
            with suppress(OSError):
                tar.close()
        self._tars = {}


def open_dataset(address: str | PathLike[str], split: SplitName | None = None) -> Dataset:
    """Open a finished dataset in any layout; ``open_dataset(path)[i]`` is a `StoredFrame`.

    Args:
        address: the dataset's folder, or an address that fsspec knows.
        split: a split of the dataset; None for all pairs.

    Raises:
        InputError: where the address has no dataset, or the dataset is not finished.
    """
    return Dataset(read_index(address), split)


def read_record(place: Place, shard: str) -> dict[str, Any]:
    """Read the record of a shard.

    Raises:
        ReadError: where the record is missing, cut off, or no record.
    """
    name = record_path(shard)
    record = _read_json(place, name)
    samples = record.get("samples")
    if not (isinstance(samples, list) and all(isinstance(sample, dict) and "files" in sample for sample in samples)):
        raise ReadError(place.path(name), "lists no samples")
    return record


def _read(place: Place, name: str) -> bytes:
    try:
        return place.read(name)
    except (FileNotFoundError, NotADirectoryError):
        raise ReadError(place.path(name), "is missing") from None
    except OSError as error:
        raise ReadError(place.path(name), f"cannot be read: {error.strerror}") from None


def _read_json(place: Place, name: str) -> dict[str, Any]:
    return JSON_OBJECT.decode(_read(place, name), place.path(name))
