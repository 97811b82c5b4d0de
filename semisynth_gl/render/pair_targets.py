"""The targets to which images and pairs of one size are drawn, their cache, and a pair while the passes work on it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from traceback import clear_frames
from typing import Any, TypeVar

import moderngl

from semisynth_gl.frame.camera import EYES, Crop, Eye, StereoCamera
from semisynth_gl.render.antialias import ColourTargets
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.state import RenderState
from semisynth_gl.render.targets import CORRESPONDENCE, FLOW, EyeTargets, Targets

COLOUR = ("colour",)

_Part = TypeVar("_Part", ColourTargets, EyeTargets, Targets)
_Sized = TypeVar("_Sized", bound="ImageTargets")


class ImageTargets:
    """All targets for images of one size without truth.

    Args:
        state: the renderer's context, and what it is to draw.
        size: width and height, px.

    Attributes:
        size: width and height, px.
        samples: targets of colour with several samples a pixel; None where the caller wants one sample.

    Raises:
        BackendError: where the driver refuses the size.
    """

    def __init__(self, state: RenderState, size: tuple[int, int]) -> None:
        self._state, self.size = state, size
        self._parts: list[ColourTargets | Targets] = []
        self.samples = self._keep(ColourTargets(state, size)) if state.options.antialias.redraws else None

    @cached_property
    def image(self) -> EyeTargets:
        """Targets of one eye's image with one sample a pixel."""
        return self._drawn_to(COLOUR, visibility=False)

    @property
    def framebuffer(self) -> moderngl.Framebuffer:
        """One of the framebuffers."""
        return self.image.framebuffer if self.samples is None else self.samples.fine

    def release(self) -> None:
        """Free all targets."""
        for part in reversed(self._parts):
            part.release()

    def _drawn_to(self, names: tuple[str, ...], *, visibility: bool) -> EyeTargets:
        state = self._state
        return self._keep(
            EyeTargets(
                state.context,
                self.size,
                names,
                visibility=visibility,
                grey=state.patches.grey,
                blended=state.options.antialias.kind == "edges",
                read=state.read,
            )
        )

    def _keep(self, part: _Part) -> _Part:
        self._parts.append(part)
        return part


class PairTargets(ImageTargets):
    """All targets for pairs of one image size that the renderer's passes need; targets that no pass needs are None.

    Args:
        state: the renderer's context, and what it is to draw.
        size: width and height, px.
        shared: whether pairs share left views; see `Renderer.render_rig`.

    Attributes:
        eyes: targets of each eye's drawing pass and visibility pass.
        shared: targets of the same passes for shared left views, with 1 / Z in the place of the disparity.
        correspondence: targets of the correspondence pass.
        then: targets to which the flow pass draws the other moment.
        flow: targets of the flow pass.

    Raises:
        BackendError: where the driver refuses the size.
    """

    def __init__(self, state: RenderState, size: tuple[int, int], *, shared: bool) -> None:
        super().__init__(state, size)
        context, options, read = state.context, state.options, state.read
        visible: dict[Eye, bool] = {eye: options.visibility and eye in options.truth_eyes for eye in EYES}
        # A comprehension would keep `self` alive after a failure, and with it all targets that were made before.
        self.eyes: dict[Eye, EyeTargets] = {}
        for eye in EYES:
            self.eyes[eye] = self._drawn_to(options.attachments(eye), visibility=visible[eye])
        self.shared: EyeTargets | None = None
        if shared:
            names = ("inverse_depth" if name == "disparity" else name for name in options.attachments("left"))
            self.shared = self._drawn_to(tuple(names), visibility=visible["left"])
        self.correspondence: Targets | None = None
        if options.corresponds:
            self.correspondence = self._keep(Targets(context, size, CORRESPONDENCE, read))
        self.then: EyeTargets | None = None
        self.flow: Targets | None = None
        if options.flow:
            self.then = self._keep(EyeTargets(context, size, ("depth", "surface"), visibility=False))
            # No pass uses the depth of these targets, so they share the other moment's depth buffer.
            self.flow = self._keep(Targets(context, size, FLOW, read, self.then.depth_buffer))

    @property
    def framebuffer(self) -> moderngl.Framebuffer:
        """One of the framebuffers."""
        return self.eyes["left"].framebuffer


@dataclass(frozen=True, slots=True)
class DrawnPair:
    """A pair whose drawing passes are done.

    Attributes:
        transforms: the scene's instances.
        crop: the part of both images that the caller wants, or None for all of it.
        sized: the targets of the pair's image size.
        eyes: the targets to which each eye's view was drawn.
        views: the channels of each eye's view that have been read so far, by name.
    """

    transforms: InstanceTransforms
    crop: Crop | None
    sized: PairTargets
    eyes: dict[Eye, EyeTargets]
    views: dict[Eye, dict[str, Any]]

    @property
    def area(self) -> Crop:
        """The part of both images that the caller wants, as a rectangle."""
        return self.crop or Crop(0, 0, *self.sized.size)


class TargetCache:
    """Targets for pairs of one size, and for images without truth of two other ones, such as denser ones for lenses.

    Use it while its context is current.

    Args:
        state: the renderer's context, and what it is to draw.
    """

    def __init__(self, state: RenderState) -> None:
        self._state = state
        self._pairs: PairTargets | None = None
        # Of the two latest sizes, the newest last: eyes may differ.
        self._images: list[ImageTargets] = []

    def for_pairs(self, camera: StereoCamera, *, shared: bool) -> PairTargets:
        """Return targets for a camera's pairs; make new ones where the size differs, or they cannot be shared.

        Raises:
            BackendError: where the driver refuses the size; the earlier targets are then kept.
        """
        latest, size = self._pairs, (camera.width_px, camera.height_px)
        if latest is not None and latest.size == size and (latest.shared is not None or not shared):
            return latest
        self._pairs = made = self._made(lambda: PairTargets(self._state, size, shared=shared), latest)
        return made

    def for_images(self, camera: StereoCamera) -> ImageTargets:
        """Return targets for a camera's images without truth: the pairs' targets, where they have that size.

        Raises:
            BackendError: as `for_pairs`.
        """
        size = camera.width_px, camera.height_px
        for latest in (self._pairs, *self._images):
            if latest is not None and latest.size == size:
                return latest
        outgrown = self._images[0] if len(self._images) == len(EYES) else None
        made = self._made(lambda: ImageTargets(self._state, size), outgrown)
        self._images = [*(each for each in self._images if each is not outgrown), made]
        return made

    def _made(self, make: Callable[[], _Sized], outgrown: _Sized | None) -> _Sized:
        gl = self._state.context.gl
        gl.gc_mode = "auto"
        try:
            targets = make()
            # moderngl binds the framebuffer in use again after making a new one, so the old ones go last.
            targets.framebuffer.use()
        except BaseException as error:
            # Clearing the frames frees the objects that were made so far, which must happen while the context is
            # current.
            clear_frames(error.__traceback__)
            raise
        finally:
            gl.gc_mode = None  # type: ignore[assignment]  # moderngl's own default
        if outgrown is not None:
            outgrown.release()
        return targets
