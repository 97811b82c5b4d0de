"""Antialiasing along outlines: the colour beyond an edge is blended into the pixels through which the edge passes."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Crop, Eye
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.model_buffers import refill
from semisynth_gl.render.outlines import Outlines
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.state import RenderState
from semisynth_gl.render.targets import EyeTargets

WEARER = np.dtype([("view_from_model", "<f4", (3, 4)), ("patch_from_uv", "<f4", 4), ("worn", "<f4", 4)])
"""The struct Wearer of edges.geom, std430."""

_FEWEST_STRIPS, _FEWEST_INSTANCES = 4096, 256
# Bindings of edges.geom.
_VERTICES, _WEARERS, _STRIPS = 0, 5, 6
# Texture unit of edges.frag, after those of the atlases and of a projector's light.
_DRAWN = 4


class EdgePass:
    """Blends along the outlines of one eye's image; see edges.geom and edges.frag."""

    def __init__(self, state: RenderState) -> None:
        context, models, self._patches = state.context, state.models, state.patches
        gl = context.gl
        self._gl, self._vertices = gl, models.vertices
        self._anisotropies = np.array(state.anisotropies)
        self._outlines = Outlines(models.meshes, models.vertex_number)
        defines = {"LARGE": 1} if len(self._patches.ends) > 1 else {}
        lights = [{}] if state.pattern is None else [{}, {"LIT": 1}]
        self._vaos = [
            gl.vertex_array(link_program(context, "edges.vert", "edges.frag", defines | lit, "edges.geom"), [])
            for lit in lights
        ]
        self._wearers = gl.buffer(reserve=_FEWEST_INSTANCES * WEARER.itemsize, dynamic=True)
        self._strips = gl.buffer(reserve=_FEWEST_STRIPS * 16, dynamic=True)

    def draw(
        self, transforms: InstanceTransforms, eye: Eye, targets: EyeTargets, part: Crop | None, *, lit: bool
    ) -> None:
        """Smooth the colour of one eye's targets, or a part of it; their depth must be that of the drawing pass.

        ``lit`` is whether a projector's light is bound for this eye; see `ProjectorLight.use`.
        """
        assert targets.blending is not None  # noqa: S101 - the targets are made for outlines
        strips = self._outlines.find(transforms, eye)
        if not len(strips):
            return
        refill(self._strips, strips)
        refill(self._wearers, self._worn(transforms, eye))
        self._vertices.bind_to_storage_buffer(_VERTICES)
        self._wearers.bind_to_storage_buffer(_WEARERS)
        self._strips.bind_to_storage_buffer(_STRIPS)
        self._gl.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        self._gl.depth_func = ">"
        self._gl.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        for atlas in range(len(self._patches.ends)):
            self._patches.use(atlas, atlas)
        targets.blending.use(part, _DRAWN)
        self._vaos[lit].render(moderngl.POINTS, len(strips))

    def _worn(self, transforms: InstanceTransforms, eye: Eye) -> NDArray[np.void]:
        """Return the numbers that edges.geom looks up for each instance, (N,) of `WEARER`."""
        scene, ends = transforms.scene, self._patches.ends
        wearers = np.zeros(len(scene), WEARER)
        wearers["view_from_model"] = transforms.rows(eye)
        wearers["patch_from_uv"] = transforms.patch_from_uv
        atlas = np.searchsorted(ends, scene.layer, side="right")
        wearers["worn"][:, 0] = scene.layer - np.concatenate([[0], ends])[atlas]
        wearers["worn"][:, 1] = atlas
        wearers["worn"][:, 2] = self._patches.sides_px[atlas]
        wearers["worn"][:, 3] = self._anisotropies[atlas]
        return wearers
