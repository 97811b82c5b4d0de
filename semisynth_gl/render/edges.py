"""Antialiasing along outlines: the colour beyond an edge is blended into the pixels through which the edge passes."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Crop, Eye
from semisynth_gl.render import occlusion
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.model_buffers import refill
from semisynth_gl.render.outlines import Outlines
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.state import RenderState
from semisynth_gl.render.targets import EyeTargets, window

WEARER = np.dtype([("view_from_model", "<f4", (3, 4)), ("patch_from_uv", "<f4", 4), ("worn", "<f4", 4)])
"""The struct Wearer of edges.geom, std430."""

_FEWEST_STRIPS, _FEWEST_INSTANCES = 4096, 256
# Bindings of edges.geom.
_VERTICES, _WEARERS, _STRIPS = 0, 5, 6
# Texture units of edges.frag and edges.geom, after those of the atlases and of a projector's light.
_DRAWN, _FARTHEST = 4, 5
# In the place of what `Occlusion.farthest` returns, hides nothing.
_NOTHING_NEARER = np.zeros((1, 1, 1, 1), np.float32)


class EdgePass:
    """Blends along the outlines of one eye's image; see edges.geom and edges.frag."""

    def __init__(self, state: RenderState, hidden: occlusion.Occlusion | None) -> None:
        context, models, self._patches = state.context, state.models, state.patches
        gl = context.gl
        self._gl, self._vertices, self._occlusion = gl, models.vertices, hidden
        self._anisotropies = np.array(state.anisotropies)
        self._outlines = Outlines(models.meshes, models.vertex_number)
        defines = {"LARGE": 1} if len(self._patches.ends) > 1 else {}
        lights = [{}] if state.pattern is None else [{}, {"LIT": 1}]
        self._programs = [
            link_program(context, "edges.vert", "edges.frag", defines | lit, "edges.geom") for lit in lights
        ]
        self._vaos = [gl.vertex_array(program, []) for program in self._programs]
        self._wearers = gl.buffer(reserve=_FEWEST_INSTANCES * WEARER.itemsize, dynamic=True)
        self._strips = gl.buffer(reserve=_FEWEST_STRIPS * 16, dynamic=True)
        self._farthest = gl.texture_array((1, 1, 1), 1, dtype="f4")

    def draw(
        self, transforms: InstanceTransforms, eye: Eye, targets: EyeTargets, part: Crop | None, *, lit: bool
    ) -> None:
        """Smooth the colour of one eye's targets, or a part of it; their depth must be that of the drawing pass.

        ``lit`` is whether a projector's light is bound for this eye; see `ProjectorLight.use`.
        """
        assert targets.blending is not None  # noqa: S101 - the targets are made for outlines
        # The sky has no outlines: there is nothing beyond it.
        seen, farthest = np.flatnonzero(transforms.in_view(eye) & ~transforms.scene.sky), _NOTHING_NEARER
        if self._occlusion is not None:
            seen, farthest = self._occlusion.farthest(transforms, eye, part, targets, seen)
        strips = self._outlines.find(transforms, eye, seen)
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
        self._use_farthest(farthest)
        program = self._programs[lit]
        # One tile of the whole image stands for "nothing is hidden", so that edges.geom reads no other.
        tile_px = max(targets.framebuffer.size) if farthest is _NOTHING_NEARER else occlusion.TILE_PX
        program["levels"], program["tile_px"] = farthest.shape[1], tile_px
        program["part"] = window(part, targets.framebuffer.size)
        self._vaos[lit].render(moderngl.POINTS, len(strips))

    def _use_farthest(self, farthest: NDArray[np.float32]) -> None:
        """Upload the result of `Occlusion.farthest` and bind it for edges.geom."""
        rows, columns = farthest.shape[2:]
        layers = farthest.reshape(-1, rows, columns)
        if self._farthest.size != (columns, rows, len(layers)):
            self._farthest.release()
            self._farthest = self._gl.texture_array((columns, rows, len(layers)), 1, dtype="f4")
            self._farthest.filter = moderngl.NEAREST, moderngl.NEAREST
        self._farthest.write(layers)
        self._farthest.use(_FARTHEST)

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
