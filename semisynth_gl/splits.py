"""Train, validation and test: which seed each has, and which photographs and models are held out for it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeVar, get_args

import numpy as np

from semisynth_gl.errors import InputError
from semisynth_gl.seeds import Purpose, generator

SplitName = Literal["train", "validation", "test"]
SPLITS: tuple[SplitName, ...] = get_args(SplitName)

Each = TypeVar("Each")


@dataclass(frozen=True, slots=True)
class Split:
    """One split of a dataset.

    Attributes:
        name: which one.
        held_out: for each other split that the dataset has than ``train``, the share of the photographs that it takes.
        models: whether models are held out in the same shares.
    """

    name: SplitName = "train"
    held_out: Mapping[SplitName, float] = field(default_factory=dict)
    models: bool = False

    def seed(self, seed: int) -> int:
        """Return the seed of this split's scenes: the dataset's for ``train``, else 64 bits that follow from it."""
        if self.name == "train":
            return seed
        return int(generator(seed, Purpose.SPLIT, SPLITS.index(self.name)).integers(2**63))

    def share(
        self, items: Sequence[Each], seed: int, what: str, purpose: int, names: Sequence[str] | None = None
    ) -> list[Each]:
        """Return those of the items that this split takes, in their order; no two splits take the same one.

        Args:
            items: what is shared out; whole photographs, for example.
            seed: the dataset's, the same for all splits.
            what: what the items are, for the message.
            purpose: a number of its own for each kind of items.
            names: the items' names. Where given, each item draws its rank by its own name, so that a further item moves
                only the items next to a border between splits; without, by its position.

        Raises:
            InputError: where there are too few for each split to take one.
        """
        counts = {name: max(1, round(share * len(items))) for name, share in self.held_out.items()}
        left = len(items) - sum(counts.values())
        if left < 1:
            shares = ", ".join(f"{count} for {name}" for name, count in counts.items())
            raise InputError(
                f"{len(items)} {what} are too few to hold some out: {shares}, which leaves {max(left, 0)} for train; "
                "give more, make fewer splits, or lower the shares in the config's section splits"
            )
        if names is None:
            order = generator(seed, Purpose.SPLIT, len(SPLITS), purpose).permutation(len(items))
        else:
            ranks = [generator(seed, Purpose.SPLIT, len(SPLITS), purpose, name).random() for name in names]
            order = np.argsort(ranks)
        begin = 0
        for name in ("validation", "test"):
            count = counts.get(name, 0)
            if name == self.name:
                return [items[number] for number in np.sort(order[begin : begin + count])]
            begin += count
        return [items[number] for number in np.sort(order[begin:])]


class Shares(Protocol):
    """The config's section ``splits``."""

    @property
    def validation(self) -> float:
        """Share of the photographs that validation takes."""

    @property
    def test(self) -> float:
        """Share that test takes."""

    @property
    def models(self) -> bool:
        """Whether models are held out too."""


def split_of(shares: Shares, splits: Collection[SplitName], name: SplitName) -> Split:
    """Return a split of a dataset that has these splits."""
    held_out: dict[SplitName, float] = {"validation": shares.validation, "test": shares.test}
    return Split(name, {each: share for each, share in held_out.items() if each in splits}, shares.models)


WHOLE = Split()
"""The one split of a dataset that has no other."""
