"""The samples of a stream, and the rule by which training processes and their workers share them.

The rule decides which process gets which samples, so the processes need not communicate.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from math import lcm
from typing import NamedTuple, Self

import torch.distributed

from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError, shown
from semisynth_gl.seeds.seeds import LARGEST_NUMBER
from semisynth_gl.seeds.splits import SPLITS, SplitName


@dataclass(frozen=True, slots=True)
class Selection:
    """The samples that a stream yields, of all training processes together.

    Attributes:
        split: name of the split.
        splits: names of all splits of the dataset; photographs are held out for each of them.
        first: number of the first sample. To resume a stream, take its first number plus
            ``steps * batch_size * world_size``.
        pairs: number of samples; None for no end.
        frames: rising numbers, counted from 0, of the frames that the stream yields of each sequence; None for all.

    Raises:
        InputError: where a value cannot be used.
    """

    split: SplitName = "train"
    splits: Sequence[SplitName] = ("train",)
    first: int = 0
    pairs: int | None = None
    frames: Sequence[int] | None = None

    def __post_init__(self) -> None:
        named = all(isinstance(split, str) and split in SPLITS for split in (self.split, *self.splits))
        if not named or self.split not in self.splits:
            raise InputError(
                f"split: expected one of splits, and as splits the dataset's own among {', '.join(SPLITS)}, got "
                f"split={shown(self.split)} and splits={shown(self.splits)}"
            )
        # States are written as JSON, which needs Python's own numbers.
        first = to_whole("first", self.first, 0, LARGEST_NUMBER)
        object.__setattr__(self, "first", first)
        if self.pairs is not None:
            pairs = to_whole("pairs", self.pairs, 1, LARGEST_NUMBER)
            object.__setattr__(self, "pairs", pairs)
        if self.frames is not None:
            frames = tuple(to_whole("frames", frame, least=0) for frame in self.frames)
            object.__setattr__(self, "frames", frames)

    def frames_in(self, length: int) -> tuple[int, ...]:
        """Return the frames that the stream yields of each sequence of ``length`` frames.

        Raises:
            InputError: where ``frames`` is empty or does not rise, or a sequence is too short for it.
        """
        frames = tuple(range(length) if self.frames is None else self.frames)
        if not frames or not set(frames) <= set(range(length)) or list(frames) != sorted(set(frames)):
            raise InputError(
                f"frames: expected rising numbers from 0 to {length - 1}, since the config's sequence.length is "
                f"{length}, got {frames}"
            )
        return frames


@dataclass(frozen=True, slots=True)
class TrainingProcess:
    """One of the training processes that share a stream.

    Attributes:
        rank: number of this process, from 0.
        world_size: number of all processes.

    Raises:
        InputError: where the rank is not from 0 to world_size - 1.
    """

    rank: int = 0
    world_size: int = 1

    def __post_init__(self) -> None:
        for name in ("rank", "world_size"):
            object.__setattr__(self, name, to_whole(name, getattr(self, name)))
        if not 0 <= self.rank < self.world_size:
            raise InputError(
                f"rank: expected 0 to world_size - 1, got rank={self.rank} and world_size={self.world_size}: without a "
                "TrainingProcess, a stream asks torch.distributed for both"
            )

    @classmethod
    def current(cls) -> Self:
        """Return this process, as torch.distributed numbers it; without torch.distributed it is the only one."""
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            return cls(torch.distributed.get_rank(), torch.distributed.get_world_size())
        return cls()


class Worker(NamedTuple):
    """A worker's number in its training process, from 0, and the total in each process; (0, 1) without workers."""

    number: int = 0
    total: int = 1


@dataclass(frozen=True, slots=True)
class Dealing:
    """The rule that deals samples out: blocks of successive samples go to the workers of all processes in turn.

    Attributes:
        first: number of the first sample.
        samples: number of samples; None for no end.
        batch: samples of a batch; a block consists of complete batches.
        frames: samples that stay together, such as those of a sequence; a block does not divide them.
    """

    first: int
    samples: int | None
    batch: int
    frames: int

    @property
    def block(self) -> int:
        """Number of samples in a block; the last block may have fewer."""
        return lcm(self.batch, self.frames)

    def numbers(self, process: TrainingProcess, worker: Worker, skipped: int = 0) -> Iterator[int]:
        """Yield the numbers of a worker's samples in rising order, without the first ``skipped`` numbers."""
        # Every process gets its first block before any process gets its second.
        turn, turns = worker.number * process.world_size + process.rank, worker.total * process.world_size
        for number in count(skipped):
            block, within = divmod(number, self.block)
            offset = (block * turns + turn) * self.block + within
            if self.samples is not None and offset >= self.samples:
                return
            yield self.first + offset

    def count(self, process: TrainingProcess) -> int | None:
        """Return the number of a process's samples; None for a stream without end."""
        if self.samples is None:
            return None
        rounds, rest = divmod(self.samples, self.block * process.world_size)
        return rounds * self.block + min(max(rest - process.rank * self.block, 0), self.block)
