"""What was drawn again, and why: read from the records of all shards."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from semisynth_gl.dataset.reader import Index, read_record
from semisynth_gl.read.error import ReadError
from semisynth_gl.splits import SplitName

PairKey = tuple[SplitName, int]


@dataclass(frozen=True, slots=True)
class Reason:
    """One kind of fault.

    Attributes:
        name: what comes before the numbers, such as ``too dark``.
        attempts: how many attempts had it; one may have several.
        example: the first of its messages.
    """

    name: str
    attempts: int
    example: str


@dataclass(frozen=True, slots=True)
class Redraws:
    """What was drawn again in a dataset, or one of its splits.

    Attributes:
        pairs: how many pairs the records tell of.
        attempts: how many attempts failed in all.
        of_pair: what was wrong with each failed attempt of a pair; pairs without one are not listed. Of a sequence,
            its first frame.
        reasons: all kinds of faults, the most frequent first.
        unread: records that could not be read, and why.
    """

    pairs: int
    attempts: int
    of_pair: Mapping[PairKey, tuple[str, ...]]
    reasons: tuple[Reason, ...]
    unread: tuple[str, ...]


def read_redraws(index: Index, split: SplitName | None = None) -> Redraws:
    """Read the records of all shards, one after the other.

    Args:
        index: the dataset's.
        split: of this split alone.
    """
    of_pair: dict[PairKey, tuple[str, ...]] = {}
    examples: dict[str, str] = {}
    counts: Counter[str] = Counter()
    unread: list[str] = []
    pairs = 0
    for each, name in _shards(index):
        if split not in (None, each):
            continue
        try:
            record = read_record(index.place, name)
        except ReadError as error:
            unread.append(str(error))
            continue
        for sample in record["samples"]:
            pairs += 1
            redrawn = tuple(str(reason) for reason in sample.get("redrawn", ()))
            if redrawn:
                of_pair[each, int(sample["pair"])] = redrawn
            for reason in redrawn:
                clauses = {clause.partition(":")[0]: clause for clause in reason.split("; ")}
                counts.update(clauses.keys())
                for kind, clause in clauses.items():
                    examples.setdefault(kind, clause)
    reasons = tuple(Reason(kind, count, examples[kind]) for kind, count in counts.most_common())
    return Redraws(pairs, sum(map(len, of_pair.values())), of_pair, reasons, tuple(unread))


def _shards(index: Index) -> list[tuple[SplitName, str]]:
    """All shards that the dataset should have, with their splits."""
    each = int(index.values["shard_pairs"])
    splits = [split for split, pairs in index.pairs.items() for _ in range(0, pairs, each)]
    return list(zip(splits, index.shard_names(), strict=True))
