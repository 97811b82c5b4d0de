"""What each benchmark's own evaluator does: which pixels it judges, what it makes of a prediction, how it averages.

Everything below was read from the evaluators' sources. What they have in common (bad: error > t, never >=) stands in
`semisynth_gl.metrics.score`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import ceil
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import InputError
from semisynth_gl.metrics.holes import fill_holes

ProtocolName = Literal["middlebury", "eth3d", "kitti", "paper"]
PROTOCOL_NAMES: tuple[ProtocolName, ...] = get_args(ProtocolName)

_SCALES = (1, 2, 4)
# The five hard ones of the 15 training pairs count half in the table on Middlebury's page.
_MIDDLEBURY_WEIGHTS = dict.fromkeys(("PianoL", "Playroom", "Playtable", "Shelves", "Vintage"), 0.5)


@dataclass(frozen=True, slots=True)
class Limits:
    """What a truth's calib.txt says of its disparities.

    Attributes:
        ndisp: an upper bound, px of the truth's size; None where nothing says so, and then there is none.
        isint: whether the truth is in whole pixels.
    """

    ndisp: int | None = None
    isint: bool = False


UNLIMITED = Limits()


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A prediction against the truth, pixel by pixel.

    Attributes:
        truth: (H, W) float32 px.
        error: (H, W) float32 px, absolute; of no meaning where not `scored`.
        judged: (H, W) bool, where the benchmark asks for a disparity.
        estimated: (H, W) bool, where the prediction has one of its own.
        scored: (H, W) bool, where `error` counts; among `judged`.
    """

    truth: NDArray[np.float32]
    error: NDArray[np.float32]
    judged: NDArray[np.bool_]
    estimated: NDArray[np.bool_]
    scored: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Protocol:
    """How a benchmark counts.

    Attributes:
        name: the benchmark's.
        source: where the definition is from.
        compare: prediction (H, W) float32 px, truth (H, W) float32 px and limits to a `Comparison`.
        invalid_is_bad: whether a pixel that is judged and not scored counts as bad; else it is left out of the shares.
        pooled: whether several images are one large one; else their figures are averaged.
        percent: whether shares are percents; else fractions.
        decimals: how numbers are printed, as a format specification.
        single: whether they are float32 when they are printed, which decides some last digits.
        columns: figures of its table, beside those that all have; each with what it is called there.
        map_px: from which error on its error map shows a pixel as bad; None where it shows the error itself.
        weights: of images in the mean, by name; 1 where it has none.
    """

    name: ProtocolName
    source: str
    compare: Callable[[NDArray[np.float32], NDArray[np.float32], Limits], Comparison]
    invalid_is_bad: bool
    pooled: bool
    percent: bool
    decimals: str
    single: bool
    columns: Mapping[str, str]
    map_px: float | None = None
    weights: Mapping[str, float] = field(default_factory=dict)

    @property
    def whole(self) -> float:
        """What all pixels are in its unit: 100 percent, or a fraction of 1."""
        return 100.0 if self.percent else 1.0


def compare_middlebury(
    prediction: NDArray[np.float32], truth: NDArray[np.float32], limits: Limits = UNLIMITED
) -> Comparison:
    """Compare as Middlebury does.

    Source: evaldisp.cpp, version 1.6, of the MiddEval3 SDK. Judged is where the truth is not +inf. A prediction of half
    or a quarter of the truth's size is scaled, each pixel taking the nearest. Only +inf is invalid. All else is clipped
    to [0, s ndisp], ndisp being that of the prediction's size and s the scale, and then, where the truth is in whole
    pixels, rounded, halves away from 0. So NaN stays NaN: it is never bad, and makes the mean error NaN.

    Args:
        prediction: (H, W), (H/2, W/2) or (H/4, W/4) float32 px, in pixels of its own size.
        truth: (H, W) float32 px.
        limits: the truth's. H and Q have an ndisp of their own, which is the full size's, divided and rounded up.

    Raises:
        InputError: where the sizes do not fit.
    """
    scale = _scale(prediction, truth)
    if scale is None:
        raise InputError(_sizes(prediction, truth, "expected the truth's size, or exactly half or a quarter of it"))
    # Halves and quarters are exact in float32, as in the kit.
    values = np.repeat(np.repeat(prediction * np.float32(scale), scale, axis=0), scale, axis=1)
    valid = values != np.inf
    largest = np.inf if limits.ndisp is None else scale * ceil(limits.ndisp / scale)
    values = np.clip(values, np.float32(0), np.float32(largest))
    if limits.isint:
        # In float64: 0.5 added to the float32 below 0.5 is 1.
        values = np.floor(values.astype(np.float64) + 0.5).astype(np.float32)
    judged = truth != np.inf
    return Comparison(truth, _error(values, truth), judged, valid, judged & valid)


def compare_eth3d(
    prediction: NDArray[np.float32], truth: NDArray[np.float32], limits: Limits = UNLIMITED
) -> Comparison:
    """Compare as ETH3D's two-view benchmark does.

    Source: src/main.cc of github.com/ETH3D/two-view-evaluation. Judged is where the truth is finite. A prediction that
    is NaN, infinite, or beyond plus or minus the image's width is left out of every figure but coverage.

    Args:
        prediction: (H, W) float32 px.
        truth: (H, W) float32 px.
        limits: not used: nothing is clipped or rounded.

    Raises:
        InputError: where the sizes differ.
    """
    del limits
    _require_same_size(prediction, truth)
    width = truth.shape[1]
    judged = np.isfinite(truth)
    estimated = np.isfinite(prediction) & (np.abs(prediction) <= width)
    return Comparison(truth, _error(prediction, truth), judged, estimated, judged & estimated)


def compare_kitti(
    prediction: NDArray[np.float32], truth: NDArray[np.float32], limits: Limits = UNLIMITED
) -> Comparison:
    """Compare as KITTI 2015 does.

    Source: evaluate_scene_flow.cpp and io_disp.h of its development kit. Judged is where the truth has a value (in its
    PNG: not 0). Holes of the prediction are filled, see `fill_holes`, and judged like the rest; density is the share of
    pixels that were no holes. The kit reads 16-bit PNG alone; here NaN, infinite values, 0 and below are holes too, as
    they would be in a PNG, and float predictions are not rounded to 1/256 px.

    Args:
        prediction: (H, W) float32 px.
        truth: (H, W) float32 px; NaN, infinite, 0 or below where there is none.
        limits: not used: nothing is clipped or rounded.

    Raises:
        InputError: where the sizes differ.
    """
    del limits
    _require_same_size(prediction, truth)
    judged = np.isfinite(truth) & (truth > 0)
    estimated = np.isfinite(prediction) & (prediction > 0)
    return Comparison(truth, _error(fill_holes(prediction, estimated), truth), judged, estimated, judged)


def compare_paper(
    prediction: NDArray[np.float32], truth: NDArray[np.float32], limits: Limits = UNLIMITED
) -> Comparison:
    """Compare as the paper of this method does, with the script of HSM.

    Source: eval_mb.py of github.com/gengshan-y/high-res-stereo. Judged is where the truth is not +inf. A prediction is
    clipped above, at ndisp, and nowhere else: +inf becomes ndisp, and no pixel is invalid. The script also resizes
    predictions of other sizes, linearly; here they are refused.

    Args:
        prediction: (H, W) float32 px.
        truth: (H, W) float32 px.
        limits: the truth's.

    Raises:
        InputError: where the sizes differ.
    """
    _require_same_size(prediction, truth)
    values = prediction if limits.ndisp is None else np.minimum(prediction, np.float32(limits.ndisp))
    judged = truth != np.inf
    return Comparison(truth, _error(values, truth), judged, np.ones_like(judged), judged)


PROTOCOLS: Mapping[ProtocolName, Protocol] = {
    "middlebury": Protocol(
        name="middlebury",
        source="MiddEval3 SDK, evaldisp 1.6",
        compare=compare_middlebury,
        invalid_is_bad=True,
        pooled=False,
        percent=True,
        decimals=".2f",
        single=True,
        columns={"avgerr": "avgerr", "coverage": "coverage", "invalid": "invalid"},
        map_px=2.0,
        weights=_MIDDLEBURY_WEIGHTS,
    ),
    "eth3d": Protocol(
        name="eth3d",
        source="ETH3D two-view evaluation",
        compare=compare_eth3d,
        invalid_is_bad=False,
        pooled=False,
        percent=False,
        decimals=".6g",
        single=False,
        columns={"avgerr": "avgerr", "coverage": "coverage"},
        map_px=1.0,
    ),
    "kitti": Protocol(
        name="kitti",
        source="KITTI 2015 development kit",
        compare=compare_kitti,
        invalid_is_bad=False,
        pooled=True,
        percent=False,
        decimals=".6f",
        single=True,
        columns={"D1-bg": "D1-bg", "D1-fg": "D1-fg", "D1-est": "D1-est", "epe": "EPE", "coverage": "density"},
    ),
    "paper": Protocol(
        name="paper",
        source="HSM, eval_mb.py",
        compare=compare_paper,
        invalid_is_bad=False,
        pooled=False,
        percent=True,
        decimals=".3f",
        single=False,
        columns={"avgerr": "avgerr"},
        map_px=2.0,
    ),
}
"""Decimals are those that each evaluator prints; ETH3D's prints six significant digits."""


def _error(values: NDArray[np.float32], truth: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(invalid="ignore", over="ignore"):
        error: NDArray[np.float32] = np.abs(values - truth)
    return error


def _scale(prediction: NDArray[np.float32], truth: NDArray[np.float32]) -> int | None:
    for scale in _SCALES:
        if (prediction.shape[0] * scale, prediction.shape[1] * scale) == truth.shape:
            return scale
    return None


def _require_same_size(prediction: NDArray[np.float32], truth: NDArray[np.float32]) -> None:
    if prediction.shape != truth.shape:
        raise InputError(_sizes(prediction, truth, "expected the same size"))


def _sizes(prediction: NDArray[np.float32], truth: NDArray[np.float32], wanted: str) -> str:
    (height, width), (true_height, true_width) = prediction.shape, truth.shape
    return f"the prediction has {width} x {height} pixels, its truth {true_width} x {true_height}: {wanted}"
