"""The drawing pass: what each eye sees of a scene, with antialiased colour in a separate pass."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from math import ceil
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, OTHER_EYE, Crop, Eye
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.render.antialias import ColourTargets
from semisynth_gl.render.backends import is_software
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.disparity import DisparityPass
from semisynth_gl.render.edges import EdgePass
from semisynth_gl.render.model_buffers import Filled, ModelBuffers
from semisynth_gl.render.occlusion import Occlusion
from semisynth_gl.render.patches import PatchTextures
from semisynth_gl.render.placing import Placed
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.readers import Reader
from semisynth_gl.render.shared_left import SharedLeft
from semisynth_gl.render.targets import EyeTargets
from semisynth_gl.render.wanted import Wanted
from semisynth_gl.scene.scene import Scene

_COLOUR = ("colour",)


class Drawing:
    """Draws both eyes' views, into targets that are made once for an image size.

    Args:
        context: the open context.
        models: the meshes that `Scene.model` counts.
        buffers: these on the GPU.
        patches: the atlases.
        anisotropies: of each atlas, most samples of a patch for a pixel.
        constants: the context's buffer of constants.
        wanted: what to draw.
        read: what takes pixels.

    Raises:
        BackendError: where the driver refuses a program, or cannot hold what antialiasing looks up.
    """

    def __init__(
        self,
        context: GraphicsContext,
        models: Sequence[Mesh],
        buffers: ModelBuffers,
        patches: PatchTextures,
        anisotropies: Sequence[int],
        constants: ConstantsBuffer,
        wanted: Wanted,
        read: Reader,
    ) -> None:
        self._context, self._gl, self._clock = context, context.gl, context.clock
        self._models, self._patches, self._anisotropies = buffers, patches, anisotropies
        self._constants, self._wanted, self._antialias = constants, wanted, wanted.antialias
        self._read_pixels = read
        self._attachments: dict[Eye, tuple[str, ...]] = {eye: wanted.attachments(eye) for eye in EYES}
        drawn = wanted.drawn_by("drawing")
        self._triangle_readers = frozenset(channel.attachment for channel in drawn if channel.reads_triangles)
        self._occlusion = Occlusion(context, models, buffers) if is_software(context.renderer) else None
        # By attachments and anisotropy.
        self._linked: dict[tuple[tuple[str, ...], int], moderngl.Program] = {}
        for names in (*self._attachments.values(), *([_COLOUR] if self._antialias.redraws else [])):
            self._programs(names)
        self._edges: EdgePass | None = None
        if self._antialias.kind == "edges":
            self._edges = EdgePass(context, models, buffers, patches, anisotropies)
        self._size: tuple[int, int] | None = None
        self._targets: dict[Eye, EyeTargets] = {}
        self._image_targets: EyeTargets | None = None
        self._colour_targets: ColourTargets | None = None
        # Of the left eye, with 1 / Z in the place of the disparity; where a left view was shared already.
        self._shared_targets: EyeTargets | None = None
        # The shared left view that these hold.
        self._shared_left: SharedLeft | None = None

    def fits(self, size: tuple[int, int], *, shared: bool) -> bool:
        """Return whether there is room for an image size already, and for left views that are shared."""
        return self._size == size and (self._shared_targets is not None or not shared)

    def resize(self, size: tuple[int, int], *, shared: bool) -> None:
        """Make room for an image size, and for left views that are shared; where that fails, all stays as it was.

        Raises:
            BackendError: where the driver refuses the size.
        """
        colour_targets = None
        if self._antialias.redraws:
            colour_targets = ColourTargets(
                self._context, size, self._antialias, self._read_pixels, grey=self._patches.grey
            )
        visible: dict[Eye, bool] = {eye: self._wanted.visibility and eye in self._wanted.truth_eyes for eye in EYES}
        targets = {
            eye: self._make_targets(size, names, visibility=visible[eye]) for eye, names in self._attachments.items()
        }
        shared_targets = None
        if shared:
            shared_targets = self._make_targets(size, self._shared_attachments, visibility=visible["left"])
        # moderngl binds the framebuffer in use again after making a new one, so the old ones go last.
        targets["left"].framebuffer.use()
        for outgrown in (*self._targets.values(), self._colour_targets, self._image_targets, self._shared_targets):
            if outgrown is not None:
                outgrown.release()
        self._targets, self._colour_targets, self._size = targets, colour_targets, size
        self._shared_targets, self._shared_left = shared_targets, None
        self._image_targets = None

    def draw(
        self, placed: Placed, crop: Crop | None, shared: SharedLeft | None
    ) -> tuple[dict[Eye, EyeTargets], dict[Eye, dict[str, Any]]]:
        """Draw both eyes' views, after `resize`.

        Args:
            placed: the instances.
            crop: draw what this part of both images needs; None for the whole images.
            shared: the shared left view that the pair has, which is drawn once.

        Returns:
            What was drawn to, and of each eye the channels that were read already, now or for an earlier pair that
            shares the left view.
        """
        scenes = [placed.scene] if shared is None else shared.scenes
        parts = {eye: self._part(scenes, eye, crop) for eye in EYES}
        targets = self._targets
        views: dict[Eye, dict[str, Any]] = {"left": {}, "right": {}}
        if shared is None:
            views["left"] = self._draw(placed, "left", parts["left"], crop, targets["left"])
        else:
            left = self._shared_targets
            assert left is not None  # noqa: S101 - see `resize`
            targets = targets | {"left": left}
            if self._shared_left is not shared:
                views["left"] = self._draw(placed, "left", parts["left"], crop, left)
                self._shared_left = shared
            self._disparity.draw(placed, left, parts["left"])
            views["left"] |= shared.channels
        views["right"] = self._draw(placed, "right", parts["right"], crop, targets["right"])
        return targets, views

    def draw_image(self, placed: Placed, eye: Eye) -> NDArray[np.uint8]:
        """Draw one eye's image alone, after `resize`."""
        scene, filled = placed.scene, self._models.fill(placed, eye)
        self._constants.write(scene.camera, eye, scene.near_of(eye))
        if self._colour_targets is not None:
            return self._draw_samples(eye, None, self._colour_targets, filled)
        if self._image_targets is None:
            size = scene.camera.width_px, scene.camera.height_px
            self._image_targets = self._make_targets(size, _COLOUR, visibility=False)
        targets = self._image_targets
        targets.limit(None)
        self._draw_once(placed, eye, None, targets, filled)
        if self._edges is not None:
            self._edges.draw(placed, eye, targets, None)
        with self._clock.timed("read", eye):
            image: NDArray[np.uint8] = targets.read("colour")
        return image

    def forget(self) -> None:
        """Draw a shared left view anew at the next pair, after a drawing of it that failed."""
        self._shared_left = None

    def keep(self, shared: SharedLeft, left: Mapping[str, Any]) -> None:
        """Keep what further pairs of a shared left view have too, of the channels that were read of it."""
        shared.keep(left)
        if self._antialias.redraws and "image" not in shared.channels:
            # Its targets are the right eye's too.
            self._shared_left = None

    @cached_property
    def _disparity(self) -> DisparityPass:
        """Makes the disparities of a left view that is shared."""
        return DisparityPass(self._context, self._constants)

    @property
    def _shared_attachments(self) -> tuple[str, ...]:
        """The attachments of a left view that is shared."""
        return tuple("inverse_depth" if name == "disparity" else name for name in self._attachments["left"])

    def _programs(self, names: tuple[str, ...]) -> list[moderngl.Program]:
        """Return the programs that draw some attachments, one for each atlas: those linked here before, or new ones."""
        for anisotropy in self._anisotropies:
            if (names, anisotropy) not in self._linked:
                self._linked[names, anisotropy] = self._link(names, anisotropy)
        return [self._linked[names, anisotropy] for anisotropy in self._anisotropies]

    def _link(self, names: tuple[str, ...], anisotropy: int) -> moderngl.Program:
        defines = {name.upper(): number for number, name in enumerate(names)}
        if self._patches.grey and "colour" in names:
            defines["GREY"] = 1
        anisotropic = anisotropy > 1 and "colour" in names
        if anisotropic:
            defines["ANISOTROPIC"] = 1
        program = link_program(self._context, "mesh.vert", "mesh.frag", defines)
        if anisotropic:
            program["most_samples"] = float(anisotropy)
        return program

    def _part(self, scenes: Sequence[Scene], eye: Eye, crop: Crop | None) -> Crop | None:
        """Return the part of one eye's image that a crop needs in any of some scenes; None for all of it."""
        # Where a camera deviates, rows are looked up too.
        if crop is None or not all(scene.camera.rectified for scene in scenes):
            return None
        looked_up = self._wanted.visibility and OTHER_EYE[eye] in self._wanted.truth_eyes
        # Along edges pixels take on colours of those beside them.
        border_px = 0 if self._edges is None else 1
        parts = [
            _drawn_part(scene, eye, crop, looked_up=looked_up, border_px=border_px, signed=self._wanted.signed)
            for scene in scenes
        ]
        x, y = min(part.x_px for part in parts), min(part.y_px for part in parts)
        return Crop(x, y, max(part.right_px for part in parts) - x, max(part.bottom_px for part in parts) - y)

    def _make_targets(self, size: tuple[int, int], names: Sequence[str], *, visibility: bool) -> EyeTargets:
        return EyeTargets(
            self._context,
            size,
            names,
            visibility=visibility,
            grey=self._patches.grey,
            blended=self._edges is not None,
            read=self._read_pixels,
        )

    def _draw(
        self, placed: Placed, eye: Eye, part: Crop | None, crop: Crop | None, targets: EyeTargets
    ) -> dict[str, Any]:
        """Draw a part of one eye's image, or all of it; return the crop's image where it is antialiased.

        Args:
            placed: the instances.
            eye: who looks.
            part: the part to draw.
            crop: the crop that the caller wants.
            targets: the targets to draw to.
        """
        scene, filled = placed.scene, self._models.fill(placed, eye, part)
        seen: Sequence[Filled] = filled
        self._constants.write(scene.camera, eye, scene.near_of(eye))
        if targets.names:
            targets.limit(part)
            if self._triangle_readers.intersection(targets.names):
                self._models.bind_triangles(placed, eye)
            seen = self._draw_once(placed, eye, part, targets, filled)
            if self._edges is not None:
                self._edges.draw(placed, eye, targets, crop)
        if self._colour_targets is None:
            return {}
        if seen is not filled:
            # Between the centres of pixels more may be seen.
            filled = self._models.fill(placed, eye, part)
        return {"image": self._draw_samples(eye, crop, self._colour_targets, filled)}

    def _draw_once(
        self, placed: Placed, eye: Eye, part: Crop | None, targets: EyeTargets, filled: Sequence[Filled]
    ) -> Sequence[Filled]:
        """Draw a part of one eye's view, one sample a pixel; return what was not left out as hidden."""
        seen = filled
        with self._clock.timed("draw", eye):
            if self._occlusion is not None:
                seen = self._occlusion.without_hidden(placed, eye, part, targets, filled)
            targets.clear(depth=seen is filled)
            self._draw_models(targets.names, seen)
        return seen

    def _draw_samples(
        self, eye: Eye, crop: Crop | None, targets: ColourTargets, filled: Sequence[Filled]
    ) -> NDArray[np.uint8]:
        """Draw one eye's colour, or a crop of it, in several samples a pixel."""
        targets.limit(crop)
        with self._clock.timed("samples", eye):
            targets.fine.use()
            targets.fine.clear(0.0, 0.0, 0.0, 0.0, depth=0.0)
            self._draw_models(_COLOUR, filled)
        with self._clock.timed("resolve", eye):
            targets.resolve()
        with self._clock.timed("read", eye):
            return targets.read_colour(crop)

    def _draw_models(self, names: tuple[str, ...], filled: Sequence[Filled]) -> None:
        programs = self._programs(names)
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.depth_func = ">"
        for part in filled:
            self._patches.use(part.atlas)
            self._models.draw(programs[part.atlas], part)


def _drawn_part(scene: Scene, eye: Eye, crop: Crop, *, looked_up: bool, border_px: int, signed: bool) -> Crop:
    """Return the part of one eye's image that a crop needs, more where the other eye's points are looked up in it."""
    camera, left, right = scene.camera, border_px, border_px
    if looked_up:
        # No disparity is larger than the near plane's. One pixel more is looked at to each side, another is for
        # rounding.
        border_px = 2
        reach = max(0, ceil(float(camera.disparity_px(scene.near_m)))) + 2
        # No disparity is smaller than that of infinity.
        behind = max(0, ceil(camera.doffs_px) if signed else 0) + 2
        left, right = (behind, reach) if eye == "left" else (reach, behind)
    x, y = max(0, crop.x_px - left), max(0, crop.y_px - border_px)
    x_end, y_end = min(camera.width_px, crop.right_px + right), min(camera.height_px, crop.bottom_px + border_px)
    return Crop(x, y, x_end - x, y_end - y)
