"""What a dataset consists of: its pairs, their shards, and the names of all files of pairs."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from semisynth_gl.codecs import Encodings
from semisynth_gl.config import Config
from semisynth_gl.dataset.schema import RECORDS, shard_name
from semisynth_gl.dataset.stored_config import StoredConfig
from semisynth_gl.frame.camera import EYES
from semisynth_gl.layouts import Key, Layout, find_layout
from semisynth_gl.layouts.key import sequence_length
from semisynth_gl.seeds.splits import SPLITS, SplitName

_Value = TypeVar("_Value")


@dataclass(frozen=True, slots=True)
class Shard:
    """A fixed range of a split's pairs, from ``first`` to ``end`` - 1, with one record once all pairs are written.

    ``number`` counts the shards of the whole dataset from 0, for tasks and ``--shards``. ``name`` is the name of the
    shard's own files without their endings.
    """

    number: int
    name: str
    split: SplitName
    first: int
    end: int


@dataclass(frozen=True, slots=True)
class Contents:
    """The contents of a dataset, planned or read.

    Attributes:
        config: the config that the dataset is made with, or the part of it that readers take from an index.
        layout_name: the name of the files' layout; see `semisynth_gl.layouts`.
        pairs: number of pairs of each split; splits without pairs are left out.
        shard_pairs: number of pairs in a shard; the last shard of a split may have fewer.
        views: number of pairs that show each scene.
    """

    config: Config | StoredConfig
    layout_name: str
    pairs: Mapping[SplitName, int]
    shard_pairs: int
    views: int

    @property
    def layout(self) -> Layout:
        """The layout of `layout_name`."""
        return find_layout(self.layout_name)

    @property
    def encodings(self) -> Encodings:
        """The codecs of the files in this layout."""
        return self.layout.encodings_of(self.config.encodings, self.config.camera.colour)

    @property
    def splits(self) -> tuple[SplitName, ...]:
        """The splits that have pairs: train, validation, test in this order."""
        return tuple(name for name in SPLITS if self.pairs.get(name))

    def folder(self, split: SplitName) -> str:
        """Return the folder of a split's files below the dataset's, "" or ending in a slash."""
        return self.layout.folder(split, self.splits)

    def key(self, split: SplitName, index: int) -> Key:
        """Return the key of a pair, which names its files."""
        length = sequence_length(self.config.outputs, self.config.sequence.length)
        return Key(self.config.name, split, index, length, self.views)

    def keys(self, split: SplitName) -> list[Key]:
        """Return the keys of all pairs of a split."""
        return [self.key(split, index) for index in range(self.pairs.get(split, 0))]

    def files(self, split: SplitName, index: int) -> dict[str, str]:
        """Return the path of each file of a pair by role: below the dataset's folder, or inside a tar."""
        config, layout = self.config, self.layout
        files = layout.files(self.key(split, index), self.encodings, config.outputs, config.truth)
        folder = "" if layout.packed else self.folder(split)
        return {role: f"{folder}{path}" for role, path in files.items()}

    def lists(self, keys: Sequence[Key]) -> dict[str, bytes]:
        """Return the layout's lists about these pairs of one split: bytes by path below the dataset's folder."""
        return self._below_folder(keys[0].split, self.layout.lists(keys, self.encodings))

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the layout's links for these pairs of one split: target by path below the dataset's folder."""
        return self._below_folder(keys[0].split, self.layout.links(keys))

    @property
    def all_lists(self) -> dict[str, bytes]:
        """The layout's lists about all pairs of each split; see `lists`."""
        return {path: data for split in self.splits for path, data in self.lists(self.keys(split)).items()}

    @property
    def all_links(self) -> dict[str, str]:
        """The layout's links for all pairs of each split; see `links`."""
        return {path: target for split in self.splits for path, target in self.links(self.keys(split)).items()}

    @property
    def copies(self) -> dict[str, str]:
        """The files that an object store gets a second time, by the path of the copy; see `Layout.copied`."""
        return {
            name.replace(original, to): name
            for original, to in self.layout.copied.items()
            for split in self.splits
            for index in range(self.pairs[split])
            for name in self.files(split, index).values()
            if original in name
        }

    @property
    def folders(self) -> list[str]:
        """The folders below the dataset's that loaders list, even where they are empty."""
        return [f"{self.folder(split)}{path}" for split in self.splits for path in self.layout.folders()]

    def images_folder(self) -> str:
        """Return the deepest folder below the dataset's that holds all images, or all tars where shards are packed."""
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
    def shards(self) -> list[Shard]:
        """All shards of the complete dataset, by number: the shards of train first."""
        ranges = [
            (split, number, first, min(first + self.shard_pairs, self.pairs[split]))
            for split in self.splits
            for number, first in enumerate(range(0, self.pairs[split], self.shard_pairs))
        ]
        return [
            Shard(position, shard_name(self.config.name, split, number), split, first, end)
            for position, (split, number, first, end) in enumerate(ranges)
        ]

    def _below_folder(self, split: SplitName, by_path: Mapping[str, _Value]) -> dict[str, _Value]:
        folder = self.folder(split)
        return {f"{folder}{path}": value for path, value in by_path.items()}
