"""The renderer: models and patches are uploaded to the GPU once, then any number of scenes are rendered with them.

A pair takes three stages: the drawing pass of each eye (`DrawPass`: colour, disparity and other outputs), the
visibility pass of each eye, and the readback, which also runs the correspondence and flow passes (`ReadbackPass`).
`RenderOptions` chooses the outputs. This module checks the caller's arguments and the errors that the driver reports.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Literal, Self, get_args
from weakref import finalize

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, Crop, Eye, StereoCamera
from semisynth_gl.frame.channels import DEFAULT_OUTPUTS, TruthViews, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.inputs.arguments import check_one_of, to_whole
from semisynth_gl.inputs.errors import BackendError, ContextLostError, InputError
from semisynth_gl.listener import Listener
from semisynth_gl.render import Backend
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import open_context
from semisynth_gl.render.draw_pass import DrawPass
from semisynth_gl.render.instance_transforms import TransformComposer
from semisynth_gl.render.model_buffers import SceneBuffers
from semisynth_gl.render.options import CHANNELS_OF_BOTH_EYES, RenderOptions
from semisynth_gl.render.patches import PatchTextures
from semisynth_gl.render.readback_pass import ReadbackPass
from semisynth_gl.render.readers import PixelReader, read_array
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.target_set import TargetSet
from semisynth_gl.scene.scene import Scene, SceneMotion

Wrap = Literal["mirror", "repeat"]
RenderStage = Literal["draw", "visibility", "readback"]

_MOST_INSTANCE_IDS = 65535
# Number of image sizes for which targets are cached: that of pairs, and with lenses, one for each eye's raw image.
_MOST_SIZES = 3
_NO_ERROR, _UNKNOWN_ERROR = "GL_NO_ERROR", "GL_UNKNOWN_ERROR"


class Renderer:
    """Renders scenes with a fixed set of models and patches. Use it in a ``with`` block, in the thread that made it.

    Args:
        models: the meshes that `Scene.model` indexes.
        layers: the patch atlas that `Scene.layer` indexes, (L, P, P, 4) uint8 RGBA; row 0 is the top. Or (L, P, P)
            uint8 grey: then images are grey, too, (H, W).
        large_layers: patches of a different size, (M, Q, Q, 4) or (M, Q, Q) uint8 like ``layers``. In `Scene.layer`,
            their numbers are L to L + M - 1. Instances with these patches are drawn last. By default there are none.
        wrap: whether a patch is mirrored beyond its border, "mirror", or repeats, "repeat".
        anisotropy: maximum number of samples of a patch, 1 to 16, for a pixel that sees the patch at a grazing angle.
            With 1, patches at a grazing angle are blurred.
        large_anisotropy: the same for large patches.
        outputs: the outputs to make besides images and disparities; see `semisynth_gl.frame.channels.RENDERED_OUTPUTS`.
        truth: the views for which disparity and outputs are made, "both" or "left".
        rectified: False if right cameras may deviate from the rectified camera.
        signed: whether disparities of 0 and below are valid.
        antialias: "none", "edges", or "ssaa2" to "ssaa8"; for colour only.
        pattern: the pattern of the scenes' projectors, (H, W) uint8; None if no scene has a projector.
        backend: "auto", "egl" or "osmesa".
        device_index: EGL's number of the device.
        read: reads pixels from framebuffers, by default into arrays in main memory; see `PixelReader`.

    Attributes:
        listener: for measurements, is called at the end of each stage ("draw", "visibility", "readback"), after the
            driver has finished the stage. With None, the default, stages overlap. Supersampled images are read in the
            stage "draw", and flow is computed in the stage "readback".

    Raises:
        BackendError: where no context can be opened, or the driver cannot hold the atlas.
        InputError: where models or layers are empty or of a wrong shape, a model is too small or too large for float32
            (1e-9 to 1e9), or an option is unknown.
    """

    def __init__(
        self,
        models: Sequence[Mesh],
        layers: NDArray[np.uint8],
        *,
        large_layers: NDArray[np.uint8] | None = None,
        wrap: Wrap = "mirror",
        anisotropy: int = 1,
        large_anisotropy: int = 1,
        outputs: Collection[str] = DEFAULT_OUTPUTS,
        truth: TruthViews = "both",
        rectified: bool = True,
        signed: bool = False,
        antialias: str = "none",
        pattern: NDArray[np.uint8] | None = None,
        backend: Backend = "auto",
        device_index: int = 0,
        read: PixelReader = read_array,
    ) -> None:
        to_whole("device_index", device_index, least=0)
        if not models:
            raise InputError("a renderer needs at least one model, got none")
        atlases = {"layers": layers} | ({} if large_layers is None else {"large_layers": large_layers})
        _check_atlases(atlases)
        self._options = RenderOptions.of(outputs, truth, antialias, rectified=rectified, signed=signed)
        check_one_of("wrap", wrap, get_args(Wrap))
        for name, samples in (("anisotropy", anisotropy), ("large_anisotropy", large_anisotropy)):
            if samples not in range(1, 17):
                raise InputError(f"{name} must be a whole number from 1 to 16, got {samples}")
        self.listener: Listener | None = None
        self._context = open_context(backend, device_index)
        try:
            self._gl = self._context.gl
            # The context is current until the end of this block. Later, `_current` makes it current for each call.
            with self._gl:
                patches = PatchTextures(self._context, tuple(atlases.values()), mirrored=wrap == "mirror")
                self._composer = TransformComposer(models)
                buffers = SceneBuffers(self._gl, models, patches.ends, with_triangles=self._options.reads_triangles)
                anisotropies = (anisotropy, large_anisotropy)[: len(atlases)]
                constants = ConstantsBuffer(self._gl, signed=signed)
                self._resources = RenderResources(
                    self._context, buffers, patches, anisotropies, constants, self._options, read, pattern
                )
                self._target_sets: dict[tuple[int, int], TargetSet] = {}  # by image size, the latest last
                self._drawing = DrawPass(self._resources)
                self._reading = ReadbackPass(self._resources, self._composer)
                reported = self._gl.error
        except BaseException:
            self._context.release()
            raise
        # Frees the context when a renderer that was not released is collected. At exit, the system frees it.
        self._free = finalize(self, self._context.release)
        self._free.atexit = False
        if reported != _NO_ERROR:
            self.release()
            raise BackendError(f"{self.renderer_name} reported {reported} while models and patches were loaded")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    @property
    def backend(self) -> Backend:
        """The backend in use, "egl" or "osmesa"."""
        return self._context.backend

    @property
    def renderer_name(self) -> str:
        """The driver's name for itself (GL_RENDERER)."""
        return self._context.renderer

    @property
    def facts(self) -> dict[str, str]:
        """The "backend", the "renderer" (the driver's name for itself), and the driver's version of "opengl"."""
        return self._context.facts

    def render(
        self,
        scene: Scene,
        crop: Crop | None = None,
        *,
        future: SceneMotion | None = None,
        past: SceneMotion | None = None,
    ) -> Frame:
        """Render one pair.

        Args:
            scene: the scene; its indices must lie within the renderer's models and layers.
            crop: the part of both images to return, with the pixels of the whole images, bit for bit; None for all.
            future: the scene's motion to the next frame, for the outputs "flow" and "disparity_change".
            past: the scene's motion to the previous frame, for the output "flow_backward".

        Returns:
            Both images, and the disparities and outputs of the views that have truth, in new arrays, unless the
            caller's ``read`` reuses arrays.

        Raises:
            InputError: where an index or the crop is out of range, the output "instances" has too few ids for the
                scene, an output needs a motion that is missing, a motion is of a different scene, the right camera
                deviates although the renderer is rectified, the scene has a projector and the renderer no pattern, or
                an instance is too small, too large or too far away for float32.
            BackendError: where the image is larger than the driver allows, or the driver reports an error.
            ContextLostError: where the context is lost, as after a reset of the GPU; a new renderer may work.
        """
        return self.render_rig(scene, [scene.camera], crop, future=future, past=past)[0]

    def render_rig(
        self,
        scene: Scene,
        cameras: Sequence[StereoCamera],
        crop: Crop | None = None,
        *,
        future: SceneMotion | None = None,
        past: SceneMotion | None = None,
    ) -> list[Frame]:
        """Render a scene with several cameras that differ only in the right eye; draw the left view once.

        Args:
            scene: the scene; see `render`.
            cameras: at least one camera; their left eyes must be that of the scene's camera.
            crop: the part of the images to return; see `render`.
            future: the motion to the next frame, with the scene's own camera; see `render`.
            past: the motion to the previous frame, with the scene's own camera; see `render`.

        Returns:
            The pair of each camera, bit for bit as `render` returns it for the scene with that camera. A channel of the
            left view that does not depend on the right eye is the same read-only array in all pairs. With several
            cameras, the renderer's ``read`` must return new arrays.

        Raises:
            InputError: where there is no camera, a camera differs in the left eye, or `render` raises it.
            BackendError, ContextLostError: as `render` does.
        """
        self._check_open()
        motions = {"future": future, "past": past}
        self._check_request(scene, cameras, motions)
        frames = []
        with self._current():
            target_set = self._target_set_of(scene.camera)
            transforms = [self._composer.compose(replace(scene, camera=camera)) for camera in cameras]
            for pair in self._drawing.draw(transforms, crop, target_set):
                self._finish("draw")
                self._reading.compute_visibility(pair)
                self._finish("visibility")
                camera = pair.transforms.scene.camera
                self._reading.read(pair, {name: motion and motion.seen_by(camera) for name, motion in motions.items()})
                self._finish("readback")
                shown_camera = camera if crop is None else camera.cropped(crop)
                frames.append(Frame(shown_camera, ViewArrays(pair.views["left"]), ViewArrays(pair.views["right"])))
        for name, array in frames[0].left.items() if len(frames) > 1 else ():
            if name not in CHANNELS_OF_BOTH_EYES and isinstance(array, np.ndarray):
                array.flags.writeable = False
        return frames

    def _check_request(
        self, scene: Scene, cameras: Sequence[StereoCamera], motions: Mapping[str, SceneMotion | None]
    ) -> None:
        """Raise InputError where the scene, a camera or a motion does not fit the renderer or the scene."""
        if not cameras:
            raise InputError("expected at least one, got none", argument="cameras")
        for camera in cameras:
            if camera.left_view_key != scene.camera.left_view_key:
                raise InputError(
                    f"cameras: expected cameras that differ from the scene's only in the right eye, {scene.camera}, "
                    f"got {camera}"
                )
            self._check_scene(replace(scene, camera=camera))
        for checked in (scene, *(motion.scene for motion in motions.values() if motion is not None)):
            self._check_scene(checked)
        for name, motion in motions.items():
            outputs = self._options.outputs_of(name)
            if outputs and motion is None:
                raise InputError(f"the output {outputs[0]} needs the scene's motion: {name}=move(scene, ...)")
            if motion is not None and motion.scene.camera != scene.camera:
                raise InputError(
                    f"expected the scene's camera, {scene.camera}, got {motion.scene.camera}", argument=name
                )

    def render_images(self, scene: Scene, eyes: Collection[Eye] = EYES) -> dict[Eye, NDArray[np.uint8]]:
        """Render only the images of a pair, without its truth. The images are those of `render`.

        Args:
            scene: the scene; its indices must lie within the renderer's models and layers.
            eyes: "left", "right" or both.

        Returns:
            The image of each of these eyes, (H, W, 3) uint8 RGB or (H, W) grey.

        Raises:
            InputError: where the scene does not fit the renderer, as in `render`, or an eye is neither left nor right.
            BackendError, ContextLostError: as `render` does.
        """
        self._check_open()
        self._check_scene(scene)
        if isinstance(eyes, str) or not set(eyes) <= set(EYES):
            raise InputError(f"expected some of {', '.join(EYES)}, got {eyes!r}", argument="eyes")
        with self._current():
            target_set = self._target_set_of(scene.camera)
            transforms = self._composer.compose(scene)
            return {eye: self._drawing.draw_image(transforms, eye, target_set) for eye in eyes}

    def _target_set_of(self, camera: StereoCamera) -> TargetSet:
        """Return the targets of a camera's image size; the targets of the latest sizes are cached."""
        size, cached = (camera.width_px, camera.height_px), self._target_sets
        cached[size] = cached.pop(size) if size in cached else TargetSet(self._resources, size)
        if len(cached) > _MOST_SIZES:
            # When moderngl makes a framebuffer, it binds the current one again afterwards: do not release that one.
            self._gl.screen.use()
            cached.pop(next(iter(cached))).release()
        return cached[size]

    def _finish(self, stage: RenderStage) -> None:
        """If there is a listener, let the driver finish a stage, then report the end of the stage."""
        if self.listener is not None:
            self._gl.finish()
            self.listener.on_stage(stage)

    @contextmanager
    def _current(self) -> Iterator[None]:
        """Make the context current, since another renderer's may be; raise errors that the driver reports."""
        with self._gl:
            try:
                yield
            except moderngl.Error as error:
                raise self._error_of(str(error)) from None
            reported = self._gl.error
            if reported != _NO_ERROR or self._context.functions.is_lost():
                raise self._error_of(reported)

    def _check_open(self) -> None:
        """Raise BackendError if the renderer was released, or was made by a different process or thread.

        In these cases the driver would crash, or wait without end.
        """
        if not self._free.alive:
            raise BackendError("this renderer was released: open a new one")
        self._context.check_owner()

    def _error_of(self, reported: str) -> BackendError:
        """Return the error to raise for one that moderngl or the driver has reported."""
        # moderngl knows all errors of a working context, so an unknown error means that the context is lost.
        if self._context.functions.is_lost() or _UNKNOWN_ERROR in (self._gl.error, reported):
            return ContextLostError(f"{self.renderer_name} lost its context while it drew a pair: was the GPU reset?")
        return BackendError(f"{self.renderer_name} reported {reported} while drawing a pair")

    def release(self) -> None:
        """Free the context and all that it holds; a second call does nothing."""
        self._free()

    def _check_scene(self, scene: Scene) -> None:
        """Raise InputError where a scene does not fit the renderer's options, models and patches."""
        if self._options.rectified and not scene.camera.rectified:
            raise InputError(
                f"scene: its right camera deviates ({scene.camera.deviation}), which needs Renderer(rectified=False)"
            )
        if scene.projector is not None and self._resources.pattern is None:
            raise InputError("its projector has a pattern, which needs Renderer(pattern=...)", argument="scene")
        ranges = (
            ("model", scene.model, len(self._resources.models)),
            ("layer", scene.layer, len(self._resources.patches)),
        )
        for name, index, count in ranges:
            if len(index) and (int(index.min()) < 0 or int(index.max()) >= count):
                raise InputError(
                    f"scene: {name} must be 0 to {count - 1}, got {int(index.min())} to {int(index.max())}"
                )
        if "instances" in self._options.outputs and len(scene) > _MOST_INSTANCE_IDS:
            raise InputError(
                f"the scene has {len(scene)} instances, but the output instances has 16-bit ids, up to "
                f"{_MOST_INSTANCE_IDS}: drop that output"
            )


def _check_atlases(atlases: Mapping[str, NDArray[np.uint8]]) -> None:
    for name, layers in atlases.items():
        side = layers.shape[1] if layers.ndim > 1 else 0
        if layers.shape[1:] not in ((side, side, 4), (side, side)) or layers.dtype != np.uint8:
            raise InputError(f"{name} must be (L, P, P, 4) or (L, P, P) uint8, got {layers.shape} {layers.dtype}")
        if len(layers) == 0 or layers.shape[1] == 0:
            raise InputError(f"{name}: the patch atlas is empty")
    if len({atlas.ndim for atlas in atlases.values()}) > 1:
        shapes = " and ".join(f"{name} {atlas.shape}" for name, atlas in atlases.items())
        raise InputError(f"layers and large_layers must both be RGBA or both be grey, got {shapes}")
