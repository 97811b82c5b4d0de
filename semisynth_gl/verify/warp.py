"""A frame's image against the next one, warped by the flow: textures move with their surfaces and carry no light."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.verify.consistency import FEWEST
from semisynth_gl.verify.finding import Verdict
from semisynth_gl.verify.landing import Landing, spread
from semisynth_gl.verify.photometry import (
    BEND,
    DEVIATIONS,
    EXPLAINED_SHARE,
    ROUNDING_LEVELS,
    SCALE,
    SHIFT_PX,
    Sampler,
    Values,
    best_step,
    cubic,
    grey,
    tiles,
)

# Sixteen pixels are read for each of these, many times over.
_MOST = 40_000


@dataclass(frozen=True, slots=True, eq=False)
class _Warp:
    """Points of an image (H, W) of grey levels, to be moved about.

    Attributes:
        image: (H, W) float32 levels.
        x: (N,) float64.
        y: (N,) float64.
    """

    image: NDArray[np.float32]
    x: Values
    y: Values

    def samples(self, x: Values, y: Values) -> tuple[Values, Values, Values]:
        """Four rows of four pixels (4, 4, N) about points, and the fractions across and down between the inner ones."""
        height, width = self.image.shape
        x, y = x.clip(1, width - 2.001), y.clip(1, height - 2.001)
        column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        steps = (-1, 0, 1, 2)
        values = np.array([[self.image[row + down, column + across] for across in steps] for down in steps], np.float64)
        return values, x - column, y - row

    def along(self, direction: Values) -> Sampler:
        """What the image has at steps along a direction (N, 2), and how fast it changes."""

        def sample(step: float) -> tuple[Values, Values]:
            values, across, down = self.samples(self.x + step * direction[:, 0], self.y + step * direction[:, 1])
            rows = [cubic(row, across) for row in values]
            value, slope_down = cubic(np.stack([row[0] for row in rows]), down)
            slope_across = cubic(np.stack([row[1] for row in rows]), down)[0]
            return value, slope_across * direction[:, 0] + slope_down * direction[:, 1]

        return sample


def check_warped(
    name: str,
    measure: str,
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    landing: Landing,
    verdict: Verdict,
) -> None:
    """Check that one frame's image, looked up where flow leads in another's, is its image; as `check_images` does.

    First the share of pixels whose residual resampling explains; then the shifts and the factor of flow at which the
    images fit best: all must be zero.

    Args:
        name: of the flow, for messages.
        measure: what names of measures begin with.
        images: of the frame that the flow is of, and of the one that it leads to; (H, W, 3) uint8.
        landing: the pixels to judge: visible, on one surface.
        verdict: takes findings and measures.
    """
    height, width = images[1].shape[:2]
    whole = (landing.x >= 1) & (landing.x < width - 2.001) & (landing.y >= 1) & (landing.y < height - 2.001)
    landing = landing.only(spread(np.flatnonzero(whole), _MOST))
    if len(landing) < FEWEST:
        return
    own = grey(images[0])[landing.row, landing.column].astype(np.float64)
    warp = _Warp(grey(images[1]), landing.x, landing.y)
    share = float(np.mean(_explained(own, warp.samples(landing.x, landing.y)[0])))
    verdict.measures[f"{measure}_explained_share"] = share
    if share < EXPLAINED_SHARE:
        verdict.add(
            "flow-images",
            f"{name}: resampling explains the residual in {share:.1%} of {len(own)} visible pixels, at least "
            f"{EXPLAINED_SHARE:.0%} were expected",
        )
        return
    flow = np.stack([landing.x - landing.column, landing.y - landing.row], axis=1)
    one, none = np.ones(len(own)), np.zeros(len(own))
    # A factor that moves pixels by no more than the shift that is allowed cannot be told from one.
    typical = float(np.sqrt(np.mean((flow**2).sum(axis=1))))
    for label, unit, direction, least in (
        ("shift_x", "px", np.stack([one, none], axis=1), SHIFT_PX),
        ("shift_y", "px", np.stack([none, one], axis=1), SHIFT_PX),
        ("scale", "times", flow, max(SCALE, SHIFT_PX / max(typical, SHIFT_PX))),
    ):
        tile = tiles(landing.row, landing.column, width)
        best = best_step(own, warp.along(direction), (direction**2).sum(axis=1), tile)
        if best is None:
            return
        step, deviation = best
        verdict.measures[f"{measure}_best_{label}_{unit}"] = step
        limit = least + DEVIATIONS * deviation
        if abs(step) > limit:
            where = f"x times {1 + step:.4f}" if label == "scale" else f"{label[-1]} {step:+.3f} px"
            verdict.add("flow-images", f"{name}: they fit best at {where}; at most {limit:.4f} {unit} off was expected")


def _explained(own: Values, samples: Values) -> NDArray[np.bool_]:
    """Whether levels (N,) lie between the four pixels around, up to the image's bend there; samples are (4, 4, N)."""
    inner = samples[1:3, 1:3].reshape(4, -1)
    across = np.abs(np.diff(samples[1:3], 2, axis=1)).max(axis=(0, 1))
    down = np.abs(np.diff(samples[:, 1:3], 2, axis=0)).max(axis=(0, 1))
    margin = ROUNDING_LEVELS + BEND * (across + down)
    explained: NDArray[np.bool_] = (own >= inner.min(axis=0) - margin) & (own <= inner.max(axis=0) + margin)
    return explained
