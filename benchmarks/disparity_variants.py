"""Ways to compute a pixel's disparity: the renderer's way, and alternatives that it does not offer."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal, Self

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render import Backend
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import open_context
from semisynth_gl.render.instance_transforms import TransformComposer
from semisynth_gl.render.model_buffers import SceneBuffers, refill
from semisynth_gl.render.programs import link_meshes, link_program
from semisynth_gl.render.projection import clip_from_view
from semisynth_gl.render.targets import EyeTargets
from semisynth_gl.scene.scene import Scene

Variant = Literal["depth24", "depth24-tight", "depth32f", "linear", "w-direct", "plane64"]
VARIANTS: Mapping[Variant, str] = {
    "depth24": "24-bit depth buffer, near plane at 0.05 m, made linear in float64",
    "depth24-tight": "24-bit depth buffer, near plane at the largest disparity, made linear in float64",
    "depth32f": "32-bit float depth buffer, reversed, made linear in float64",
    "linear": "interpolated linear depth",
    "w-direct": "gl_FragCoord.w times f B",
    "plane64": "plane equation of the triangle, double precision",
}
"""Descriptions of the variants."""
RENDERERS_VARIANT: Variant = "w-direct"

_DEPTH_BUFFER_VARIANTS: tuple[Variant, ...] = ("depth24", "depth24-tight", "depth32f")
_DEFINES: dict[Variant, dict[str, int]] = {"linear": {"LINEAR": 1}, "plane64": {"PLANE64": 1}}
# A near plane that is usual if the scene is unknown.
_CUSTOMARY_NEAR_M = 0.05
# A 24-bit buffer's step in 1/Z is (1/near - 1/far) / 2^24: the far plane does not matter and is put far away.
_FAR_M = 1e5
_STEPS_24 = 2**24 - 1
# No variant samples patches, so a scene may have any number of them.
_ANY_PATCH = np.iinfo(np.int64).max
_POSES, _CAMERA_64 = 4, 1  # the bindings in variant.frag

CAMERA_64 = np.dtype(
    [
        ("centre_px_64", "<f8", 2),
        ("focal_px_64", "<f8"),
        ("focal_baseline_64", "<f8"),
        ("doffs_px_64", "<f8"),
        ("", "<f8"),
    ]
)
"""The uniform block of variant.frag, std140."""

_SHADERS = Path(__file__).resolve().parent / "shaders"
VARIANT_SHADERS = str(_SHADERS / "variant.vert"), str(_SHADERS / "variant.frag")


class DisparityVariants:
    """Renders the disparity of one eye by any variant. Use it in a ``with`` block, in the thread that made it.

    Args:
        models: the meshes that `Scene.model` indexes.
        backend: "auto", "egl" or "osmesa".

    Attributes:
        usable: the variants that the driver supports, in the order of `VARIANTS`; some drivers have no doubles.

    Raises:
        BackendError: if no context can be opened.
    """

    def __init__(self, models: Sequence[Mesh], backend: Backend = "auto") -> None:
        self._context = open_context(backend)
        self._gl = self._context.gl
        self._constants = ConstantsBuffer(self._gl)
        self._camera_64 = self._gl.buffer(reserve=CAMERA_64.itemsize)
        self._composer = TransformComposer(models)
        self._models = SceneBuffers(self._gl, models, np.array([_ANY_PATCH]), with_triangles=True)
        self._poses = self._gl.buffer(reserve=1)
        self._targets: EyeTargets | None = None
        self._depth_m: EyeTargets | None = None
        self._depth_only: dict[int, tuple[moderngl.Renderbuffer, moderngl.Framebuffer]] = {}
        self._programs: dict[Variant, moderngl.Program] = {}
        depth_only = link_program(self._context, *VARIANT_SHADERS, {})
        for variant in VARIANTS:
            if variant in _DEPTH_BUFFER_VARIANTS:
                self._programs[variant] = depth_only
            elif variant == RENDERERS_VARIANT:
                self._programs[variant] = link_meshes(self._context, {"DISPARITY": 0})
            else:
                with suppress(BackendError):
                    self._programs[variant] = link_program(self._context, *VARIANT_SHADERS, _DEFINES[variant])
        self.usable = tuple(self._programs)
        self._from_depth = link_program(self._context, "whole_image.vert", str(_SHADERS / "variant_depth.frag"), {})
        self._from_depth_vao = self._gl.vertex_array(self._from_depth, [])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def disparity(self, scene: Scene, eye: Eye, variant: Variant) -> NDArray[np.float32]:
        """Return one eye's disparity by a variant of `usable`: (H, W) float32 px.

        It is inf where it is not positive or nothing is seen. Raises BackendError if the driver reports an error.
        """
        if variant in _DEPTH_BUFFER_VARIANTS:
            disparity = self._from_depth_buffer(scene, eye, variant)
        else:
            disparity = self._from_shader(scene, eye, variant)
        self._check()
        return disparity

    def release(self) -> None:
        """Free the context and its objects."""
        self._context.release()

    def _from_shader(self, scene: Scene, eye: Eye, variant: Variant) -> NDArray[np.float32]:
        targets, program, camera = self._sized(scene), self._programs[variant], scene.camera
        if variant == "linear" and self._depth_m is not None:
            self._depth_m.framebuffer.use()
            self._depth_m.framebuffer.clear(0.0, 0.0, 0.0, 0.0, depth=0.0)
            self._draw(scene, eye, program)
            targets.framebuffer.use()
            self._depth_m.bind(depth=0)
            self._gl.enable_only(moderngl.NOTHING)
            self._constants.write(scene, eye)
            self._from_depth_vao.render(moderngl.TRIANGLES, 3)
            return np.asarray(targets.read("disparity"))
        if variant == "plane64":
            refill(self._poses, self._composer.compose(scene).rows(eye))
            self._poses.bind_to_storage_buffer(_POSES)
            constants = camera.intrinsics_px(eye)[:2], camera.focal_px, camera.focal_baseline, camera.doffs_px, 0.0
            self._camera_64.write(np.array(constants, CAMERA_64))
            self._camera_64.bind_to_uniform_block(_CAMERA_64)
            self._models.bind_triangles(self._composer.compose(scene), eye)
        targets.clear()
        self._draw(scene, eye, program)
        return np.asarray(targets.read("disparity"))

    def _from_depth_buffer(self, scene: Scene, eye: Eye, variant: Variant) -> NDArray[np.float32]:
        camera, bits = scene.camera, 32 if variant == "depth32f" else 24
        target = self._depth_target(scene, bits)
        if bits == 32:
            target.use()
            target.clear(depth=0.0)
            self._draw(scene, eye, self._programs[variant])
            inverse_depth = self._read_depth(target).astype(np.float64) / scene.near_m
            seen = inverse_depth > 0
        else:
            near = scene.near_m if variant == "depth24-tight" else min(scene.near_m, _CUSTOMARY_NEAR_M)
            projection = clip_from_view(camera, eye, near)
            projection[2] = 0, 0, _FAR_M / (_FAR_M - near), -_FAR_M * near / (_FAR_M - near)
            target.use()
            target.clear(depth=1.0)
            self._draw(scene, eye, self._programs[variant], projection=projection)
            # float32 represents all 2^24 values, so rounding recovers the buffer's integers.
            steps = np.rint(self._read_depth(target).astype(np.float64) * _STEPS_24)
            inverse_depth = 1 / near - steps / _STEPS_24 * (1 / near - 1 / _FAR_M)
            seen = steps < _STEPS_24
        disparity = camera.focal_baseline * inverse_depth - camera.doffs_px
        return np.where(seen & (disparity > 0), disparity, np.inf).astype(np.float32)

    def _draw(
        self, scene: Scene, eye: Eye, program: moderngl.Program, *, projection: NDArray[np.float64] | None = None
    ) -> None:
        """Draw one eye into the current framebuffer; with ``projection``, depth increases with distance."""
        ranges = self._models.upload(self._composer.compose(scene), eye)
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.depth_func = ">" if projection is None else "<"
        self._constants.write(scene, eye, projection=projection)
        for drawn in ranges:
            self._models.draw(program, drawn)

    def _sized(self, scene: Scene) -> EyeTargets:
        size = scene.camera.width_px, scene.camera.height_px
        if self._targets is None or self._targets.framebuffer.size != size:
            outgrown = [targets for targets in (self._targets, self._depth_m) if targets is not None]
            self._targets = EyeTargets(self._context, size, ("disparity",))
            self._depth_m = EyeTargets(self._context, size, ("depth",))
            self._targets.framebuffer.use()
            for targets in outgrown:
                targets.release()
        return self._targets

    def _depth_target(self, scene: Scene, bits: int) -> moderngl.Framebuffer:
        size = scene.camera.width_px, scene.camera.height_px
        if bits not in self._depth_only or self._depth_only[bits][0].size != size:
            outgrown = self._depth_only.pop(bits, None)
            buffer = self._gl.depth_renderbuffer(size)  # 24 bits
            if bits == 32:
                self._context.functions.make_depth_float32(buffer.glo, *size)
            self._depth_only[bits] = buffer, self._gl.framebuffer([], buffer)
            self._depth_only[bits][1].use()
            for resource in reversed(outgrown or ()):
                resource.release()
        return self._depth_only[bits][1]

    @staticmethod
    def _read_depth(target: moderngl.Framebuffer) -> NDArray[np.float32]:
        """Return the depth buffer, (H, W) float32, top row first."""
        width, height = target.size
        return np.frombuffer(target.read(attachment=-1, components=1, dtype="f4"), np.float32).reshape(height, width)

    def _check(self) -> None:
        error = self._gl.error
        if error != "GL_NO_ERROR":
            raise BackendError(f"{self._context.renderer} reported {error} while drawing")
