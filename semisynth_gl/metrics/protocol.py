"""The definitions of each benchmark's own evaluator: judged pixels, treatment of predictions, averages.

Everything below was read from the evaluators' sources. Their common part (bad: error > t, never >=) is in
`semisynth_gl.metrics.score`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import ceil
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.errors import InputError, shown

ProtocolName = Literal["middlebury", "eth3d", "kitti", "paper"]
"""A benchmark; ``paper`` counts as HSM's eval_mb.py does."""
PROTOCOL_NAMES: tuple[ProtocolName, ...] = get_args(ProtocolName)
UNFILLED = np.float32(-1)
"""KITTI's value for no disparity; where holes cannot be filled, it is compared with the truth like any other."""

Disparity = NDArray[np.float32]
Where = NDArray[np.bool_]

# The five hard ones of the 15 training pairs count half in the table on Middlebury's page.
_MIDDLEBURY_WEIGHTS = dict.fromkeys(("PianoL", "Playroom", "Playtable", "Shelves", "Vintage"), 0.5)


@dataclass(frozen=True, slots=True)
class Limits:
    """The entries of a truth's calib.txt on disparities.

    Attributes:
        ndisp: an upper bound, px of the truth's size; None for no bound.
        isint: whether the truth is in whole pixels.
        signed: whether disparities of 0 and below are valid, which no benchmark has.
    """

    ndisp: int | None = None
    isint: bool = False
    signed: bool = False


UNLIMITED = Limits()


@dataclass(frozen=True, slots=True, eq=False)
class PixelComparison:
    """A prediction against the truth, px, pixel by pixel, (H, W) each.

    The benchmark asks for a disparity where ``judged``, and the prediction itself has one where ``estimated``. The
    absolute error counts where ``scored``, which is a part of judged, and means nothing elsewhere.
    """

    truth: Disparity
    error: Disparity
    judged: Where
    estimated: Where
    scored: Where


@dataclass(frozen=True, slots=True)
class Protocol:
    """The definitions of a benchmark.

    Attributes:
        name: the benchmark's.
        source: the origin of the definitions.
        compare: a function of a prediction (H, W) float32 px, a truth (H, W) float32 px and the truth's limits; raises
            InputError where the sizes do not fit.
        columns: figures of the benchmark's table beside the common ones, each with its name in that table.
        decimals: a format specification, with which the evaluator prints numbers.
        percent: whether shares are percents; else fractions.
        single: whether printed numbers are float32, which decides some last digits.
        invalid_is_bad: whether a pixel that is judged and not scored counts as bad; else it is left out of the shares.
        pooled: whether several images count as one large image; else their figures are averaged.
        map_px: the error above which an error map shows a pixel as bad; None where the map shows the error itself.
        weights: of images in the mean, by name; 1 for all others.
    """

    name: ProtocolName
    source: str
    compare: Callable[[Disparity, Disparity, Limits], PixelComparison]
    columns: Mapping[str, str]
    decimals: str
    percent: bool = False
    single: bool = False
    invalid_is_bad: bool = False
    pooled: bool = False
    map_px: float | None = None
    weights: Mapping[str, float] = field(default_factory=dict)

    @property
    def headline(self) -> str:
        """The name of the figure that pairs are ranked by: of bad pixels where error maps have a bound, else D1-all."""
        return "D1-all" if self.map_px is None else f"bad-{self.map_px:g}"

    @property
    def full_share(self) -> float:
        """The share of all pixels in the protocol's unit: 100 percent, or a fraction of 1."""
        return 100.0 if self.percent else 1.0


def _compare_middlebury(prediction: Disparity, truth: Disparity, limits: Limits) -> PixelComparison:
    """Compare as Middlebury does.

    Source: evaldisp.cpp, version 1.6, of the MiddEval3 SDK. Judged is where the truth is not +inf. A prediction of half
    or a quarter of the truth's size, in pixels of its own size, is scaled; each pixel takes the nearest. Only +inf is
    invalid. All else is clipped to [0, s ndisp] (signed, above alone) and then, where the truth is in whole pixels,
    rounded, halves away from 0. Here s is the scale, and ndisp that of the prediction's size: the full size's, divided
    and rounded up. NaN stays NaN: it is never bad, and makes the mean error NaN.
    """
    scales = [scale for scale in (1, 2, 4) if tuple(scale * side for side in prediction.shape) == truth.shape]
    if not scales:
        raise _wrong_size(prediction, truth, "expected the truth's size, or exactly half or a quarter of it")
    scale = scales[0]
    # Halves and quarters are exact in float32, as in the kit.
    values = np.repeat(np.repeat(prediction * np.float32(scale), scale, axis=0), scale, axis=1)
    valid = values != np.inf
    largest = np.inf if limits.ndisp is None else scale * ceil(limits.ndisp / scale)
    values = np.clip(values, np.float32(-np.inf if limits.signed else 0), np.float32(largest))
    if limits.isint:
        # In float64: 0.5 added to the float32 below 0.5 is 1.
        values = np.floor(values.astype(np.float64) + 0.5).astype(np.float32)
    judged = truth != np.inf
    return PixelComparison(truth, _error(values, truth), judged, valid, judged & valid)


def _compare_eth3d(prediction: Disparity, truth: Disparity, _: Limits) -> PixelComparison:
    """Compare as ETH3D's two-view benchmark does.

    Source: src/main.cc of github.com/ETH3D/two-view-evaluation. Judged is where the truth is finite. A prediction that
    is NaN, infinite, or beyond plus or minus the image's width is left out of every figure but coverage.
    """
    _require_same_size(prediction, truth)
    judged = np.isfinite(truth)
    estimated = np.isfinite(prediction) & (np.abs(prediction) <= truth.shape[1])
    return PixelComparison(truth, _error(prediction, truth), judged, estimated, judged & estimated)


def _compare_kitti(prediction: Disparity, truth: Disparity, limits: Limits) -> PixelComparison:
    """Compare as KITTI 2015 does.

    Source: evaluate_scene_flow.cpp and io_disp.h of its development kit. Judged is where the truth has a value (in its
    PNG: not 0). Holes of the prediction are filled, see `fill_holes`, and judged like the rest; density is the share of
    pixels that were no holes. The kit reads 16-bit PNG alone; here NaN, infinite values, 0 and below are holes too, as
    they would be in a PNG, and float predictions are not rounded to 1/256 px. Of signed disparities, 0 and below are
    values like any other.
    """
    _require_same_size(prediction, truth)
    judged = np.isfinite(truth) & (limits.signed | (truth > 0))
    estimated = np.isfinite(prediction) & (limits.signed | (prediction > 0))
    return PixelComparison(truth, _error(fill_holes(prediction, estimated), truth), judged, estimated, judged)


def _compare_paper(prediction: Disparity, truth: Disparity, limits: Limits) -> PixelComparison:
    """Compare as the paper of this method does, with the script of HSM.

    Source: eval_mb.py of github.com/gengshan-y/high-res-stereo. Judged is where the truth is not +inf. A prediction is
    clipped above, at ndisp, and nowhere else: +inf becomes ndisp, and no pixel is invalid. The script also resizes
    predictions of other sizes, linearly; here they are refused.
    """
    _require_same_size(prediction, truth)
    values = prediction if limits.ndisp is None else np.minimum(prediction, np.float32(limits.ndisp))
    judged = truth != np.inf
    return PixelComparison(truth, _error(values, truth), judged, np.ones_like(judged), judged)


def fill_holes(disparity: Disparity, valid: Where) -> Disparity:
    """Fill holes of a prediction (H, W) px, where it is not valid, as KITTI's kit does.

    Source: ``interpolateBackground`` in io_disp.h of KITTI's development kit. Within a row a hole takes the smaller of
    its left and right neighbours; at the row's ends it takes the only one. Rows above the first row that has a value
    take that row's, and rows below the last take the last's. Rows without any value between such rows stay `UNFILLED`.
    """
    known, columns = np.where(valid, disparity, np.float32(np.nan)), np.arange(disparity.shape[1])
    before = np.maximum.accumulate(np.where(valid, columns, 0), axis=1)
    after = np.minimum.accumulate(np.where(valid, columns, columns[-1])[:, ::-1], axis=1)[:, ::-1]
    # At the ends of a row one of the sides is NaN, and fmin takes the other one.
    filled = np.fmin(*(np.take_along_axis(known, column, axis=1) for column in (before, after)))
    rows = np.flatnonzero(valid.any(axis=1))
    if rows.size:
        filled[: rows[0]] = filled[rows[0]]
        filled[rows[-1] + 1 :] = filled[rows[-1]]
    return np.where(np.isnan(filled), UNFILLED, filled)


def _error(values: Disparity, truth: Disparity) -> Disparity:
    with np.errstate(invalid="ignore", over="ignore"):
        error: Disparity = np.abs(values - truth)
    return error


def _require_same_size(prediction: Disparity, truth: Disparity) -> None:
    if prediction.shape != truth.shape:
        raise _wrong_size(prediction, truth, "expected the same size")


def _wrong_size(prediction: Disparity, truth: Disparity, expected: str) -> InputError:
    return InputError(f"the prediction has {shown_size(prediction)} pixels, its truth {shown_size(truth)}: {expected}")


def shown_size(image: NDArray[np.generic]) -> str:
    """Return the size of an image, (H, W), as messages give it: width x height."""
    return f"{image.shape[1]} x {image.shape[0]}"


# Decimals are those that each evaluator prints; ETH3D's prints six significant digits.
PROTOCOLS: Mapping[ProtocolName, Protocol] = {
    protocol.name: protocol
    for protocol in (
        Protocol(
            "middlebury",
            "MiddEval3 SDK, evaldisp 1.6",
            _compare_middlebury,
            columns={"avgerr": "avgerr", "coverage": "coverage", "invalid": "invalid"},
            decimals=".2f",
            percent=True,
            single=True,
            invalid_is_bad=True,
            map_px=2.0,
            weights=_MIDDLEBURY_WEIGHTS,
        ),
        Protocol(
            "eth3d",
            "ETH3D two-view evaluation",
            _compare_eth3d,
            columns={"avgerr": "avgerr", "coverage": "coverage"},
            decimals=".6g",
            map_px=1.0,
        ),
        Protocol(
            "kitti",
            "KITTI 2015 development kit",
            _compare_kitti,
            columns={"D1-bg": "D1-bg", "D1-fg": "D1-fg", "D1-est": "D1-est", "epe": "EPE", "coverage": "density"},
            decimals=".6f",
            single=True,
            pooled=True,
        ),
        Protocol(
            "paper",
            "HSM, eval_mb.py",
            _compare_paper,
            columns={"avgerr": "avgerr"},
            decimals=".3f",
            percent=True,
            map_px=2.0,
        ),
    )
}
"""The definitions of each benchmark by its name."""


def find_protocol(name: ProtocolName | Protocol) -> Protocol:
    """Return a benchmark's definitions by their name, or the given ones; an InputError lists the names."""
    if isinstance(name, Protocol):
        return name
    if not isinstance(name, str) or name not in PROTOCOLS:
        raise InputError(f"a protocol must be one of {', '.join(PROTOCOLS)}, got {shown(name)}")
    return PROTOCOLS[name]
