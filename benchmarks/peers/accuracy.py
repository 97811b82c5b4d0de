"""Errors of the disparities that the compared renderers write, against the project's float64 rays."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from exr import read_exr
from peer_semisynth_gl import own_models, own_scene
from scene import PeerScene

from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.scene.raycast import cast_rays

# A pixel counts if only one instance is within this distance around it, without a jump of disparity,
_FROM_EDGE_PX = 2
_JUMP_PX = 1.0
# and only one triangle within this distance: beside a crease, vertex rounding decides which triangle is drawn.
_FROM_CREASE_PX = 0.05
_AROUND = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if (x, y) != (0, 0)]


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Pixels of the left view whose disparity is known.

    Attributes:
        row: frame to (N,) int64.
        column: frame to (N,) int64.
        disparity_px: frame to (N,) float64.
    """

    row: dict[int, np.ndarray]
    column: dict[int, np.ndarray]
    disparity_px: dict[int, np.ndarray]


def cast_truth(scene: PeerScene, frames: Sequence[int], rays: int = 3000) -> Truth:
    """Cast rays through random pixels, without pixels near outlines and creases."""
    models, truth = own_models(scene), Truth({}, {}, {})
    rng = np.random.default_rng(0)
    for frame in frames:
        drawn = own_scene(scene, frame)
        row, column = rng.integers(0, scene.height_px, rays), rng.integers(0, scene.width_px, rays)
        hits = cast_rays(drawn, models, "left", column.astype(np.float64), row.astype(np.float64))
        disparity = drawn.camera.disparity_px(hits.depth_m)
        kept = (hits.instance >= 0) & (disparity > 0)
        for x, y in _AROUND:
            near = cast_rays(drawn, models, "left", column + _FROM_CREASE_PX * x, row + _FROM_CREASE_PX * y)
            kept &= (near.instance == hits.instance) & (near.triangle == hits.triangle)
            far = cast_rays(drawn, models, "left", column + _FROM_EDGE_PX * x, row + _FROM_EDGE_PX * y)
            kept &= far.instance == hits.instance
            kept &= np.abs(drawn.camera.disparity_px(far.depth_m) - disparity) < _JUMP_PX * _FROM_EDGE_PX
        truth.row[frame], truth.column[frame] = row[kept], column[kept]
        truth.disparity_px[frame] = disparity[kept]
    return truth


def read_disparity_map(folder: Path) -> np.ndarray:
    """Read the left disparity in a pair's folder, PFM or EXR."""
    [path] = (path for path in folder.glob("disp*") if "right" not in path.name)
    return read_exr(path) if path.suffix == ".exr" else PFM.read(path)


def errors_px(out: Path, truth: Truth) -> dict[str, float]:
    """Return the median, the 99.9 % quantile and the maximum of a renderer's absolute errors of disparity."""
    parts = []
    for frame, disparity in truth.disparity_px.items():
        drawn = read_disparity_map(out / f"{frame:06d}")[truth.row[frame], truth.column[frame]]
        parts.append(np.abs(drawn.astype(np.float64) - disparity))
    error = np.concatenate(parts)
    return {
        "median": float(np.median(error)),
        "p99_9": float(np.quantile(error, 0.999)),
        "worst": float(error.max()),
        "pixels": len(error),
    }
