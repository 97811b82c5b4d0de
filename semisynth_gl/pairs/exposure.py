"""Motion blur: an exposure that lasts is the mean of images of its moments.

Moments lie evenly and symmetrically about the frame's own time, so that what moves steadily is seen, on average, where
the truth has it. Images are averaged as 8-bit values and rounded once.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.frame import Frame
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import Scene

# Values that are averaged at a time.
_BLOCK = 1 << 17


def moments(share: float, count: int) -> NDArray[np.float64]:
    """Return the middles of ``count`` equal parts of an exposure, (count,), counted from its own middle.

    They, and the exposure's length ``share``, are in times between frames.
    """
    return share * ((np.arange(count) + 0.5) / count - 0.5)


def exposed(renderer: Renderer, frame: Frame, now: Scene, scenes: Sequence[Scene], eyes: Sequence[Eye] = EYES) -> Frame:
    """Return a frame with the mean of the images of several moments; the frame itself where nothing moves.

    Args:
        renderer: draws the images.
        frame: of the scene at its own time, whole.
        now: that scene.
        scenes: the same instances and camera at the moments of the exposure. Those that stand as they do now are not
            drawn again.
        eyes: whose images; the others stay.
    """
    moved = [scene for scene in scenes if not _stands(now, scene)]
    if not moved:
        return frame
    still = len(scenes) - len(moved)
    sums = {eye: np.multiply(frame.view(eye).image, still, dtype=np.uint16) for eye in eyes}
    for scene in moved:
        for eye, image in renderer.render_images(scene, eyes).items():
            sums[eye] += image
    views = {eye: frame.view(eye) for eye in EYES}
    views |= {eye: views[eye].with_channels({"image": _mean(total, len(scenes))}) for eye, total in sums.items()}
    return Frame(frame.camera, views["left"], views["right"])


def _stands(now: Scene, then: Scene) -> bool:
    return np.array_equal(now.camera_from_world, then.camera_from_world) and np.array_equal(
        now.world_from_model, then.world_from_model
    )


def _mean(total: NDArray[np.uint16], count: int) -> NDArray[np.uint8]:
    """Return a sum of images divided by their number, to the nearest level; halves go to the even one."""
    result = np.empty(total.shape, np.uint8)
    table = np.rint(np.arange(255 * count + 1) / count).astype(np.uint8)
    flat, values = result.reshape(-1), total.reshape(-1)
    for first in range(0, len(flat), _BLOCK):
        np.take(table, values[first : first + _BLOCK], out=flat[first : first + _BLOCK], mode="clip")
    return result
