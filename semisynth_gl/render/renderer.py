"""The renderer: models and patches go to the GPU once, then any number of scenes are drawn from them.

A pair takes three steps: the drawing pass of each eye (colour and planar depth, one multi-draw call), the truth pass of
each eye (disparity and visibility from both depths), and the copy of the results into arrays.
"""

from collections.abc import Sequence
from types import TracebackType
from typing import Literal, Self

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import EYES, Eye
from semisynth_gl.errors import BackendError, InputError
from semisynth_gl.frame import Frame
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.render.context import Backend, open_context
from semisynth_gl.render.model_buffers import ModelBuffers
from semisynth_gl.render.programs import link_program, set_uniform
from semisynth_gl.render.projection import clip_from_view
from semisynth_gl.render.targets import EyeTargets
from semisynth_gl.scene.scene import Scene

Wrap = Literal["mirror", "repeat"]

_OTHER: dict[Eye, Eye] = {"left": "right", "right": "left"}


class Renderer:
    """Draws scenes with a fixed set of models and patches. Use it in a ``with`` block, in the thread that made it.

    Args:
        models: the meshes that `Scene.model` counts.
        layers: (L, P, P, 4) uint8 RGBA, the patch atlas that `Scene.layer` counts; row 0 is the top.
        wrap: what lies beyond a patch's border, its mirror image or itself again.
        backend: "auto", "egl" or "osmesa".
        device_index: EGL's number of the device.

    Raises:
        BackendError: where no context can be opened, or the driver cannot hold the atlas.
        InputError: where models or layers are empty or of a wrong shape.
    """

    def __init__(
        self,
        models: Sequence[Mesh],
        layers: NDArray[np.uint8],
        *,
        wrap: Wrap = "mirror",
        backend: Backend = "auto",
        device_index: int = 0,
    ) -> None:
        if not models:
            raise InputError("a renderer needs at least one model, got none")
        if layers.ndim != 4 or layers.shape[1] != layers.shape[2] or layers.shape[3] != 4 or layers.dtype != np.uint8:
            raise InputError(f"layers must be (L, P, P, 4) uint8, got {layers.shape} {layers.dtype}")
        if len(layers) == 0 or layers.shape[1] == 0:
            raise InputError("the patch atlas is empty")
        self._context = open_context(backend, device_index)
        try:
            self._gl = self._context.gl
            self._atlas = self._upload_atlas(layers, wrap)
            self._mesh_program = link_program(self._context, "mesh.vert", "mesh.frag")
            set_uniform(self._mesh_program, "atlas", 0)
            set_uniform(self._mesh_program, "mirror", wrap == "mirror")
            self._truth_program = link_program(self._context, "truth.vert", "truth.frag")
            set_uniform(self._truth_program, "own_depth", 0)
            set_uniform(self._truth_program, "other_depth", 1)
            self._truth_vao = self._gl.vertex_array(self._truth_program, [])
            self._models = ModelBuffers(self._gl, self._mesh_program, models)
        except BaseException:
            self._context.release()
            raise
        self._targets: dict[Eye, EyeTargets] = {}
        self._size: tuple[int, int] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    @property
    def backend(self) -> Backend:
        """The backend in use, "egl" or "osmesa"."""
        return self._context.backend

    @property
    def renderer_name(self) -> str:
        """What the driver calls itself (GL_RENDERER)."""
        return self._context.renderer

    def render(self, scene: Scene) -> Frame:
        """Draw one pair.

        Args:
            scene: indices must lie within the renderer's models and layers.

        Returns:
            Both images, both disparities and both visibilities, in new arrays.

        Raises:
            InputError: where an index is out of range.
            BackendError: where the image is larger than the driver allows, or drawing failed.
        """
        self._check_indices(scene)
        self._resize(scene.camera.width_px, scene.camera.height_px)
        for eye in EYES:
            self._draw_surface(scene, eye)
        for eye in EYES:
            self._draw_truth(scene, eye)
        frame = Frame(
            camera=scene.camera,
            left=self._targets["left"].read_colour(),
            right=self._targets["right"].read_colour(),
            disparity_left=self._targets["left"].read_disparity(),
            disparity_right=self._targets["right"].read_disparity(),
            visibility_left=self._targets["left"].read_visibility(),
            visibility_right=self._targets["right"].read_visibility(),
        )
        error = self._gl.error
        if error != "GL_NO_ERROR":
            raise BackendError(f"{self.renderer_name} reported {error} while drawing a pair")
        return frame

    def release(self) -> None:
        """Free the context and all that it holds; a second call does nothing."""
        for targets in self._targets.values():
            targets.release()
        self._targets = {}
        self._context.release()

    def _upload_atlas(self, layers: NDArray[np.uint8], wrap: Wrap) -> moderngl.TextureArray:
        count, side = layers.shape[:2]
        most = int(self._gl.info["GL_MAX_ARRAY_TEXTURE_LAYERS"])
        widest = int(self._gl.info["GL_MAX_TEXTURE_SIZE"])
        if count > most or side > widest:
            raise BackendError(
                f"the patch atlas has {count} patches of {side} px, but {self._context.renderer} holds {most} of up to "
                f"{widest} px: lower textures.max_patches or textures.patch_px"
            )
        atlas = self._gl.texture_array((side, side, count), 4, np.ascontiguousarray(layers))
        atlas.build_mipmaps()
        atlas.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        # The shader mirrors by folding the coordinate; what it folds must then end at the border.
        atlas.repeat_x = atlas.repeat_y = wrap == "repeat"
        return atlas

    def _check_indices(self, scene: Scene) -> None:
        ranges = (("model", scene.model, len(self._models)), ("layer", scene.layer, self._atlas.layers))
        for name, index, count in ranges:
            if len(index) and (int(index.min()) < 0 or int(index.max()) >= count):
                raise InputError(
                    f"scene: {name} must be 0 to {count - 1}, got {int(index.min())} to {int(index.max())}"
                )

    def _resize(self, width_px: int, height_px: int) -> None:
        if self._size == (width_px, height_px):
            return
        outgrown = list(self._targets.values())
        self._targets = {eye: EyeTargets.create(self._context, width_px, height_px) for eye in EYES}
        # moderngl binds the framebuffer in use again after making a new one, so the old ones go last.
        self._targets["left"].surface.use()
        for targets in outgrown:
            targets.release()
        self._size = (width_px, height_px)

    def _draw_surface(self, scene: Scene, eye: Eye) -> None:
        targets = self._targets[eye]
        targets.surface.use()
        targets.surface.clear(0.0, 0.0, 0.0, 0.0, depth=0.0)
        projection = clip_from_view(scene.camera, eye, scene.near_m)
        set_uniform(self._mesh_program, "clip_from_view", tuple(projection.T.ravel().tolist()))
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.depth_func = ">"
        self._atlas.use(0)
        self._models.draw(scene, eye)

    def _draw_truth(self, scene: Scene, eye: Eye) -> None:
        targets = self._targets[eye]
        targets.truth.use()
        self._gl.enable_only(moderngl.NOTHING)
        targets.depth_m.use(0)
        self._targets[_OTHER[eye]].depth_m.use(1)
        set_uniform(self._truth_program, "focal_baseline", scene.camera.focal_baseline)
        set_uniform(self._truth_program, "doffs_px", scene.camera.doffs_px)
        set_uniform(self._truth_program, "other_from_own", -1.0 if eye == "left" else 1.0)
        self._truth_vao.render(moderngl.TRIANGLES, 3)
