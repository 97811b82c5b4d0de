"""The splits train, validation and test: the seed of each, and which photographs and models it has."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeVar, get_args

import numpy as np

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.seeds.seeds import Purpose, generator

SplitName = Literal["train", "validation", "test"]
SPLITS: tuple[SplitName, ...] = get_args(SplitName)

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Split:
    """One split of a dataset.

    Attributes:
        dataset_seed: the dataset's seed, the same for all its splits.
        name: name of the split.
        held_out: share of the photographs' subjects that is held out for ``validation`` and for ``test``, unless the
            dataset lacks that split. Photographs of one subject show the same thing.
        models: whether models are held out too, by the same shares.
    """

    dataset_seed: int
    name: SplitName = "train"
    held_out: Mapping[SplitName, float] = field(default_factory=dict)
    models: bool = False

    @property
    def seed(self) -> int:
        """The seed of this split's scenes: for ``train`` the dataset's, else a number derived from it."""
        if self.name == "train":
            return self.dataset_seed
        return int(generator(self.dataset_seed, Purpose.SPLIT, SPLITS.index(self.name)).integers(2**63))

    def select(self, items: Sequence[Item], what: str, purpose: int, names: Sequence[str] | None = None) -> list[Item]:
        """Return the items of this split, in their order. Each item is in one split only.

        Args:
            items: the items of all splits, which are shuffled and then divided by the shares of ``held_out``.
            what: plural noun for the items in messages.
            purpose: number of the kind of items; each kind is shuffled independently.
            names: the items' names, if any. With names, a new item moves few others to another split.

        Raises:
            InputError: where a split would get no item.
        """
        counts = {name: max(1, round(share * len(items))) for name, share in self.held_out.items()}
        rest = len(items) - sum(counts.values())
        if rest < 1:
            shares = ", ".join(f"{count} for {name}" for name, count in counts.items())
            raise InputError(
                f"too few {what} to hold some out, {len(items)} in all: {shares}, which leaves none for train; give "
                "more, make fewer splits, or lower the shares in the config's section splits"
            )
        if names is None:
            order = generator(self.dataset_seed, Purpose.SPLIT, len(SPLITS), purpose).permutation(len(items))
        else:
            ranks = [generator(self.dataset_seed, Purpose.SPLIT, len(SPLITS), purpose, name).random() for name in names]
            order = np.argsort(ranks)
        validation, test = (counts.get(name, 0) for name in ("validation", "test"))
        parts = np.split(order, [validation, validation + test])
        chosen = dict(zip(("validation", "test", "train"), parts, strict=True))[self.name]
        return [items[number] for number in np.sort(chosen)]
