"""Costs of the stages of a pair, and the stage that limits how many pairs a machine can make."""

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
    """Costs of one stage of one pair.

    Attributes:
        seconds: from the stage's beginning to its end.
        cpu_seconds: of all threads of the process together.
        result_bytes: size of the stage's result; None where the result stays with the driver or is small.
    """

    seconds: float
    cpu_seconds: float
    result_bytes: int | None


@dataclass(frozen=True, slots=True)
class StageRow:
    """One stage alone: one process, one thread, the driver made to finish it before the next begins.

    Attributes:
        name: one of `PAIR_STAGES`, or "processor", the processor's part of all stages.
        text: a description.
        seconds: mean over the pairs.
        cpu_seconds: mean over the pairs.
        share: part of the seconds of all stages.
        bytes_per_pair: mean size of the stage's result; None where it stays with the driver or is small.
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
    """Average the costs of pairs.

    Args:
        pairs: costs of each pair by stage.
        cores: number of cores that the machine has for them.
        software: True where the processor draws.

    Returns:
        A row of each stage in their order, then the row of the processor.
    """
    seconds = {stage: float(np.mean([pair[stage].seconds for pair in pairs])) for stage in PAIR_STAGES}
    processor = {stage: float(np.mean([pair[stage].cpu_seconds for pair in pairs])) for stage in PAIR_STAGES}
    total, total_processor = sum(seconds.values()), sum(processor.values())
    rows = []
    for stage in PAIR_STAGES:
        sizes = [pair[stage].result_bytes for pair in pairs]
        on_gpu = stage in _ON_THE_GPU and not software
        allows = _per_second(1, seconds[stage]) if on_gpu else _per_second(cores, processor[stage])
        rows.append(
            StageRow(
                stage, STAGE_TEXTS[stage], seconds[stage], processor[stage], seconds[stage] / total,
                float(np.mean([count for count in sizes if count is not None])) if None not in sizes else None, allows,
            )
        )  # fmt: skip
    text = "all of the above" if software else "the processor's part of all of the above"
    allows = _per_second(cores, total_processor)
    return [*rows, StageRow(PROCESSOR, text, total, total_processor, 1.0, None, allows)]


def limit_of(
    rows: Sequence[StageRow], cores: int, reached_per_second: float, shares: Sequence[float]
) -> dict[str, Any]:
    """Name the limit of a run, and how near to it the run came.

    A pair goes through all stages: no run is faster than the narrowest stage allows alone, nor faster than the
    processor can do its part of all stages. Where the processor draws, the processor's limit is always less.

    Args:
        rows: result of `stage_rows`.
        cores: number of cores.
        reached_per_second: pairs per second from start to end.
        shares: of each round, pairs per second divided by the limit of that round's stages.
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
    """Divide, with a microsecond in place of times below the clock's resolution."""
    return at_once / max(seconds, 1e-6)
