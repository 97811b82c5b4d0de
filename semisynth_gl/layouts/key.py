"""What the names of a pair's files depend on."""

from collections.abc import Collection
from dataclasses import dataclass

from semisynth_gl.frame.frame import FLOW_OUTPUTS
from semisynth_gl.seeds.splits import SplitName


@dataclass(frozen=True, slots=True)
class Key:
    """The identity of a pair in a dataset.

    Attributes:
        config: the config's name; letters, digits and hyphens.
        index: the pair's number in the split.
        sequence_length: how many frames make a sequence in a dataset with an output of `FLOW_OUTPUTS`, whose loaders
            take names that follow each other for successive frames; None in any other dataset, where each pair has
            another name.
        views: how many pairs show each scene, see `semisynth_gl.config.Config.views`. Loaders of sequences get one for
            each right view, of pairs that are as many apart.
    """

    config: str
    split: SplitName
    index: int
    sequence_length: int | None = None
    views: int = 1

    @property
    def sequence(self) -> int:
        """The number of the sequence that loaders see the pair in; `index` in a dataset without such an output."""
        if self.sequence_length is None:
            return self.index
        scene, view = divmod(self.index, self.views)
        return scene // self.sequence_length * self.views + view

    @property
    def frame(self) -> int:
        """The pair's number in that sequence; 0 in a dataset without such an output."""
        return 0 if self.sequence_length is None else self.index // self.views % self.sequence_length

    @property
    def name(self) -> str:
        """A name for the pair: sorted by name is sorted by index up to a million pairs."""
        return f"{self.config}-{self.index:06d}"


def sequence_length(outputs: Collection[str], length: int) -> int | None:
    """Return `Key.sequence_length` of a dataset with these outputs whose sequences have so many frames."""
    return length if FLOW_OUTPUTS.intersection(outputs) else None
