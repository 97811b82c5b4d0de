"""The visibility pass: marks the pixels of one eye's image that the other eye sees too."""

from math import ceil

import numpy as np

from semisynth_gl.camera import OTHER_EYE, Crop, Eye
from semisynth_gl.frame import VISIBLE
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.model_buffers import ModelBuffers, Placed
from semisynth_gl.render.programs import link_compute
from semisynth_gl.render.targets import EyeTargets

# Texture units of visibility.comp, its image unit and its storage block.
_OWN_DISPARITY, _OTHER_DISPARITY, _OWN_SURFACE, _OTHER_SURFACE = range(4)
_VISIBILITY, _WORK = 0, 5
_TILE_PX = 4
_GROUP_TILES = 16, 4
# Steps that work on lists take turns through them, since only the driver knows how long they are.
_MOST_GROUPS = 128
# Larger images are judged band by band, which bounds the lists.
_MOST_PIXELS = 1 << 21
_COUNTERS = np.zeros(4, "<u4").tobytes()


class VisibilityPass:
    """Four compute steps, each for what the one before leaves open; see visibility.comp.

    Args:
        context: the open context.
        constants: its buffer of constants.
    """

    def __init__(self, context: GraphicsContext, constants: ConstantsBuffer) -> None:
        self._context = context
        self._gl = context.gl
        self._constants = constants
        self._tiles, *self._later = (link_compute(context, "visibility.comp", {"STEP": step}) for step in range(4))
        self._work = context.gl.buffer(reserve=len(_COUNTERS), dynamic=True)

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
        self._constants.write(placed.scene.camera, OTHER_EYE[eye], placed.scene.near_m)
        whole = Crop(0, 0, *own.framebuffer.size)
        part = whole if crop is None else crop
        # Tiles stand at the same places whatever the crop is.
        x, y = part.x_px // _TILE_PX, part.y_px // _TILE_PX
        columns, bottom = ceil(part.right_px / _TILE_PX) - x, ceil(part.bottom_px / _TILE_PX)
        rows = max(1, _MOST_PIXELS // (_TILE_PX**2 * columns))
        self._make_room(columns * min(rows, bottom - y))
        with self._context.clock.timed("masks", eye):
            own.visibility.framebuffer.use()
            self._context.unbound.clear_unsigned(0, VISIBLE)
            for first in range(y, bottom, rows):
                self._judge((x, first, columns, min(rows, bottom - first)))

    def _make_room(self, tiles: int) -> None:
        """Let the lists hold all tiles twice and all pixels."""
        size = len(_COUNTERS) + 4 * tiles * (2 + _TILE_PX**2)
        if self._work.size < size:
            self._work.orphan(size)
        self._work.bind_to_storage_buffer(_WORK)

    def _judge(self, band: tuple[int, int, int, int]) -> None:
        self._work.write(_COUNTERS)
        self._tiles["band"] = band
        self._tiles.run(ceil(band[2] / _GROUP_TILES[0]), ceil(band[3] / _GROUP_TILES[1]))
        for step in self._later:
            self._gl.memory_barrier()
            step["band"] = band
            step.run(_MOST_GROUPS)
        self._gl.memory_barrier()
