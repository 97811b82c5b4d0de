"""Make the pictures of README and docs/rigs.md: a pair with its disparity, and two frames with their flow.

Run it as ``python docs/make_picture.py docs/images``.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.colors import hsv_to_rgb
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl import load_config, render_pair
from semisynth_gl.frame.frame import as_rgb
from semisynth_gl.pairs.pipeline import PairRenderer


def strip(panels: list[NDArray[np.uint8]], path: Path) -> None:
    """Write pictures of one size from left to right, at half their size."""
    gap = np.full((panels[0].shape[0], 12, 3), 255, np.uint8)
    beside = [part for panel in panels for part in (panel, gap)][:-1]
    Image.fromarray(np.concatenate(beside, axis=1)).reduce(2).save(path, quality=75)


def coloured(values: NDArray[np.floating], largest: float) -> NDArray[np.uint8]:
    """Return colours of values from 0 to ``largest``, which is bright."""
    return (255 * mpl.colormaps["inferno"](values / largest)[..., :3]).astype(np.uint8)


def flow_colours(flow: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return colours of flow, 0 to 1: the hue is its direction, and the saturation its length."""
    length = np.hypot(flow[..., 0], flow[..., 1])
    angle = np.arctan2(flow[..., 1], flow[..., 0]) / (2 * np.pi) % 1
    return hsv_to_rgb(np.stack([angle, np.clip(length / 40, 0, 1), np.ones_like(length)], axis=2))


def draw_pair(path: Path) -> None:
    """Show left and right image, and the disparity."""
    frame = render_pair(load_config("sceneflow"), index=1)
    strip([frame.left.image, frame.right.image, coloured(frame.left.disparity, 200)], path)


def draw_flow(path: Path) -> None:
    """Show two frames, the flow between them, and its mask."""
    config = load_config("sceneflow", ["scenes=[]", "camera.sway_m=0.05", "camera.sway_deg=1", "sequence.length=2"])
    with PairRenderer(config.model_copy(update={"outputs": ("flow",), "truth": "left"}), 1) as renderer:
        now, then = renderer.render(0).frame, renderer.render(1).frame
    mask = as_rgb(now.left.flow_visibility)
    strip([now.left.image, then.left.image, (255 * flow_colours(now.left.flow)).astype(np.uint8), mask], path)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    draw_pair(folder / "pair.jpg")
    draw_flow(folder / "flow.jpg")
