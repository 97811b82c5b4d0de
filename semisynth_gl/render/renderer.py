"""The renderer: models and patches go to the GPU once, then any number of scenes are drawn from them.

A pair takes three steps: the drawing pass of each eye (colour, planar depth and surface, one multi-draw call; colour in
a pass of its own where it is antialiased), the truth pass of each eye (disparity, visibility and instances from both
eyes' depths and surfaces), and the copy of the results into arrays.
"""

from collections.abc import Collection, Sequence
from types import TracebackType
from typing import Literal, Self

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import EYES, Eye
from semisynth_gl.errors import BackendError, InputError
from semisynth_gl.frame import DEFAULT_OUTPUTS, OUTPUTS, Frame, Output
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.render.antialias import ColourTargets, parse_antialias
from semisynth_gl.render.context import Backend, open_context
from semisynth_gl.render.model_buffers import ModelBuffers
from semisynth_gl.render.programs import link_program, set_uniform
from semisynth_gl.render.projection import clip_from_view
from semisynth_gl.render.targets import EyeTargets, needs_surface
from semisynth_gl.scene.scene import Scene

Wrap = Literal["mirror", "repeat"]

_OTHER: dict[Eye, Eye] = {"left": "right", "right": "left"}
_MOST_INSTANCE_IDS = 65535
# Texture units.
_OWN_DEPTH, _OWN_SURFACE, _OTHER_DEPTH, _OTHER_SURFACE = range(4)


class Renderer:
    """Draws scenes with a fixed set of models and patches. Use it in a ``with`` block, in the thread that made it.

    Args:
        models: the meshes that `Scene.model` counts.
        layers: (L, P, P, 4) uint8 RGBA, the patch atlas that `Scene.layer` counts; row 0 is the top.
        wrap: what lies beyond a patch's border, its mirror image or itself again.
        anisotropy: most samples of a patch for a pixel that sees it at a grazing angle; 1 blurs there.
        outputs: what to make beside images and disparities, of "visibility", "instances" and "depth".
        antialias: "none", "msaa4" (or what the driver has) or "ssaa2" to "ssaa8"; for colour only.
        backend: "auto", "egl" or "osmesa".
        device_index: EGL's number of the device.

    Raises:
        BackendError: where no context can be opened, or the driver cannot hold the atlas.
        InputError: where models or layers are empty or of a wrong shape, or an option is unknown.
    """

    def __init__(
        self,
        models: Sequence[Mesh],
        layers: NDArray[np.uint8],
        *,
        wrap: Wrap = "mirror",
        anisotropy: int = 1,
        outputs: Collection[Output] = DEFAULT_OUTPUTS,
        antialias: str = "none",
        backend: Backend = "auto",
        device_index: int = 0,
    ) -> None:
        if not models:
            raise InputError("a renderer needs at least one model, got none")
        if layers.ndim != 4 or layers.shape[1] != layers.shape[2] or layers.shape[3] != 4 or layers.dtype != np.uint8:
            raise InputError(f"layers must be (L, P, P, 4) uint8, got {layers.shape} {layers.dtype}")
        if len(layers) == 0 or layers.shape[1] == 0:
            raise InputError("the patch atlas is empty")
        unknown = set(outputs) - set(OUTPUTS)
        if unknown:
            raise InputError(f"outputs: expected some of {', '.join(OUTPUTS)}, got {', '.join(sorted(unknown))}")
        if anisotropy not in range(1, 17):
            raise InputError(f"anisotropy must be a whole number from 1 to 16, got {anisotropy}")
        self._released = False
        self._outputs = frozenset(outputs)
        self._antialias = parse_antialias(antialias)
        self._context = open_context(backend, device_index)
        try:
            self._gl = self._context.gl
            self._atlas = self._upload_atlas(layers, wrap)
            self._models = ModelBuffers(self._gl, models, traced="visibility" in self._outputs)
            self._link_programs(wrap, anisotropy)
        except BaseException:
            self._context.release()
            raise
        self._targets: dict[Eye, EyeTargets] = {}
        self._colour_targets: ColourTargets | None = None
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
            Both images, both disparities and the outputs that were asked for, in new arrays.

        Raises:
            InputError: where an index is out of range, or there are more instances than ids.
            BackendError: where the image is larger than the driver allows, or drawing failed.
        """
        self._check(scene)
        # Another renderer of this thread may have made its context current.
        with self._gl:
            return self._render(scene)

    def _render(self, scene: Scene) -> Frame:
        self._resize(scene.camera.width_px, scene.camera.height_px)
        colour = {eye: self._draw(scene, eye) for eye in EYES}
        for eye in EYES:
            self._derive_truth(scene, eye)
        left, right = self._targets["left"], self._targets["right"]
        with_depth = "depth" in self._outputs
        frame = Frame(
            camera=scene.camera,
            left=left.read_colour() if colour["left"] is None else colour["left"],
            right=right.read_colour() if colour["right"] is None else colour["right"],
            disparity_left=left.read_disparity(),
            disparity_right=right.read_disparity(),
            visibility_left=left.read_visibility(),
            visibility_right=right.read_visibility(),
            instances_left=left.read_instances(),
            instances_right=right.read_instances(),
            depth_left=left.read_depth() if with_depth else None,
            depth_right=right.read_depth() if with_depth else None,
        )
        error = self._gl.error
        if error != "GL_NO_ERROR":
            raise BackendError(f"{self.renderer_name} reported {error} while drawing a pair")
        return frame

    def release(self) -> None:
        """Free the context and all that it holds; a second call does nothing."""
        if self._released:
            return
        self._released = True
        with self._gl:
            for targets in self._targets.values():
                targets.release()
            if self._colour_targets is not None:
                self._colour_targets.release()
        self._targets, self._colour_targets = {}, None
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

    def _link_programs(self, wrap: Wrap, anisotropy: int) -> None:
        """Link the programs; the numbers are the attachments that `EyeTargets` has."""
        drawn = ["TRUTH", *(["SURFACE"] if needs_surface(self._outputs) else [])]
        if self._antialias.kind == "none":
            drawn.insert(0, "COLOUR")
        sampling = {"ANISOTROPY": anisotropy}
        self._draw_program = link_program(self._context, "mesh.vert", "mesh.frag", _numbered(drawn) | sampling)
        self._colour_program = self._draw_program
        if self._antialias.kind != "none":
            self._colour_program = link_program(self._context, "mesh.vert", "mesh.frag", {"COLOUR": 0} | sampling)
        set_uniform(self._colour_program, "atlas", 0)
        set_uniform(self._colour_program, "mirror", wrap == "mirror")

        derived = ["DISPARITY", *(name.upper() for name in ("visibility", "instances") if name in self._outputs)]
        self._truth_passes = [self._truth_pass(_numbered(derived))]
        if "visibility" in self._outputs:
            self._truth_passes += [self._truth_pass(_numbered(derived) | {"TRACE": n}) for n in (1, 2)]

    def _truth_pass(self, defines: dict[str, int]) -> tuple[moderngl.Program, moderngl.VertexArray]:
        program = link_program(self._context, "truth.vert", "truth.frag", defines)
        set_uniform(program, "own_depth", _OWN_DEPTH)
        if needs_surface(self._outputs):
            set_uniform(program, "own_surface", _OWN_SURFACE)
        if "visibility" in self._outputs:
            set_uniform(program, "other_depth", _OTHER_DEPTH)
            set_uniform(program, "other_surface", _OTHER_SURFACE)
        return program, self._gl.vertex_array(program, [])

    def _check(self, scene: Scene) -> None:
        ranges = (("model", scene.model, len(self._models)), ("layer", scene.layer, self._atlas.layers))
        for name, index, count in ranges:
            if len(index) and (int(index.min()) < 0 or int(index.max()) >= count):
                raise InputError(
                    f"scene: {name} must be 0 to {count - 1}, got {int(index.min())} to {int(index.max())}"
                )
        if "instances" in self._outputs and len(scene) > _MOST_INSTANCE_IDS:
            raise InputError(
                f"a scene of {len(scene)} instances was asked for with the output instances, but 16-bit ids count up "
                f"to {_MOST_INSTANCE_IDS}: leave that output out"
            )

    def _resize(self, width_px: int, height_px: int) -> None:
        if self._size == (width_px, height_px):
            return
        antialiased = self._antialias.kind != "none"
        outgrown, outgrown_colour = list(self._targets.values()), self._colour_targets
        # All or nothing: a size that the driver refuses leaves the renderer as it was.
        colour_targets = ColourTargets(self._context, width_px, height_px, self._antialias) if antialiased else None
        self._targets = {
            eye: EyeTargets(self._context, width_px, height_px, self._outputs, colour=not antialiased) for eye in EYES
        }
        self._colour_targets = colour_targets
        # moderngl binds the framebuffer in use again after making a new one, so the old ones go last.
        self._targets["left"].drawing.use()
        for targets in outgrown:
            targets.release()
        if outgrown_colour is not None:
            outgrown_colour.release()
        self._size = (width_px, height_px)

    def _draw(self, scene: Scene, eye: Eye) -> NDArray[np.uint8] | None:
        """Draw one eye's depth, surface and colour; return the colour where it is antialiased."""
        commands = self._models.fill(scene, eye)
        projection = tuple(clip_from_view(scene.camera, eye, scene.near_m).T.ravel().tolist())
        self._atlas.use(0)
        self._draw_into(self._targets[eye].drawing, self._draw_program, projection, commands)
        if self._colour_targets is None:
            return None
        self._draw_into(self._colour_targets.fine, self._colour_program, projection, commands)
        return self._colour_targets.read_colour()

    def _draw_into(
        self, target: moderngl.Framebuffer, program: moderngl.Program, projection: tuple[float, ...], commands: int
    ) -> None:
        target.use()
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.depth_func = ">"
        target.clear(0.0, 0.0, 0.0, 0.0, depth=0.0)
        set_uniform(program, "clip_from_view", projection)
        self._models.draw(program, commands)

    def _derive_truth(self, scene: Scene, eye: Eye) -> None:
        own, other, camera = self._targets[eye], self._targets[_OTHER[eye]], scene.camera
        own.truth.use()
        own.depth_m.use(_OWN_DEPTH)
        if own.surface is not None:
            own.surface.use(_OWN_SURFACE)
        if "visibility" in self._outputs and other.surface is not None:
            other.depth_m.use(_OTHER_DEPTH)
            other.surface.use(_OTHER_SURFACE)
            self._models.bind_for_tracing(scene, _OTHER[eye])
        self._gl.enable_only(moderngl.DEPTH_TEST)
        # All draws stand at depth 0, where nothing drawn can be. What the first discards keeps the drawing's depth,
        # and the others are drawn where that is so.
        for number, (program, vao) in enumerate(self._truth_passes):
            self._gl.depth_func = "1" if number == 0 else "!="
            set_uniform(program, "focal_baseline", camera.focal_baseline)
            set_uniform(program, "doffs_px", camera.doffs_px)
            if "visibility" in self._outputs:
                set_uniform(program, "other_from_own", -1.0 if eye == "left" else 1.0)
            if number > 0:
                set_uniform(program, "focal_px", camera.focal_px)
                set_uniform(program, "near_m", scene.near_m)
                set_uniform(program, "other_centre_px", (camera.cx_px(_OTHER[eye]), camera.cy_px))
            vao.render(moderngl.TRIANGLES, 3)


def _numbered(names: Sequence[str]) -> dict[str, int]:
    return {name: number for number, name in enumerate(names)}
