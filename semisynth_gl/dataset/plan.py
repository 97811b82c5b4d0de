"""What a dataset shall be: which pairs, in which shards, under which names. Everything follows from it but pixels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from math import ceil
from typing import Any

from semisynth_gl.config import Config
from semisynth_gl.encodings import FlowEncoding
from semisynth_gl.errors import InputError
from semisynth_gl.layouts import Key, Layout, find_layout
from semisynth_gl.layouts.layout import sequence_length
from semisynth_gl.splits import SPLITS, Split, SplitName

PROGRAM = "semisynth-gl"

# About 1 GB is the habit for shards; a small dataset is cut finer so that workers can share it.
_SHARD_BYTES = 1_000_000_000
_FEWEST_SHARDS = 8
# Of photographs as PNG, measured over the packaged configs; a byte more or less only moves a shard's size.
_IMAGE_BYTES_PER_PIXEL = 1.8
_MASK_BYTES_PER_PIXEL = 0.05
_FLOAT_BYTES = 4
_FLOW_BYTES_PER_PIXEL: Mapping[FlowEncoding, float] = {"flo": 8, "pfm": 12, "png16": 4}
_KEYS_SHOWN = 8


@dataclass(frozen=True, slots=True)
class Shard:
    """A fixed range of a split's pairs, on disk whole or not at all.

    Attributes:
        number: its number among all shards of the dataset, which tasks and ``--shards`` count.
        name: of its files, without ending.
        split: whose pairs it holds.
        first: number of its first pair.
        end: number of the pair after its last one.
    """

    number: int
    name: str
    split: SplitName
    first: int
    end: int


@dataclass(frozen=True, slots=True)
class Plan:
    """What a dataset shall be.

    Attributes:
        config: the configuration.
        seed: 0 or more.
        layout_name: see `semisynth_gl.layouts`.
        pairs: how many of each split; splits without pairs are left out.
        shard_pairs: how many are in a shard; the last one of a split may have fewer.
    """

    config: Config
    seed: int
    layout_name: str
    pairs: Mapping[SplitName, int]
    shard_pairs: int

    @property
    def layout(self) -> Layout:
        """The layout."""
        return find_layout(self.layout_name)

    @property
    def splits(self) -> tuple[SplitName, ...]:
        """The splits that the dataset has."""
        return tuple(name for name in SPLITS if self.pairs.get(name))

    def split(self, name: SplitName) -> Split:
        """Return a split, with what is held out for it."""
        return self.config.splits.split(name, self.splits)

    def folder(self, split: SplitName) -> str:
        """Return the folder of a split's files below the dataset's, "" or ending in a slash."""
        folder = self.layout.folder(split, self.splits)
        return f"{folder}/" if folder else ""

    def key(self, split: SplitName, index: int) -> Key:
        """Return what the names of a pair's files depend on."""
        length = sequence_length(self.config.outputs, self.config.sequence.length)
        return Key(self.config.name, split, index, length)

    def keys(self, split: SplitName) -> list[Key]:
        """Return the keys of all pairs of a split."""
        return [self.key(split, index) for index in range(self.pairs.get(split, 0))]

    @property
    def shards(self) -> list[Shard]:
        """All shards, by number: those of train first."""
        ranges = [
            (split, number, first)
            for split in self.splits
            for number, first in enumerate(range(0, self.pairs[split], self.shard_pairs))
        ]
        return [
            Shard(
                at,
                f"{PROGRAM.removesuffix('-gl')}-{self.config.name}-{split}-{number:06d}",
                split,
                first,
                min(first + self.shard_pairs, self.pairs[split]),
            )
            for at, (split, number, first) in enumerate(ranges)
        ]

    def values(self) -> dict[str, Any]:
        """Return what the plan says, in JSON's types."""
        return {
            "program": PROGRAM,
            "version": version(PROGRAM),
            "config": self.config.name,
            "config_sha256": self.config.digest(),
            "config_values": self.config.model_dump(mode="json"),
            "seed": self.seed,
            "layout": self.layout_name,
            "pairs": dict(self.pairs),
            "shard_pairs": self.shard_pairs,
        }


def make_plan(
    config: Config, seed: int, layout_name: str, pairs: Mapping[SplitName, int], shard_pairs: int | None = None
) -> Plan:
    """Make a plan.

    Args:
        config: the configuration; outputs that the layout needs are added.
        seed: 0 or more.
        layout_name: see `semisynth_gl.layouts`.
        pairs: how many of each split.
        shard_pairs: how many in a shard; by default as many as give about 1 GB, and fewer in small datasets.

    Raises:
        InputError: where there is no such layout, or the numbers or the config's encodings do not go with it.
    """
    layout = find_layout(layout_name)
    if seed < 0:
        raise InputError(f"a seed must be 0 or more, got {seed}")
    wanted = {name: pairs[name] for name in SPLITS if pairs.get(name)}
    if not wanted or min(wanted.values()) < 1:
        raise InputError(f"expected at least one pair, got {dict(pairs)}")
    if shard_pairs is not None and shard_pairs < 1:
        raise InputError(f"a shard holds at least one pair, got --shard-pairs {shard_pairs}")
    files = type(config.files)()
    if layout.encodings is not None and config.files != files:
        raise InputError(
            f"the layout {layout_name} has encodings of its own ({layout.encodings.image}, "
            f"{layout.encodings.disparity}, {layout.encodings.flow}): leave files.image, files.disparity and "
            "files.flow out of the config"
        )
    length = sequence_length(config.outputs, config.sequence.length)
    if length is not None and layout.most_frames is not None and length > layout.most_frames:
        raise InputError(
            f"the layout {layout_name} has names for {layout.most_frames} frames of a sequence with flow, got "
            f"sequence.length {length}: set it to {layout.most_frames} or less, or choose another with --layout"
        )
    layout.chosen_encodings(config).check()
    lacking = [output for output in sorted(layout.needs) if output not in config.outputs]
    if lacking:
        config = config.model_copy(update={"outputs": (*config.outputs, *lacking)})
    if shard_pairs is None:
        shard_pairs = _shard_pairs(config, layout, max(wanted.values()))
    return Plan(config, seed, layout_name, wanted, shard_pairs)


def _shard_pairs(config: Config, layout: Layout, pairs: int) -> int:
    views = 2 if config.truth == "both" else 1
    encodings = layout.chosen_encodings(config)
    disparity = _FLOAT_BYTES if encodings.disparity == "pfm" else _FLOAT_BYTES / 2
    flow = _FLOW_BYTES_PER_PIXEL[encodings.flow] + _MASK_BYTES_PER_PIXEL
    per_pixel = 2 * _IMAGE_BYTES_PER_PIXEL + views * (
        disparity
        + _MASK_BYTES_PER_PIXEL * ("visibility" in config.outputs)
        + _MASK_BYTES_PER_PIXEL * ("instances" in config.outputs)
        + _FLOAT_BYTES * ("depth" in config.outputs)
        + flow * ("flow" in config.outputs)
        + flow * ("flow_backward" in config.outputs)
        + _FLOAT_BYTES * ("disparity_change" in config.outputs)
    )
    size = per_pixel * config.camera.width_px * config.camera.height_px
    wanted = max(1, min(round(_SHARD_BYTES / size), ceil(pairs / _FEWEST_SHARDS)))
    # A sequence that lies in two shards is set up twice.
    length = config.sequence.length
    return ceil(wanted / length) * length


def differences(there: Mapping[str, Any], wanted: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Name the values that differ between two mappings in JSON's types, by dotted key, with both values."""
    found: list[str] = []
    for key in dict.fromkeys((*there, *wanted)):
        one, other = there.get(key, _ABSENT), wanted.get(key, _ABSENT)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            found += differences(one, other, f"{prefix}{key}.")
        elif one != other:
            found.append(f"{prefix}{key} ({_shown(one)} there, {_shown(other)} now)")
    return found


def few(names: Sequence[str]) -> str:
    """Write a list, of many the first ones."""
    more = f" and {len(names) - _KEYS_SHOWN} more" if len(names) > _KEYS_SHOWN else ""
    return ", ".join(names[:_KEYS_SHOWN]) + more


_ABSENT = object()


def _shown(value: object) -> str:
    text = "nothing" if value is _ABSENT else repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
