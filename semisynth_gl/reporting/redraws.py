"""Read from the records of all shards which pairs were drawn again, and why."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from semisynth_gl.dataset.reader import StoredIndex, read_record
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.seeds.splits import SplitName

PairKey = tuple[SplitName, int]
"""A pair's split, and its number in the split."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A kind of fault for which pairs were drawn again.

    Attributes:
        name: the kind, such as ``too dark``.
        attempts: number of failed attempts with this fault; an attempt with several faults counts for each of them.
        example: the first message of this kind.
    """

    name: str
    attempts: int
    example: str


@dataclass(frozen=True, slots=True)
class Redraws:
    """The failed attempts of a dataset, or of one of its splits.

    Attributes:
        pairs: number of pairs in the records.
        attempts: number of all failed attempts.
        messages: a message for each failed attempt, by the pair's key, for the pairs that have failed attempts; those
            of a sequence are listed under its first frame.
        faults: all kinds of faults, the most frequent first.
        unread: messages about the records that could not be read.
    """

    pairs: int
    attempts: int
    messages: Mapping[PairKey, tuple[str, ...]]
    faults: tuple[Fault, ...]
    unread: tuple[str, ...]


def read_redraws(index: StoredIndex, split: SplitName | None = None) -> Redraws:
    """Read the records of all shards, or of the shards of one split; unreadable records are listed in the result."""
    messages: dict[PairKey, tuple[str, ...]] = {}
    examples: dict[str, str] = {}
    counts: Counter[str] = Counter()
    unread: list[str] = []
    pairs = 0
    for shard in index.plan.shards:
        if split not in (None, shard.split):
            continue
        try:
            record = read_record(index.root, shard, packed=index.plan.layout.packed)
        except ReadError as error:
            unread.append(str(error))
            continue
        for sample in record.samples:
            pairs += 1
            attempts = tuple(sample.redrawn)
            if attempts:
                messages[shard.split, sample.pair] = attempts
            for message in attempts:
                clauses = {clause.partition(":")[0]: clause for clause in message.split("; ")}
                counts.update(clauses.keys())
                examples = clauses | examples
    faults = tuple(Fault(name, count, examples[name]) for name, count in counts.most_common())
    return Redraws(pairs, sum(map(len, messages.values())), messages, faults, tuple(unread))
