"""The real pairs that judge what networks learnt, and the score: bad-1 of the pixels that both eyes see."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge import Score, score, unconfirmed
from semisynth_gl.judge.score import mean_figures
from semisynth_gl.judge.truth import Truth

sys.path.append(str(Path(__file__).resolve().parents[2] / "examples"))

import judged_pairs

FIGURE = "bad-1"
_PROTOCOL = "middlebury"
_ONE_SURFACE_PX = 1.0
"""Pixels whose disparities differ by no more than this lie on one surface."""
_SGBM_BLOCK = 5


@dataclass(frozen=True, slots=True, eq=False)
class RealPair:
    """A pair to judge a network by.

    Attributes:
        left: (H, W, 3) uint8.
        right: (H, W, 3) uint8.
        truth: of the left pair.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    truth: Truth


Predictor = Callable[[RealPair], NDArray[np.float32]]


def read_pairs(folders: Sequence[Path], least_factor: int, max_disparity: float) -> dict[str, RealPair]:
    """Read the Motorcycle that scikit-image ships, and all scenes of folders in Middlebury's layout.

    Args:
        folders: as `judged_pairs.folder` takes them.
        least_factor: by which all are shrunk.
        max_disparity: px; pairs that show more are shrunk further, by the least whole factor that will do.

    Raises:
        InputError: where a folder has no scenes, or two scenes have one name.
    """
    pairs: dict[str, RealPair] = {}
    for judged in (judged_pairs.motorcycle(), *map(judged_pairs.folder, folders)):
        for number in range(len(judged)):
            item = judged[number]
            name, truth = item["name"], item["truth"]
            if name in pairs:
                raise InputError(f"{judged.title}: {name} is there twice: leave one of them out")
            if truth.visible is None:
                truth = Truth(truth.disparity, seen_by_both(truth.disparity))
            pair = RealPair(*(item[eye].numpy().transpose(1, 2, 0) for eye in ("left", "right")), truth)
            largest_px = float(truth.disparity[np.isfinite(truth.disparity)].max(initial=0))
            factor = max(least_factor, ceil(largest_px / max_disparity))
            pairs[name] = pair if factor == 1 else shrunk(pair, factor)
    return pairs


def seen_by_both(disparity: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Tell which pixels of a left view the right view sees too, by nothing but the left view's disparity.

    A pixel is hidden where a nearer one arrives at the same column of the right view, and out of view left of it.

    Args:
        disparity: (H, W) px, inf where there is none.
    """
    height, width = disparity.shape
    known = np.isfinite(disparity)
    columns = np.rint(np.arange(width) - np.where(known, disparity, 0)).astype(int)
    known &= columns >= 0
    rows = np.broadcast_to(np.arange(height)[:, None], disparity.shape)
    nearest = np.full(disparity.shape, -np.inf, np.float32)
    np.maximum.at(nearest, (rows[known], columns[known]), disparity[known])
    return known & (disparity >= nearest[rows, np.maximum(columns, 0)] - _ONE_SURFACE_PX)


def shrunk_image(image: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """Shrink (H, W, 3) by the means of squares of pixels; what is left over on the right and below is left out."""
    return np.rint(_squares(image, factor).mean((1, 3))).astype(np.uint8)


def shrunk_disparity(disparity: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Shrink (H, W) px, inf where there is none: squares of pixels that do not lie on one surface have none."""
    squares = _squares(disparity, factor)
    least, most = squares.min((1, 3)), squares.max((1, 3))
    one = np.isfinite(most) & (most <= least + _ONE_SURFACE_PX)
    means = np.where(one[:, None, :, None], squares, 0).mean((1, 3)) / factor
    return np.where(one, means, np.inf).astype(np.float32)


def shrunk(pair: RealPair, factor: int) -> RealPair:
    """Shrink a pair with its truth. A square counts as seen by both eyes where all of its pixels do."""
    visible = pair.truth.visible
    truth = Truth(
        shrunk_disparity(pair.truth.disparity, factor),
        None if visible is None else _squares(visible, factor).all((1, 3)),
    )
    return RealPair(shrunk_image(pair.left, factor), shrunk_image(pair.right, factor), truth)


def _squares(values: NDArray[Any], factor: int) -> NDArray[Any]:
    height, width = (side // factor for side in values.shape[:2])
    return values[: factor * height, : factor * width].reshape(height, factor, width, factor, *values.shape[2:])


def judge(pairs: Mapping[str, RealPair], predict: Predictor) -> tuple[dict[str, float], float]:
    """Predict pairs, and return the figure of each in %, and that of all as the benchmark averages them."""
    scores: dict[str, Score] = {}
    for name, pair in pairs.items():
        scores[name] = score(predict(pair), pair.truth.disparity, _PROTOCOL, mask=pair.truth.visible)
    return {name: each.figures()[FIGURE] for name, each in scores.items()}, mean_figures(scores)[FIGURE]


def mirrored(pair: RealPair) -> RealPair:
    """Swap the eyes of a pair and mirror both: a network's disparities of it are the right view's, mirrored."""
    return replace(pair, left=pair.right[:, ::-1], right=pair.left[:, ::-1])


def judge_without_truth(pairs: Mapping[str, RealPair], predict: Predictor) -> dict[str, float]:
    """Return what share of each pair's pixels the predictions of its other view do not confirm, %."""
    return {name: unconfirmed(predict(pair), predict(mirrored(pair))[:, ::-1]) for name, pair in pairs.items()}


def plainness(pair: RealPair) -> float:
    """Return the share of the left image, in %, whose 9 x 9 windows vary by less than 4 levels."""
    grey = pair.left.astype(np.float64).mean(axis=2)
    mean, square = (cv2.blur(values, (9, 9)) for values in (grey, grey**2))
    return float(100 * np.mean(np.sqrt(np.maximum(square - mean**2, 0)) < 4))


def semi_global(max_disparity: int) -> Predictor:
    """OpenCV's semi-global block matching, of all colours, holes filled with the farther of what lies beside them."""
    of_block = 3 * _SGBM_BLOCK**2
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=16 * -(-max_disparity // 16),
        blockSize=_SGBM_BLOCK,
        P1=8 * of_block,
        P2=32 * of_block,
        disp12MaxDiff=1,
        uniquenessRatio=5,
        speckleWindowSize=50,
        speckleRange=1,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )

    def predict(pair: RealPair) -> NDArray[np.float32]:
        # The columns on the left, for which the search would leave the image, are matched against its edge.
        beside = ((0, 0), (matcher.getNumDisparities(), 0), (0, 0))
        left, right = (np.pad(image, beside, mode="edge") for image in (pair.left, pair.right))
        found = matcher.compute(left, right)[:, matcher.getNumDisparities() :].astype(np.float32) / 16
        return _filled(np.where(found > 0, found, np.inf))

    return predict


def _filled(disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    known = np.isfinite(disparity)
    columns = np.arange(disparity.shape[1])
    before = np.maximum.accumulate(np.where(known, columns, -1), 1)
    after = np.minimum.accumulate(np.where(known, columns, len(columns))[:, ::-1], 1)[:, ::-1]
    # An infinite column to each side, for rows that begin or end with a hole.
    padded = np.pad(disparity, ((0, 0), (1, 1)), constant_values=np.inf)
    beside = (np.take_along_axis(padded, each + 1, 1) for each in (before, after))
    return np.minimum(*beside).astype(np.float32)
