"""The figures of a prediction by a benchmark's definitions, computed from counts and sums over pixels."""

from collections.abc import Mapping
from dataclasses import replace
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.arguments import check_one_of, to_array
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.protocol import PROTOCOLS, PixelComparison, Protocol, ProtocolName, Truth

_THRESHOLDS_PX = {f"bad-{threshold:g}": threshold for threshold in (0.5, 1.0, 2.0, 4.0)}
_QUANTILES = {f"A{100 * quantile:g}": quantile for quantile in (0.5, 0.9, 0.95, 0.99)}
_OUTLIER_PX, _OUTLIER_SHARE = 3.0, 0.05

Sums = Mapping[str, float]
"""The counts and sums of `tally`, for an image or for several."""


def score(
    prediction: NDArray[np.floating],
    truth: NDArray[np.floating] | Truth,
    protocol: ProtocolName,
    *,
    mask: NDArray[np.bool_] | None = None,
) -> dict[str, float]:
    """Return the figures of a prediction by a benchmark's definitions; docs/evaluate.md defines their names.

    Shares are in percent or fractions, as in the benchmark; errors are in px. All figures are NaN if no pixel is
    judged. If no judged pixel has a valid prediction, all judged pixels are bad, and errors are infinite with ``eth3d``
    and NaN with ``middlebury``, as in the evaluators.

    Args:
        prediction: (H, W) floats, px; the protocol decides which values are invalid. Middlebury also takes predictions
            of half or a quarter of the truth's size. Errors are computed in float32, as in the evaluators.
        truth: (H, W) floats, px, inf where there is no disparity; or a `Truth`, which may have limits, too.
        protocol: name of one of `PROTOCOLS`.
        mask: (H, W) bool of the truth's size, True for the pixels to use, such as those that both views see; None for
            all pixels.

    Raises:
        InputError: where sizes differ, an array is not (H, W), or there is no such protocol.
    """
    check_one_of("protocol", protocol, PROTOCOLS)
    rules, values = PROTOCOLS[protocol], to_array("prediction", prediction, np.float32)
    if not isinstance(truth, Truth):
        truth = Truth(to_array("truth", truth, np.float32))
    if values.ndim != 2 or truth.disparity.ndim != 2:
        raise InputError(f"expected arrays (H, W), got the shapes {values.shape} and {truth.disparity.shape}")
    truth = replace(truth, visible=None if mask is None else np.asarray(mask, bool))
    return figures(tally(rules.compare(values, truth), rules, truth.visible), rules)


def tally(comparison: PixelComparison, protocol: Protocol, mask: NDArray[np.bool_] | None) -> Sums:
    """Count the pixels of a comparison where a mask (H, W) is True; None counts all pixels.

    Returns:
        - ``judged``, ``estimated`` and ``scored``: numbers of pixels, see `PixelComparison`.
        - ``bad-0.5`` to ``bad-4``: the scored pixels with an error above 0.5 to 4 px.
        - ``outliers`` and ``outliers_estimated``: the scored and the estimated pixels of which `is_outlier` is true.
        - ``sum_px`` and ``sum_squared_px2``: sums of the scored pixels' errors and of their squares.
        - ``A50`` to ``A99``: see `error_quantiles`.
        - ``judged-bg``, ``outliers-bg``, ``judged-fg``, ``outliers-fg``: in the background and on objects, if known.

        If an invalid prediction is bad, ``bad-`` and ``outliers`` also count the judged pixels that are not scored.
    """
    judged, scored = comparison.judged, comparison.scored
    if mask is not None:
        judged, scored = judged & mask, scored & mask
    estimated, error = judged & comparison.estimated, comparison.error[scored]
    outlier = is_outlier(error, comparison.truth.disparity[scored])
    unscored = (judged & ~scored).sum() if protocol.invalid == "bad" else 0
    counts = {
        "judged": judged.sum(),
        "estimated": estimated.sum(),
        "scored": scored.sum(),
        **{name: (error > threshold).sum() + unscored for name, threshold in _THRESHOLDS_PX.items()},
        "outliers": outlier.sum() + unscored,
        "outliers_estimated": (outlier & estimated[scored]).sum(),
    }
    objects = comparison.truth.objects
    if protocol.pooled and objects is not None:
        for part, within in (("bg", objects[scored] == 0), ("fg", objects[scored] > 0)):
            # With KITTI's protocol, all judged pixels are scored.
            counts |= {f"judged-{part}": within.sum(), f"outliers-{part}": (outlier & within).sum()}
    whole = {name: int(count) for name, count in counts.items()}
    if not error.size:
        worst = inf if judged.any() and protocol.invalid != "bad" else nan
        return whole | dict.fromkeys(("sum_px", "sum_squared_px2", *_QUANTILES), worst)
    # ETH3D sums in double, too. Middlebury's kit sums in float32: at 1500 x 1000, the third digit is wrong.
    with np.errstate(over="ignore"):
        sums = {"sum_px": error.sum(dtype=np.float64), "sum_squared_px2": np.square(error).sum(dtype=np.float64)}
    return whole | {name: float(total) for name, total in sums.items()} | error_quantiles(error)


def figures(sums: Sums, protocol: Protocol) -> dict[str, float]:
    """Return the figures that `score` describes, from the sums of an image or of several."""
    full, judged, estimated, scored = (protocol.full_share, *(sums[name] for name in ("judged", "estimated", "scored")))
    rated = judged if protocol.invalid == "bad" else scored

    def share(count: float, total: float) -> float:
        return nan if judged == 0 else (full * count / total if total else full)

    mean_px, mean_squared_px2 = (sums[name] / max(scored, 1) for name in ("sum_px", "sum_squared_px2"))
    parts = [part for part in ("bg", "fg") if f"judged-{part}" in sums]
    return {
        **{name: share(sums[name], rated) for name in _THRESHOLDS_PX},
        **{f"D1-{part}": _ratio(sums[f"outliers-{part}"], sums[f"judged-{part}"]) for part in parts},
        "D1-all": share(sums["outliers"], rated),
        "D1-est": full * _ratio(sums["outliers_estimated"], estimated),
        "avgerr": mean_px,
        # The root of a float32, as in ETH3D's evaluator.
        "rms": float(np.sqrt(np.float32(mean_squared_px2))),
        **{name: sums[name] for name in _QUANTILES},
        "coverage": share(estimated, judged),
        "invalid": share(judged - estimated, judged),
    }


def is_outlier(error: NDArray[np.float32], truth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which errors (N,) px are above 3 px and above 5 % of the truth (N,) px.

    Source: ``disparityErrorsOutlier`` in evaluate_scene_flow.cpp of KITTI's development kit. The kit compares a float32
    quotient with the double 0.05, which is slightly below the float32 0.05. So an error of exactly 5 % is an outlier,
    and an error of exactly 3 px is not.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        quotient = error / np.abs(truth)
    # numpy would compare a float32 with the float32 0.05.
    return (error > _OUTLIER_PX) & np.asarray(quotient.astype(np.float64) > _OUTLIER_SHARE)


def error_quantiles(error: NDArray[np.float32]) -> dict[str, float]:
    """Return the quantiles A50, A90, A95 and A99 of n errors, n above 0.

    The quantile q is element floor(n q) of the sorted errors, counted from 0; NaN sorts last. Source: src/main.cc of
    github.com/ETH3D/two-view-evaluation, where n q is a float32. Middlebury's page reports the same figures, but its
    kit does not compute them.
    """
    ranks = [min(int(np.floor(np.float32(error.size) * np.float32(q))), error.size - 1) for q in _QUANTILES.values()]
    return dict(zip(_QUANTILES, np.partition(error, ranks)[ranks].tolist(), strict=True))


def mean_figures(images: Mapping[str, Sums], protocol: Protocol) -> dict[str, float]:
    """Return the figures of several images together, as the benchmark computes them, given each image's sums by name.

    KITTI pools the pixels of all images, but averages the images' quantiles. The other benchmarks average the images'
    figures; Middlebury halves the weight of five of its training pairs. Images without judged pixels are ignored.
    """
    counted = {name: sums for name, sums in images.items() if sums["judged"]} or images
    if protocol.pooled:
        names = dict.fromkeys(name for sums in counted.values() for name in sums)
        pooled = {name: sum(sums.get(name, 0) for sums in counted.values()) for name in names}
        quantiles = np.mean([[sums[name] for name in _QUANTILES] for sums in counted.values()], axis=0)
        return figures(pooled | dict(zip(_QUANTILES, quantiles.tolist(), strict=True)), protocol)
    of_images = [figures(sums, protocol) for sums in counted.values()]
    weights = [0.5 if name in protocol.halved else 1.0 for name in counted]
    return {name: float(np.average([row[name] for row in of_images], weights=weights)) for name in of_images[0]}


def _ratio(count: float, total: float) -> float:
    return count / total if total else nan
