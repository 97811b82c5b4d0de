"""The sliver pass: hides points of one eye's view behind surfaces narrower than a pixel of the other eye's."""

from math import ceil

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.listed_steps import groups_of
from semisynth_gl.render.model_buffers import refill
from semisynth_gl.render.programs import link_compute
from semisynth_gl.render.state import RenderState
from semisynth_gl.render.structs import BLOCKS, RUN

# Most triangles of a run. A group of invocations works through one run after another; a run has a single instance.
_RUN_TRIANGLES = 512
# Bindings of the two lists. A list starts with a header of 16 bytes (entry count, padding); an entry takes 16 bytes.
_LISTS = _NARROW, _CUTS = 6, 7
_ENTRY = _HEADER = 16
_FEWEST_ENTRIES = 1 << 16
# Length of the lists for each triangle, more than most scenes need; the steps run again where a list was too short.
_ENTRIES_OF_TRIANGLE = 0.5
# Units of the undecided points: images in visibility.comp, textures in slivers.comp.
_OPEN_IMAGES = 1, 2, 3
_OPEN_TEXTURES = 7, 8, 6


class OpenPoints:
    """Pixels of one view whose visibility is undecided, grouped by the pixel of the other view that they project to.

    ``size`` is the image's width and height, px.

    Raises:
        BackendError: where the driver has no textures of that size.
    """

    def __init__(self, context: GraphicsContext, size: tuple[int, int]) -> None:
        self._unbound = context.unbound
        width, height = size
        try:
            self._textures = [
                context.gl.texture((columns, height), 1, dtype="u4") for columns in (width, width, ceil(width / 32))
            ]
            first, _, columns = self._textures
            self._cleared = [context.gl.framebuffer([texture]) for texture in (first, columns)]
        except moderngl.Error as error:
            raise BackendError(f"{context.renderer} cannot list points of {width} x {height} px: {error}") from error
        for texture in self._textures:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)

    def collect(self) -> None:
        """Clear the lists, and bind them for visibility.comp to fill."""
        for framebuffer in self._cleared:
            framebuffer.use()
            self._unbound.clear_unsigned(0, 0)
        for texture, unit in zip(self._textures, _OPEN_IMAGES, strict=True):
            texture.bind_to_image(unit, read=True, write=True)

    def bind(self) -> None:
        """Bind the lists for slivers.comp to look up."""
        for texture, unit in zip(self._textures, _OPEN_TEXTURES, strict=True):
            texture.use(unit)

    def release(self) -> None:
        """Free all textures and framebuffers."""
        for framebuffer in self._cleared:
            framebuffer.release()
        for texture in self._textures:
            texture.release()


class SliverPass:
    """Three compute steps that cut the narrow triangles of the other eye's view along rows; see slivers.comp."""

    def __init__(self, state: RenderState) -> None:
        context, self._models = state.context, state.models
        self._gl = context.gl
        self._steps = [link_compute(context, "slivers.comp", {"STEP": step}) for step in range(3)]
        self._runs = context.gl.buffer(reserve=RUN.itemsize, dynamic=True)
        self._lists = {binding: context.gl.buffer(reserve=_HEADER + _ENTRY * _FEWEST_ENTRIES) for binding in _LISTS}
        # NVIDIA's driver moves a buffer that the processor reads or writes out of the GPU's memory, where atomic
        # counters are slow. So the processor does not touch the lists: zeros are copied into their headers, and the
        # headers into a buffer that is read once both eyes are drawn.
        self._zeros = context.gl.buffer(bytes(_HEADER))
        self._headers = context.gl.buffer(bytes(len(EYES) * len(_LISTS) * _HEADER))
        self._groups = groups_of(context)

    def draw(self, transforms: InstanceTransforms, other: Eye, points: OpenPoints) -> None:
        """Mark points of one eye's view as occluded that lie behind slivers in the ``other`` eye's view.

        Both eyes' disparities, the visibility to complete, the triangles and the constants must be bound as for
        visibility.comp. Some marks are missing where `lengthen` says so.
        """
        runs = self._runs_of(transforms, other)
        if not len(runs):
            return
        refill(self._runs, runs)
        self._runs.bind_to_storage_buffer(BLOCKS["Runs"].binding)
        points.bind()
        self._steps[0]["run_count"] = len(runs)
        for binding, entries in self._lists.items():
            self._make_room(binding, int(runs["triangles"].sum() * _ENTRIES_OF_TRIANGLE))
            self._gl.copy_buffer(entries, self._zeros, _HEADER)
            entries.bind_to_storage_buffer(binding)
        for step in self._steps:
            step.run(self._groups)
            self._gl.memory_barrier()
        for number, entries in enumerate(self._lists.values(), len(_LISTS) * EYES.index(other)):
            self._gl.copy_buffer(self._headers, entries, _HEADER, write_offset=number * _HEADER)

    def lengthen(self) -> bool:
        """Lengthen the lists that were too short in the latest `draw` of either eye; return whether any was.

        Which entries a full list holds depends on chance, so both eyes must then be drawn again.
        """
        counts = np.frombuffer(self._headers.read(), "<u4").reshape(len(EYES), len(_LISTS), -1)[:, :, 0].max(axis=0)
        grown = [self._make_room(binding, count) for binding, count in zip(_LISTS, counts.tolist(), strict=True)]
        return any(grown)

    def _make_room(self, binding: int, entries: int) -> bool:
        """Lengthen a list that has no room for so many entries; return whether it had none."""
        size = _HEADER + _ENTRY * entries
        if size <= self._lists[binding].size:
            return False
        self._lists[binding].orphan(size + size // 4)
        return True

    def _runs_of(self, transforms: InstanceTransforms, eye: Eye) -> NDArray[np.void]:
        """Return the triangles of the instances that an eye may see, run by run: (R,) of `RUN`."""
        # The sky hides nothing.
        shown = np.flatnonzero(transforms.in_view(eye) & ~transforms.scene.sky)
        first, triangles = self._models.triangles_of(transforms.scene.model[shown])
        count = -(-triangles // _RUN_TRIANGLES)
        number = np.arange(len(shown)).repeat(count)
        begin = _RUN_TRIANGLES * (np.arange(len(number)) - (np.cumsum(count) - count).repeat(count))
        runs = np.zeros(len(number), RUN)
        runs["instance"] = shown[number]
        runs["first_triangle"] = first[number] + begin
        runs["triangles"] = np.minimum(triangles[number] - begin, _RUN_TRIANGLES)
        runs["fronts_only"] = transforms.fronts_only(eye)[shown[number]]
        return runs
