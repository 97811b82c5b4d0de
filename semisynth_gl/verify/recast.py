"""The strongest check: make a pair's scene again, and cast float64 rays at some of its pixels."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl import oracle
from semisynth_gl.camera import EYES, Eye
from semisynth_gl.errors import InputError
from semisynth_gl.read.dataset import Index
from semisynth_gl.read.stored import StoredFrame
from semisynth_gl.remake import RemadeScenes
from semisynth_gl.scene.scene import Scene
from semisynth_gl.splits import SplitName
from semisynth_gl.verify.finding import Verdict

# What the renderer promises for disparity at a pixel's centre.
_ERROR_PX = 1e-3
# Rasterisers move vertices to a grid of 1/256 px at best, of 1/16 px at worst: beside an edge they may see the
# surface on its other side.
_EDGE_PX = 1 / 32


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
        """Compare both disparities with rays through randomly chosen pixels.

        Args:
            frame: the pair as it was read.
            pixels: how many, half of them in each view.
            verdict: takes findings and measures.
        """
        made = self._remade.scene(frame)
        if made is None:
            verdict.add("oracle", "config and seed of the index give another camera than the pair's provenance has")
            return
        rng = np.random.default_rng((self._remade.seed, frame.index))
        errors = []
        for eye, disparity in zip(EYES, (frame.disparity_left, frame.disparity_right), strict=True):
            if disparity is None:
                continue
            height, width = disparity.shape
            x = rng.integers(0, width, -(-pixels // 2)).astype(np.float64)
            y = rng.integers(0, height, -(-pixels // 2)).astype(np.float64)
            came = disparity[y.astype(np.int64), x.astype(np.int64)].astype(np.float64)
            bound = _ERROR_PX + frame.rounding_px(came)
            expected = _as_said(self._cast(made, eye, x, y), came, frame.disparity_largest_px)
            error = _difference(came, expected)
            off = np.flatnonzero(~(error <= bound))
            errors.append(error[error <= bound])
            if off.size:
                off = off[~self._is_edge(made, eye, x[off], y[off], came[off], frame)]
            if off.size:
                first = off[0]
                verdict.add(
                    "oracle",
                    f"{eye}: {off.size} of {len(x)} pixels are off by more than {bound[first]:.3g} px; at "
                    f"({x[first]:.0f}, {y[first]:.0f}) the ray finds {expected[first]:.6g} px, "
                    f"the file has {came[first]:.6g} px",
                )
        verdict.measures["oracle_largest_px"] = float(np.concatenate(errors).max(initial=0.0))

    def _cast(self, scene: Scene, eye: Eye, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return oracle.disparity_px(scene.camera, oracle.cast(scene, self._remade.models, eye, x, y))

    def _is_edge(
        self,
        scene: Scene,
        eye: Eye,
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        came: NDArray[np.float64],
        frame: StoredFrame,
    ) -> NDArray[np.bool_]:
        """Whether rays within `_EDGE_PX` of each pixel's centre find disparities about what the file has there."""
        steps = np.array([-_EDGE_PX, -_EDGE_PX / 8, 0.0, _EDGE_PX / 8, _EDGE_PX])
        dx, dy = np.meshgrid(steps, steps)
        # All rays in one call: its cost is the number of instances more than the number of rays.
        near = self._cast(scene, eye, np.add.outer(x, dx.ravel()).ravel(), np.add.outer(y, dy.ravel()).ravel())
        near = _as_said(near.reshape(len(x), -1), came[:, None], frame.disparity_largest_px)
        bound = _ERROR_PX + frame.rounding_px(came)
        return np.asarray((near.min(axis=1) - bound <= came) & (came <= near.max(axis=1) + bound))


def _as_said(expected: NDArray[np.float64], came: NDArray[np.float64], largest_px: float) -> NDArray[np.float64]:
    """Make inf what a file's encoding cannot say, where the file has inf."""
    return np.where((expected > largest_px) & np.isinf(came), np.inf, expected)


def _difference(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Absolute difference; 0 where both are inf, inf where one is."""
    with np.errstate(invalid="ignore"):
        difference: NDArray[np.float64] = np.where(one == other, 0.0, np.abs(one - other))
    return difference
