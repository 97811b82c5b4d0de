"""Draw the picture of the README: left, right and disparity of one pair.

Run it as ``python docs/make_picture.py docs/images/pair.jpg``.
"""

import sys

import matplotlib as mpl
import numpy as np
from PIL import Image

from semisynth_gl import load_config, render_pair

frame = render_pair(load_config("sceneflow"), index=int(sys.argv[2]) if len(sys.argv) > 2 else 4)
shown = mpl.colormaps["inferno"](frame.disparity_left / 200)[..., :3]
panels = [frame.left, frame.right, (255 * shown).astype(np.uint8)]
gap = np.full((frame.left.shape[0], 12, 3), 255, np.uint8)
strip = np.concatenate([panels[0], gap, panels[1], gap, panels[2]], axis=1)
Image.fromarray(strip).reduce(2).save(sys.argv[1], quality=75)
