"""Draw the pictures of docs/rigs.md.

Run it as ``python docs/make_rigs.py docs/images``.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from make_picture import strip
from numpy.typing import NDArray

from semisynth_gl import load_config, render_pair
from semisynth_gl.pairs.pipeline import PairRenderer


def draw_baselines(path: Path) -> None:
    """Draw a left view, and three right views of it, each above the left disparity that belongs to it."""
    rig = {"width_px": 640, "baselines": [0.25, 0.5, 1.0], "baseline_m": None}
    with PairRenderer(load_config("sceneflow", {"camera": rig, "outputs": ["depth"]}), 0) as renderer:
        frames = [renderer.render(3 + view).frame for view in range(3)]
    left = frames[0].left
    largest = float(frames[-1].left.disparity.max())
    # What is nearer is brighter, as in disparity.
    above = [left.image, *(frame.right.image for frame in frames)]
    below = [_coloured(1 / left.depth, largest / frames[-1].camera.focal_baseline)]
    below += [_coloured(frame.left.disparity, largest) for frame in frames]
    gap = np.full((12, left.image.shape[1], 3), 255, np.uint8)
    columns = [np.concatenate([one, gap, two]) for one, two in zip(above, below, strict=True)]
    strip(columns, path)


def _coloured(values: NDArray[np.float32], largest: float) -> NDArray[np.uint8]:
    return (255 * mpl.colormaps["inferno"](values / largest)[..., :3]).astype(np.uint8)


def draw_rectification(path: Path) -> None:
    """Draw both images of a pair whose right camera deviates, and how far its rows are off."""
    config = load_config("sceneflow", ["rig.right_roll_deg=1", "rig.right_y_px=6", "outputs=[correspondence]"])
    frame = render_pair(config, index=1)
    off = mpl.colormaps["coolwarm"](frame.left.correspondence[..., 1] / 40 + 0.5)[..., :3]
    strip([frame.left.image, frame.right.image, (255 * off).astype(np.uint8)], path)


DRAWN: dict[str, Callable[[Path], None]] = {
    "rigs-baselines.jpg": draw_baselines,
    "rigs-rectification.jpg": draw_rectification,
}
"""What draws each picture, by the picture's name."""

if __name__ == "__main__":
    for name, draw in DRAWN.items():
        draw(Path(sys.argv[1]) / name)
