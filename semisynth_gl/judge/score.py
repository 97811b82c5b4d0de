"""Counts and sums over the pixels of an image, and the figures that follow from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.arguments import to_array
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.protocol import (
    UNLIMITED,
    Limits,
    PixelComparison,
    Protocol,
    ProtocolName,
    find_protocol,
    shown_size,
)

THRESHOLDS_PX = (0.5, 1.0, 2.0, 4.0)
QUANTILES = (0.5, 0.9, 0.95, 0.99)
_OUTLIER_PX = 3.0
_OUTLIER_SHARE = 0.05
# Attributes of `Score` that add up over images.
_SUMMED = ("judged", "estimated", "scored", "outliers", "outliers_estimated", "sum_px", "sum_squared_px2")


@dataclass(frozen=True, slots=True)
class Score:
    """Counts and sums over some pixels of an image, or of several.

    Attributes:
        protocol: the benchmark's definitions.
        judged: number of pixels where a disparity was asked for.
        estimated: number of judged pixels for which the prediction itself has a value.
        scored: number of judged pixels whose error counts: all of them under protocols that fill holes (KITTI) or
            have no invalid values (``paper``).
        bad: for each of `THRESHOLDS_PX`, number of scored pixels with a larger error; an equal error is not bad.
        outliers: number of scored pixels that are off by more than 3 px and more than 5 %; see `is_outlier`.
        outliers_estimated: number of outliers among the estimated pixels.
        sum_px: sum of the absolute errors of the scored pixels.
        sum_squared_px2: sum of the squares of these errors.
        quantiles_px: errors that the shares `QUANTILES` of the scored pixels do not exceed; see `error_quantiles`.
    """

    protocol: Protocol
    judged: int
    estimated: int
    scored: int
    bad: tuple[int, ...]
    outliers: int
    outliers_estimated: int
    sum_px: float
    sum_squared_px2: float
    quantiles_px: tuple[float, ...]

    def figures(self) -> dict[str, float]:
        """Return the figures that docs/evaluate.md defines, by name: shares in the protocol's unit, and px.

        All figures are NaN where no pixel was judged. If pixels were judged, but none was scored, all of them are bad,
        and errors are infinite under ETH3D's protocol and NaN under Middlebury's, as in their evaluators.
        """
        full = self.protocol.full_share
        # Under Middlebury's protocol pixels without a score are bad too.
        unscored = self.judged - self.scored if self.protocol.invalid_is_bad else 0

        def share(count: int, total: int) -> float:
            return nan if self.judged == 0 else (full * count / total if total else full)

        def mean(total: float) -> float:
            return total / self.scored if self.scored else _worst_px(self.protocol, self.judged)

        counted = self.scored + unscored
        return {
            **{f"bad-{t:g}": share(n + unscored, counted) for t, n in zip(THRESHOLDS_PX, self.bad, strict=True)},
            "D1-all": share(self.outliers + unscored, counted),
            "D1-est": share(self.outliers_estimated, self.estimated) if self.estimated else nan,
            "avgerr": mean(self.sum_px),
            "epe": mean(self.sum_px),
            "rms": float(np.sqrt(np.float32(mean(self.sum_squared_px2)))),
            **{f"A{100 * q:g}": value for q, value in zip(QUANTILES, self.quantiles_px, strict=True)},
            "coverage": share(self.estimated, self.judged),
            "invalid": share(self.judged - self.estimated, self.judged),
        }


def score(
    prediction: NDArray[np.floating],
    truth: NDArray[np.floating],
    protocol: ProtocolName | Protocol,
    *,
    mask: NDArray[np.bool_] | None = None,
    limits: Limits = UNLIMITED,
) -> Score:
    """Score a prediction against the truth by a benchmark's definitions.

    Args:
        prediction: (H, W) floats, px; the protocol decides which values are invalid. Middlebury also takes predictions
            of half or a quarter of the truth's size. Errors are computed in float32, as in the evaluators.
        truth: (H, W) floats, px, inf where there is no disparity.
        protocol: one of `PROTOCOLS`, or its name.
        mask: (H, W) bool of the truth's size, True for the pixels to count, such as the pixels that both views see;
            None for all pixels.
        limits: ndisp and isint of the truth, and whether its disparities are signed.

    Raises:
        InputError: where sizes differ, an array is not (H, W), or there is no such protocol.
    """
    protocol = find_protocol(protocol)
    maps = (to_array("prediction", prediction, np.float32), to_array("truth", truth, np.float32))
    for name, array in zip(("prediction", "truth"), maps, strict=True):
        if array.ndim != 2:
            raise InputError(f"{name} must be (H, W), got an array of shape {array.shape}")
    return tally(protocol.compare(*maps, limits), protocol, None if mask is None else mask.astype(np.bool_))


def tally(comparison: PixelComparison, protocol: Protocol, mask: NDArray[np.bool_] | None = None) -> Score:
    """Count the pixels of a comparison in a mask (H, W) of the truth's size, or all pixels without a mask.

    Raises:
        InputError: where the mask has another size.
    """
    judged, scored = comparison.judged, comparison.scored
    if mask is not None:
        if mask.shape != judged.shape:
            sizes = f"the mask has {shown_size(mask)} pixels, the truth {shown_size(judged)}"
            raise InputError(f"{sizes}: expected one size")
        judged, scored = judged & mask, scored & mask
    estimated = judged & comparison.estimated
    error, truth = comparison.error[scored], comparison.truth[scored]
    outlier = is_outlier(error, truth)
    # Squares in float32, summed in double, and the root of a float32 give the same digits as ETH3D's evaluator.
    with np.errstate(over="ignore"):
        squared = float(np.square(error).sum(dtype=np.float64))
    return Score(
        protocol=protocol,
        judged=int(judged.sum()),
        estimated=int(estimated.sum()),
        scored=int(scored.sum()),
        bad=tuple(int((error > threshold).sum()) for threshold in THRESHOLDS_PX),
        outliers=int(outlier.sum()),
        outliers_estimated=int((outlier & estimated[scored]).sum()),
        # ETH3D sums in double too. Middlebury's kit sums in float32, which is off from the 3rd digit on at 1500 x 1000.
        sum_px=float(error.sum(dtype=np.float64)),
        sum_squared_px2=squared,
        quantiles_px=error_quantiles(error) if error.size else (_worst_px(protocol, judged.sum()),) * len(QUANTILES),
    )


def is_outlier(error: NDArray[np.float32], truth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which errors (N,) px are above 3 px and above 5 % of the truth (N,) px.

    Source: ``disparityErrorsOutlier`` in evaluate_scene_flow.cpp of KITTI's development kit. The kit compares a float32
    quotient with the double 0.05, which is slightly below the float32 nearest to it. So an error of exactly 5 % is an
    outlier, and an error of exactly 3 px is not.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        quotient = error / np.abs(truth)
    # numpy would round a plain 0.05 to float32 before it compares.
    return (error > _OUTLIER_PX) & np.asarray(quotient.astype(np.float64) > _OUTLIER_SHARE)


def error_quantiles(error: NDArray[np.float32]) -> tuple[float, ...]:
    """Return A50, A90, A95 and A99 of the n errors, n above 0.

    The quantile q is the error at place floor(n q), counted from 0, in ascending order; NaN sorts last. Source:
    src/main.cc of github.com/ETH3D/two-view-evaluation, where n q is a float32. Middlebury's page reports the same
    figures, but its kit does not compute them.
    """
    places = [min(int(np.floor(np.float32(error.size) * np.float32(q))), error.size - 1) for q in QUANTILES]
    return tuple(float(value) for value in np.partition(error, places)[places])


def _worst_px(protocol: Protocol, judged: int) -> float:
    """Return the mean error where no pixel was scored."""
    return nan if protocol.invalid_is_bad or not judged else inf


def pool(scores: Sequence[Score]) -> Score:
    """Pool the pixels of several scores into one score, as KITTI does with its images.

    Quantiles cannot be pooled from counts, so the pooled quantiles are the means of the scores' quantiles.

    Args:
        scores: at least one score; all have the same protocol.
    """
    sums: dict[str, Any] = {name: sum(getattr(score, name) for score in scores) for name in _SUMMED}
    bad = tuple(map(sum, zip(*(score.bad for score in scores), strict=True)))
    quantiles = [score.quantiles_px for score in scores if score.judged] or [(nan,) * len(QUANTILES)]
    means = tuple(sum(values) / len(quantiles) for values in zip(*quantiles, strict=True))
    return Score(protocol=scores[0].protocol, bad=bad, quantiles_px=means, **sums)


def mean_figures(scores: Mapping[str, Score]) -> dict[str, float]:
    """Return the figures of several images together, by the figure's name, averaged as their benchmark does it.

    KITTI pools the pixels of all images. The other benchmarks average the images' figures; Middlebury halves the weight
    of five of its training pairs. An image without a judged pixel does not count.

    Args:
        scores: at least one score, by the image's name; all have the same protocol.
    """
    protocol = next(iter(scores.values())).protocol
    counted = {name: score for name, score in scores.items() if score.judged} or scores
    if protocol.pooled:
        return pool(list(counted.values())).figures()
    figures = [score.figures() for score in counted.values()]
    weights = [protocol.weights.get(name, 1.0) for name in counted]
    rows = list(zip(weights, figures, strict=True))
    return {name: sum(weight * row[name] for weight, row in rows) / sum(weights) for name in figures[0]}
