"""The identity of a pair, after which layouts name its files."""

from collections.abc import Collection
from dataclasses import dataclass

from semisynth_gl.frame.channels import FLOW_OUTPUTS
from semisynth_gl.seeds.splits import SplitName


@dataclass(frozen=True, slots=True)
class Key:
    """The identity of a pair in a dataset.

    Attributes:
        config: the config's name; letters, digits and hyphens.
        index: the pair's number in the split, from 0.
        sequence_length: number of frames in a sequence, in a dataset with an output of `FLOW_OUTPUTS`, whose loaders
            take files with successive names for successive frames. None in any other dataset, where names only tell
            pairs apart.
        views: number of pairs that show each scene, see `semisynth_gl.config.Config.views`. Loaders then see one
            sequence for each right view, whose frames are every ``views``-th pair.
    """

    config: str
    split: SplitName
    index: int
    sequence_length: int | None = None
    views: int = 1

    @property
    def sequence(self) -> int:
        """The number of the sequence in which loaders see the pair; `index` where `sequence_length` is None."""
        if self.sequence_length is None:
            return self.index
        scene, view = divmod(self.index, self.views)
        return scene // self.sequence_length * self.views + view

    @property
    def frame(self) -> int:
        """The pair's number in its `sequence`, from 0; 0 where `sequence_length` is None."""
        return 0 if self.sequence_length is None else self.index // self.views % self.sequence_length

    @property
    def name(self) -> str:
        """A name for the pair; up to a million pairs, names sort in the order of the indices."""
        return f"{self.config}-{self.index:06d}"


def sequence_length(outputs: Collection[str], length: int) -> int | None:
    """Return `Key.sequence_length` of a dataset with these outputs, whose sequences have ``length`` frames."""
    return length if FLOW_OUTPUTS.intersection(outputs) else None
