"""Evaluate the predictions for a set against its truth, pair by pair; report the results as JSON and as tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.inputs.errors import InputError, ReadError, counted
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.judge.error_map import draw_error_map
from semisynth_gl.judge.predictions import find_predictions
from semisynth_gl.judge.protocol import Protocol, ProtocolName, find_protocol, shown_size
from semisynth_gl.judge.score import Score, mean_figures, tally
from semisynth_gl.judge.truth import TruePair, find_truth
from semisynth_gl.seeds.splits import SplitName

ALL, VISIBLE = "all", "non-occluded"
REGIONS = (ALL, VISIBLE)
"""The regions that figures are given for: all pixels with truth, and the pixels with truth that both views see."""
SIGN_HINT = (
    "most values are negative, but disparity is x_left - x_right, which is positive: if they are the flow from "
    "the left image to the right one, as RAFT-Stereo writes it, negate them"
)
"""The hint to the user about a prediction that is `Evaluation.negative`."""
_BACKGROUND, _FOREGROUND = "background", "foreground"
_PARTS: Mapping[str, str] = {_BACKGROUND: "D1-bg", _FOREGROUND: "D1-fg"}
# `_COLUMNS` has all columns of tables in their order; the table of every benchmark has those in `_COMMON`.
_COMMON = frozenset({"bad-0.5", "bad-1", "bad-2", "bad-4", "D1-all", "rms", "A50", "A90", "A95", "A99"})
_COLUMNS = (
    *("bad-0.5", "bad-1", "bad-2", "bad-4", "D1-bg", "D1-fg", "D1-all", "D1-est", "avgerr", "epe", "rms"),
    *("A50", "A90", "A95", "A99", "coverage", "invalid"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """The result for a pair.

    Attributes:
        name: the pair's name.
        prediction: the prediction's file.
        scores: by (region,); under a pooled protocol, and where the truth has a map of objects, also by
            (region, ``background``) and (region, ``foreground``).
        error_map: (H, W, 3) uint8 RGB; None where it was not asked for.
        negative: whether most predicted values are below 0, as in a flow to the right image, though the set's
            disparities are not signed.
    """

    name: str
    prediction: Path
    scores: Mapping[tuple[str, ...], Score]
    error_map: NDArray[np.uint8] | None = None
    negative: bool = False


def evaluate(
    predictions: str | PathLike[str],
    truth: str | PathLike[str],
    protocol: ProtocolName | Protocol | None = None,
    *,
    split: SplitName | None = None,
    masks: str | PathLike[str] | None = None,
    partial: bool = False,
) -> dict[str, Any]:
    """Evaluate a folder of predictions, as ``semisynth-gl evaluate`` does.

    Args:
        predictions: a folder of .pfm, .npy or 16-bit .png files, named after the pairs or after the files of the truth;
            see `find_predictions`.
        truth: a dataset of this program or a folder of Middlebury, ETH3D or KITTI; see `find_truth`.
        protocol: one of `PROTOCOLS`, or its name; by default the protocol of the benchmark whose layout the truth has.
        split: a split of a dataset of this program; None for all pairs.
        masks: a folder of 8-bit masks, 255 where not occluded, to use instead of the truth's own masks.
        partial: whether predictions for some pairs may be missing.

    Returns:
        The content of ``--json``, in JSON's types: ``protocol``, ``source``, ``unit``, ``average``, the number of
        ``pairs``, the names of ``missing`` pairs, ``mean`` (figures by region and name) and ``images`` (for each pair
        its ``name``, ``prediction``, counts of ``pixels`` by region, and ``figures`` as in ``mean``). `Score.figures`
        explains the figures; figures that are not finite are None.

    Raises:
        InputError: where a folder or a protocol does not exist, names or sizes do not fit, or predictions are missing.
        ReadError: where a file cannot be read.
    """
    address = fspath(truth)
    folder = address if "://" in address else str(expanded(address))
    true_set = find_truth(folder, split, None if masks is None else expanded(fspath(masks)))
    chosen = find_protocol(true_set.protocol if protocol is None else protocol)
    found, missing = find_predictions(expanded(fspath(predictions)), true_set.pairs, partial=partial)
    evaluations = [evaluate_pair(*each, chosen) for each in found]
    return report_json(evaluations, chosen, missing)


def evaluate_pair(pair: TruePair, prediction: Path, protocol: Protocol, *, draw: bool = False) -> Evaluation:
    """Evaluate a file with a prediction for a pair; with ``draw``, draw its error map too.

    Raises:
        InputError: where the sizes do not fit, or the truth has no disparity.
        ReadError: where a file cannot be read, or the prediction has no disparity.
    """
    truth = pair.read()
    values = read_disparity_map(prediction, pair.png_scale, signed=pair.signed)
    finite = values[np.isfinite(values)]
    negative = not pair.signed and bool(finite.size and 2 * np.count_nonzero(finite < 0) > finite.size)
    try:
        comparison = protocol.compare(values, truth.disparity, truth.limits)
    except InputError as error:
        raise InputError(f"{prediction}: {error} ({pair.source})") from None
    if not (np.isfinite(values).any() and comparison.estimated.any()):
        size, hint = shown_size(values), "expected pixels, and inf (in a PNG 0) only where there is no disparity"
        fault = f"by the definitions of {protocol.source} none of its {size} values is valid"
        raise ReadError(prediction, f"has no disparity: {fault}; {SIGN_HINT if negative else hint}")
    if not comparison.judged.any():
        raise InputError(f"{pair.source}: the truth of {pair.name} has no disparity, so there is nothing to compare")
    masks = {ALL: np.ones_like(comparison.judged)}
    if truth.visible is not None:
        masks[VISIBLE] = truth.visible
    scores: dict[tuple[str, ...], Score] = {}
    for region, mask in masks.items():
        scores[region,] = tally(comparison, protocol, mask)
        if protocol.pooled and truth.objects is not None:
            scores[region, _BACKGROUND] = tally(comparison, protocol, mask & (truth.objects == 0))
            scores[region, _FOREGROUND] = tally(comparison, protocol, mask & (truth.objects > 0))
    error_map = draw_error_map(comparison, protocol, truth.visible) if draw else None
    return Evaluation(pair.name, prediction, scores, error_map, negative)


def region_figures(evaluations: Sequence[Evaluation], region: str) -> dict[str, float]:
    """Return the mean figures of pairs in one of `REGIONS`, by name; {} where no pair has the region.

    See `mean_figures`. Truths with a map of objects add D1-bg and D1-fg, the shares of outliers in the background and
    in the foreground.
    """

    def scores(*key: str) -> dict[str, Score]:
        return {pair.name: pair.scores[key] for pair in evaluations if key in pair.scores}

    whole = scores(region)
    parts = {name: found for part, name in _PARTS.items() if (found := scores(region, part))}
    figures = {name: mean_figures(found)["D1-all"] for name, found in parts.items()}
    return figures | mean_figures(whole) if whole else {}


def report_json(evaluations: Sequence[Evaluation], protocol: Protocol, missing: Sequence[str]) -> dict[str, Any]:
    """Return the results in JSON's types, with None for figures that are not finite; see `evaluate` for the keys."""

    def figures(pairs: Sequence[Evaluation]) -> dict[str, dict[str, float | None]]:
        regions = {region: values for region in REGIONS if (values := region_figures(pairs, region))}
        return {
            region: {name: float(value) if np.isfinite(value) else None for name, value in values.items()}
            for region, values in regions.items()
        }

    def pixels(pair: Evaluation) -> dict[str, dict[str, int]]:
        scores = {region: pair.scores[region,] for region in REGIONS if (region,) in pair.scores}
        counts = "judged", "estimated", "scored"
        return {region: {name: getattr(score, name) for name in counts} for region, score in scores.items()}

    return {
        "protocol": protocol.name,
        "source": protocol.source,
        "unit": "percent" if protocol.percent else "fraction",
        "average": "pooled pixels" if protocol.pooled else "mean of pairs",
        "pairs": len(evaluations),
        "missing": list(missing),
        "mean": figures(evaluations),
        "images": [
            {"name": pair.name, "prediction": str(pair.prediction), "pixels": pixels(pair), "figures": figures([pair])}
            for pair in evaluations
        ],
    }


def report_table(
    evaluations: Sequence[Evaluation], region: str, protocol: Protocol, most: int | None = None
) -> list[str]:
    """Return the lines of a table with the benchmark's own decimals: a row for each pair, and a row for all pairs.

    If there are more than ``most`` pairs, only the ``most`` worst by `Protocol.headline` have a row, the worst first.
    """

    def cell(value: float | None) -> str:
        if value is None or np.isnan(value):
            return "-" if value is None else "nan"
        # Some evaluators print a float32, whose rounding decides the last digit.
        return format(float(np.float32(value)) if protocol.single else value, protocol.decimals)

    mean = region_figures(evaluations, region)
    columns = [name for name in _COLUMNS if name in mean and (name in _COMMON or name in protocol.columns)]
    figures = [(pair.name, region_figures([pair], region)) for pair in evaluations]
    head = f"{region} pixels; shares in {'%' if protocol.percent else 'fractions'}, errors in px"
    if most is not None and len(figures) > most:
        head += f"; the {most} worst of {counted(len(figures), 'pair')} by {protocol.headline}"
        # A pair without the figure counts as the worst.
        figures.sort(key=lambda each: -np.nan_to_num(each[1].get(protocol.headline, np.nan), nan=np.inf))
        del figures[most:]
    figures.append(("pooled" if protocol.pooled else "mean", mean))
    rows = [["", *(protocol.columns.get(name, name) for name in columns)]]
    rows += [[name, *(cell(values.get(column)) for column in columns)] for name, values in figures]
    first, *others = (max(map(len, cells)) for cells in zip(*rows, strict=True))
    lines = [head]
    for name, *cells in rows:
        lines.append("  ".join([name.ljust(first), *(text.rjust(n) for text, n in zip(cells, others, strict=True))]))
    return lines
