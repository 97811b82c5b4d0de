"""The definitions of each benchmark's own evaluator: judged pixels, treatment of predictions, averages.

All definitions are taken from the evaluators' source code. The part that all evaluators share (a pixel is bad where
error > t, never >=) is in `semisynth_gl.judge.score`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.arguments import check_one_of
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.interpolation import fill_holes

ProtocolName = Literal["middlebury", "eth3d", "kitti", "paper"]
"""Name of a benchmark; ``paper`` stands for the definitions of HSM's eval_mb.py."""
PROTOCOL_NAMES: tuple[ProtocolName, ...] = get_args(ProtocolName)
Disparity = NDArray[np.float32]
Where = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a truth's disparities, as its calib.txt gives them.

    ``ndisp`` bounds the disparities from above, in pixels of the truth's size; None for no bound. ``isint`` says
    whether they are whole pixels, and ``signed`` whether 0 and below are valid.
    """

    ndisp: int | None = None
    isint: bool = False
    signed: bool = False


UNLIMITED = Limits()


class PixelComparison(NamedTuple):
    """A prediction compared with the truth pixel by pixel; all arrays are (H, W) of the truth's size.

    Attributes:
        truth: px.
        error: absolute error, px; meaningless where a pixel is not scored.
        judged: where the benchmark asks for a disparity.
        estimated: where the prediction itself has a valid disparity.
        scored: where the error counts; scored pixels are judged pixels.
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
        name: name of the benchmark.
        source: the program whose definitions these are.
        compare: compares a prediction (H, W) float32 px with a truth (H, W) float32 px under the truth's limits; raises
            InputError where the sizes do not fit.
        full_share: factor of all shares: 100 for percent, 1 for fractions.
        invalid_is_bad: whether a pixel that is judged but not scored counts as bad; otherwise shares leave it out.
        pooled: whether several images count as one large image; otherwise their figures are averaged.
        halved: names of the images that have half the weight of others in the mean.
    """

    name: ProtocolName
    source: str
    compare: Callable[[Disparity, Disparity, Limits], PixelComparison]
    full_share: float = 1.0
    invalid_is_bad: bool = False
    pooled: bool = False
    halved: frozenset[str] = frozenset()


def _compare_middlebury(prediction: Disparity, truth: Disparity, limits: Limits) -> PixelComparison:
    """Compare as evaldisp.cpp, version 1.6, of the MiddEval3 SDK does.

    A prediction of half or a quarter of the truth's size, whose disparities are in its pixels, is enlarged: each pixel
    takes the value of the nearest one. Only +inf is invalid. All other values are clipped to [0, s n], where s is the
    scale and n is the truth's ndisp / s, rounded up; signed values are clipped only from above. If the truth is in
    whole pixels, values are then rounded, halves upwards. NaN stays NaN: it is never bad, and makes the mean error NaN.
    """
    scale = next((scale for scale in (2, 4) if scale * prediction.shape[0] == truth.shape[0]), 1)
    _check_size(prediction, truth, scale)
    # Halves and quarters are exact in float32, as in the kit.
    values = np.repeat(np.repeat(prediction * np.float32(scale), scale, axis=0), scale, axis=1)
    valid = values != np.inf
    largest = np.inf if limits.ndisp is None else scale * ceil(limits.ndisp / scale)
    values = np.clip(values, np.float32(-np.inf if limits.signed else 0), np.float32(largest))
    if limits.isint:
        # In float64: in float32, 0.5 plus the largest number below 0.5 would be 1.
        values = np.floor(values.astype(np.float64) + 0.5).astype(np.float32)
    judged = truth != np.inf
    return PixelComparison(truth, _error(values, truth), judged, valid, judged & valid)


def _compare_eth3d(prediction: Disparity, truth: Disparity, _: Limits) -> PixelComparison:
    """Compare as src/main.cc of github.com/ETH3D/two-view-evaluation does.

    A prediction that is NaN, infinite, or larger in size than the image's width counts only in coverage and invalid.
    """
    _check_size(prediction, truth)
    judged = np.isfinite(truth)
    estimated = np.isfinite(prediction) & (np.abs(prediction) <= truth.shape[1])
    return PixelComparison(truth, _error(prediction, truth), judged, estimated, judged & estimated)


def _compare_kitti(prediction: Disparity, truth: Disparity, limits: Limits) -> PixelComparison:
    """Compare as evaluate_scene_flow.cpp and io_disp.h of KITTI 2015's development kit do.

    NaN, infinite values, 0 and, unless signed, negative values are holes. They are filled by `fill_holes`, and judged
    like all other pixels. Float predictions are not rounded to the kit's 1/256 px.
    """
    _check_size(prediction, truth)
    judged = np.isfinite(truth) & (limits.signed | (truth > 0))
    estimated = np.isfinite(prediction) & (limits.signed | (prediction > 0))
    filled = fill_holes(np.where(estimated, prediction, np.float32(np.nan)))
    return PixelComparison(truth, _error(filled, truth), judged, estimated, judged)


def _compare_paper(prediction: Disparity, truth: Disparity, limits: Limits) -> PixelComparison:
    """Compare as the paper of this method does, by eval_mb.py of github.com/gengshan-y/high-res-stereo.

    A prediction is clipped only from above, at ndisp, and no pixel is invalid. The script resizes predictions of other
    sizes linearly; here they raise InputError.
    """
    _check_size(prediction, truth)
    values = prediction if limits.ndisp is None else np.minimum(prediction, np.float32(limits.ndisp))
    judged = truth != np.inf
    return PixelComparison(truth, _error(values, truth), judged, np.ones_like(judged), judged)


def _error(values: Disparity, truth: Disparity) -> Disparity:
    with np.errstate(invalid="ignore", over="ignore"):
        error: Disparity = np.abs(values - truth)
    return error


def _check_size(prediction: Disparity, truth: Disparity, scale: int = 1) -> None:
    if tuple(scale * side for side in prediction.shape) != truth.shape:
        raise InputError(f"the prediction has {shown_size(prediction)} pixels, its truth {shown_size(truth)}")


def shown_size(image: NDArray[np.generic]) -> str:
    """Return the size of an image (H, W) or (H, W, C) for messages: width x height."""
    return f"{image.shape[1]} x {image.shape[0]}"


# In the table on Middlebury's page, the five hard ones of the 15 training pairs have half the weight.
_HARD = frozenset({"PianoL", "Playroom", "Playtable", "Shelves", "Vintage"})
_ROWS = (
    Protocol(
        "middlebury", "MiddEval3 SDK, evaldisp 1.6", _compare_middlebury, 100.0, invalid_is_bad=True, halved=_HARD
    ),
    Protocol("eth3d", "ETH3D two-view evaluation", _compare_eth3d),
    Protocol("kitti", "KITTI 2015 development kit", _compare_kitti, pooled=True),
    Protocol("paper", "HSM, eval_mb.py", _compare_paper, 100.0),
)
PROTOCOLS: Mapping[ProtocolName, Protocol] = {row.name: row for row in _ROWS}
"""The definitions of each benchmark by its name."""


def find_protocol(name: ProtocolName) -> Protocol:
    """Return the protocol of a name; an unknown name raises InputError."""
    check_one_of("protocol", name, PROTOCOLS)
    return PROTOCOLS[name]
