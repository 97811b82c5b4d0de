"""The plan of a dataset: its pairs, their shards and their names. Everything but the pixels follows from the plan."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from math import ceil
from typing import Any

from semisynth_gl.config import Config
from semisynth_gl.dataset.schema import (
    CARD,
    CROISSANT,
    FORMAT,
    INDEX,
    PARTIAL,
    PROGRAM,
    RECORDS,
    shard_name,
)
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.frame import CHANNELS
from semisynth_gl.inputs.arguments import check_type, to_whole
from semisynth_gl.inputs.errors import InputError, counted, shown
from semisynth_gl.layouts import LAYOUTS, Key, Layout, find_layout
from semisynth_gl.layouts.key import sequence_length
from semisynth_gl.plugins import Records, plugin_records
from semisynth_gl.seeds.splits import SPLITS, Split, SplitName

# Shards usually have about 1 GB; a small dataset has smaller ones so that workers can share it.
_SHARD_BYTES = 1_000_000_000
_FEWEST_SHARDS = 8
# Each is a few files, and a line of the index.
_MOST_SHARDS = 1_000_000
_OF_EVERY_DATASET = (INDEX, CARD, CROISSANT, RECORDS, PARTIAL)


@dataclass(frozen=True, slots=True)
class Shard:
    """A fixed range of a split's pairs, on disk complete or not at all.

    Attributes:
        number: the shard's number among all shards of the dataset, which tasks and ``--shards`` count.
        name: the name of the shard's files, without their ending.
        split: the split of the pairs.
        first: number of the first pair.
        end: number of the last pair, plus 1.
    """

    number: int
    name: str
    split: SplitName
    first: int
    end: int


@dataclass(frozen=True, slots=True)
class Plan:
    """The plan of a dataset.

    Attributes:
        config: the configuration.
        seed: 0 or more.
        layout_name: see `semisynth_gl.layouts`.
        pairs: number of pairs of each split; splits without pairs are left out.
        shard_pairs: number of pairs in a shard; the last shard of a split may have fewer.
        plugins: the packages of the plug-ins that the dataset is made with.
    """

    config: Config
    seed: int
    layout_name: str
    pairs: Mapping[SplitName, int]
    shard_pairs: int
    plugins: Records = field(default_factory=dict)

    @property
    def layout(self) -> Layout:
        """The layout."""
        return find_layout(self.layout_name)

    @property
    def splits(self) -> tuple[SplitName, ...]:
        """The splits of the dataset."""
        return tuple(name for name in SPLITS if self.pairs.get(name))

    def split(self, name: SplitName) -> Split:
        """Return a split with its shares of photographs and models."""
        return self.config.splits.split(name, self.splits)

    def folder(self, split: SplitName) -> str:
        """Return the folder of a split's files below the dataset's, "" or ending in a slash."""
        return self.layout.folder(split, self.splits)

    def files(self, split: SplitName, index: int) -> dict[str, str]:
        """Return the path of each file of a pair by role: below the dataset's folder, or inside a tar."""
        config, layout = self.config, self.layout
        files = layout.files(self.key(split, index), layout.encodings_for(config), config.outputs, config.truth)
        if layout.packed:
            return files
        folder = self.folder(split)
        return {role: f"{folder}{path}" for role, path in files.items()}

    def images_folder(self) -> str:
        """Return the folder below the dataset's in which all images are: of its tars, where shards are packed."""
        if self.layout.packed:
            return RECORDS
        images = (
            self.files(split, index)[eye]
            for split in self.splits
            for index in (0, self.pairs[split] - 1)
            for eye in EYES
        )
        return os.path.commonpath([os.path.dirname(path) for path in images])  # noqa: PTH120 - of addresses too

    @property
    def kind(self) -> str:
        """What the pairs are, in a word or two."""
        return "rectified stereo" if self.config.rig.none() else "stereo"

    def key(self, split: SplitName, index: int) -> Key:
        """Return the key of a pair, which names its files."""
        length = sequence_length(self.config.outputs, self.config.sequence.length)
        return Key(self.config.name, split, index, length, self.config.views)

    def keys(self, split: SplitName) -> list[Key]:
        """Return the keys of all pairs of a split."""
        return [self.key(split, index) for index in range(self.pairs.get(split, 0))]

    @property
    def shards(self) -> list[Shard]:
        """All shards, by number."""
        return list_shards(self.config.name, self.pairs, self.shard_pairs)

    def values(self) -> dict[str, Any]:
        """Return the plan in JSON's types."""
        return {
            "program": PROGRAM,
            "version": version(PROGRAM),
            "format": FORMAT,
            "config": self.config.name,
            "config_sha256": self.config.digest(),
            "config_values": self.config.model_dump(mode="json"),
            "seed": self.seed,
            "layout": self.layout_name,
            "pairs": dict(self.pairs),
            "shard_pairs": self.shard_pairs,
            **({"views": self.config.views} if self.config.views > 1 else {}),
            **({"plugins": dict(self.plugins)} if self.plugins else {}),
        }


def list_shards(config: str, pairs: Mapping[SplitName, int], shard_pairs: int) -> list[Shard]:
    """Return all shards of a dataset by number, the shards of train first.

    Args:
        config: the config's name.
        pairs: number of pairs of each split.
        shard_pairs: number of pairs in a shard.
    """
    ranges = [
        (shard_name(config, split, number), split, first, min(first + shard_pairs, pairs[split]))
        for split in SPLITS
        for number, first in enumerate(range(0, pairs.get(split, 0), shard_pairs))
    ]
    return [Shard(number, *shard) for number, shard in enumerate(ranges)]


def make_plan(
    config: Config, seed: int, layout_name: str, pairs: Mapping[SplitName, int], shard_pairs: int | None = None
) -> Plan:
    """Make a plan.

    Args:
        config: the configuration; outputs that the layout needs are added.
        seed: 0 or more.
        layout_name: see `semisynth_gl.layouts`.
        pairs: number of pairs of each split.
        shard_pairs: number of pairs in a shard; by default for about 1 GB, and fewer in small datasets.

    Raises:
        InputError: where there is no such layout, or the numbers or the config's encodings do not go with it.
    """
    check_type("config", config, Config, "load_config(NAME_OR_PATH) reads one")
    layout = find_layout(layout_name)
    seed = to_whole("a seed", seed, least=0)
    counts = {name: pairs[name] for name in SPLITS if pairs.get(name)}
    if not counts or min(counts.values()) < 1:
        raise InputError(f"expected at least one pair, got {dict(pairs)}")
    if shard_pairs is not None:
        shard_pairs = to_whole("--shard-pairs", shard_pairs, least=1)
    if layout.encodings is not None and config.files != type(config.files)():
        raise InputError(
            f"the layout {layout_name} has encodings of its own ({layout.encodings.image.name}, "
            f"{layout.encodings.disparity.name}, {layout.encodings.flow.name}): leave files.image, files.disparity and "
            f"files.flow out of the config, or choose another with --layout: {', '.join(_free_layouts())}"
        )
    length = sequence_length(config.outputs, config.sequence.length)
    if length is not None and layout.most_frames is not None and length > layout.most_frames:
        raise InputError(
            f"the layout {layout_name} has names for {layout.most_frames} frames of a sequence with flow, got "
            f"sequence.length {length}: set it to {layout.most_frames} or less, or choose another with --layout"
        )
    if unsaid := sorted(layout.lacks.intersection(config.outputs)):
        able = ", ".join(name for name in LAYOUTS if unsaid[0] not in find_layout(name).lacks)
        raise InputError(
            f"the layout {layout_name} has no files for the output {unsaid[0]}, which its loaders do not know: leave "
            f"it out of outputs, or choose another with --layout: {able}"
        )
    encodings = layout.encodings_for(config)
    if encodings.signed and not encodings.disparity.signed:
        others = [each for each in LAYOUTS if find_layout(each).own_encodings(signed=True).disparity.signed]
        raise InputError(
            f"the layout {layout_name} stores disparities as {encodings.disparity.description}, which has no values of "
            f"0 and below, but disparity.signed makes these valid: choose another with --layout: {', '.join(others)}"
        )
    encodings.check_installed()
    if lacking := sorted(layout.needs.difference(config.outputs)):
        config = config.model_copy(update={"outputs": (*config.outputs, *lacking)})
    if shard_pairs is None:
        shard_pairs = _shard_pairs(config, layout, max(counts.values()))
    shards = sum(ceil(count / shard_pairs) for count in counts.values())
    if shards > _MOST_SHARDS:
        raise InputError(
            f"{counted(shards, 'shard')} of {counted(shard_pairs, 'pair')}: expected at most {_MOST_SHARDS}; give a "
            "larger --shard-pairs, or make several datasets"
        )
    plan = Plan(config, seed, layout_name, counts, shard_pairs, used_plugins(config, layout_name))
    _check_names(plan)
    return plan


def used_plugins(config: Config, layout_name: str) -> Records:
    """Return the packages, as they are installed here, of the plug-ins that a dataset is made with.

    Raises:
        InputError: where one is not installed.
    """
    used = [*config.used_plugins().values()]
    if layout_name not in LAYOUTS:
        used.append(("layouts", layout_name))
    return plugin_records(used)


def _free_layouts() -> list[str]:
    """Return the names of the layouts whose encodings a config chooses."""
    return [name for name in LAYOUTS if find_layout(name).encodings is None]


def _check_names(plan: Plan) -> None:
    """Raise InputError where the layout gives files of its own names that every dataset has."""
    for split in plan.splits:
        keys, folder = [plan.key(split, 0)], plan.folder(split)
        lists = plan.layout.lists(keys, plan.layout.encodings_for(plan.config))
        names = [f"{folder}{path}" for path in (*lists, *plan.layout.links(keys), *plan.layout.folders())]
        for name in names if plan.layout.packed else (*names, *plan.files(split, 0).values()):
            if name.partition("/")[0] in _OF_EVERY_DATASET:
                raise InputError(
                    f"the layout {plan.layout_name} gives a file the name {name}: expected none in "
                    f"{', '.join(_OF_EVERY_DATASET)}, which every dataset has"
                )


def _shard_pairs(config: Config, layout: Layout, pairs: int) -> int:
    encodings = layout.encodings_for(config)
    per_pixel = 0.0
    for channel in CHANNELS.values():
        if channel.output is None or channel.output in config.outputs:
            views = 2 if config.truth == "both" or channel.name == "image" else 1
            per_pixel += views * encodings.codec(channel.codec).pixel_bytes
    size = per_pixel * config.camera.width_px * config.camera.height_px
    number = max(1, min(round(_SHARD_BYTES / size), ceil(pairs / _FEWEST_SHARDS)))
    # A sequence in two shards would be set up twice.
    together = config.sequence_pairs
    return ceil(number / together) * together


def differences(before: Mapping[str, Any], now: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Return the dotted keys at which two mappings in JSON's types differ, each with both values."""
    texts: list[str] = []
    for key in dict.fromkeys((*before, *now)):
        old, new = before.get(key, _ABSENT), now.get(key, _ABSENT)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            texts += differences(old, new, f"{prefix}{key}.")
        elif old != new:
            texts.append(f"{prefix}{key} ({_shown(old)} there, {_shown(new)} now)")
    return texts


_ABSENT = object()


def _shown(value: object) -> str:
    return "nothing" if value is _ABSENT else shown(value, 40)
