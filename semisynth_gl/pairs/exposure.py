"""Motion blur: a long exposure is the mean of images of several moments.

The moments lie evenly and symmetrically about the frame's own time, so that the blurred image of a steadily moving
point is centred on its place in the truth. Images are averaged as 8-bit values and rounded once.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import Scene


def moments(share: float, count: int) -> NDArray[np.float64]:
    """Return the (count,) middles of ``count`` equal parts of an exposure, as times from the middle of the exposure.

    The times and the exposure's length ``share`` are in units of the time between frames.
    """
    return share * ((np.arange(count) + 0.5) / count - 0.5)


def expose(renderer: Renderer, scenes: Sequence[Scene], eyes: Sequence[Eye]) -> dict[Eye, NDArray[np.uint8]]:
    """Return the mean of the images of a scene at up to 257 moments, by eye; halves are rounded to the even level."""
    first, *others = scenes
    images = renderer.render_images(first, eyes)
    if not others:
        return images
    sums = {eye: image.astype(np.uint16) for eye, image in images.items()}
    for scene in others:
        for eye, image in renderer.render_images(scene, eyes).items():
            sums[eye] += image
    table = np.rint(np.arange(255 * len(scenes) + 1) / len(scenes)).astype(np.uint8)
    return {eye: np.take(table, total) for eye, total in sums.items()}
