"""The visibility pass: marks the pixels of one eye's image that the other eye sees too."""

from semisynth_gl.camera import OTHER_EYE, Crop, Eye
from semisynth_gl.frame import VISIBLE
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.listed_steps import ListedSteps
from semisynth_gl.render.model_buffers import ModelBuffers
from semisynth_gl.render.placing import Placed
from semisynth_gl.render.targets import EyeTargets

# Texture units of visibility.comp, and its image unit.
_OWN_DISPARITY, _OTHER_DISPARITY, _OWN_SURFACE, _OTHER_SURFACE = range(4)
_VISIBILITY = 0
_TILE_PX = 4
# Two lists of tiles, and one of pixels.
_ENTRIES = 2 + _TILE_PX**2


class VisibilityPass:
    """Four compute steps, each for what the one before leaves open; see visibility.comp.

    Args:
        context: the open context.
        constants: its buffer of constants.
    """

    def __init__(self, context: GraphicsContext, constants: ConstantsBuffer) -> None:
        self._context = context
        self._constants = constants
        self._steps = ListedSteps(context, "visibility.comp", 4, _TILE_PX, _ENTRIES)

    def draw(
        self, placed: Placed, eye: Eye, targets: dict[Eye, EyeTargets], models: ModelBuffers, crop: Crop | None
    ) -> None:
        """Fill the visibility of one eye's targets, or a crop of it, from both eyes' disparities and surfaces."""
        own, other = targets[eye], targets[OTHER_EYE[eye]]
        if own.visibility is None:
            raise RuntimeError("these targets were made without visibility")
        own.visibility.limit(crop)
        own.visibility.bind_to_image("visibility", _VISIBILITY)
        own.bind("disparity", _OWN_DISPARITY)
        own.bind("surface", _OWN_SURFACE)
        other.bind("disparity", _OTHER_DISPARITY)
        other.bind("surface", _OTHER_SURFACE)
        models.bind_triangles(placed, OTHER_EYE[eye])
        self._constants.write(placed.scene.camera, OTHER_EYE[eye], placed.scene.near_of(OTHER_EYE[eye]))
        with self._context.clock.timed("masks", eye):
            own.visibility.framebuffer.use()
            self._context.unbound.clear_unsigned(0, VISIBLE)
            self._steps.run(crop or Crop(0, 0, *own.framebuffer.size))
