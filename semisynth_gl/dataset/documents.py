"""The JSON files about a dataset, typed: index, plan, and the records and journals of shards.

The values of a file are checked here, before a path is opened or memory allocated by them. Keys that this version does
not know are ignored: another version may have written them. Documents of a newer format are refused.
"""

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, Field, InstanceOf, ValidationError, ValidationInfo, field_validator
from pydantic.dataclasses import dataclass

from semisynth_gl.config.fields import count, reason_of
from semisynth_gl.config.model import Config
from semisynth_gl.dataset.contents import Contents, Shard
from semisynth_gl.dataset.schema import FORMAT, INDEX, PLAN, PROGRAM, tar_path
from semisynth_gl.dataset.stored_config import MOST_PAIRS, StoredConfig, StoredDocument, StoredObject
from semisynth_gl.dataset.tar import content_offsets
from semisynth_gl.inputs.errors import InputError, ReadError, abbreviate, counted, shown
from semisynth_gl.layouts import layout_names
from semisynth_gl.plugins import MissingPluginError, Records, require_plugins
from semisynth_gl.seeds.splits import SPLITS, SplitName
from semisynth_gl.textures.atlas import Patch

CHANGED_INDEX = f"somebody changed it; without {INDEX}, the dataset's generate command goes on from {PLAN}"
"""Advice in messages about an index with values that no dataset has."""

# Larger than any dataset, and small enough to count with.
_MOST_BYTES = 2**62
_SHOWN = 3

_Document = TypeVar("_Document", bound=StoredObject)


class NewerFormatError(InputError):
    """A dataset has a newer format than this program reads."""


def _check_below(name: str) -> str:
    path = PurePosixPath(name)
    if not path.parts or path.is_absolute() or ".." in path.parts or str(path) != name or not name.isprintable():
        raise ValueError("expected a path below the dataset's folder")
    return name


_Format = Annotated[int, Field(ge=1, le=FORMAT)]
_Number = Annotated[int, Field(ge=0)]
_Count = Annotated[int, count(MOST_PAIRS)]
_Bytes = Annotated[int, Field(ge=0, le=_MOST_BYTES, strict=True)]
_Pairs = Annotated[int, Field(ge=1, le=MOST_PAIRS)]
_Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$", strict=True)]
_FileName = Annotated[str, AfterValidator(_check_below)]
# Names of files may have bytes that are not UTF-8, which pydantic's strings refuse.
_Text = InstanceOf[str]


class _Package(StoredObject):
    """Name and version of a plug-in's package; their patterns are strict since messages put both into a command."""

    package: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100)]
    version: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+!-]*$", max_length=100)]


class PlanDocument(StoredDocument):
    """A dataset's plan; see `semisynth_gl.dataset.plan.Plan.values`."""

    program: Literal["semisynth-gl"]
    plugins: dict[str, dict[str, _Package]] = Field(default_factory=dict)
    layout: str
    version: str
    format: _Format = 1
    config: Annotated[str, *Config.model_fields["name"].metadata]
    config_sha256: _Sha256
    config_values: StoredConfig
    seed: _Number
    pairs: Annotated[dict[SplitName, _Pairs], Field(min_length=1)]
    shard_pairs: _Pairs
    views: _Pairs = 1
    sources: dict[SplitName, dict[str, str]] = Field(default_factory=dict)

    @field_validator("layout")
    @classmethod
    def _is_known(cls, name: str, info: ValidationInfo) -> str:
        package = info.data.get("plugins", {}).get("layouts", {}).get(name)
        if package is not None:
            require_plugins({"layouts": {name: package.model_dump()}})
        if name not in layout_names():
            raise ValueError(f"expected one of {', '.join(layout_names())}")
        return name

    @field_validator("config_values")
    @classmethod
    def _has_the_name(cls, config: StoredConfig, info: ValidationInfo) -> StoredConfig:
        if config.name != info.data.get("config", config.name):
            raise ValueError(f"expected a config with the name {info.data['config']!r}")
        return config

    @property
    def plugin_records(self) -> Records:
        """The packages of the plug-ins that the dataset is made with."""
        return {
            group: {name: each.model_dump() for name, each in names.items()} for group, names in self.plugins.items()
        }

    @property
    def contents(self) -> Contents:
        """The dataset's pairs, shards and files."""
        pairs = {name: self.pairs[name] for name in SPLITS if name in self.pairs}
        return Contents(self.config_values, self.layout, pairs, self.shard_pairs, self.views)


class _Source(StoredObject):
    name: _Text
    sha256: _Sha256 | None = None
    licence: _Text


class _Patch(StoredObject):
    source: _Text
    left_px: _Number
    top_px: _Number
    side_px: _Count
    first_layer: _Number
    layer_count: _Count
    texture: float
    large: bool = False
    subject: _Text = ""
    sha256: _Sha256 | None = None

    @property
    def patch(self) -> Patch:
        """The patch, without its pixels."""
        return Patch(**self.model_dump(exclude={"sha256"}))


class SplitSources(StoredObject):
    """What the index says of a split's photographs, patches and models."""

    pairs: _Pairs | None = None
    photographs: list[_Source] = Field(default_factory=list)
    patches: list[_Patch] = Field(default_factory=list)
    models: list[_Source] = Field(default_factory=list)
    left_out: list[_Text] = Field(default_factory=list)


class ShardEntry(StoredObject):
    """What the index says of a shard."""

    shard: str
    split: SplitName
    first: _Number
    end: _Number
    tar: _FileName | None = None
    bytes: _Bytes
    sha256: _Sha256
    redraws: _Number


class IndexDocument(PlanDocument):
    """A dataset's index; see `semisynth_gl.dataset.index.describe_dataset`."""

    renderers: list[str]
    redraws: _Number
    bytes: _Bytes
    splits: dict[SplitName, SplitSources]
    shards: list[ShardEntry]


@dataclass(frozen=True, slots=True)
class StoredFile:
    """A file of a pair: its size, and its digest or its offset in a tar.

    It is a dataclass, since datasets have millions of files, and models would take too much memory.
    """

    bytes: _Bytes
    sha256: _Sha256 | None = None
    offset: _Bytes | None = None


class Sample(StoredObject):
    """What the record of a shard says of a pair."""

    pair: _Number
    files: Annotated[dict[_FileName, StoredFile], Field(min_length=1)]
    redrawn: list[str] = Field(default_factory=list)
    share_beyond: float = 0.0


class JournalEntry(StoredDocument, Sample):
    """A line of a shard's journal; see `semisynth_gl.dataset.shard`."""

    redrawn: list[str]
    share_beyond: float
    renderer: str
    seconds: float
    end: _Bytes = 0
    crc32: _Number = 0


class RecordDocument(ShardEntry):
    """The record of a shard; see `semisynth_gl.dataset.shard`."""

    format: _Format = 1
    renderers: list[str]
    samples: list[Sample]

    @property
    def entry(self) -> dict[str, Any]:
        """What the index says of the shard, in JSON's types."""
        return self.model_dump(include=set(ShardEntry.model_fields), exclude_none=True)

    @property
    def sizes(self) -> dict[str, int]:
        """The size in bytes, by name, of the shard's tar or of each file of its pairs."""
        if self.tar is not None:
            return {self.tar: self.bytes}
        return {name: file.bytes for sample in self.samples for name, file in sample.files.items()}


def parse_document(values: Mapping[str, Any], model: type[_Document], path: Path) -> _Document:
    """Check the values of a document, in JSON's types, and return them typed; the path is for messages.

    Raises:
        NewerFormatError: where a newer program wrote the document.
        ReadError: where keys are wrong or missing; the message has the expected and the found values.
        MissingPluginError: where the layout is a plug-in's that is not installed.
    """
    number = values.get("format")
    if issubclass(model, PlanDocument) and isinstance(number, int) and number > FORMAT:
        raise NewerFormatError(
            f"{path}: format: expected at most {FORMAT}, which {PROGRAM} {version(PROGRAM)} reads, got "
            f"{shown(number)}: {PROGRAM} {shown(values.get('version'))} wrote the dataset; install that version or a "
            "newer one"
        )
    try:
        return model.model_validate(values)
    except MissingPluginError as error:
        raise MissingPluginError(f"{path}: {error}") from None
    except ValidationError as error:
        faults = []
        for fault in error.errors(include_url=False):
            key = ".".join(str(part) for part in fault["loc"] if part != "[key]")
            came = "" if fault["type"] == "missing" else f", got {shown(fault['input'])}"
            faults.append(f"{key}: {reason_of(fault)}{came}")
        raise ReadError(path, abbreviate(faults, _SHOWN)) from None


def parse_index(values: Mapping[str, Any], path: Path) -> IndexDocument:
    """Parse an index; raises as `parse_document` does, and ReadError where pairs and list of shards disagree."""
    index = parse_document(values, IndexDocument, path)
    # Compare the counts first: a wrong number of pairs may make a list of shards that no memory holds.
    count = sum(-(-number // index.shard_pairs) for number in index.pairs.values())
    if count != len(index.shards):
        raise ReadError(path, f"shards: expected {count} by pairs and shard_pairs, got {len(index.shards)}")
    for shard, entry in zip(index.contents.shards, index.shards, strict=True):
        _check_shard(entry, shard, f"shards.{shard.number}.", path)
    return index


def parse_beginning(values: Mapping[str, Any], name: str, path: Path) -> PlanDocument:
    """Parse the index or the plan of a dataset; ``name`` is `INDEX` or `PLAN`. Raises as `parse_index` does."""
    return parse_index(values, path) if name == INDEX else parse_document(values, PlanDocument, path)


def parse_record(values: Mapping[str, Any], shard: Shard, path: Path, *, packed: bool) -> RecordDocument:
    """Parse the record of a shard, in JSON's types; the path is for messages.

    In a packed shard, the files' offsets in the tar must agree with their sizes.

    Raises:
        ReadError: where a value is wrong, or the record lists other pairs than the shard's.
    """
    record = parse_document(values, RecordDocument, path)
    _check_shard(record, shard, "", path)
    expected, came = list(range(shard.first, shard.end)), [sample.pair for sample in record.samples]
    if came != expected:
        pairs = f"{counted(len(came), 'pair')} ({shown(came)})"
        raise ReadError(path, f"samples: expected the pairs {shard.first} to {shard.end - 1}, the record lists {pairs}")
    if not packed:
        return record
    if record.tar != tar_path(shard.name):
        raise ReadError(path, f"tar: expected {tar_path(shard.name)}, got {shown(record.tar)}")
    files = [
        (f"samples.{number}.files.{name}", file)
        for number, sample in enumerate(record.samples)
        for name, file in sample.files.items()
    ]
    offsets, size = content_offsets(file.bytes for _, file in files)
    for (key, file), offset in zip(files, offsets, strict=True):
        if file.offset != offset:
            raise ReadError(path, f"{key}.offset: expected {offset} by the sizes, got {shown(file.offset)}")
    if record.bytes != size:
        raise ReadError(path, f"bytes: expected {size} by the sizes of the files, got {record.bytes}")
    return record


def _check_shard(entry: ShardEntry, shard: Shard, prefix: str, path: Path) -> None:
    expected = {"shard": shard.name, "split": shard.split, "first": shard.first, "end": shard.end}
    for key, value in expected.items():
        if getattr(entry, key) != value:
            raise ReadError(path, f"{prefix}{key}: expected {value!r}, got {shown(getattr(entry, key))}")
