"""The visibility pass: marks the pixels of one eye's image that the other eye sees too."""

from collections.abc import Collection

from semisynth_gl.frame.camera import OTHER_EYE, Eye
from semisynth_gl.frame.channels import VISIBLE
from semisynth_gl.render.listed_steps import ListedSteps
from semisynth_gl.render.pair_targets import DrawnPair
from semisynth_gl.render.state import RenderState

_TILE_PX = 4
# Most entries for a tile: one in each of two lists of tiles, and all its pixels in a list of pixels.
_ENTRIES = 2 + _TILE_PX**2


class VisibilityPass:
    """Four compute steps, each for the pixels that earlier steps leave open; see visibility.comp."""

    def __init__(self, state: RenderState) -> None:
        self._state = state
        self._steps = ListedSteps(state.context, "visibility.comp", 4, _TILE_PX, _ENTRIES)

    def draw(self, pair: DrawnPair, eyes: Collection[Eye]) -> None:
        """Fill the visibility of these eyes' views, or a crop of it, from both eyes' disparities and surfaces."""
        for eye in eyes:
            visibility, other = pair.sized.visibility[eye], OTHER_EYE[eye]
            visibility.limit(pair.crop)
            visibility.bind_to_images(visibility=0)
            pair.eyes[eye].bind(disparity=0, surface=2)
            pair.eyes[other].bind(disparity=1, surface=3)
            self._state.models.bind_triangles(pair.transforms, other)
            self._state.constants.write(pair.transforms.scene, other)
            visibility.framebuffer.use()
            self._state.context.unbound.clear_unsigned(0, VISIBLE)
            self._steps.run(pair.area)
