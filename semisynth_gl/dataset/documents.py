"""The JSON files about a dataset, typed: index, plan, and the records and journals of shards.

What a file says is checked here, before anything is opened or allocated by it. Keys that this version does not know are
left alone: another version may have written them. A document of a newer format than this program's is refused.
"""

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    InstanceOf,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from pydantic_core import PydanticKnownError

from semisynth_gl.codecs import DISPARITY_CODECS, FLOW_CODECS, IMAGE_CODECS
from semisynth_gl.config.fields import Finite, count, one_of, reason_of
from semisynth_gl.config.model import Config
from semisynth_gl.dataset.plan import Shard, list_shards
from semisynth_gl.dataset.schema import FORMAT, INDEX, PLAN, PROGRAM, tar_path
from semisynth_gl.dataset.tar import content_offsets
from semisynth_gl.frame.frame import Colour, TruthViews
from semisynth_gl.inputs.errors import InputError, ReadError, abbreviate, counted, shown
from semisynth_gl.layouts import layout_names
from semisynth_gl.plugins import MissingPluginError, require_plugins
from semisynth_gl.seeds.splits import SplitName

CHANGED_INDEX = f"somebody changed it; without {INDEX}, the dataset's generate command goes on from {PLAN}"
"""What to do where an index has values that no dataset has."""

# Larger than any dataset, and small enough to count with.
_MOST_PAIRS = 10**8
_MOST_BYTES = 2**62
_SHOWN = 3


class NewerFormatError(InputError):
    """A dataset has a newer format than this program reads."""


def _check_below(name: str) -> str:
    path = PurePosixPath(name)
    if not path.parts or path.is_absolute() or ".." in path.parts or str(path) != name or not name.isprintable():
        raise ValueError("expected a path below the dataset's folder")
    return name


_Format = Annotated[int, Field(ge=1, le=FORMAT)]
_Number = Annotated[int, Field(ge=0)]
_Count = Annotated[int, count(_MOST_PAIRS)]
_Bytes = Annotated[int, Field(ge=0, le=_MOST_BYTES)]
_Pairs = Annotated[int, Field(ge=1, le=_MOST_PAIRS)]
_Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
_FileName = Annotated[str, AfterValidator(_check_below)]
# Names of files may have bytes that are no UTF-8, which pydantic's own strings refuse.
_Text = InstanceOf[str]
_Object = dict[str, Any]


class _Facts(BaseModel):
    """Base of all documents and of the objects in them: values are not coerced."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)


class _Camera(_Facts):
    width_px: _Count | None = None
    height_px: _Count | None = None
    colour: Colour = "rgb"


class _Disparity(_Facts):
    signed: bool = False
    max_px: Finite | None = None

    @field_validator("max_px")
    @classmethod
    def _is_positive(cls, max_px: float | None, info: ValidationInfo) -> float | None:
        if max_px is not None and max_px <= 0 and not info.data.get("signed", True):
            raise PydanticKnownError("greater_than", {"gt": 0})
        return max_px


class _Sequence(_Facts):
    length: Annotated[int, Field(ge=1, le=_MOST_PAIRS)] = 1


class _Files(_Facts):
    image: Annotated[str, one_of(IMAGE_CODECS)] | None = None
    disparity: Annotated[str, one_of(DISPARITY_CODECS)] | None = None
    flow: Annotated[str, one_of(FLOW_CODECS)] | None = None


class _Particles(_Facts):
    layers: list[_Object] | None = None
    clutter: list[_Object] | None = None


class _StoredConfig(_Facts):
    """The keys of a config without which pairs cannot be read or shown; `Config` has the others.

    Each is optional: configs of other versions may have others.
    """

    name: Annotated[str, *Config.model_fields["name"].metadata] | None = None
    outputs: list[str] | None = None
    truth: TruthViews = "both"
    camera: _Camera | None = None
    disparity: _Disparity | None = None
    sequence: _Sequence | None = None
    files: _Files | None = None
    particles: _Particles | None = None
    textures: _Object | None = None
    imperfections: _Object | None = None
    checks: _Object | None = None


class _Package(_Facts):
    """Messages have both in a command to be copied."""

    package: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100)]
    version: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+!-]*$", max_length=100)]


class PlanDocument(_Facts):
    """A dataset's plan; see `semisynth_gl.dataset.plan.Plan.values`."""

    program: Literal["semisynth-gl"]
    plugins: dict[str, dict[str, _Package]] = {}
    layout: str
    version: str
    format: _Format = 1
    config: Annotated[str, *Config.model_fields["name"].metadata]
    config_sha256: _Sha256
    config_values: _StoredConfig
    seed: _Number
    pairs: Annotated[dict[SplitName, _Pairs], Field(min_length=1)]
    shard_pairs: _Pairs
    views: _Pairs = 1
    sources: dict[SplitName, dict[str, str]] = {}

    @field_validator("layout")
    @classmethod
    def _is_known(cls, name: str, info: ValidationInfo) -> str:
        package = info.data.get("plugins", {}).get("layouts", {}).get(name)
        if package is not None:
            require_plugins({"layouts": {name: package.model_dump()}})
        if name not in layout_names():
            raise ValueError(f"expected one of {', '.join(layout_names())}")
        return name


class _Source(_Facts):
    name: _Text
    sha256: _Sha256 | None = None
    licence: _Text


class _Patch(_Facts):
    source: _Text
    left_px: _Number
    top_px: _Number
    side_px: _Count
    first_layer: _Number
    layer_count: _Count
    texture: float
    large: bool = False
    contrast: float = 1.0
    subject: _Text = ""
    sha256: _Sha256 | None = None


class _SplitSources(_Facts):
    pairs: _Pairs | None = None
    photographs: list[_Source] = []
    patches: list[_Patch] = []
    models: list[_Source] = []
    left_out: list[_Text] = []


class _ShardEntry(_Facts):
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
    splits: dict[SplitName, _SplitSources]
    shards: list[_ShardEntry]


class _File(_Facts):
    bytes: _Bytes
    sha256: _Sha256 | None = None
    offset: _Bytes | None = None


class _Sample(_Facts):
    pair: _Number
    files: Annotated[dict[_FileName, _File], Field(min_length=1)]
    redrawn: list[str] = []
    share_beyond: float = 0.0


class JournalEntry(_Sample):
    """A line of a shard's journal; see `semisynth_gl.dataset.shard`."""

    redrawn: list[str]
    share_beyond: float
    renderer: str
    seconds: float
    end: _Bytes = 0
    crc32: _Number = 0


class RecordDocument(_ShardEntry):
    """The record of a shard; see `semisynth_gl.dataset.shard`."""

    format: _Format = 1
    renderers: list[str]
    samples: list[_Sample]


def check_document(values: Mapping[str, Any], model: type[_Facts], path: Path) -> None:
    """Check the values of a document.

    Args:
        values: in JSON's types.
        model: the kind of document.
        path: the document's file, for messages.

    Raises:
        ReadError: with the keys that are wrong or missing, what was expected, and what came.
        MissingPluginError: where the layout is a plug-in's that is not installed.
    """
    try:
        model.model_validate(values)
    except MissingPluginError as error:
        raise MissingPluginError(f"{path}: {error}") from None
    except ValidationError as error:
        faults = []
        for fault in error.errors(include_url=False):
            key = ".".join(str(part) for part in fault["loc"] if part != "[key]")
            came = "" if fault["type"] == "missing" else f", got {shown(fault['input'])}"
            faults.append(f"{key}: {reason_of(fault)}{came}")
        raise ReadError(path, abbreviate(faults, _SHOWN)) from None


def check_plan(values: Mapping[str, Any], path: Path) -> None:
    """Check a plan.

    Raises:
        NewerFormatError: where a newer program wrote it.
        ReadError: see `check_document`.
    """
    _check_format(values, path)
    check_document(values, PlanDocument, path)


def check_index(values: Mapping[str, Any], path: Path) -> None:
    """Check an index, whose list of shards must be the one that follows from its numbers of pairs.

    Raises:
        NewerFormatError: where a newer program wrote it.
        ReadError: see `check_document`.
    """
    _check_format(values, path)
    check_document(values, IndexDocument, path)
    pairs, shard_pairs, listed = values["pairs"], values["shard_pairs"], values["shards"]
    # Counted first: a wrong number may ask for a list that no memory holds.
    count = sum(-(-number // shard_pairs) for number in pairs.values())
    if count != len(listed):
        raise ReadError(path, f"shards: expected {count} by pairs and shard_pairs, got {len(listed)}")
    for number, shard in enumerate(list_shards(values["config"], pairs, shard_pairs)):
        _check_shard(listed[number], shard, f"shards.{number}.", path)


def check_record(values: Mapping[str, Any], shard: Shard, path: Path, *, packed: bool) -> None:
    """Check the record of a shard: its pairs are the shard's, and the members of a tar stand where its record says.

    Args:
        values: in JSON's types.
        shard: the shard.
        path: the record's file, for messages.
        packed: whether the layout packs shards into tars.

    Raises:
        ReadError: see `check_document`.
    """
    check_document(values, RecordDocument, path)
    _check_shard(values, shard, "", path)
    expected, came = list(range(shard.first, shard.end)), [sample["pair"] for sample in values["samples"]]
    if came != expected:
        raise ReadError(
            path, f"samples: expected the pairs {shard.first} to {shard.end - 1}, its record lists "
            f"{counted(len(came), 'pair')} ({shown(came)})"
        )  # fmt: skip
    if not packed:
        return
    if values.get("tar") != tar_path(shard.name):
        raise ReadError(path, f"tar: expected {tar_path(shard.name)}, got {shown(values.get('tar'))}")
    files = [
        (f"samples.{number}.files.{name}", file)
        for number, sample in enumerate(values["samples"])
        for name, file in sample["files"].items()
    ]
    offsets, size = content_offsets(file["bytes"] for _, file in files)
    for (key, file), offset in zip(files, offsets, strict=True):
        if file.get("offset") != offset:
            raise ReadError(path, f"{key}.offset: expected {offset} by the sizes, got {shown(file.get('offset'))}")
    if values["bytes"] != size:
        raise ReadError(path, f"bytes: expected {size} by the sizes of the files, got {values['bytes']}")


def _check_format(values: Mapping[str, Any], path: Path) -> None:
    number = values.get("format")
    if isinstance(number, int) and number > FORMAT:
        raise NewerFormatError(
            f"{path}: format: expected at most {FORMAT}, which {PROGRAM} {version(PROGRAM)} reads, got "
            f"{shown(number)}: {PROGRAM} {shown(values.get('version'))} wrote the dataset; install that version or a "
            "newer one"
        )


def _check_shard(values: Mapping[str, Any], shard: Shard, prefix: str, path: Path) -> None:
    expected = {"shard": shard.name, "split": shard.split, "first": shard.first, "end": shard.end}
    for key, value in expected.items():
        if values[key] != value:
            raise ReadError(path, f"{prefix}{key}: expected {value!r}, got {shown(values[key])}")
