"""Compute passes of several steps. Each step decides what it can, and lists the rest for later steps."""

from collections.abc import Mapping
from math import ceil

import numpy as np

from semisynth_gl.frame.camera import Crop
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.programs import link_compute

# Binding of the work lists' buffer in shaders. It begins with four counters, the number of entries of each list.
_WORK = 5
_EMPTY_LISTS = np.zeros(4, "<u4").tobytes()
# Columns and rows of tiles that one workgroup of the first step handles.
_GROUP_TILES = 16, 4
# Number of workgroups of the later steps. It is fixed, since only the driver knows the lists' lengths. A GPU needs more
# groups, to hide the latency of memory.
_GROUPS_ON_SOFTWARE, _GROUPS_ON_GPU = 128, 2048
# Larger images are processed in bands of at most this size, which limits the size of the lists.
_MOST_PIXELS = 1 << 21


class WorkListShader:
    """A compute shader in steps: the first step decides tiles of the image, later steps the entries of work lists.

    In the shader, STEP is the number of the step. The uniform `band` is the part of the image to process: left column,
    first row, width and height, in tiles of side ``tile_px``. For each tile, all lists together have room for
    ``entries`` entries. Raises BackendError where the driver refuses the shader.
    """

    def __init__(
        self,
        context: GraphicsContext,
        shader: str,
        steps: int,
        tile_px: int,
        entries: int,
        defines: Mapping[str, int] | None = None,
    ) -> None:
        self._gl = context.gl
        self._steps = [link_compute(context, shader, {"STEP": step, **(defines or {})}) for step in range(steps)]
        self._tile_px, self._entries = tile_px, entries
        self._work = context.gl.buffer(reserve=len(_EMPTY_LISTS))
        self._groups = _GROUPS_ON_SOFTWARE if context.software else _GROUPS_ON_GPU

    def set(self, name: str, value: object) -> None:
        """Set a uniform in all steps that use it."""
        for step in self._steps:
            if step.get(name, None) is not None:
                step[name] = value

    def run(self, part: Crop) -> None:
        """Process a part of the image, extended to whole tiles of the image. Later commands see the result."""
        x, y = part.x_px // self._tile_px, part.y_px // self._tile_px
        columns, bottom = ceil(part.right_px / self._tile_px) - x, ceil(part.bottom_px / self._tile_px)
        rows = max(1, _MOST_PIXELS // (self._tile_px**2 * columns))
        size = len(_EMPTY_LISTS) + 4 * self._entries * columns * min(rows, bottom - y)
        if self._work.size < size:
            self._work.orphan(size)
        self._work.bind_to_storage_buffer(_WORK)
        for first in range(y, bottom, rows):
            self._process((x, first, columns, min(rows, bottom - first)))

    def _process(self, band: tuple[int, int, int, int]) -> None:
        self._work.write(_EMPTY_LISTS)
        self.set("band", band)
        first, *later = self._steps
        first.run(ceil(band[2] / _GROUP_TILES[0]), ceil(band[3] / _GROUP_TILES[1]))
        for step in later:
            self._gl.memory_barrier()
            step.run(self._groups)
        self._gl.memory_barrier()
