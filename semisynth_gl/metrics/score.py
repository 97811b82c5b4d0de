"""Counts and sums over the pixels of an image, and the figures that follow from them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import InputError
from semisynth_gl.metrics.protocol import PROTOCOLS, UNLIMITED, Comparison, Limits, Protocol, ProtocolName

THRESHOLDS_PX = (0.5, 1.0, 2.0, 4.0)
QUANTILES = (0.5, 0.9, 0.95, 0.99)
_OUTLIER_PX = 3.0
_OUTLIER_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class Score:
    """What was counted in some pixels of an image, or of several.

    Attributes:
        protocol: by which it was counted.
        judged: pixels where a disparity was asked for.
        estimated: those of them where the prediction has one of its own.
        scored: those of them whose error counts; as many as judged where holes are filled or cannot be.
        bad: those of the latter whose error exceeds each of `THRESHOLDS_PX`; equal is not bad.
        outliers: likewise, off by more than 3 px and more than 5 %; see `is_outlier`.
        outliers_estimated: outliers among the estimated ones.
        sum_px: sum of the absolute errors.
        sum_squared_px2: sum of their squares.
        quantiles_px: errors that the shares `QUANTILES` of the pixels do not exceed; see `quantiles_of`.
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
        """Return what benchmarks report, in the protocol's unit: percents or fractions, and px.

        ``bad-t``
            share of pixels with an error above t px: of those judged, invalid ones being bad (Middlebury), or of those
            scored (ETH3D; in the others these are the same).
        ``D1-all``
            likewise, share of outliers (KITTI 2015).
        ``D1-est``
            share of outliers among the pixels with an estimate (``errors_*_result`` of KITTI's kit); NaN without any.
        ``avgerr``, ``epe``
            mean absolute error of the pixels scored; one number under the benchmarks' name and under that of training
            code.
        ``rms``
            root of the mean squared error, likewise.
        ``A50`` to ``A99``
            see `quantiles_of`.
        ``coverage``
            share of the judged pixels with an estimate; KITTI's density.
        ``invalid``
            the rest.

        All are NaN where no pixel was judged. Where none was scored, all pixels are bad; errors are infinite for ETH3D
        and NaN for Middlebury, as their evaluators have them.
        """
        whole = self.protocol.whole
        invalid = self.judged - self.scored
        among = self.judged if self.protocol.invalid_is_bad else self.scored
        more = invalid if self.protocol.invalid_is_bad else 0

        def share(count: int, of: int) -> float:
            if self.judged == 0:
                return nan
            return whole * count / of if of else whole

        mean, mean_square = self._mean(self.sum_px), self._mean(self.sum_squared_px2)
        quantiles = {f"A{100 * q:g}": value for q, value in zip(QUANTILES, self.quantiles_px, strict=True)}
        return {
            **{f"bad-{t:g}": share(n + more, among) for t, n in zip(THRESHOLDS_PX, self.bad, strict=True)},
            "D1-all": share(self.outliers + more, among),
            "D1-est": share(self.outliers_estimated, self.estimated) if self.estimated else nan,
            "avgerr": mean,
            "epe": mean,
            "rms": float(np.sqrt(np.float32(mean_square))),
            **quantiles,
            "coverage": nan if self.judged == 0 else whole * self.estimated / self.judged,
            "invalid": nan if self.judged == 0 else whole * (self.judged - self.estimated) / self.judged,
        }

    def _mean(self, total: float) -> float:
        if self.judged == 0:
            return nan
        return total / self.scored if self.scored else _worst(self.protocol)


def score(
    prediction: NDArray[np.floating],
    truth: NDArray[np.floating],
    protocol: ProtocolName | Protocol,
    *,
    mask: NDArray[np.bool_] | None = None,
    limits: Limits = UNLIMITED,
) -> Score:
    """Score a prediction.

    Args:
        prediction: (H, W) px; what counts as no disparity is the protocol's affair. Middlebury takes half and quarter
            sizes too. Errors are those of float32, as in the evaluators.
        truth: (H, W) px, inf where there is none.
        protocol: one of `PROTOCOLS`, or its name.
        mask: (H, W) bool, pixels to look at, such as those that both views see; None for all.
        limits: ndisp and isint of the truth.

    Raises:
        InputError: where sizes differ.
    """
    by = protocol if isinstance(protocol, Protocol) else PROTOCOLS[protocol]
    compared = by.compare(np.asarray(prediction, np.float32), np.asarray(truth, np.float32), limits)
    return tally(compared, by, mask)


def tally(compared: Comparison, protocol: Protocol, mask: NDArray[np.bool_] | None = None) -> Score:
    """Count the pixels of a comparison.

    Args:
        compared: by the protocol.
        protocol: whose `figures` follow.
        mask: (H, W) bool, pixels to look at; None for all.

    Raises:
        InputError: where the mask has another size than the truth.
    """
    judged, scored = compared.judged, compared.scored
    if mask is not None:
        if mask.shape != judged.shape:
            (height, width), (true_height, true_width) = mask.shape, judged.shape
            raise InputError(
                f"the mask has {width} x {height} pixels, the truth {true_width} x {true_height}: expected one size"
            )
        judged, scored = judged & mask, scored & mask
    estimated = judged & compared.estimated
    error, truth = compared.error[scored], compared.truth[scored]
    outlier = is_outlier(error, truth)
    return Score(
        protocol=protocol,
        judged=int(judged.sum()),
        estimated=int(estimated.sum()),
        scored=int(scored.sum()),
        bad=tuple(int((error > threshold).sum()) for threshold in THRESHOLDS_PX),
        outliers=int(outlier.sum()),
        outliers_estimated=int((outlier & estimated[scored]).sum()),
        # ETH3D sums in double too. Middlebury's kit sums in float32, which at 1500 x 1000 is off from the 3rd digit on.
        sum_px=float(error.sum(dtype=np.float64)),
        sum_squared_px2=_sum_of_squares(error),
        quantiles_px=quantiles_of(error)
        if error.size
        else (_worst(protocol) if judged.any() else nan,) * len(QUANTILES),
    )


def is_outlier(error: NDArray[np.float32], truth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Tell which errors are above 3 px and above 5 % of the truth.

    Source: ``disparityErrorsOutlier`` in evaluate_scene_flow.cpp of KITTI's development kit. The quotient is a float32
    and the bound a double, just below the float32 next to it: exactly 5 % is an outlier, exactly 3 px is none.

    Args:
        error: (N,) float32 px, absolute.
        truth: (N,) float32 px.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        quotient = error / np.abs(truth)
    # numpy would round a plain 0.05 to float32 before it compares.
    far: NDArray[np.bool_] = quotient.astype(np.float64) > _OUTLIER_SHARE
    return (error > _OUTLIER_PX) & far


def quantiles_of(error: NDArray[np.float32]) -> tuple[float, ...]:
    """Return A50, A90, A95 and A99: number floor(n q), counted from 0, of the n errors in ascending order.

    Source: src/main.cc of github.com/ETH3D/two-view-evaluation, where n q is a float32. Middlebury's page reports the
    same figures, but its kit has none. NaN sorts last.

    Args:
        error: (N,) float32 px, at least one.
    """
    places = [min(int(np.floor(np.float32(error.size) * np.float32(q))), error.size - 1) for q in QUANTILES]
    return tuple(float(value) for value in np.partition(error, places)[places])


def _sum_of_squares(error: NDArray[np.float32]) -> float:
    # Squares of float32, summed in double, and the root of a float32: as ETH3D's evaluator, digit by digit.
    with np.errstate(over="ignore"):
        return float(np.square(error).sum(dtype=np.float64))


def _worst(protocol: Protocol) -> float:
    """The mean error of no pixel at all."""
    return nan if protocol.invalid_is_bad else inf


def pool(scores: Sequence[Score]) -> Score:
    """Put the pixels of several scores together, as KITTI does with its images.

    Quantiles cannot be put together from counts; the mean of the images' stands for them.

    Args:
        scores: at least one, by one protocol.
    """

    def total(of: Callable[[Score], int]) -> int:
        return sum(map(of, scores))

    counted = [each for each in scores if each.judged]
    return Score(
        protocol=scores[0].protocol,
        judged=total(lambda each: each.judged),
        estimated=total(lambda each: each.estimated),
        scored=total(lambda each: each.scored),
        bad=tuple(sum(counts) for counts in zip(*(each.bad for each in scores), strict=True)),
        outliers=total(lambda each: each.outliers),
        outliers_estimated=total(lambda each: each.outliers_estimated),
        sum_px=sum(each.sum_px for each in scores),
        sum_squared_px2=sum(each.sum_squared_px2 for each in scores),
        quantiles_px=tuple(
            sum(values) / len(counted) for values in zip(*(each.quantiles_px for each in counted), strict=True)
        )
        or (nan,) * len(QUANTILES),
    )


def mean_figures(scores: Mapping[str, Score]) -> dict[str, float]:
    """Return the figures of several images together, as their benchmark averages them.

    KITTI pools the pixels of all images. The others average the images' figures; Middlebury halves the weight of five
    of its training pairs. An image without a judged pixel takes no part.

    Args:
        scores: by name, at least one, by one protocol.
    """
    protocol = next(iter(scores.values())).protocol
    counted = {name: each for name, each in scores.items() if each.judged} or scores
    if protocol.pooled:
        return pool(list(counted.values())).figures()
    weights = [protocol.weights.get(name, 1.0) for name in counted]
    figures = [each.figures() for each in counted.values()]
    return {
        name: sum(weight * each[name] for weight, each in zip(weights, figures, strict=True)) / sum(weights)
        for name in figures[0]
    }
