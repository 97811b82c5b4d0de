"""The correspondence pass: where the other eye sees what one eye sees, for right cameras that deviate."""

import numpy as np

from semisynth_gl.frame.camera import OTHER_EYE, Crop, Eye, StereoCamera
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.listed_steps import ListedSteps
from semisynth_gl.render.model_buffers import ModelBuffers
from semisynth_gl.render.placing import Placed
from semisynth_gl.render.readers import Reader
from semisynth_gl.render.targets import CORRESPONDENCE, EyeTargets, Targets

# Texture units of flow.comp, and its image units.
_OWN_DEPTH, _OWN_SURFACE, _OTHER_DEPTH, _OTHER_SURFACE, _OWN_DISPARITY = 0, 1, 2, 3, 6
_IMAGES = {"correspondence": 0, "disparity": 1, "visibility": 2}


class CorrespondencePass:
    """Compares both eyes' depths and surfaces in two compute steps; see flow.comp.

    Args:
        context: the open context.
        constants: its buffer of constants.
        read: what takes pixels.
    """

    def __init__(self, context: GraphicsContext, constants: ConstantsBuffer, read: Reader) -> None:
        self._context = context
        self._constants = constants
        self._read = read
        # Pixel by pixel, with one list of pixels.
        self._steps = ListedSteps(context, "flow.comp", 2, tile_px=1, entries=1, defines={"OTHER_EYE": 1})
        self._targets: Targets | None = None

    def draw(
        self, placed: Placed, eye: Eye, drawn: dict[Eye, EyeTargets], models: ModelBuffers, crop: Crop | None
    ) -> Targets:
        """Find the correspondences of what one eye's targets show; return what holds them until the next call.

        Of a rectified pair, correspondences are what the disparities in the targets say, and the targets' disparities
        and visibilities are better than those found here.
        """
        targets = self._sized(drawn[eye].framebuffer.size)
        scene, camera, other = placed.scene, placed.scene.camera, OTHER_EYE[eye]
        self._steps.set("rectified", camera.rectified)
        self._steps.set("turn_and_shift", _turn_and_shift(camera, eye))
        own_lens, lens = np.array(camera.lens_px(eye)), np.array(camera.lens_px(other))
        self._steps.set("own_lens", tuple(own_lens))
        self._steps.set("lens_change", tuple(lens - own_lens))
        models.bind_triangles(placed, other)
        drawn[eye].bind("depth", _OWN_DEPTH)
        drawn[eye].bind("surface", _OWN_SURFACE)
        drawn[eye].bind("disparity", _OWN_DISPARITY)
        drawn[other].bind("depth", _OTHER_DEPTH)
        drawn[other].bind("surface", _OTHER_SURFACE)
        for name, unit in _IMAGES.items():
            targets.bind_to_image(name, unit)
        self._constants.write(camera, other, scene.near_of(other))
        with self._context.clock.timed("correspondence", eye):
            self._steps.run(crop or Crop(0, 0, *drawn[eye].framebuffer.size))
        return targets

    def _sized(self, size: tuple[int, int]) -> Targets:
        """Return targets of an image size, new ones where it is another than before."""
        if self._targets is None or self._targets.framebuffer.size != size:
            targets = Targets(self._context, size, CORRESPONDENCE, self._read)
            # moderngl binds the framebuffer in use again after making a new one, so the old ones go last.
            targets.framebuffer.use()
            if self._targets is not None:
                self._targets.release()
            self._targets = targets
        return self._targets


def _turn_and_shift(camera: StereoCamera, eye: Eye) -> list[tuple[float, ...]]:
    """Return the rows of R - 1 and of the shift that take a point of one eye's frame to the other eye's."""
    other = OTHER_EYE[eye]
    own_turn, other_turn = (np.eye(3) if turn is None else turn for turn in (camera.turn(eye), camera.turn(other)))
    shift = other_turn @ (camera.offset_m(eye) - camera.offset_m(other), 0.0, 0.0)
    return [(*row, at) for row, at in zip(other_turn @ own_turn.T - np.eye(3), shift, strict=True)]
