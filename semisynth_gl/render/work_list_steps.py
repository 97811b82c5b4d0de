"""Multi-step compute passes. Each step settles what it can, and appends the rest to a work list for the next step."""

from collections.abc import Mapping
from math import ceil

import numpy as np

from semisynth_gl.frame.camera import Crop
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.programs import link_compute

# Binding of the buffer of work lists in shaders. The buffer's header has the number of entries of each list.
_WORK = 5
_COUNTERS = np.zeros(4, "<u4").tobytes()
# Invocations of the first step that work together, in columns and rows of tiles.
_GROUP_TILES = 16, 4
# Numbers of groups that share a work list. They are fixed, since only the driver knows the lists' lengths. A GPU gets
# more groups: it hides the latency of a fetch behind other groups.
_GROUPS_ON_SOFTWARE, _GROUPS_ON_GPU = 128, 2048
# Larger images are judged in bands of at most this size, which limits the size of the lists.
_MOST_PIXELS = 1 << 21


class WorkListSteps:
    """A compute shader in steps: the first step judges tiles of the image, later steps judge the entries of work lists.

    In the shader, STEP is the number of the step. The uniform `band` is the part of the image that is judged: left
    column, first row, width and height, in tiles.

    Args:
        context: the context.
        shader: the shader's file.
        steps: number of steps.
        tile_px: side of a tile.
        entries: maximum number of entries of a tile in all lists together.
        defines: numbers to define in the shader; see `shader_source`.

    Raises:
        BackendError: where the driver refuses the shader.
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
        self._work = context.gl.buffer(reserve=len(_COUNTERS))
        self._groups = _GROUPS_ON_SOFTWARE if context.software else _GROUPS_ON_GPU

    def set(self, name: str, value: object) -> None:
        """Set a uniform in all steps that use it."""
        for step in self._steps:
            if step.get(name, None) is not None:
                step[name] = value

    def run(self, part: Crop) -> None:
        """Judge a part of the image, extended to whole tiles; later drawing sees the result."""
        # The grid of tiles begins at the image's corner, not at the part's.
        x, y = part.x_px // self._tile_px, part.y_px // self._tile_px
        columns, bottom = ceil(part.right_px / self._tile_px) - x, ceil(part.bottom_px / self._tile_px)
        rows = max(1, _MOST_PIXELS // (self._tile_px**2 * columns))
        size = len(_COUNTERS) + 4 * self._entries * columns * min(rows, bottom - y)
        if self._work.size < size:
            self._work.orphan(size)
        self._work.bind_to_storage_buffer(_WORK)
        for first in range(y, bottom, rows):
            self._judge((x, first, columns, min(rows, bottom - first)))

    def _judge(self, band: tuple[int, int, int, int]) -> None:
        self._work.write(_COUNTERS)
        self.set("band", band)
        first, *later = self._steps
        first.run(ceil(band[2] / _GROUP_TILES[0]), ceil(band[3] / _GROUP_TILES[1]))
        for step in later:
            self._gl.memory_barrier()
            step.run(self._groups)
        self._gl.memory_barrier()
