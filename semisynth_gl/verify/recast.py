"""The strongest check: make a pair's scene again, and cast float64 rays at some of its pixels."""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from semisynth_gl import oracle
from semisynth_gl.camera import EYES, Eye
from semisynth_gl.dataset.reader import Index
from semisynth_gl.dataset.remake import RemadeScenes
from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.errors import InputError
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.scene import Motion
from semisynth_gl.splits import SplitName
from semisynth_gl.verify.compared import vector
from semisynth_gl.verify.finding import Verdict
from semisynth_gl.verify.flow import OPPOSITE, flow_bound_px

Found = Mapping[str, NDArray[np.float64]]
"""What R rays find, by the arrays of `Frame` without the view, each (R, C) in px."""

# What the renderer promises for disparity at a pixel's centre.
_ERROR_PX = 1e-3
# Rasterisers move vertices to a grid of 1/256 px at best, of 1/16 px at worst: beside an edge they may see the
# surface on its other side.
_EDGE_PX = 1 / 32
# Rays about a pixel's centre: steps to the right and down, 25 of each.
_STEPS = (-_EDGE_PX, -_EDGE_PX / 8, 0.0, _EDGE_PX / 8, _EDGE_PX)
_NEAR = tuple(steps.ravel() for steps in np.meshgrid(_STEPS, _STEPS))
_MEASURES = {
    "disparity": "oracle_largest_px",
    "flow": "oracle_flow_largest_px",
    "flow_backward": "oracle_flow_largest_px",
    "disparity_change": "oracle_change_largest_px",
}


class Recaster:
    """Judges the pairs of a split by their scenes, made again.

    Args:
        index: the dataset.
        split: whose pairs.

    Raises:
        InputError: where its scenes cannot be made again; see `RemadeScenes`.
    """

    def __init__(self, index: Index, split: SplitName) -> None:
        try:
            self._remade = RemadeScenes(index, split)
        except InputError as error:
            raise InputError(
                f"{error}. --oracle needs them; verify without it to see what else is wrong with the dataset"
            ) from None

    def check(self, frame: StoredFrame, pixels: int, verdict: Verdict) -> None:
        """Compare disparities, flow and changes of disparity with rays through randomly chosen pixels.

        Args:
            frame: the pair as it was read.
            pixels: how many, half of them in each view.
            verdict: takes findings and measures.
        """
        made = self._remade.sampled(frame)
        if made is None:
            verdict.add("oracle", "config and seed of the index give another camera than the pair's provenance has")
            return
        motions = {
            name: self._remade.motion(made, frames)
            for name, frames, needs in (
                ("flow", +1, ("flow", "disparity_change")),
                ("flow_backward", -1, ("flow_backward",)),
            )
            if any(getattr(frame, f"{each}_{eye}") is not None for each in needs for eye in EYES)
        }
        rng = np.random.default_rng((self._remade.seed, frame.index))
        largest: dict[str, float] = {}
        for eye in EYES:
            disparity = getattr(frame, f"disparity_{eye}")
            if disparity is None:
                continue
            height, width = disparity.shape
            x = rng.integers(0, width, -(-pixels // 2)).astype(np.float64)
            y = rng.integers(0, height, -(-pixels // 2)).astype(np.float64)
            look = partial(self._look, made, eye)
            for measure, error in _compare(frame, eye, (x, y), motions, look, verdict).items():
                largest[measure] = max(largest.get(measure, 0.0), error)
        verdict.measures.update(largest)

    def _look(
        self,
        made: SampledScene,
        eye: Eye,
        motions: Mapping[str, Motion],
        x: NDArray[np.float64],
        y: NDArray[np.float64],
    ) -> Found:
        scene, models = made.scene, self._remade.models
        hits = cast_rays(scene, models, eye, x, y)
        found = {"disparity": oracle.disparity_px(scene.camera, hits)[:, None]}
        for name, motion in motions.items():
            flows = oracle.flow(scene, models, motion, eye, x, y, hits)
            found[name] = flows.flow_px
            if name == "flow":
                found["disparity_change"] = flows.disparity_change_px[:, None]
        return found


def _compare(
    frame: StoredFrame,
    eye: Eye,
    pixels: tuple[NDArray[np.float64], NDArray[np.float64]],
    motions: Mapping[str, Motion],
    look: Callable[[Mapping[str, Motion], NDArray[np.float64], NDArray[np.float64]], Found],
    verdict: Verdict,
) -> dict[str, float]:
    """Compare a view's arrays with what rays find; return the largest errors that are allowed, by measure."""
    x, y = pixels
    largest: dict[str, float] = {}
    found = look(motions, x, y)
    for name, expected in found.items():
        array = getattr(frame, f"{name}_{eye}")
        if array is None:
            continue
        came = array[y.astype(np.int64), x.astype(np.int64)].reshape(len(x), -1).astype(np.float64)
        bound = _bound_px(frame, name, came)
        error = _difference(came, _as_said(frame, name, found, came)).max(axis=1)
        off = np.flatnonzero(~(error <= bound))
        measure = _MEASURES[name]
        largest[measure] = max(largest.get(measure, 0.0), float(error[error <= bound].max(initial=0.0)))
        if off.size:
            of = "flow" if name == "disparity_change" else name
            moves = {of: motions[of]} if of in motions else {}
            near = look(
                moves, *(np.add.outer(each[off], step).ravel() for each, step in zip(pixels, _NEAR, strict=True))
            )
            off = off[~_is_edge(frame, name, near, came[off], bound[off])]
        if off.size:
            first = off[0]
            label = eye if name == "disparity" else f"{name}_{eye}"
            verdict.add(
                "oracle",
                f"{label}: {off.size} of {len(x)} pixels are off by more than {bound[first]:.3g} px; at "
                f"({x[first]:.0f}, {y[first]:.0f}) the ray finds {vector(expected[first])} px, "
                f"the file has {vector(came[first])} px",
            )
    return largest


def _bound_px(frame: StoredFrame, name: str, came: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the most that values (R, C) of a file may be off by, (R,) px."""
    if name == "disparity":
        return _ERROR_PX + frame.rounding_px(came[:, 0])
    known = np.where(np.isfinite(came), came, 0.0)
    return flow_bound_px(known, 0.0 if name == "disparity_change" else frame.flow_error_px)


def _is_edge(
    frame: StoredFrame,
    name: str,
    near: Found,
    came: NDArray[np.float64],
    bound: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Whether rays within `_EDGE_PX` of each pixel's centre, ``near``, find about what the file has there, (R, C)."""
    every = np.repeat(came, len(_NEAR[0]), axis=0)
    values = _as_said(frame, name, near, every).reshape(len(came), -1, came.shape[1])
    low, high = values.min(axis=1) - bound[:, None], values.max(axis=1) + bound[:, None]
    return np.asarray(((low <= came) & (came <= high)).all(axis=1))


def _as_said(frame: StoredFrame, name: str, found: Found, came: NDArray[np.float64]) -> NDArray[np.float64]:
    """Make inf, of what rays find, what a file's encodings cannot say, where the file has inf; both (R, C)."""
    # Where the disparity cannot be said, its change is left out too.
    source, largest_px = found["disparity"], frame.disparity_largest_px
    if name in OPPOSITE:
        source, largest_px = np.abs(found[name]).max(axis=1, keepdims=True), frame.flow_largest_px
    unsaid = np.isinf(came).all(axis=1, keepdims=True) & (source > largest_px)
    return np.where(unsaid, np.inf, found[name])


def _difference(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Absolute difference; 0 where both are inf, inf where one is."""
    with np.errstate(invalid="ignore"):
        difference: NDArray[np.float64] = np.where(one == other, 0.0, np.abs(one - other))
    return difference
