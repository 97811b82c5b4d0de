"""The visibility pass: marks the pixels of one eye's image that the other eye sees too."""

from semisynth_gl.frame.camera import OTHER_EYE, Crop, Eye
from semisynth_gl.frame.frame import VISIBLE
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.listed_steps import ListedSteps
from semisynth_gl.render.model_buffers import ModelBuffers
from semisynth_gl.render.placing import Placed
from semisynth_gl.render.slivers import OpenPoints, SliverPass
from semisynth_gl.render.targets import EyeTargets

# Texture units of visibility.comp, and its image unit.
_OWN_DISPARITY, _OTHER_DISPARITY, _OWN_SURFACE, _OTHER_SURFACE = range(4)
_VISIBILITY = 0
_TILE_PX = 4
# Two lists of tiles, and one of pixels.
_ENTRIES = 2 + _TILE_PX**2


class VisibilityPass:
    """Four compute steps, each for what the one before leaves open (visibility.comp), and the sliver pass.

    Args:
        context: the open context.
        models: the models on the GPU.
        constants: the context's buffer of constants.

    Raises:
        BackendError: where the driver refuses a shader.
    """

    def __init__(self, context: GraphicsContext, models: ModelBuffers, constants: ConstantsBuffer) -> None:
        self._context = context
        self._models, self._constants = models, constants
        self._slivers = SliverPass(context, models)
        self._open: OpenPoints | None = None
        self._steps = ListedSteps(context, "visibility.comp", 4, _TILE_PX, _ENTRIES)

    def resize(self, size: tuple[int, int]) -> None:
        """Make room for another image size; a size that the driver refuses leaves the pass as it was."""
        outgrown, self._open = self._open, OpenPoints(self._context, size)
        # moderngl binds the framebuffer in use again after making a new one, so the old one goes last.
        self._open.collect()
        if outgrown is not None:
            outgrown.release()

    def draw(self, placed: Placed, eye: Eye, targets: dict[Eye, EyeTargets], crop: Crop | None) -> None:
        """Fill the visibility of one eye's targets, or a crop of it, from both eyes' disparities and surfaces."""
        own, other = targets[eye], targets[OTHER_EYE[eye]]
        if own.visibility is None or self._open is None:
            raise RuntimeError("these targets were made without visibility")
        own.visibility.limit(crop)
        own.visibility.bind_to_image("visibility", _VISIBILITY)
        own.bind("disparity", _OWN_DISPARITY)
        own.bind("surface", _OWN_SURFACE)
        other.bind("disparity", _OTHER_DISPARITY)
        other.bind("surface", _OTHER_SURFACE)
        self._models.bind_triangles(placed, OTHER_EYE[eye])
        self._constants.write(placed.scene.camera, OTHER_EYE[eye], placed.scene.near_of(OTHER_EYE[eye]))
        with self._context.clock.timed("masks", eye):
            self._open.collect()
            own.visibility.framebuffer.use()
            self._context.unbound.clear_unsigned(0, VISIBLE)
            self._steps.run(crop or Crop(0, 0, *own.framebuffer.size))
            self._slivers.draw(placed, OTHER_EYE[eye], self._open)
