"""The visibility pass: marks the pixels of one eye's image that the other eye sees too."""

from collections.abc import Collection

from semisynth_gl.frame.camera import OTHER_EYE, Eye
from semisynth_gl.frame.channels import VISIBLE
from semisynth_gl.render.listed_steps import ListedSteps
from semisynth_gl.render.pair_targets import DrawnPair
from semisynth_gl.render.slivers import SliverPass
from semisynth_gl.render.state import RenderState

_TILE_PX = 4
# Most entries for a tile: one in each of two lists of tiles, and all its pixels in a list of pixels.
_ENTRIES = 2 + _TILE_PX**2


class VisibilityPass:
    """Four compute steps, each for the pixels that earlier steps leave open (visibility.comp), and the sliver pass."""

    def __init__(self, state: RenderState) -> None:
        self._state = state
        self._slivers = SliverPass(state)
        self._steps = ListedSteps(state.context, "visibility.comp", 4, _TILE_PX, _ENTRIES)

    def draw(self, pair: DrawnPair, eyes: Collection[Eye]) -> None:
        """Fill the visibility of these eyes' views, or a crop of it, from both eyes' disparities and surfaces."""
        for eye in eyes:
            self._draw(pair, eye)
        if self._slivers.lengthen():
            self.draw(pair, eyes)

    def _draw(self, pair: DrawnPair, eye: Eye) -> None:
        visibility, points = pair.eyes[eye].visibility, pair.sized.open_points
        if visibility is None or points is None:
            raise RuntimeError("these targets were made without visibility")
        other, context = OTHER_EYE[eye], self._state.context
        visibility.limit(pair.crop)
        visibility.bind_to_images(visibility=0)
        pair.eyes[eye].bind(disparity=0, surface=2)
        pair.eyes[other].bind(disparity=1, surface=3)
        self._state.models.bind_triangles(pair.transforms, other)
        self._state.constants.write(pair.transforms.scene, other)
        points.collect()
        visibility.framebuffer.use()
        context.unbound.clear_unsigned(0, VISIBLE)
        self._steps.run(pair.area)
        self._slivers.draw(pair.transforms, other, points)
