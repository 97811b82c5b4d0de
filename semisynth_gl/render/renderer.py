"""The renderer: models and patches go to the GPU once, then any number of scenes are drawn from them.

A pair takes three steps: the drawing pass of each eye (`Drawing`: colour, disparity and what else was asked for), the
visibility pass of each eye, and the copy of the results into arrays, with the passes that compare moments or views in
other ways (`Reading`). `Wanted` says what is made; what a caller hands in is checked here, and so is what the driver
reports.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from traceback import clear_frames
from typing import Literal, Self
from weakref import finalize

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, Crop, Eye, StereoCamera
from semisynth_gl.frame.frame import DEFAULT_OUTPUTS, Frame, TruthViews, View
from semisynth_gl.geometry.mesh import Mesh, centred
from semisynth_gl.inputs.arguments import check_type, to_whole
from semisynth_gl.inputs.errors import BackendError, ContextLostError, InputError
from semisynth_gl.listener import Listener
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import open_context
from semisynth_gl.render.drawing import Drawing
from semisynth_gl.render.loaded import Loaded
from semisynth_gl.render.model_buffers import ModelBuffers
from semisynth_gl.render.pair_targets import PairTargets
from semisynth_gl.render.pass_clock import PassClock
from semisynth_gl.render.patches import PatchTextures
from semisynth_gl.render.placing import Placing
from semisynth_gl.render.readers import Reader, read_array
from semisynth_gl.render.reading import Reading
from semisynth_gl.render.shared_left import SharedLeft
from semisynth_gl.render.wanted import Wanted
from semisynth_gl.scene.scene import Motion, Scene

Wrap = Literal["mirror", "repeat"]
RenderStage = Literal["draw", "visibility", "readback"]

_MOST_INSTANCE_IDS = 65535
_NO_ERROR, _UNKNOWN_ERROR = "GL_NO_ERROR", "GL_UNKNOWN_ERROR"


class Renderer:
    """Draws scenes with a fixed set of models and patches. Use it in a ``with`` block, in the thread that made it.

    Args:
        models: the meshes that `Scene.model` counts.
        layers: (L, P, P, 4) uint8 RGBA, the patch atlas that `Scene.layer` counts; row 0 is the top. Or (L, P, P) uint8
            grey: then images are (H, W), of one component all the way.
        large_layers: (M, Q, Q, 4) uint8 RGBA, or (M, Q, Q) grey like ``layers``, patches of another size, which
            `Scene.layer` counts from L on; instances that wear them are drawn after the others. None for none.
        wrap: what lies beyond a patch's border, its mirror image or itself again.
        anisotropy: most samples of a patch for a pixel that sees it at a grazing angle; 1 blurs there.
        large_anisotropy: the same of large patches.
        outputs: what to make beside images and disparities; see `semisynth_gl.frame.frame.OUTPUTS`.
        truth: of which views disparity and outputs are made, "both" or "left".
        rectified: False where right cameras may deviate from the rectified one: both eyes' depths are drawn then.
        signed: whether disparities of 0 and below are valid.
        antialias: "none", "edges", "msaa4" (or what the driver has) or "ssaa2" to "ssaa8"; for colour only.
        backend: "auto", "egl" or "osmesa".
        device_index: EGL's number of the device.
        read: what takes the pixels that were drawn: arrays in memory by default; see `Reader` for others.

    Attributes:
        listener: for measurements: hears the end of each stage ("draw", "visibility", "readback"), which the driver is
            made to finish first. Without a listener stages overlap, and nothing is called. Antialiased colour is read
            back in the stage "draw", and flow is drawn in the stage "readback".

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
        backend: Backend = "auto",
        device_index: int = 0,
        read: Reader = read_array,
    ) -> None:
        check_type("models", models, Sequence)
        for model in models:
            check_type("a model", model, Mesh, "make_mesh makes one")
        to_whole("device_index", device_index, least=0)
        if not models:
            raise InputError("a renderer needs at least one model, got none")
        atlases = {"layers": layers} | ({} if large_layers is None else {"large_layers": large_layers})
        _check_atlases(atlases)
        self._wanted = Wanted.of(outputs, truth, antialias, rectified=rectified, signed=signed)
        for name, most in (("anisotropy", anisotropy), ("large_anisotropy", large_anisotropy)):
            if most not in range(1, 17):
                raise InputError(f"{name} must be a whole number from 1 to 16, got {most}")
        self.listener: Listener | None = None
        self._targets: PairTargets | None = None
        self._context = open_context(backend, device_index)
        try:
            self._gl = self._context.gl
            # Current from its opening on, which would keep what it holds alive after its release.
            with self._gl:
                patches = PatchTextures(self._context, tuple(atlases.values()), mirrored=wrap == "mirror")
                drawn = [centred(model) for model in models]
                self._placing = Placing(drawn)
                meshes = [model.mesh for model in drawn]
                buffers = ModelBuffers(self._gl, meshes, patches.ends, traced=self._wanted.reads_triangles)
                anisotropies = (anisotropy, large_anisotropy)[: len(atlases)]
                constants = ConstantsBuffer(self._gl, signed=signed)
                self._loaded = Loaded(self._context, buffers, patches, anisotropies, constants, self._wanted, read)
                self._drawing = Drawing(self._loaded)
                self._reading = Reading(self._loaded, self._placing)
                reported = self._gl.error
        except BaseException:
            self._context.release()
            raise
        # Frees what a renderer holds that nobody released, when it is collected. Not when Python ends: all goes then.
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
        """Backend, renderer and version of OpenGL, as the driver calls them."""
        return self._context.facts

    @property
    def clock(self) -> PassClock:
        """For measurements: times each pass while it runs; it does not before it is started."""
        return self._context.clock

    def count_objects(self) -> dict[str, int]:
        """Count what the driver holds for this renderer, by kind; for the search for leaks."""
        self._check_open()
        with self._gl:
            return self._context.unbound.count_objects()

    def render(
        self, scene: Scene, crop: Crop | None = None, *, future: Motion | None = None, past: Motion | None = None
    ) -> Frame:
        """Draw one pair.

        Args:
            scene: indices must lie within the renderer's models and layers.
            crop: draw and return this part of both images alone; its pixels equal the whole image's, bit for bit.
            future: how the scene gets to the next frame, for the outputs "flow" and "disparity_change".
            past: how it gets to the previous frame, for the output "flow_backward".

        Returns:
            Both images, both disparities and the outputs that were asked for, in new arrays.

        Raises:
            InputError: where an index or the crop is out of range, there are more instances than ids, an output needs
                a motion that is not there or not the scene's, or float32 cannot hold an instance as the camera sees it.
            BackendError: where the image is larger than the driver allows, or drawing failed.
            ContextLostError: where the driver took the context away; another renderer may still be opened.
        """
        self._check_open()
        motions = {"future": future, "past": past}
        self._check_request(scene, crop, motions)
        return self._draw_pair(scene, crop, motions)

    def share_left(
        self,
        scene: Scene,
        cameras: Sequence[StereoCamera],
        crop: Crop | None = None,
        *,
        future: Motion | None = None,
        past: Motion | None = None,
    ) -> SharedLeft:
        """Prepare the pairs of a scene before several cameras that differ in the right eye alone.

        Args:
            scene: see `render`, as for the others.
            cameras: at least one; each is the scene's in the left eye.
            crop: see there.
            future: see there; its camera is the scene's.
            past: likewise.

        Returns:
            What draws the pair of any of the cameras when it is asked to, and the left view once for all of them.

        Raises:
            InputError: where a camera differs in the left eye, and as `render` does.
            BackendError: where the renderer was released.
        """
        self._check_open()
        self._check_request(scene, crop, {"future": future, "past": past})
        check_type("cameras", cameras, Sequence)
        shared = SharedLeft(self._draw_of_shared, scene, cameras, crop, future, past)
        for shown in shared.scenes:
            self._check(shown)
        return shared

    def _draw_of_shared(self, shared: SharedLeft, number: int) -> Frame:
        """Draw one pair of a shared left view."""
        self._check_open()
        scene = shared.scenes[number]
        seen = {
            name: motion and replace(motion, scene=replace(motion.scene, camera=scene.camera))
            for name, motion in shared.motions.items()
        }
        return self._draw_pair(scene, shared.crop, seen, shared)

    def _check_request(self, scene: Scene, crop: Crop | None, motions: Mapping[str, Motion | None]) -> None:
        """Raise InputError where the scene or the crop cannot be drawn, or a motion is missing that an output needs."""
        check_type("scene", scene, Scene)
        check_type("crop", crop, Crop | None)
        for name, motion in motions.items():
            check_type(name, motion, Motion | None, "move makes one")
        for shown in (scene, *(motion.scene for motion in motions.values() if motion is not None)):
            self._check(shown)
        for name, motion in motions.items():
            wanted = self._wanted.needing(name)
            if wanted and motion is None:
                raise InputError(f"the output {wanted[0]} needs the scene's motion: render(scene, {name}=Motion(...))")

    def render_images(self, scene: Scene, eyes: Collection[Eye] = EYES) -> dict[Eye, NDArray[np.uint8]]:
        """Draw the images of a pair alone, as `render` draws them, and nothing of its truth.

        Args:
            scene: indices must lie within the renderer's models and layers.
            eyes: whose images.

        Raises:
            InputError: where an index is out of range, or an eye is neither left nor right.
            BackendError: where the image is larger than the driver allows, or drawing failed.
            ContextLostError: where the driver took the context away; another renderer may still be opened.
        """
        self._check_open()
        check_type("scene", scene, Scene)
        self._check(scene)
        if isinstance(eyes, str) or not set(eyes) <= set(EYES):
            raise InputError(f"eyes: expected some of {', '.join(EYES)}, got {eyes!r}")
        with self._current():
            sized = self._sized(scene, shared=False)
            placed = self._placing.place(scene)
            return {eye: self._drawing.draw_image(placed, eye, sized) for eye in eyes}

    def _draw_pair(
        self,
        scene: Scene,
        crop: Crop | None,
        motions: Mapping[str, Motion | None],
        shared: SharedLeft | None = None,
    ) -> Frame:
        """Draw one pair, and raise what the driver reports."""
        camera = scene.camera if crop is None else scene.camera.cropped(crop)

        def finish(stage: RenderStage) -> None:
            if self.listener is not None:
                self._gl.finish()
                self.listener.on_stage(stage)

        with self._current():
            sized = self._sized(scene, shared=shared is not None)
            pair = self._drawing.draw(self._placing.place(scene), crop, sized, shared)
            finish("draw")
            self._reading.find_visibility(pair)
            finish("visibility")
            self._reading.read(pair, motions)
            finish("readback")
            frame = Frame(camera, View(pair.views["left"]), View(pair.views["right"]))
        if shared is not None:
            shared.keep(frame.left)
            if self._wanted.antialias.redraws and "image" not in shared.channels:
                # The right eye's colour was drawn over it.
                sized.shared_left = None
        return frame

    @contextmanager
    def _current(self) -> Iterator[None]:
        """Make the context current, since another renderer of this thread may have made its own so; find faults."""
        with self._gl:
            try:
                yield
            except moderngl.Error as error:
                raise self._fault(str(error)) from None
            reported = self._gl.error
            if reported != _NO_ERROR or self._context.unbound.is_lost():
                raise self._fault(reported)

    def _check_open(self) -> None:
        """Raise BackendError where the renderer was released, or this is not the process or thread that made it.

        The driver would crash on the use of either, or wait without end.
        """
        if not self._free.alive:
            raise BackendError("this renderer was released: open another one")
        self._context.check_owner()

    def _fault(self, error: str) -> BackendError:
        """Return the error of a drawing that failed, after which a shared left view is drawn anew."""
        if self._targets is not None:
            self._targets.shared_left = None
        # moderngl knows the errors of a context that lives; any other one is that it does not.
        if self._context.unbound.is_lost() or _UNKNOWN_ERROR in (self._gl.error, error):
            return ContextLostError(f"{self.renderer_name} lost its context while it drew a pair: was the GPU reset?")
        return BackendError(f"{self.renderer_name} reported {error} while drawing a pair")

    def release(self) -> None:
        """Free the context and all that it holds; a second call does nothing."""
        self._free()

    def _check(self, scene: Scene) -> None:
        if self._wanted.rectified and not scene.camera.rectified:
            raise InputError(
                f"scene: its right camera deviates ({scene.camera.deviation}), which takes Renderer(rectified=False)"
            )
        ranges = (("model", scene.model, len(self._loaded.models)), ("layer", scene.layer, len(self._loaded.patches)))
        for name, index, count in ranges:
            if len(index) and (int(index.min()) < 0 or int(index.max()) >= count):
                raise InputError(
                    f"scene: {name} must be 0 to {count - 1}, got {int(index.min())} to {int(index.max())}"
                )
        if "instances" in self._wanted.outputs and len(scene) > _MOST_INSTANCE_IDS:
            raise InputError(
                f"a scene of {len(scene)} instances was asked for with the output instances, but 16-bit ids count up "
                f"to {_MOST_INSTANCE_IDS}: leave that output out"
            )

    def _sized(self, scene: Scene, *, shared: bool) -> PairTargets:
        """Return the targets of a scene's image size; new ones where it, or what they are for, is new.

        A size that the driver refuses leaves the renderer as it was.
        """
        outgrown, size = self._targets, (scene.camera.width_px, scene.camera.height_px)
        if outgrown is not None and outgrown.size == size and (outgrown.shared is not None or not shared):
            return outgrown
        self._gl.gc_mode = "auto"
        try:
            self._targets = PairTargets(self._loaded, size, shared=shared)
        except BaseException as error:
            # What was made so far goes with the frames that made it, as long as this context is current.
            clear_frames(error.__traceback__)
            raise
        finally:
            self._gl.gc_mode = None  # type: ignore[assignment]  # moderngl's own default
        if outgrown is not None:
            # moderngl binds the framebuffer in use again after making a new one, so the old ones go last.
            self._targets.eyes["left"].framebuffer.use()
            outgrown.release()
        return self._targets


def _check_atlases(atlases: Mapping[str, NDArray[np.uint8]]) -> None:
    for name, layers in atlases.items():
        check_type(name, layers, np.ndarray)
        side = layers.shape[1] if layers.ndim > 1 else 0
        if layers.shape[1:] not in ((side, side, 4), (side, side)) or layers.dtype != np.uint8:
            raise InputError(f"{name} must be (L, P, P, 4) or (L, P, P) uint8, got {layers.shape} {layers.dtype}")
        if len(layers) == 0 or layers.shape[1] == 0:
            raise InputError(f"{name}: the patch atlas is empty")
    if len({atlas.ndim for atlas in atlases.values()}) > 1:
        shapes = " and ".join(f"{name} {atlas.shape}" for name, atlas in atlases.items())
        raise InputError(f"layers and large_layers must both be RGBA or both be grey, got {shapes}")
