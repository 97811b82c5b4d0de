"""Ways to get the disparity: error against the oracle, and time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.scenes import BenchScenes, Checked
from semisynth_gl.bench.timing import alternated, compared, front
from semisynth_gl.camera import EYES
from semisynth_gl.render.variants import DEFAULT_WAY, DisparityVariants, Way

WAY_TEXTS: Mapping[Way, str] = {
    "depth24": "24-bit depth buffer, near plane at 0.05 m, made linear in float64",
    "depth24-tight": "24-bit depth buffer, near plane at the largest disparity, made linear in float64",
    "depth32f": "32-bit float depth buffer, reversed, made linear in float64",
    "linear": "interpolated linear depth",
    "w": "1/gl_FragCoord.w, by way of depth",
    "w-direct": "gl_FragCoord.w times f B",
    "plane": "plane equation of the triangle, float32",
    "plane64": "plane equation of the triangle, double precision",
}


@dataclass(frozen=True, slots=True)
class ErrorStats:
    """Absolute errors, px.

    Attributes:
        median_px: half of the pixels are better.
        p999_px: all but one in a thousand are better.
        worst_px: the largest.
        missing: pixels with a truth but no value, or the other way round.
    """

    median_px: float
    p999_px: float
    worst_px: float
    missing: int


@dataclass(frozen=True, slots=True)
class WayRow:
    """One way to get the disparity.

    Attributes:
        name: of `WAYS`.
        text: what it does.
        seconds_per_pair: both eyes drawn and read back, disparity alone.
        time_ratio: to the default's.
        error: against the oracle.
        on_front: whether no other way is both faster and more exact (at p99.9).
    """

    name: str
    text: str
    seconds_per_pair: float
    time_ratio: float
    error: ErrorStats
    on_front: bool


def error_stats(came: NDArray[np.floating], truth: NDArray[np.float64]) -> ErrorStats:
    """Compare values of any shape with the truth; what is not finite in both is passed over."""
    finite = np.isfinite(came) & np.isfinite(truth)
    error = np.abs(came[finite].astype(np.float64) - truth[finite])
    missing = int((np.isfinite(came) != np.isfinite(truth)).sum())
    if not error.size:
        return ErrorStats(np.nan, np.nan, np.nan, missing)
    return ErrorStats(float(np.median(error)), float(np.quantile(error, 0.999)), float(error.max()), missing)


def measure_ways(
    bench: BenchScenes, variants: DisparityVariants, checked: Sequence[Checked], repeats: int
) -> list[WayRow]:
    """Measure every way that the driver can do.

    Args:
        bench: the scenes.
        variants: draws them.
        checked: where the truth is known.
        repeats: how often each way draws all scenes, in turns.
    """
    truth = np.concatenate([part.disparity_px for part in checked])
    errors = {}
    for way in variants.ways:
        came = [variants.disparity(bench.scenes[part.scene], part.eye, way)[part.row, part.column] for part in checked]
        errors[way] = error_stats(np.concatenate(came), truth)

    def draw(way: Way) -> None:
        for scene in bench.scenes:
            for eye in EYES:
                variants.disparity(scene, eye, way)

    times = compared(
        alternated({way: partial(draw, way) for way in variants.ways}, repeats), DEFAULT_WAY, len(bench.scenes)
    )
    best = front({way: (times[way].ratio, errors[way].p999_px) for way in variants.ways})
    return [
        WayRow(way, WAY_TEXTS[way], times[way].seconds, times[way].ratio, errors[way], way in best)
        for way in variants.ways
    ]
