"""Predictions of a whole set against its truth, pair by pair."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import InputError
from semisynth_gl.metrics.error_map import draw_error_map
from semisynth_gl.metrics.predictions import Prediction
from semisynth_gl.metrics.protocol import Protocol
from semisynth_gl.metrics.score import Score, mean_figures, tally
from semisynth_gl.metrics.truth import TruePair
from semisynth_gl.read.disparity import read_disparity
from semisynth_gl.read.error import ReadError

ALL, VISIBLE = "all", "non-occluded"
REGIONS = (ALL, VISIBLE)
"""What figures are over: all pixels with truth, and those of them that both views see."""
BACKGROUND, FOREGROUND = "background", "foreground"
_PARTS: Mapping[str, str] = {BACKGROUND: "D1-bg", FOREGROUND: "D1-fg"}


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """A pair that has been evaluated.

    Attributes:
        name: the pair's.
        scores: by region; (region, part) where the truth has a map of objects, part being ``background`` or
            ``foreground``.
        error_map: (H, W, 3) uint8 RGB; None where it was not asked for.
    """

    name: str
    scores: Mapping[tuple[str, ...], Score]
    error_map: NDArray[np.uint8] | None = None


def evaluate_pair(pair: TruePair, prediction: Prediction, protocol: Protocol, *, draw: bool = False) -> Evaluated:
    """Evaluate a prediction.

    Args:
        pair: whose truth it is compared with.
        prediction: the file.
        protocol: by which.
        draw: whether to draw an error map.

    Raises:
        ReadError: where a file cannot be read, or the prediction holds no disparity at all.
        InputError: where sizes do not fit, or the truth holds no disparity.
    """
    truth = pair.read()
    values = read_disparity(prediction.path, prediction.png_scale)
    try:
        compared = protocol.compare(values, truth.disparity, truth.limits)
    except InputError as error:
        raise InputError(f"{prediction.path}: {error} ({pair.source})") from None
    if not (np.isfinite(values).any() and compared.estimated.any()):
        height, width = values.shape
        raise ReadError(
            prediction.path,
            f"holds no disparity: not one of its {width} x {height} values is valid by the definitions of "
            f"{protocol.source}; expected pixels, inf (in a PNG 0) only where there is none",
        )
    if not compared.judged.any():
        raise InputError(f"{pair.source}: the truth of {pair.name} holds no disparity, so there is nothing to compare")
    masks: dict[str, NDArray[np.bool_] | None] = {ALL: None}
    if truth.visible is not None:
        masks[VISIBLE] = truth.visible
    scores: dict[tuple[str, ...], Score] = {}
    for region, mask in masks.items():
        scores[region,] = tally(compared, protocol, mask)
        if protocol.pooled and truth.objects is not None:
            whole = np.ones_like(compared.judged) if mask is None else mask
            for part, there in ((BACKGROUND, truth.objects == 0), (FOREGROUND, truth.objects > 0)):
                scores[region, part] = tally(compared, protocol, whole & there)
    error_map = draw_error_map(compared, protocol, truth.visible) if draw else None
    return Evaluated(pair.name, scores, error_map)


def figures_of(evaluated: Sequence[Evaluated], region: str) -> dict[str, float]:
    """Return the figures of pairs in a region, as their benchmark averages them; see `mean_figures`.

    With maps of objects there are also D1-bg and D1-fg, outliers in the background and elsewhere.

    Returns:
        Nothing where no pair has the region.
    """
    figures: dict[str, float] = {}
    for part, name in _PARTS.items():
        scores = {each.name: each.scores[region, part] for each in evaluated if (region, part) in each.scores}
        if scores:
            figures[name] = mean_figures(scores)["D1-all"]
    scores = {each.name: each.scores[region,] for each in evaluated if (region,) in each.scores}
    return figures | mean_figures(scores) if scores else {}


def counts_of(evaluated: Evaluated, region: str) -> dict[str, int]:
    """Return how many pixels of a pair were judged, estimated and scored in a region; see `Score`."""
    score = evaluated.scores[region,]
    return {"judged": score.judged, "estimated": score.estimated, "scored": score.scored}


def report_of(
    evaluated: Sequence[Evaluated], protocol: Protocol, missing: Sequence[str], paths: Mapping[str, Path]
) -> dict[str, Any]:
    """Return everything in JSON's types; what is not finite is None.

    Args:
        evaluated: at least one pair.
        protocol: by which.
        missing: names of pairs without a prediction.
        paths: the predictions' files, by the pair's name.
    """

    def regions(pairs: Sequence[Evaluated]) -> dict[str, dict[str, float | None]]:
        found = {region: figures_of(pairs, region) for region in REGIONS}
        return {region: _plain(figures) for region, figures in found.items() if figures}

    return {
        "protocol": protocol.name,
        "source": protocol.source,
        "unit": "percent" if protocol.percent else "fraction",
        "average": "pooled pixels" if protocol.pooled else "mean of pairs",
        "pairs": len(evaluated),
        "missing": list(missing),
        "mean": regions(evaluated),
        "images": [
            {
                "name": each.name,
                "prediction": str(paths[each.name]),
                "pixels": {region: counts_of(each, region) for region in REGIONS if (region,) in each.scores},
                "figures": regions([each]),
            }
            for each in evaluated
        ],
    }


def _plain(figures: Mapping[str, float]) -> dict[str, float | None]:
    return {name: float(value) if np.isfinite(value) else None for name, value in figures.items()}
