"""How each benchmark's evaluator selects pixels, reads predictions and averages images, according to its source code.

`semisynth_gl.judge.score` has what all evaluators share: a pixel is bad if error > t, never >=.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.interpolation import fill_holes

ProtocolName = Literal["middlebury", "eth3d", "kitti", "paper"]
"""Name of a benchmark; ``paper`` is HSM's eval_mb.py, which the paper of this method used."""

Disparity = NDArray[np.float32]
Where = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The truth of a pair's left view; all arrays are (H, W).

    Attributes:
        disparity: float32 px, inf where unknown.
        visible: True where the right view also sees the point; None if the set has no mask.
        objects: 0 in the background, the number of an object elsewhere, as in KITTI's obj_map; None without such a map.
        ndisp: upper bound of the disparities, px, from calib.txt; None for no bound.
        isint: whether the disparities are whole pixels, from calib.txt.
        signed: whether disparities of 0 and below are valid.
    """

    disparity: Disparity
    visible: Where | None = None
    objects: NDArray[np.uint8] | None = None
    ndisp: int | None = None
    isint: bool = False
    signed: bool = False


class PixelComparison(NamedTuple):
    """A prediction compared with the truth pixel by pixel; all arrays are (H, W) of the truth's size.

    Attributes:
        truth: the truth.
        error: absolute error, float32 px; meaningless in pixels that are not scored.
        judged: where the benchmark asks for a disparity.
        estimated: where the prediction has a valid disparity, before holes are filled.
        scored: the judged pixels whose error is used.
    """

    truth: Truth
    error: Disparity
    judged: Where
    estimated: Where
    scored: Where


@dataclass(frozen=True, slots=True)
class Protocol:
    """How a benchmark compares predictions with the truth.

    Attributes:
        name: name of the benchmark.
        source: the evaluator from which the definitions come.
        read: for a prediction and the truth, returns three arrays (H, W): the predicted disparities to compare, float32
            px; True where the prediction is valid; True where the benchmark judges the pixel.
        full_share: factor of all shares: 100 for percent, 1 for fractions.
        invalid: treatment of a judged pixel whose prediction is not valid: it is ``bad``, or ``left out`` of shares and
            means, or ``filled`` by ``read`` and then compared.
        pooled: whether several images count as one large image; otherwise their figures are averaged.
        halved: names of the images with half weight in the mean.
    """

    name: ProtocolName
    source: str
    read: Callable[[Disparity, Truth], tuple[Disparity, Where, Where]]
    full_share: float = 1.0
    invalid: Literal["bad", "left out", "filled"] = "left out"
    pooled: bool = False
    halved: frozenset[str] = frozenset()

    def compare(self, prediction: Disparity, truth: Truth) -> PixelComparison:
        """Compare a prediction (H, W), float32 px, with the truth; raises InputError if sizes do not fit."""
        values, estimated, judged = self.read(prediction, truth)
        for name, array in {"prediction": values, "mask": truth.visible, "map of objects": truth.objects}.items():
            if array is not None and array.shape != truth.disparity.shape:
                size = shown_size(prediction if array is values else array)
                raise InputError(f"the {name} has {size} pixels, the truth {shown_size(truth.disparity)}")
        with np.errstate(invalid="ignore", over="ignore"):
            error: Disparity = np.abs(values - truth.disparity)
        scored = judged if self.invalid == "filled" else judged & estimated
        return PixelComparison(truth, error, judged, estimated, scored)


def _read_middlebury(prediction: Disparity, truth: Truth) -> tuple[Disparity, Where, Where]:
    """Read as evaldisp.cpp, version 1.6, of the MiddEval3 SDK does.

    A prediction of 1/s of the truth's size, s = 2 or 4, with disparities in pixels of that size, is enlarged by
    repeating pixels. Only +inf is invalid. All other values are clipped to [0, s ceil(ndisp / s)]; signed values are
    clipped only from above. If the truth has whole pixels, values are then rounded, halves upwards. NaN stays NaN: such
    a pixel is never bad, and makes the mean error NaN.
    """
    scale = next((scale for scale in (2, 4) if scale * prediction.shape[0] == truth.disparity.shape[0]), 1)
    values = np.repeat(np.repeat(prediction * np.float32(scale), scale, axis=0), scale, axis=1)
    valid = values != np.inf
    largest = np.inf if truth.ndisp is None else scale * ceil(truth.ndisp / scale)
    values = np.clip(values, np.float32(-np.inf if truth.signed else 0), np.float32(largest))
    if truth.isint:
        # In float32, 0.5 plus the largest number below 0.5 would be 1.
        values = np.floor(values.astype(np.float64) + 0.5).astype(np.float32)
    return values, valid, truth.disparity != np.inf


def _read_eth3d(prediction: Disparity, truth: Truth) -> tuple[Disparity, Where, Where]:
    """Read as src/main.cc of github.com/ETH3D/two-view-evaluation does.

    NaN, infinite values and values above the image's width in magnitude are invalid.
    """
    valid = np.isfinite(prediction) & (np.abs(prediction) <= truth.disparity.shape[1])
    return prediction, valid, np.isfinite(truth.disparity)


def _read_kitti(prediction: Disparity, truth: Truth) -> tuple[Disparity, Where, Where]:
    """Read as evaluate_scene_flow.cpp and io_disp.h of KITTI 2015's development kit do.

    NaN, infinite values and, unless signed, 0 and negative values are holes, which `fill_holes` fills. Float
    predictions are not rounded to the kit's 1/256 px.
    """
    valid, judged = (np.isfinite(each) & (truth.signed | (each > 0)) for each in (prediction, truth.disparity))
    return fill_holes(np.where(valid, prediction, np.float32(np.nan))), valid, judged


def _read_paper(prediction: Disparity, truth: Truth) -> tuple[Disparity, Where, Where]:
    """Read as the paper of this method does, by eval_mb.py of github.com/gengshan-y/high-res-stereo.

    A prediction is clipped only from above, at ndisp, and no pixel is invalid. The script resizes predictions whose
    size differs from the truth's; `Protocol.compare` refuses them.
    """
    values = prediction if truth.ndisp is None else np.minimum(prediction, np.float32(truth.ndisp))
    return values, np.ones(values.shape, bool), truth.disparity != np.inf


def shown_size(image: NDArray[np.generic]) -> str:
    """Return the size of an image (H, W) or (H, W, C) for messages: width x height."""
    return f"{image.shape[1]} x {image.shape[0]}"


# In the table on Middlebury's page, these five hard training pairs have half the weight of the other ten.
_HARD = frozenset({"PianoL", "Playroom", "Playtable", "Shelves", "Vintage"})
PROTOCOLS: Mapping[ProtocolName, Protocol] = {
    row.name: row
    for row in (
        Protocol("middlebury", "MiddEval3 SDK, evaldisp 1.6", _read_middlebury, 100.0, "bad", halved=_HARD),
        Protocol("eth3d", "ETH3D two-view evaluation", _read_eth3d),
        Protocol("kitti", "KITTI 2015 development kit", _read_kitti, invalid="filled", pooled=True),
        Protocol("paper", "HSM, eval_mb.py", _read_paper, 100.0),
    )
}
"""The definitions of each benchmark by its name."""
