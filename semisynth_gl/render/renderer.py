"""The renderer: models and patches go to the GPU once, then any number of scenes are drawn from them.

A pair takes three steps: the drawing pass of each eye (colour, disparity and what else was asked for; colour in a pass
of its own where it is antialiased), the visibility pass of each eye (from both eyes' disparities and surfaces), and the
copy of the results into arrays.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, cached_property
from math import ceil
from traceback import clear_frames
from typing import Any, Literal, Self
from weakref import finalize

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.arguments import check_type, to_whole
from semisynth_gl.camera import EYES, OTHER_EYE, Crop, Eye, StereoCamera
from semisynth_gl.errors import BackendError, ContextLostError, InputError
from semisynth_gl.frame import (
    CHANNELS,
    DEFAULT_OUTPUTS,
    FLOW_OUTPUTS,
    FUTURE_OUTPUTS,
    OUTPUTS,
    PAST_OUTPUTS,
    TRUTH_VIEWS,
    Channel,
    Frame,
    Moment,
    Pass,
    TruthViews,
    View,
)
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.listener import Listener
from semisynth_gl.render.antialias import ColourTargets, parse_antialias
from semisynth_gl.render.backends import Backend, is_software
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import open_context
from semisynth_gl.render.correspondence import CorrespondencePass
from semisynth_gl.render.disparity import DisparityPass
from semisynth_gl.render.edges import EdgePass
from semisynth_gl.render.flow import FlowPass
from semisynth_gl.render.model_buffers import Filled, ModelBuffers, Placed
from semisynth_gl.render.occlusion import Occlusion
from semisynth_gl.render.pass_clock import PassClock
from semisynth_gl.render.patches import PatchTextures
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.readers import Reader, read_array
from semisynth_gl.render.shared_left import SharedLeft
from semisynth_gl.render.targets import CORRESPONDENCE, EyeTargets
from semisynth_gl.render.visibility import VisibilityPass
from semisynth_gl.scene.scene import Motion, Scene

Wrap = Literal["mirror", "repeat"]
RenderStage = Literal["draw", "visibility", "readback"]

_NEEDS_MOTION: Mapping[str, frozenset[str]] = {"future": FUTURE_OUTPUTS, "past": PAST_OUTPUTS}
_MOST_INSTANCE_IDS = 65535
_UNKNOWN_ERROR = "GL_UNKNOWN_ERROR"


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
        outputs: what to make beside images and disparities; see `semisynth_gl.frame.OUTPUTS`.
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
        InputError: where models or layers are empty or of a wrong shape, or an option is unknown.
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
        check_type("antialias", antialias, str)
        check_type("signed", signed, bool)
        to_whole("device_index", device_index, least=0)
        if not models:
            raise InputError("a renderer needs at least one model, got none")
        atlases = {"layers": layers} | ({} if large_layers is None else {"large_layers": large_layers})
        _check_atlases(atlases)
        _check_outputs(outputs, rectified=rectified)
        if truth not in TRUTH_VIEWS:
            raise InputError(f"truth: expected one of {', '.join(TRUTH_VIEWS)}, got {truth}")
        for name, most in (("anisotropy", anisotropy), ("large_anisotropy", large_anisotropy)):
            if most not in range(1, 17):
                raise InputError(f"{name} must be a whole number from 1 to 16, got {most}")
        self.listener: Listener | None = None
        self._read_pixels = read
        self._outputs = frozenset(outputs)
        self._channels = [row for row in CHANNELS.values() if row.output is None or row.output in outputs]
        self._rectified, self._signed = rectified, signed
        self._corresponds = not rectified or "correspondence" in self._outputs
        self._truth_eyes: tuple[Eye, ...] = EYES if truth == "both" else ("left",)
        self._antialias = parse_antialias(antialias)
        self._attachments: dict[Eye, tuple[str, ...]] = {eye: self._drawn(eye) for eye in EYES}
        drawn = self._drawn_by("drawing")
        self._triangle_readers = frozenset(channel.attachment for channel in drawn if channel.reads_triangles)
        self._context = open_context(backend, device_index)
        try:
            self._gl = self._context.gl
            self._patches = PatchTextures(self._context, tuple(atlases.values()), mirrored=wrap == "mirror")
            reads_triangles = self._corresponds or any(channel.reads_triangles for channel in self._channels)
            self._models = ModelBuffers(self._gl, models, self._patches.ends, traced=reads_triangles)
            self._constants = ConstantsBuffer(self._gl, signed=signed)
            software = is_software(self._context.renderer)
            self._occlusion = Occlusion(self._context, models, self._models) if software else None
            anisotropies = (anisotropy, large_anisotropy)[: len(atlases)]
            self._link_programs(anisotropies)
            self._edges: EdgePass | None = None
            if self._antialias.kind == "edges":
                self._edges = EdgePass(self._context, models, self._models, self._patches, anisotropies)
        except BaseException:
            self._context.release()
            raise
        self._targets: dict[Eye, EyeTargets] = {}
        self._image_targets: EyeTargets | None = None
        self._colour_targets: ColourTargets | None = None
        # Of the left eye, with 1 / Z in the place of the disparity; where a left view was shared already.
        self._shared_targets: EyeTargets | None = None
        # The shared left view that these hold.
        self._shared_left: SharedLeft | None = None
        self._size: tuple[int, int] | None = None
        # Frees what a renderer holds that nobody released, when it is collected. Not when Python ends: all goes then.
        self._free = finalize(self, self._context.release)
        self._free.atexit = False

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
            crop: draw and return this part of both images alone; its pixels are those of the whole image, bit for bit.
            future: how the scene gets to the next frame, for the outputs "flow" and "disparity_change".
            past: how it gets to the previous frame, for the output "flow_backward".

        Returns:
            Both images, both disparities and the outputs that were asked for, in new arrays.

        Raises:
            InputError: where an index or the crop is out of range, there are more instances than ids, or an output
                needs a motion that is not there or not the scene's.
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
        """Raise InputError where what shall be drawn is none, or lacks a motion that an output needs."""
        check_type("scene", scene, Scene)
        check_type("crop", crop, Crop | None)
        for shown in (scene, *(motion.scene for motion in motions.values() if motion is not None)):
            self._check(shown)
        for name, outputs in _NEEDS_MOTION.items():
            wanted = sorted(self._outputs & outputs)
            if wanted and motions[name] is None:
                raise InputError(f"the output {wanted[0]} needs the scene's motion: render(scene, {name}=Motion(...))")

    def render_images(self, scene: Scene, eyes: Collection[Eye] = EYES) -> dict[Eye, NDArray[np.uint8]]:
        """Draw the images of a pair alone, as `render` draws them, and nothing of its truth.

        Args:
            scene: indices must lie within the renderer's models and layers.
            eyes: whose images.

        Raises:
            InputError: where an index is out of range, or an eye is none.
            BackendError: where the image is larger than the driver allows, or drawing failed.
            ContextLostError: where the driver took the context away; another renderer may still be opened.
        """
        self._check_open()
        check_type("scene", scene, Scene)
        self._check(scene)
        if isinstance(eyes, str) or not set(eyes) <= set(EYES):
            raise InputError(f"eyes: expected some of {', '.join(EYES)}, got {eyes!r}")
        with self._drawing():
            self._resize((scene.camera.width_px, scene.camera.height_px), shared=False)
            placed = self._models.place(scene)
            return {eye: self._draw_image(placed, eye) for eye in eyes}

    def _draw_pair(
        self,
        scene: Scene,
        crop: Crop | None,
        motions: Mapping[str, Motion | None],
        shared: SharedLeft | None = None,
    ) -> Frame:
        """Draw one pair, and raise what the driver reports."""
        with self._drawing():
            frame = self._render(scene, crop, motions, shared)
        if shared is not None:
            self._keep(shared, frame.left)
        return frame

    @contextmanager
    def _drawing(self) -> Iterator[None]:
        """Make the context current, since another renderer of this thread may have made its own so; find faults."""
        with self._gl:
            try:
                yield
            except moderngl.Error as error:
                self._shared_left = None
                raise self._fault(str(error)) from None
            reported = self._gl.error
            if reported != "GL_NO_ERROR" or self._context.unbound.is_lost():
                self._shared_left = None
                raise self._fault(reported)

    def _check_open(self) -> None:
        """Refuse what the driver would crash on, or wait for without end.

        Raises:
            BackendError: where the renderer was released, or this is not the process or thread that made it.
        """
        if not self._free.alive:
            raise BackendError("this renderer was released: open another one")
        self._context.check_owner()

    def _fault(self, error: str) -> BackendError:
        """Return the error of a drawing that failed."""
        # moderngl knows the errors of a context that lives; any other one is that it does not.
        if self._context.unbound.is_lost() or _UNKNOWN_ERROR in (self._gl.error, error):
            return ContextLostError(f"{self.renderer_name} lost its context while it drew a pair: was the GPU reset?")
        return BackendError(f"{self.renderer_name} reported {error} while drawing a pair")

    def _render(
        self, scene: Scene, crop: Crop | None, motions: Mapping[str, Motion | None], shared: SharedLeft | None
    ) -> Frame:
        def finish(stage: RenderStage) -> None:
            if self.listener is not None:
                self._gl.finish()
                self.listener.on_stage(stage)

        camera, rectified = scene.camera if crop is None else scene.camera.cropped(crop), scene.camera.rectified
        self._resize((scene.camera.width_px, scene.camera.height_px), shared=shared is not None)
        placed = self._models.place(scene)
        # What was read of the left view for an earlier pair, by channel.
        views: dict[Eye, dict[str, Any]] = {"left": {} if shared is None else dict(shared.channels), "right": {}}
        targets = self._draw_both(placed, crop, shared, views)
        finish("draw")
        if self._visibility is not None and rectified:
            for eye in self._truth_eyes:
                self._visibility.draw(placed, eye, targets, self._models, crop)
        finish("visibility")
        for eye in EYES:
            self._read(eye, targets[eye], crop, views[eye], rectified=rectified)
        if self._correspondence is not None:
            self._read_correspondence(self._correspondence, placed, crop, targets, views)
        for name, motion in motions.items():
            if self._flow is not None and motion is not None and self._outputs & _NEEDS_MOTION[name]:
                moment: Moment = "next" if name == "future" else "previous"
                self._read_flow(self._flow, placed, motion, crop, moment, targets, views)
        finish("readback")
        return Frame(camera, View(views["left"]), View(views["right"]))

    def _draw_both(
        self, placed: Placed, crop: Crop | None, shared: SharedLeft | None, views: dict[Eye, dict[str, Any]]
    ) -> dict[Eye, EyeTargets]:
        """Draw both eyes, and put images that are read meanwhile into the views; return what was drawn to."""
        scenes = [placed.scene] if shared is None else shared.scenes
        parts = {eye: self._part(scenes, eye, crop) for eye in EYES}
        targets, programs = self._targets, self._draw_programs
        if shared is None:
            self._shared_left = None
            views["left"] |= self._draw(placed, "left", parts["left"], crop, programs["left"], targets["left"])
        else:
            left, (left_programs, disparity_pass) = self._shared_targets, self._shared_programs
            assert left is not None  # noqa: S101 - see `_resize`
            targets = targets | {"left": left}
            if self._shared_left is not shared:
                drawn = self._draw(placed, "left", parts["left"], crop, left_programs, left)
                views["left"] = drawn | views["left"]
                self._shared_left = shared
            disparity_pass.draw(placed, left, parts["left"])
        views["right"] |= self._draw(placed, "right", parts["right"], crop, programs["right"], targets["right"])
        return targets

    def _part(self, scenes: Sequence[Scene], eye: Eye, crop: Crop | None) -> Crop | None:
        """Return the part of one eye's image that a crop needs in any of some scenes; None for all of it."""
        # Where a camera deviates, rows are looked up too.
        if crop is None or not all(scene.camera.rectified for scene in scenes):
            return None
        looked_up = self._visibility is not None and OTHER_EYE[eye] in self._truth_eyes
        # Along edges pixels take on colours of those beside them.
        border_px = 0 if self._edges is None else 1
        parts = [
            _drawn_part(scene, eye, crop, looked_up=looked_up, border_px=border_px, signed=self._signed)
            for scene in scenes
        ]
        x, y = min(part.x_px for part in parts), min(part.y_px for part in parts)
        return Crop(x, y, max(part.right_px for part in parts) - x, max(part.bottom_px for part in parts) - y)

    def _keep(self, shared: SharedLeft, left: Mapping[str, Any]) -> None:
        """Keep what further pairs of a shared left view have too: arrays, since a reader may reuse what else it makes.

        Arrays become read-only: several frames have them.
        """
        for name, array in left.items():
            if CHANNELS[name].of_own_view and isinstance(array, np.ndarray):
                array.flags.writeable = False
                shared.channels[name] = array
        if self._antialias.redraws and "image" not in shared.channels:
            # Its targets are the right eye's too.
            self._shared_left = None

    def _read(self, eye: Eye, targets: EyeTargets, crop: Crop | None, view: dict[str, Any], *, rectified: bool) -> None:
        """Copy out one eye's channels of the drawing and the visibility pass, but for what the view has already."""
        image = CHANNELS["image"]
        with self.clock.timed("read", eye):
            for channel in self._drawn_by("drawing"):
                drawn = eye in self._truth_eyes and (rectified or channel.name not in CORRESPONDENCE)
                if channel.name not in view and (channel is image or drawn):
                    view[channel.name] = targets.read(channel.attachment, crop)
            if targets.visibility is not None and rectified:
                for channel in self._drawn_by("visibility"):
                    view[channel.name] = targets.visibility.read(channel.attachment, crop)

    def _read_correspondence(
        self,
        correspondence: CorrespondencePass,
        placed: Placed,
        crop: Crop | None,
        targets: dict[Eye, EyeTargets],
        views: dict[Eye, dict[str, Any]],
    ) -> None:
        """Find the correspondences and, of a pair that deviates, disparities and masks; copy them into the views."""
        found = [channel for channel in self._channels if channel.attachment in CORRESPONDENCE]
        if placed.scene.camera.rectified:
            found = self._drawn_by("correspondence")
        for eye in self._truth_eyes:
            compared = correspondence.draw(placed, eye, targets, self._models, crop)
            with self.clock.timed("read", eye):
                for channel in found:
                    views[eye][channel.name] = compared.read(channel.attachment, crop)

    def _read_flow(
        self,
        flow_pass: FlowPass,
        placed: Placed,
        motion: Motion,
        crop: Crop | None,
        moment: Moment,
        own: Mapping[Eye, EyeTargets],
        views: dict[Eye, dict[str, Any]],
    ) -> None:
        """Draw the flow to one other moment, and copy out its channels, but for those that the views have already."""
        moved = flow_pass.place(placed, motion, self._models)
        for eye in self._truth_eyes:
            left_out = views[eye].keys()
            channels = [row for row in self._drawn_by("flow") if row.moment == moment and row.name not in left_out]
            if not channels:
                continue
            targets = flow_pass.draw(placed, moved, eye, own[eye], self._models, crop)
            with self.clock.timed("read", eye):
                for channel in channels:
                    views[eye][channel.name] = targets.read(channel.attachment, crop)

    def _drawn_by(self, name: Pass) -> list[Channel[Any]]:
        return [channel for channel in self._channels if channel.drawn_by == name]

    def release(self) -> None:
        """Free the context and all that it holds; a second call does nothing."""
        self._free()

    def _drawn(self, eye: Eye) -> tuple[str, ...]:
        """Return the attachments that the drawing pass of an eye writes."""
        own, visibility = eye in self._truth_eyes, "visibility" in self._outputs
        flow = own and bool(self._outputs & FLOW_OUTPUTS)
        # What the visibility pass and the flow pass look up is drawn for them.
        needed = {
            "colour": not self._antialias.redraws,
            "disparity": own or visibility,
            "depth": flow or self._corresponds or (own and "depth" in self._outputs),
            "surface": visibility or flow or self._corresponds,
        }
        names = {channel.attachment: own for channel in self._drawn_by("drawing")} | needed
        return tuple(name for name, drawn in names.items() if drawn)

    @cached_property
    def _shared_programs(self) -> tuple[list[moderngl.Program], DisparityPass]:
        """The programs of a left view that is shared, one for each atlas, and the pass that makes its disparities."""
        programs = {each: self._link(self._shared_attachments, each) for each in set(self._anisotropies)}
        return [programs[each] for each in self._anisotropies], DisparityPass(self._context, self._constants)

    @property
    def _shared_attachments(self) -> tuple[str, ...]:
        """The attachments of a left view that is shared."""
        return tuple("inverse_depth" if name == "disparity" else name for name in self._attachments["left"])

    def _link_programs(self, anisotropies: Sequence[int]) -> None:
        link = cache(self._link)
        # One for each atlas; they are the same where they write and sample alike.
        self._draw_programs: dict[Eye, list[moderngl.Program]] = {
            eye: [link(names, each) for each in anisotropies] for eye, names in self._attachments.items()
        }
        self._anisotropies = anisotropies
        self._colour_programs: list[moderngl.Program] = []
        if self._antialias.redraws:
            self._link_colour()
        self._visibility = VisibilityPass(self._context, self._constants) if "visibility" in self._outputs else None
        self._correspondence: CorrespondencePass | None = None
        if self._corresponds:
            self._correspondence = CorrespondencePass(self._context, self._constants, self._read_pixels)
        self._flow = None
        if self._outputs & FLOW_OUTPUTS:
            self._flow = FlowPass(self._context, self._constants, self._read_pixels)

    def _link_colour(self) -> list[moderngl.Program]:
        """Return the programs that draw colour alone, one for each atlas; most renderers need none of them."""
        if not self._colour_programs:
            link = cache(self._link)
            self._colour_programs = [link(("colour",), each) for each in self._anisotropies]
        return self._colour_programs

    def _link(self, names: tuple[str, ...], anisotropy: int) -> moderngl.Program:
        locations = {name.upper(): number for number, name in enumerate(names)}
        grey = {"GREY": 1} if self._patches.grey and "colour" in names else {}
        return link_program(self._context, "mesh.vert", "mesh.frag", locations | {"ANISOTROPY": anisotropy} | grey)

    def _check(self, scene: Scene) -> None:
        if self._rectified and not scene.camera.rectified:
            raise InputError(
                f"scene: its right camera deviates ({scene.camera.deviation}), which takes Renderer(rectified=False)"
            )
        ranges = (("model", scene.model, len(self._models)), ("layer", scene.layer, len(self._patches)))
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

    def _resize(self, size: tuple[int, int], *, shared: bool) -> None:
        if self._size == size and (self._shared_targets is not None or not shared):
            return
        # All or nothing: a size that the driver refuses leaves the renderer as it was.
        self._gl.gc_mode = "auto"
        try:
            targets, colour_targets = self._make_targets(size)
            shared_targets = self._make_eye_targets(size, "left", self._shared_attachments) if shared else None
        except BaseException as error:
            # What was made so far goes with the frames that made it, as long as this context is current.
            clear_frames(error.__traceback__)
            raise
        finally:
            self._gl.gc_mode = None  # type: ignore[assignment]  # moderngl's own default
        # moderngl binds the framebuffer in use again after making a new one, so the old ones go last.
        targets["left"].framebuffer.use()
        for outgrown in (*self._targets.values(), self._colour_targets, self._image_targets, self._shared_targets):
            if outgrown is not None:
                outgrown.release()
        self._targets, self._colour_targets, self._size = targets, colour_targets, size
        self._shared_targets, self._shared_left = shared_targets, None
        self._image_targets = None

    def _make_targets(self, size: tuple[int, int]) -> tuple[dict[Eye, EyeTargets], ColourTargets | None]:
        colour_targets = None
        if self._antialias.redraws:
            colour_targets = ColourTargets(
                self._context, size, self._antialias, self._read_pixels, grey=self._patches.grey
            )
        targets = {eye: self._make_eye_targets(size, eye, names) for eye, names in self._attachments.items()}
        if self._flow is not None:
            self._flow.resize(size)
        return targets, colour_targets

    def _make_eye_targets(self, size: tuple[int, int], eye: Eye, names: Sequence[str]) -> EyeTargets:
        return EyeTargets(
            self._context,
            size,
            names,
            visibility="visibility" in self._outputs and eye in self._truth_eyes,
            grey=self._patches.grey,
            blended=self._edges is not None,
            read=self._read_pixels,
        )

    def _draw(
        self,
        placed: Placed,
        eye: Eye,
        part: Crop | None,
        crop: Crop | None,
        programs: Sequence[moderngl.Program],
        targets: EyeTargets,
    ) -> dict[str, Any]:
        """Draw a part of one eye's image, or all of it; return the crop's image where it is antialiased.

        Args:
            placed: the instances.
            eye: who looks.
            part: what is drawn.
            crop: what is asked for.
            programs: write the targets' attachments; one for each atlas.
            targets: what is drawn to.
        """
        scene, filled = placed.scene, self._models.fill(placed, eye, part)
        seen: Sequence[Filled] = filled
        self._constants.write(scene.camera, eye, scene.near_of(eye))
        if self._attachments[eye]:
            targets.limit(part)
            if self._triangle_readers.intersection(self._attachments[eye]):
                self._models.bind_triangles(placed, eye)
            seen = self._draw_once(placed, eye, part, targets, programs, filled)
            if self._edges is not None:
                self._edges.draw(placed, eye, targets, crop)
        if self._colour_targets is None:
            return {}
        if seen is not filled:
            # Between the centres of pixels more may be seen.
            filled = self._models.fill(placed, eye, part)
        return {"image": self._draw_samples(eye, crop, self._colour_targets, filled)}

    def _draw_image(self, placed: Placed, eye: Eye) -> NDArray[np.uint8]:
        """Draw one eye's image alone."""
        scene, filled = placed.scene, self._models.fill(placed, eye)
        self._constants.write(scene.camera, eye, scene.near_of(eye))
        if self._colour_targets is not None:
            return self._draw_samples(eye, None, self._colour_targets, filled)
        if self._image_targets is None:
            size, blended = (scene.camera.width_px, scene.camera.height_px), self._edges is not None
            self._image_targets = EyeTargets(
                self._context,
                size,
                ("colour",),
                visibility=False,
                grey=self._patches.grey,
                blended=blended,
                read=self._read_pixels,
            )
        targets = self._image_targets
        targets.limit(None)
        self._draw_once(placed, eye, None, targets, self._link_colour(), filled)
        if self._edges is not None:
            self._edges.draw(placed, eye, targets, None)
        with self.clock.timed("read", eye):
            image: NDArray[np.uint8] = targets.read("colour")
        return image

    def _draw_once(
        self,
        placed: Placed,
        eye: Eye,
        part: Crop | None,
        targets: EyeTargets,
        programs: Sequence[moderngl.Program],
        filled: Sequence[Filled],
    ) -> Sequence[Filled]:
        """Draw a part of one eye's view, one sample a pixel; return what was not left out as hidden."""
        seen = filled
        with self.clock.timed("draw", eye):
            if self._occlusion is not None:
                seen = self._occlusion.without_hidden(placed, eye, part, targets, filled)
            targets.clear(depth=seen is filled)
            self._draw_models(programs, seen)
        return seen

    def _draw_samples(
        self, eye: Eye, crop: Crop | None, targets: ColourTargets, filled: Sequence[Filled]
    ) -> NDArray[np.uint8]:
        """Draw one eye's colour, or a crop of it, in several samples a pixel."""
        targets.limit(crop)
        with self.clock.timed("samples", eye):
            targets.fine.use()
            targets.fine.clear(0.0, 0.0, 0.0, 0.0, depth=0.0)
            self._draw_models(self._link_colour(), filled)
        with self.clock.timed("resolve", eye):
            targets.resolve()
        with self.clock.timed("read", eye):
            return targets.read_colour(crop)

    def _draw_models(self, programs: Sequence[moderngl.Program], filled: Sequence[Filled]) -> None:
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.depth_func = ">"
        for part in filled:
            self._patches.use(part.atlas)
            self._models.draw(programs[part.atlas], part)


def _check_outputs(outputs: Collection[str], *, rectified: bool) -> None:
    if isinstance(outputs, str) or not isinstance(outputs, Collection) or not set(outputs) <= set(OUTPUTS):
        raise InputError(f"outputs: expected some of {', '.join(OUTPUTS)}, got {outputs!r}")
    if not rectified and "disparity_change" in outputs:
        raise InputError(
            "the output disparity_change is a rectified pair's: leave it out, or let no right camera deviate"
        )


def _check_atlases(atlases: Mapping[str, NDArray[np.uint8]]) -> None:
    for name, atlas in atlases.items():
        _check_atlas(name, atlas)
    if len({atlas.ndim for atlas in atlases.values()}) > 1:
        shapes = " and ".join(f"{name} {atlas.shape}" for name, atlas in atlases.items())
        raise InputError(f"layers and large_layers must both be RGBA or both be grey, got {shapes}")


def _check_atlas(name: str, layers: NDArray[np.uint8]) -> None:
    check_type(name, layers, np.ndarray)
    side = layers.shape[1] if layers.ndim > 1 else 0
    if layers.shape[1:] not in ((side, side, 4), (side, side)) or layers.dtype != np.uint8:
        raise InputError(f"{name} must be (L, P, P, 4) or (L, P, P) uint8, got {layers.shape} {layers.dtype}")
    if len(layers) == 0 or layers.shape[1] == 0:
        raise InputError(f"{name}: the patch atlas is empty")


def _drawn_part(scene: Scene, eye: Eye, crop: Crop, *, looked_up: bool, border_px: int, signed: bool) -> Crop:
    """Return the part of one eye's image that a crop needs, more where the other eye's points are looked up in it."""
    camera, left, right = scene.camera, border_px, border_px
    if looked_up:
        # No disparity is larger than the near plane's. One pixel more is looked at to each side, another is for
        # rounding.
        border_px = 2
        reach = max(0, ceil(float(camera.disparity_px(scene.near_m)))) + 2
        # None is smaller than that of what is infinitely far away.
        behind = max(0, ceil(camera.doffs_px) if signed else 0) + 2
        left, right = (behind, reach) if eye == "left" else (reach, behind)
    x, y = max(0, crop.x_px - left), max(0, crop.y_px - border_px)
    x_end, y_end = min(camera.width_px, crop.right_px + right), min(camera.height_px, crop.bottom_px + border_px)
    return Crop(x, y, x_end - x, y_end - y)
