"""Motion blur: a long exposure is the mean of images of several moments.

The moments lie evenly and symmetrically about the frame's own time, so that the blurred image of a steadily moving
point is centred on its place in the truth. Images are averaged as 8-bit values and rounded once.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import Scene

# Number of values that are averaged at a time.
_BLOCK = 1 << 17


def moments(share: float, count: int) -> NDArray[np.float64]:
    """Return the (count,) middles of ``count`` equal parts of an exposure, as times from the middle of the exposure.

    The times and the exposure's length ``share`` are in units of the time between frames.
    """
    return share * ((np.arange(count) + 0.5) / count - 0.5)


def exposed(
    renderer: Renderer, images: Mapping[Eye, NDArray[np.uint8]], now: Scene, scenes: Sequence[Scene]
) -> dict[Eye, NDArray[np.uint8]]:
    """Return the mean of the images of several moments; the same images if nothing moves.

    Args:
        renderer: draws the images.
        images: the images of the scene at its own time, by the eyes whose images to blur.
        now: the scene at its own time.
        scenes: the scene with the same instances and cameras at each moment of the exposure, up to 257 moments. Scenes
            equal to ``now`` are not drawn again.
    """
    moved = [scene for scene in scenes if not _stands(now, scene)]
    if not moved:
        return dict(images)
    still = len(scenes) - len(moved)
    sums = {eye: np.multiply(image, still, dtype=np.uint16) for eye, image in images.items()}
    for scene in moved:
        for eye, image in renderer.render_images(scene, tuple(images)).items():
            sums[eye] += image
    return {eye: _mean(total, len(scenes)) for eye, total in sums.items()}


def _stands(now: Scene, then: Scene) -> bool:
    return np.array_equal(now.camera_from_world, then.camera_from_world) and np.array_equal(
        now.world_from_model, then.world_from_model
    )


def _mean(total: NDArray[np.uint16], count: int) -> NDArray[np.uint8]:
    """Return a sum of images divided by their number, rounded to the nearest level, and halves to the even level."""
    result = np.empty(total.shape, np.uint8)
    table = np.rint(np.arange(255 * count + 1) / count).astype(np.uint8)
    flat, values = result.reshape(-1), total.reshape(-1)
    for first in range(0, len(flat), _BLOCK):
        np.take(table, values[first : first + _BLOCK], out=flat[first : first + _BLOCK], mode="clip")
    return result
