"""The JSON files about a dataset: plan, records of shards, and index.

`parse` checks all values before they are used to open a path or allocate memory. It ignores unknown keys, which another
version of the program may have written, and refuses documents of a newer format.
"""

from collections.abc import Callable, Mapping
from functools import cached_property
from importlib.metadata import version
from math import ceil
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, InstanceOf, ValidationError, model_validator
from pydantic.dataclasses import dataclass

from semisynth_gl.codecs import Encodings
from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.config.errors import reason_of
from semisynth_gl.config.model import Config
from semisynth_gl.inputs.errors import InputError, ReadError, shown
from semisynth_gl.layouts import Layout, PairKey, find_layout, layout_names
from semisynth_gl.layouts.layout import sequence_length
from semisynth_gl.plugins import PluginPackage, require_plugins
from semisynth_gl.seeds.splits import SPLITS, Split, SplitName

PROGRAM = "semisynth-gl"
"""Value of the key ``program`` in index and plan."""
FORMAT = 1
"""Value of the key ``format`` in index, plan and records: the newest format that this program reads.

Increase it for a change that older versions would misread. A new key needs no increase: older versions ignore it.
"""
INDEX = "index.json"
"""The dataset's index, written last: a dataset with an index is complete."""
CARD = "README.md"
SHARDS_FOLDER = "shards"
"""Folder of the plan, and of each shard's record, log and tar."""
PLAN = f"{SHARDS_FOLDER}/plan.json"
"""The dataset's plan, written first."""
LOCK = f"{SHARDS_FOLDER}/lock"
"""The file that a run locks; the run that finishes the dataset removes it."""
MOST_PAIRS = 10**8
"""Maximum number of pairs of a split."""

_Format = Annotated[int, Field(ge=1, le=FORMAT)]
_Number = Annotated[int, Field(ge=0)]
_Bytes = Annotated[int, Field(ge=0, le=2**62, strict=True)]
_Pairs = Annotated[int, Field(ge=1, le=MOST_PAIRS)]
_Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$", strict=True)]
# Names of files may have bytes that are not UTF-8, which pydantic's strings do not allow.
_Text = InstanceOf[str]
_Value = TypeVar("_Value")


class DatasetDocument(BaseModel):
    """A JSON object about a dataset; values are not coerced."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False, serialize_by_alias=True)

    def values(self) -> dict[str, Any]:
        """Return the document's content in JSON's types."""
        return self.model_dump(mode="json")


@dataclass(frozen=True, slots=True)
class Shard:
    """A fixed range of a split's pairs, from ``first`` to ``end`` - 1.

    ``number`` is the shard's number in the whole dataset, from 0. ``name`` is the stem of the names of its record, log
    and tar.
    """

    number: int
    name: str
    split: SplitName
    first: int
    end: int

    @property
    def record(self) -> str:
        """The path of the record. It is written last, so a shard with a record is complete."""
        return f"{SHARDS_FOLDER}/{self.name}.json"

    @property
    def log(self) -> str:
        """The path of the log, which holds the elapsed time."""
        return f"{SHARDS_FOLDER}/{self.name}.log"

    @property
    def tar(self) -> str:
        """The path of the tar with the files of all pairs, in layouts that are packed."""
        return f"{SHARDS_FOLDER}/{self.name}.tar"


class DatasetPlan(DatasetDocument):
    """The plan of a dataset: config, seed, layout and numbers of pairs. Shards and names of files follow from it.

    Attributes:
        version: the version of the program that began the dataset.
        name: the config's name.
        config: the config, with the outputs that the layout needs.
        pairs: number of pairs of each split that has pairs.
        shard_pairs: number of pairs in a shard; the last shard of a split may have fewer.
        views: number of pairs that show each scene.
        plugins: the package of each plug-in that the dataset is made with, by group and name.
        sources: digests of patches and models, by name in each split.
    """

    program: Literal["semisynth-gl"]
    version: str
    format: _Format = 1
    name: Annotated[str, *Config.model_fields["name"].metadata] = Field(alias="config")
    config_sha256: _Sha256
    config: Config = Field(alias="config_values")
    seed: _Number
    layout_name: str = Field(alias="layout")
    pairs: Annotated[dict[SplitName, _Pairs], Field(min_length=1)]
    shard_pairs: _Pairs
    views: Annotated[_Pairs, Field(exclude_if=lambda views: views == 1)] = 1
    plugins: Annotated[dict[str, dict[str, PluginPackage]], Field(exclude_if=lambda plugins: not plugins)] = {}
    sources: dict[SplitName, dict[str, str]] = {}

    @property
    def layout(self) -> Layout:
        """The layout of `layout_name`."""
        return find_layout(self.layout_name)

    @cached_property
    def encodings(self) -> Encodings:
        """The codecs of the files in this layout."""
        return self.layout.encodings_for(self.config)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the images, px."""
        return self.config.camera.height_px, self.config.camera.width_px

    @property
    def splits(self) -> tuple[SplitName, ...]:
        """The splits that have pairs: train, validation, test in this order."""
        return tuple(name for name in SPLITS if self.pairs.get(name))

    def split(self, name: SplitName) -> Split:
        """Return a split, which chooses its photographs and models."""
        return self.config.splits.split(name, self.splits, self.seed)

    @cached_property
    def shards(self) -> tuple[Shard, ...]:
        """All shards of the complete dataset, by number: the shards of train first."""
        shards: list[Shard] = []
        for split in self.splits:
            for number, first in enumerate(range(0, self.pairs[split], self.shard_pairs)):
                end = min(first + self.shard_pairs, self.pairs[split])
                name = f"semisynth-{self.name}-{split}-{number:06d}"
                shards.append(Shard(len(shards), name, split, first, end))
        return tuple(shards)

    def folder(self, split: SplitName) -> str:
        """Return the folder of a split's files below the dataset's, "" or ending in a slash."""
        return self.layout.folder(split, self.splits)

    def key(self, split: SplitName, index: int) -> PairKey:
        """Return the key of a pair, which names its files."""
        return PairKey(self.name, split, index, sequence_length(self.config), self.views)

    def files(self, split: SplitName, index: int) -> dict[str, str]:
        """Return the path of each file of a pair, below the dataset's folder or inside a tar.

        The keys are the files' roles: what a file contains, such as ``disparity_left``.
        """
        config, layout = self.config, self.layout
        files = layout.files(self.key(split, index), self.encodings, config.outputs, config.truth)
        folder = "" if layout.packed else self.folder(split)
        return {role: f"{folder}{path}" for role, path in files.items()}

    @property
    def lists(self) -> dict[str, bytes]:
        """The layout's lists of the pairs of each split: bytes by path below the dataset's folder."""
        return self._in_folders(lambda keys: self.layout.lists_of(keys, self.encodings))

    @property
    def links(self) -> dict[str, str]:
        """The symbolic links: by each link's path in the dataset's folder, its target relative to the link's folder."""
        return self._in_folders(self.layout.links_of)

    def _in_folders(self, of_pairs: Callable[[list[PairKey]], Mapping[str, _Value]]) -> dict[str, _Value]:
        """Call a function with the keys of each split's pairs, and put the split's folder before the paths returned."""
        return {
            f"{self.folder(split)}{path}": value
            for split in self.splits
            for path, value in of_pairs([self.key(split, index) for index in range(self.pairs[split])]).items()
        }

    @property
    def folders(self) -> list[str]:
        """The folders below the dataset's that loaders list, even if they are empty."""
        return [f"{self.folder(split)}{path}" for split in self.splits for path in self.layout.folders]

    @property
    def top_names(self) -> set[str]:
        """The names of the files and folders directly in the dataset's folder."""
        names = {INDEX, CARD, SHARDS_FOLDER, *self.lists, *self.links, *self.folders}
        for split in self.splits if not self.layout.packed else ():
            for index in range(self.pairs[split]):
                names.update(self.files(split, index).values())
        return {name.split("/")[0] for name in names}


class _Patch(DatasetDocument):
    source: _Text
    left_px: _Number
    top_px: _Number
    side_px: _Pairs
    first_layer: _Number
    layer_count: _Pairs
    texture: float
    large: bool = False
    subject: _Text = ""


class SplitPatches(DatasetDocument):
    """The patches of a split in the index. Readers ignore the split's other sources: photographs and models."""

    patches: list[_Patch] = []


class ShardEntry(DatasetDocument):
    """A shard in the index; ``sha256`` is the digest of its tar, or else of what `sha256sum` prints for its files."""

    shard: str
    split: SplitName
    first: _Number
    end: _Number
    tar: str | None = None
    bytes: _Bytes
    sha256: _Sha256
    redraws: _Number

    def describes(self, shard: Shard) -> bool:
        """Return whether the entry is about a shard."""
        return (self.shard, self.split, self.first, self.end) == (shard.name, shard.split, shard.first, shard.end)


class DatasetIndex(DatasetPlan):
    """The index of a dataset: its plan, its sources and its shards."""

    renderers: list[str]
    split_sources: dict[SplitName, SplitPatches] = Field(alias="splits")
    shard_entries: list[ShardEntry] = Field(alias="shards")

    @model_validator(mode="after")
    def _lists_its_shards(self) -> Self:
        # Compare the counts first: with a wrong number of pairs, the list of shards might fill memory.
        count = sum(ceil(pairs / self.shard_pairs) for pairs in self.pairs.values())
        entries = self.shard_entries
        if count != len(entries) or not all(map(ShardEntry.describes, entries, self.shards)):
            raise ValueError("shards: expected the shards that follow from pairs and shard_pairs")
        return self


@dataclass(frozen=True, slots=True)
class StoredFile:
    """A file of a pair: its size, and its digest or its offset in a tar. A BaseModel would take much more memory."""

    bytes: _Bytes
    sha256: _Sha256 | None = None
    offset: _Bytes | None = None


class PairRecord(DatasetDocument):
    """What the record of a shard says about a pair. Readers ignore further keys."""

    pair: _Number
    files: Annotated[dict[str, StoredFile], Field(min_length=1)]


class ShardRecord(ShardEntry):
    """The record of a complete shard."""

    format: _Format = 1
    renderers: list[str]
    samples: list[PairRecord]

    @property
    def entry(self) -> dict[str, Any]:
        """What the index says about the shard, in JSON's types."""
        return self.model_dump(include=set(ShardEntry.model_fields), exclude_none=True)


_Document = TypeVar("_Document", bound=DatasetDocument)


def parse(model: type[_Document], data: bytes, path: Path) -> _Document:
    """Parse the bytes of a document's file; the path is for messages.

    Raises:
        InputError: where a plan or index has a newer format, or its layout is of a plug-in that is not installed.
        ReadError: where the bytes are no JSON, keys are wrong or missing, or a record has a newer format.
    """
    values = JSON_OBJECT.decode(data, path)
    found = values.get("format")
    if issubclass(model, DatasetPlan) and isinstance(found, int) and found > FORMAT:
        raise InputError(
            f"{path}: format: expected at most {FORMAT}, which {PROGRAM} {version(PROGRAM)} reads, got {found}: "
            f"{PROGRAM} {shown(values.get('version'))} wrote the dataset; install that version or a newer one"
        )
    try:
        document = model.model_validate(values, extra="ignore")
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in fault["loc"] if part != "[key]")  # pydantic's mark of a mapping's key
        got = f", got {shown(fault['input'])}" if key and fault["type"] != "missing" else ""
        raise ReadError(path, f"{key}: {reason_of(fault)}{got}".removeprefix(": ")) from None
    if isinstance(document, DatasetPlan) and document.layout_name not in layout_names():
        require_plugins(path, "layouts", document.plugins.get("layouts", {}))
        raise ReadError(path, f"layout: expected one of {', '.join(layout_names())}")
    return document
