"""Draw the pictures of docs/rigs.md.

Run it as ``python docs/make_rigs.py docs/images``.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from make_picture import strip

from semisynth_gl import load_config, render_pair


def draw_rectification(path: Path) -> None:
    """Draw both images of a pair whose right camera deviates, and how far its rows are off."""
    config = load_config("sceneflow", ["rig.right_roll_deg=1", "rig.right_y_px=6", "outputs=[correspondence]"])
    frame = render_pair(config, index=1)
    off = mpl.colormaps["coolwarm"](frame.left.correspondence[..., 1] / 40 + 0.5)[..., :3]
    strip([frame.left.image, frame.right.image, (255 * off).astype(np.uint8)], path)


DRAWN: dict[str, Callable[[Path], None]] = {
    "rigs-rectification.jpg": draw_rectification,
}
"""What draws each picture, by the picture's name."""

if __name__ == "__main__":
    for name, draw in DRAWN.items():
        draw(Path(sys.argv[1]) / name)
