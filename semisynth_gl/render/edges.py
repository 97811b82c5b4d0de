"""Antialiases outlines: blends the colour beyond an edge into the pixels through which the edge passes."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Crop, Eye
from semisynth_gl.render import occlusion
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.model_buffers import refill
from semisynth_gl.render.outlines import OutlineFinder
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.targets import EyeTargets, window

PATCHED_INSTANCE = np.dtype([
    ("view_from_model", "<f4", (3, 4)), ("patch_from_uv", "<f4", 4),
    ("layer", "<f4"), ("atlas", "<f4"), ("side_texels", "<f4"), ("most_samples", "<f4"),
])  # fmt: skip
"""The struct PatchedInstance of edges.geom, std430."""

_FEWEST_STRIPS, _FEWEST_INSTANCES = 4096, 256
# Bindings of edges.geom.
_VERTICES, _INSTANCES, _STRIPS = 0, 5, 6
# Texture units of edges.frag and edges.geom, after those of the atlases and of a projector's light.
_DRAWN, _FARTHEST = 4, 5
# Passed instead of the result of `OcclusionCuller.farthest` if nothing is hidden.
_NOTHING_HIDDEN = np.zeros((1, 1, 1, 1), np.float32)


class EdgeBlendPass:
    """Blends along the outlines of one eye's image; see edges.geom and edges.frag."""

    def __init__(self, resources: RenderResources, hidden: occlusion.OcclusionCuller | None) -> None:
        context, models, self._patches = resources.context, resources.models, resources.patches
        gl = context.gl
        self._gl, self._vertices, self._occlusion = gl, models.vertices, hidden
        self._anisotropies = np.array(resources.anisotropies)
        self._outlines = OutlineFinder(models.meshes, models.vertex_number)
        defines = {"LARGE": 1} if len(self._patches.ends) > 1 else {}
        lights: dict[bool, dict[str, int]] = {False: {}} if resources.pattern is None else {False: {}, True: {"LIT": 1}}
        self._programs = {
            lit: link_program(context, "edges.vert", "edges.frag", defines | light, "edges.geom")
            for lit, light in lights.items()
        }
        self._vaos = {lit: gl.vertex_array(program, []) for lit, program in self._programs.items()}
        self._instances = gl.buffer(reserve=_FEWEST_INSTANCES * PATCHED_INSTANCE.itemsize, dynamic=True)
        self._strips = gl.buffer(reserve=_FEWEST_STRIPS * 16, dynamic=True)
        self._farthest = gl.texture_array((1, 1, 1), 1, dtype="f4")

    def draw(
        self, transforms: InstanceTransforms, eye: Eye, targets: EyeTargets, part: Crop | None, *, lit: bool
    ) -> None:
        """Smooth the colour of one eye's targets, or a part of it, by the depth that the drawing pass left there.

        ``lit`` says whether a projector's light is bound for this eye; see `ProjectorLight.use`.
        """
        assert targets.blending is not None  # noqa: S101 - the targets are made for outlines
        # The sky has no outlines: there is nothing beyond it.
        seen, farthest = np.flatnonzero(transforms.in_view(eye) & ~transforms.scene.sky), _NOTHING_HIDDEN
        if self._occlusion is not None:
            seen, farthest = self._occlusion.farthest(transforms, eye, part, targets, seen)
        strips = self._outlines.find(transforms, eye, seen)
        if not len(strips):
            return
        refill(self._strips, strips)
        refill(self._instances, self._patched_instances(transforms, eye))
        self._vertices.bind_to_storage_buffer(_VERTICES)
        self._instances.bind_to_storage_buffer(_INSTANCES)
        self._strips.bind_to_storage_buffer(_STRIPS)
        self._gl.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        self._gl.depth_func = ">"
        self._gl.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        for atlas in range(len(self._patches.ends)):
            self._patches.use(atlas, atlas)
        targets.blending.use(part, _DRAWN)
        self._use_farthest(farthest)
        program = self._programs[lit]
        # If nothing is hidden, a single tile covers the whole image, so edges.geom never indexes past it.
        tile_px = max(targets.framebuffer.size) if farthest is _NOTHING_HIDDEN else occlusion.TILE_PX
        program["levels"], program["tile_px"] = farthest.shape[1], tile_px
        program["part"] = window(part, targets.framebuffer.size)
        self._vaos[lit].render(moderngl.POINTS, len(strips))

    def _use_farthest(self, farthest: NDArray[np.float32]) -> None:
        """Upload the result of `OcclusionCuller.farthest` and bind it for edges.geom."""
        rows, columns = farthest.shape[2:]
        layers = farthest.reshape(-1, rows, columns)
        if self._farthest.size != (columns, rows, len(layers)):
            self._farthest.release()
            self._farthest = self._gl.texture_array((columns, rows, len(layers)), 1, dtype="f4")
            self._farthest.filter = moderngl.NEAREST, moderngl.NEAREST
        self._farthest.write(layers)
        self._farthest.use(_FARTHEST)

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
