"""Costs of the stages of a pair, and the stage that limits how many pairs a machine can make."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from semisynth_gl.pairs.pipeline import PAIR_STAGES

STAGES = (*PAIR_STAGES, "encode", "write")
"""The stages of a pair in a dataset, in order: the renderer's, then the handling of the arrays."""

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


class Costs(NamedTuple):
    """Costs of one stage of one pair.

    Attributes:
        seconds: from the stage's beginning to its end.
        cpu_seconds: of all threads of the process together.
        result_bytes: size of the stage's result; None where the result stays with the driver or is small.
    """

    seconds: float
    cpu_seconds: float
    result_bytes: int | None


def stage_rows(pairs: Sequence[Mapping[str, Costs]], cores: int, *, software: bool) -> list[dict[str, Any]]:
    """Average the costs of pairs.

    Args:
        pairs: costs of each pair by stage.
        cores: number of cores that the machine has for them.
        software: True where the processor draws.

    Returns:
        A row of each stage in their order, then the row of the processor's part of all stages. "share" is the stage's
        part of the seconds of all stages; "allows_per_second" is the number of pairs per second if a pair were this
        stage alone: on the processor, with all cores at work.
    """
    costs = np.array([[pair[stage][:2] for stage in STAGES] for pair in pairs])
    seconds, processor = np.moveaxis(costs, -1, 0).mean(axis=1).tolist()
    total = sum(seconds)

    def row(name: str, text: str, wall: float, cpu: float, size: float | None, *, on_gpu: bool) -> dict[str, Any]:
        return {
            "name": name,
            "text": text,
            "seconds": wall,
            "cpu_seconds": cpu,
            "share": wall / total,
            "bytes_per_pair": size,
            # A microsecond stands for times below the clock's resolution.
            "allows_per_second": 1 / max(wall, 1e-6) if on_gpu else cores / max(cpu, 1e-6),
        }

    rows = []
    for stage, wall, cpu in zip(STAGES, seconds, processor, strict=True):
        sizes = [size for pair in pairs if (size := pair[stage].result_bytes) is not None]
        mean = float(np.mean(sizes)) if len(sizes) == len(pairs) else None
        on_gpu = stage in _ON_THE_GPU and not software
        rows.append(row(stage, STAGE_TEXTS[stage], wall, cpu, mean, on_gpu=on_gpu))
    text = "all of the above" if software else "the processor's part of all of the above"
    return [*rows, row(PROCESSOR, text, total, sum(processor), None, on_gpu=False)]


def speed_limit(
    rows: Sequence[Mapping[str, Any]], cores: int, reached_per_second: float, shares: Sequence[float]
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
    limit = min(rows, key=lambda row: row["allows_per_second"])
    narrowest = min(rows[:-1], key=lambda row: row["allows_per_second"])  # the last row is the processor's
    return {
        "cores": cores,
        "narrowest_stage": narrowest["name"],
        "narrowest_allows_per_second": narrowest["allows_per_second"],
        "by": limit["name"],
        "allows_per_second": limit["allows_per_second"],
        "reached_per_second": reached_per_second,
        "share": float(np.median(shares)),
        "shares": list(shares),
    }
