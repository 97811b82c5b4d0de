"""Which samples of a stream go to which process: a rule alone, so that nobody has to ask anybody."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, takewhile
from math import lcm


@dataclass(frozen=True, slots=True)
class Consumer:
    """One of the processes that share a stream.

    Attributes:
        rank: number of its training process.
        ranks: how many of these there are.
        worker: number of the loader's worker within the rank; 0 where the loader has none.
        workers: how many of these each rank has; 1 where the loader has none.
    """

    rank: int
    ranks: int
    worker: int
    workers: int

    @property
    def turn(self) -> int:
        """When it gets its first block: all ranks have their first batch before any has its second."""
        return self.worker * self.ranks + self.rank

    @property
    def turns(self) -> int:
        """How many blocks are dealt until it is its turn again."""
        return self.ranks * self.workers


@dataclass(frozen=True, slots=True)
class Dealing:
    """Samples first, first + 1 ... in blocks, which the consumers get in turn.

    Attributes:
        first: number of the first sample.
        samples: how many there are; None for no end.
        batch: how many samples a batch has.
        whole: how many samples belong together, those of a sequence; a block holds whole batches and whole sequences.
    """

    first: int
    samples: int | None
    batch: int
    whole: int

    @property
    def block(self) -> int:
        """How many samples a block has; the last one may have fewer."""
        return lcm(self.batch, self.whole)

    def numbers(self, consumer: Consumer, skipped: int = 0) -> Iterator[int]:
        """Return the numbers of the samples that a consumer gets, growing, without the first ``skipped`` ones."""
        own = (self._offset(consumer, number) for number in count(skipped))
        return (self.first + offset for offset in takewhile(self._there, own))

    def count(self, rank: int, ranks: int) -> int | None:
        """How many samples a rank gets; None for no end."""
        if self.samples is None:
            return None
        rounds, rest = divmod(self.samples, self.block * ranks)
        return rounds * self.block + min(max(rest - rank * self.block, 0), self.block)

    def _offset(self, consumer: Consumer, number: int) -> int:
        block, within = divmod(number, self.block)
        return (block * consumer.turns + consumer.turn) * self.block + within

    def _there(self, offset: int) -> bool:
        return self.samples is None or offset < self.samples
