"""Antialiases outlines: where an edge of a surface crosses a pixel, blends the colours of both sides into the pixel."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.render import occlusion
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.model_buffers import refill
from semisynth_gl.render.outlines import OutlineFinder
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.targets import EyeView, viewport_of

PATCHED_INSTANCE = np.dtype([
    ("view_from_model", "<f4", (3, 4)), ("patch_from_uv", "<f4", 4),
    ("layer", "<f4"), ("atlas", "<f4"), ("side_texels", "<f4"), ("most_samples", "<f4"),
])  # fmt: skip
"""The struct PatchedInstance of edges.geom, std430."""

_FEWEST_STRIPS, _FEWEST_INSTANCES = 4096, 256  # initial capacities of the buffers
# Bindings of edges.geom.
_VERTICES, _INSTANCES, _STRIPS = 0, 5, 6
# Texture units of edges.frag and edges.geom, after those of the atlases and of a projector's light.
_DRAWN_COLOUR, _DEPTH_TABLE = 4, 5


class EdgeBlendPass:
    """Draws a strip along each outline, which blends colours; see edges.geom and edges.frag."""

    def __init__(self, resources: RenderResources, culler: occlusion.OcclusionCuller | None) -> None:
        context, models, self._patches = resources.context, resources.models, resources.patches
        gl = context.gl
        self._gl, self._vertices, self._culler = gl, models.vertices, culler
        self._anisotropies = np.array(resources.anisotropies)
        self._outlines = OutlineFinder(models.meshes, models.vertex_number)
        defines = {"LARGE": 1} if len(self._patches.ends) > 1 else {}
        self._programs = {
            lit: link_program(context, "edges.vert", "edges.frag", defines | ({"LIT": 1} if lit else {}), "edges.geom")
            for lit in ([False] if resources.pattern is None else [False, True])
        }
        self._vaos = {lit: gl.vertex_array(program, []) for lit, program in self._programs.items()}
        self._instances = gl.buffer(reserve=_FEWEST_INSTANCES * PATCHED_INSTANCE.itemsize, dynamic=True)
        self._strips = gl.buffer(reserve=_FEWEST_STRIPS * 16, dynamic=True)
        self._depth_table = gl.texture_array((1, 1, 1), 1, dtype="f4")

    def draw(self, view: EyeView, *, lit: bool) -> None:
        """Antialias a view's colour along outlines, by the depth that the drawing pass has left in its targets.

        ``lit`` says whether a projector's light is bound for this eye; see `ProjectorLight.bind`.
        """
        transforms, targets = view.transforms, view.targets
        assert targets.blending is not None  # noqa: S101 - the targets are made for outlines
        # Nothing lies beyond the sky's edges, so there is no colour to blend.
        instances = np.flatnonzero(transforms.in_view(view.eye) & ~transforms.scene.sky)
        if self._culler is None:
            # A single tile covers the image. Its depth of 0, that of infinity, hides nothing.
            depth_table, tile_px = np.zeros((1, 1, 1, 1), np.float32), max(targets.framebuffer.size)
        else:
            instances, depth_table = self._culler.cull_outlines(view, instances)
            tile_px = occlusion.TILE_PX
        strips = self._outlines.find(transforms, view.eye, instances)
        if not len(strips):
            return
        refill(self._strips, strips)
        refill(self._instances, self._patched_instances(transforms, view.eye))
        self._vertices.bind_to_storage_buffer(_VERTICES)
        self._instances.bind_to_storage_buffer(_INSTANCES)
        self._strips.bind_to_storage_buffer(_STRIPS)
        self._gl.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        self._gl.depth_func = ">"
        self._gl.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        for atlas in range(len(self._patches.ends)):
            self._patches.use(atlas, atlas)
        targets.blending.use(view.part, _DRAWN_COLOUR)
        self._bind_depth_table(depth_table)
        program = self._programs[lit]
        program["column_levels"], program["tile_px"] = depth_table.shape[1], tile_px
        program["part"] = viewport_of(view.part, targets.framebuffer.size)
        self._vaos[lit].render(moderngl.POINTS, len(strips))

    def _bind_depth_table(self, depth_table: NDArray[np.float32]) -> None:
        """Upload a sparse table of depths, [a, b, row, column], and bind it for edges.geom."""
        rows, columns = depth_table.shape[2:]
        layers = depth_table.reshape(-1, rows, columns)
        if self._depth_table.size != (columns, rows, len(layers)):
            self._depth_table.release()
            self._depth_table = self._gl.texture_array((columns, rows, len(layers)), 1, dtype="f4")
            self._depth_table.filter = moderngl.NEAREST, moderngl.NEAREST
        self._depth_table.write(layers)
        self._depth_table.use(_DEPTH_TABLE)

    def _patched_instances(self, transforms: InstanceTransforms, eye: Eye) -> NDArray[np.void]:
        """Return what edges.geom reads of each instance, (N,) of `PATCHED_INSTANCE`."""
        scene, ends = transforms.scene, self._patches.ends
        instances = np.zeros(len(scene), PATCHED_INSTANCE)
        instances["view_from_model"] = transforms.rows(eye)
        instances["patch_from_uv"] = transforms.patch_from_uv
        atlas = np.searchsorted(ends, scene.layer, side="right")
        instances["layer"] = scene.layer - np.concatenate([[0], ends])[atlas]
        instances["atlas"] = atlas
        instances["side_texels"] = self._patches.sides_px[atlas]
        instances["most_samples"] = self._anisotropies[atlas]
        return instances
