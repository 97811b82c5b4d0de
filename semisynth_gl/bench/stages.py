"""What each stage of a pair takes, and which of them limits how many pairs a machine can make."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from semisynth_gl.pairs.pipeline import PAIR_STAGES

STAGE_TEXTS: Mapping[str, str] = {
    "sample": "what stands where",
    "draw": "colour, disparity and surfaces of both eyes",
    "visibility": "both masks",
    "readback": "from the driver into arrays",
    "check": "cheap checks of the pair, imperfections, provenance",
    "encode": "PNG and PFM in memory",
    "write": "files into the dataset's folder",
}
_ON_THE_GPU = ("draw", "visibility", "readback")
PROCESSOR = "processor"


@dataclass(frozen=True, slots=True)
class Costs:
    """What a stage took for one pair.

    Attributes:
        seconds: from its beginning to its end.
        cpu_seconds: of all threads of the process together.
        made_bytes: that it hands on; None where that stays with the driver or is small.
    """

    seconds: float
    cpu_seconds: float
    made_bytes: int | None


@dataclass(frozen=True, slots=True)
class StageRow:
    """One stage alone: one process, one thread, the driver made to finish it before the next begins.

    Attributes:
        name: one of `PAIR_STAGES`, or "processor", all that the processor does for a pair.
        text: what it does.
        seconds: mean over the pairs.
        cpu_seconds: likewise.
        share: of the seconds of all stages.
        bytes_per_pair: mean of what it hands on.
        allows_per_second: pairs per second if a pair were this alone: on the processor, with all cores at work.
    """

    name: str
    text: str
    seconds: float
    cpu_seconds: float
    share: float
    bytes_per_pair: float | None
    allows_per_second: float


def stage_rows(pairs: Sequence[Mapping[str, Costs]], cores: int, *, software: bool) -> list[StageRow]:
    """Put the costs of pairs together.

    Args:
        pairs: of each pair its stages' costs.
        cores: how many the machine has for them.
        software: whether the processor draws.

    Returns:
        A row per stage in their order, then one for all that the processor does.
    """
    seconds = {stage: float(np.mean([pair[stage].seconds for pair in pairs])) for stage in PAIR_STAGES}
    processor = {stage: float(np.mean([pair[stage].cpu_seconds for pair in pairs])) for stage in PAIR_STAGES}
    total, total_processor = sum(seconds.values()), sum(processor.values())
    rows = []
    for stage in PAIR_STAGES:
        made = [pair[stage].made_bytes for pair in pairs]
        on_gpu = stage in _ON_THE_GPU and not software
        allows = _per_second(1, seconds[stage]) if on_gpu else _per_second(cores, processor[stage])
        rows.append(
            StageRow(
                stage, STAGE_TEXTS[stage], seconds[stage], processor[stage], seconds[stage] / total,
                float(np.mean([count for count in made if count is not None])) if None not in made else None, allows,
            )
        )  # fmt: skip
    text = "all of the above" if software else "what of all of the above is the processor's"
    whole = StageRow(
        PROCESSOR, text, total, total_processor, 1.0, None, _per_second(cores, total_processor)
    )  # fmt: skip
    return [*rows, whole]


def limit_of(
    rows: Sequence[StageRow], cores: int, reached_per_second: float, shares: Sequence[float]
) -> dict[str, Any]:
    """Say what limits, and how near to it a run came.

    A pair goes through all stages, so that no run is faster than the narrowest one allows alone, nor faster than the
    processor can do its part of all of them. Where the processor draws, the latter is always less.

    Args:
        rows: of `stage_rows`.
        cores: how many there are.
        reached_per_second: pairs per second from start to end.
        shares: of each round, pairs per second divided by what that round's stages allow.
    """
    narrowest = min((row for row in rows if row.name != PROCESSOR), key=lambda row: row.allows_per_second)
    limit = min(rows, key=lambda row: row.allows_per_second)
    return {
        "cores": cores,
        "narrowest_stage": narrowest.name,
        "narrowest_allows_per_second": narrowest.allows_per_second,
        "by": limit.name,
        "allows_per_second": limit.allows_per_second,
        "reached_per_second": reached_per_second,
        "share": float(np.median(shares)),
        "shares": [float(share) for share in shares],
    }


def _per_second(at_once: int, seconds: float) -> float:
    """What so many at once allow; a clock that shows nothing counts as a microsecond."""
    return at_once / max(seconds, 1e-6)
