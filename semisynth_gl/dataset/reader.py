"""A dataset as a sequence of pairs, with the same names in every layout."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, overload

from semisynth_gl.dataset.places import Place, open_place
from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.encodings import DISPARITY_ENCODINGS, FLOW_ENCODINGS, IMAGE_ENCODINGS, Encodings
from semisynth_gl.errors import InputError
from semisynth_gl.frame import DEFAULT_OUTPUTS, OUTPUTS, Output, TruthOf
from semisynth_gl.layouts import Key, Layout, find_layout, layout_names
from semisynth_gl.layouts.layout import sequence_length
from semisynth_gl.read.error import ReadError
from semisynth_gl.read.json import decode_json
from semisynth_gl.splits import SPLITS, SplitName

INDEX = "index.json"
RECORDS = "shards"
PLAN = f"{RECORDS}/plan.json"
_PROGRAM = "semisynth-gl"


@dataclass(frozen=True, slots=True)
class Index:
    """What a dataset says of itself.

    Attributes:
        place: where it lies.
        values: the whole of index.json; of an unfinished dataset, what it was begun as.
        fault: why index.json could not be read, or None.
    """

    place: Place
    values: Mapping[str, Any]
    fault: str | None = None

    @property
    def layout(self) -> Layout:
        """Under which names its files stand."""
        return find_layout(self.values["layout"])

    @property
    def config(self) -> Mapping[str, Any]:
        """The config's values, as JSON has them; empty where the index has none."""
        values = self.values.get("config_values")
        return values if isinstance(values, dict) else {}

    @property
    def encodings(self) -> Encodings:
        """Of images, disparities and flow.

        Raises:
            InputError: where this version knows no such encoding.
        """
        own = self.layout.encodings
        if own is not None:
            return own
        files = self.config.get("files")
        default = Encodings()
        if not isinstance(files, dict):
            return default
        image, disparity = files.get("image", default.image), files.get("disparity", default.disparity)
        flow = files.get("flow", default.flow)
        if image not in IMAGE_ENCODINGS or disparity not in DISPARITY_ENCODINGS or flow not in FLOW_ENCODINGS:
            raise InputError(
                f"{self.place.address}: expected encodings that this version knows in {INDEX}, got files.image "
                f"{image!r}, files.disparity {disparity!r} and files.flow {flow!r}"
            )
        return Encodings(image, disparity, flow)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """What there is beside images and disparities."""
        outputs = self.config.get("outputs")
        return tuple(name for name in OUTPUTS if name in outputs) if isinstance(outputs, list) else DEFAULT_OUTPUTS

    @property
    def truth(self) -> TruthOf:
        """Of which views there is truth."""
        return "left" if self.config.get("truth") == "left" else "both"

    @property
    def pairs(self) -> dict[SplitName, int]:
        """How many pairs each split has."""
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
        """Return a number of the config, or None where it has none there."""
        keys = self.config.get(section)
        value = keys.get(key) if isinstance(keys, dict) else None
        return value if isinstance(value, int | float) else None

    def folder(self, split: SplitName) -> str:
        """Return the folder of a split's files, "" or ending in a slash."""
        folder = self.layout.folder(split, tuple(self.pairs))
        return f"{folder}/" if folder else ""

    def key(self, split: SplitName, index: int) -> Key:
        """Return what the names of a pair's files depend on."""
        length = max(int(self.number("sequence", "length") or 1), 1)
        return Key(str(self.values.get("config")), split, index, sequence_length(self.outputs, length))

    def files(self, split: SplitName, index: int) -> dict[str, str]:
        """Return the path that each file of a pair should have, by role: below the dataset's, or inside a tar."""
        layout = self.layout
        files = layout.roles(layout.files(self.key(split, index), self.encodings), self.outputs, self.truth)
        folder = "" if layout.packed else self.folder(split)
        return {role: f"{folder}{path}" for role, path in files.items()}

    def shard_names(self) -> list[str]:
        """Return the names of all shards that it should have, by number."""
        each = int(self.values["shard_pairs"])
        return [
            f"semisynth-{self.values['config']}-{split}-{number:06d}"
            for split, pairs in self.pairs.items()
            for number in range(-(-pairs // each))
        ]


def read_index(address: str | PathLike[str]) -> Index:
    """Open a dataset, finished or not.

    Args:
        address: its folder, or an address that fsspec knows.

    Raises:
        InputError: where there is no dataset of this program.
    """
    place = open_place(address)
    if place.local is not None and not place.local.is_dir():
        there = "expected a folder, got a file" if place.local.exists() else "there is no such folder"
        raise InputError(f"{address}: {there}")
    fault = None
    for name in (INDEX, PLAN):
        try:
            values = decode_json(place.read(name), Path(name))
        except (FileNotFoundError, NotADirectoryError):
            fault = fault or f"{INDEX} is missing"
            continue
        except ReadError as error:
            fault = f"{INDEX} {error.reason}"
            continue
        if values.get("program") != _PROGRAM:
            raise InputError(f"{address}: {name} is not of {_PROGRAM}: program is {values.get('program')!r}")
        if values.get("layout") not in layout_names():
            raise InputError(
                f"{address}: expected a layout of {', '.join(layout_names())} in {name}, got {values.get('layout')!r}"
            )
        return Index(place, values, fault if name == PLAN else None)
    raise InputError(f"{address}: not a dataset: {fault}, and there is no {PLAN} of an unfinished one")


class Dataset(Sequence[StoredFrame]):
    """A finished dataset, or one of its splits: ``dataset[i]`` is a pair with its truth.

    Nothing is read before it is asked for. It may be handed to other processes, such as a DataLoader's workers.

    Args:
        index: the dataset's.
        split: one of its splits; None for all pairs, those to train on first.

    Attributes:
        about: what the dataset says of itself.

    Raises:
        InputError: where the dataset is not finished, or has no such split.
    """

    def __init__(self, index: Index, split: SplitName | None = None) -> None:
        if index.fault is not None:
            raise InputError(
                f"{index.place.address}: {index.fault}: the dataset is not finished; run its generate command again"
            )
        if split is not None and split not in index.pairs:
            raise InputError(
                f"{index.place.address}: expected a split of {', '.join(index.pairs)}, got {split!r}"
            )  # fmt: skip
        self.about = index
        self._pairs = [
            (name, number) for name, count in index.pairs.items() if split in (None, name) for number in range(count)
        ]
        self._records: dict[str, Mapping[str, Any]] = {}
        self._tars: dict[str, BinaryIO] = {}

    def __getstate__(self) -> dict[str, Any]:
        # Open files do not travel to other processes.
        return {"about": self.about, "_pairs": self._pairs, "_records": self._records, "_tars": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)

    def __len__(self) -> int:
        return len(self._pairs)

    @overload
    def __getitem__(self, number: int) -> StoredFrame: ...

    @overload
    def __getitem__(self, number: slice) -> list[StoredFrame]: ...

    def __getitem__(self, number: int | slice) -> StoredFrame | list[StoredFrame]:
        """Read a pair.

        Raises:
            IndexError: where there are not so many.
            ReadError: where a file is missing or cannot be read.
            InputError: where an encoding needs what is not installed.
        """
        if isinstance(number, slice):
            return [self[each] for each in range(*number.indices(len(self)))]
        split, pair = self._pairs[number]
        values = {role: self._decoded(split, pair, role, path) for role, path in self.about.files(split, pair).items()}
        return self.about.layout.assemble(self.about.key(split, pair), values, self.about.encodings)

    def pair(self, number: int) -> tuple[SplitName, int]:
        """Return the split of a pair, and the pair's number there."""
        return self._pairs[number]

    def _decoded(self, split: SplitName, pair: int, role: str, path: str) -> Any:  # noqa: ANN401 - by role
        about = self.about
        data = self._member(split, pair, path) if about.layout.packed else _read(about.place, path)
        return about.layout.decode_file(role, data, about.place.path(path), about.encodings)

    def _member(self, split: SplitName, pair: int, name: str) -> bytes:
        """Read a file out of the tar of its shard, where the shard's record says that it begins."""
        each = int(self.about.values["shard_pairs"])
        shard = f"semisynth-{self.about.values['config']}-{split}-{pair // each:06d}"
        place = self.about.place
        if shard not in self._records:
            record = read_record(place, shard)
            self._tars[shard] = _opened(place, record["tar"])
            self._records[shard] = record
        elif shard not in self._tars:
            self._tars[shard] = _opened(place, self._records[shard]["tar"])
        try:
            file = self._records[shard]["samples"][pair % each]["files"][name]
        except (KeyError, IndexError, TypeError):
            raise ReadError(place.path(f"{RECORDS}/{shard}.json"), f"has no entry of {name}") from None
        tar = self._tars[shard]
        tar.seek(file["offset"])
        data = tar.read(file["bytes"])
        if len(data) < file["bytes"]:
            raise ReadError(place.path(f"{RECORDS}/{shard}.tar"), f"ends before {name} does")
        return data

    def close(self) -> None:
        """Close the tars that are open."""
        for tar in self._tars.values():
            with suppress(OSError):
                tar.close()
        self._tars = {}


def open_dataset(address: str | PathLike[str], split: SplitName | None = None) -> Dataset:
    """Open a finished dataset in any layout; ``open_dataset(path)[i]`` is a `StoredFrame`.

    Args:
        address: its folder, or an address that fsspec knows.
        split: one of its splits; None for all pairs.

    Raises:
        InputError: where there is none, or it is not finished.
    """
    return Dataset(read_index(address), split)


def read_record(place: Place, shard: str) -> dict[str, Any]:
    """Read the record of a shard.

    Raises:
        ReadError: where it is missing, cut off, or no record.
    """
    name = f"{RECORDS}/{shard}.json"
    record = decode_json(_read(place, name), place.path(name))
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


def _opened(place: Place, name: str) -> BinaryIO:
    try:
        return place.open(name)
    except FileNotFoundError:
        raise ReadError(place.path(name), "is missing") from None
