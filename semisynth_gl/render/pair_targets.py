"""The targets to which images and pairs of one size are drawn, their cache, and a pair while the passes work on it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from semisynth_gl.frame.camera import EYES, Crop, Eye, StereoCamera
from semisynth_gl.render.antialias import ColourTargets
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.state import RenderState
from semisynth_gl.render.targets import CORRESPONDENCE, FLOW, VISIBILITY, Attachment, EyeTargets, Targets

COLOUR = ("colour",)


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
        self.samples: ColourTargets | None = None
        if state.options.antialias.redraws:
            self.samples = ColourTargets(state, size)
            self._parts.append(self.samples)

    @cached_property
    def image(self) -> EyeTargets:
        """Targets of one eye's image with one sample a pixel."""
        return self._drawn_to(COLOUR)

    def release(self) -> None:
        """Free all targets."""
        for part in self._parts:
            part.release()

    def _drawn_to(self, names: tuple[str, ...]) -> EyeTargets:
        state, blended = self._state, self._state.options.antialias.kind == "edges"
        made = EyeTargets(state.context, self.size, names, grey=state.patches.grey, blended=blended, read=state.read)
        self._parts.append(made)
        return made


class PairTargets(ImageTargets):
    """All targets for pairs of one image size; a pass's targets are made when it first draws.

    Args:
        state: the renderer's context, and what it is to draw.
        size: width and height, px.
        shared: whether pairs share left views; see `Renderer.render_rig`.

    Attributes:
        eyes: targets of each eye's drawing pass.
        shared: targets of the same pass for shared left views, with 1 / Z in the place of the disparity, or None.

    Raises:
        BackendError: where the driver refuses the size.
    """

    def __init__(self, state: RenderState, size: tuple[int, int], *, shared: bool) -> None:
        super().__init__(state, size)
        options = state.options
        self.eyes: dict[Eye, EyeTargets] = {eye: self._drawn_to(options.attachments(eye)) for eye in EYES}
        self.shared: EyeTargets | None = None
        if shared:
            names = ("inverse_depth" if name == "disparity" else name for name in options.attachments("left"))
            self.shared = self._drawn_to(tuple(names))

    @cached_property
    def visibility(self) -> dict[Eye, Targets]:
        """Targets of the visibility pass for each eye that has truth."""
        return {eye: self._compared(VISIBILITY) for eye in self._state.options.truth_eyes}

    @cached_property
    def correspondence(self) -> Targets:
        """Targets of the correspondence pass."""
        return self._compared(CORRESPONDENCE)

    @cached_property
    def then(self) -> EyeTargets:
        """Targets to which the flow pass draws the other moment."""
        made = EyeTargets(self._state.context, self.size, ("depth", "surface"))
        self._parts.append(made)
        return made

    @cached_property
    def flow(self) -> Targets:
        """Targets of the flow pass."""
        return self._compared(FLOW)

    def _compared(self, attachments: dict[str, Attachment]) -> Targets:
        made = Targets(self._state.context, self.size, attachments, self._state.read)
        self._parts.append(made)
        return made


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
    """Caches framebuffers: those of the latest pair size, and of the two latest sizes that are drawn without truth.

    Lenses ask for denser images, of another size for each eye. Use the cache while its context is current.

    Args:
        state: the renderer's context, and what it is to draw.
    """

    def __init__(self, state: RenderState) -> None:
        self._state = state
        self._pairs: PairTargets | None = None
        self._images: list[ImageTargets] = []  # the latest last

    def for_pairs(self, camera: StereoCamera, *, shared: bool) -> PairTargets:
        """Return targets for a camera's pairs; make new ones where the size differs, or they cannot be shared.

        Raises:
            BackendError: where the driver refuses the size; the earlier targets are then kept.
        """
        latest, size = self._pairs, (camera.width_px, camera.height_px)
        if latest is not None and latest.size == size and (latest.shared is not None or not shared):
            return latest
        self._pairs = PairTargets(self._state, size, shared=shared)
        self._release(latest)
        return self._pairs

    def for_images(self, camera: StereoCamera) -> ImageTargets:
        """Return targets for a camera's images without truth: the pairs' targets, where they have that size.

        Raises:
            BackendError: as `for_pairs`.
        """
        size = camera.width_px, camera.height_px
        if self._pairs is not None and self._pairs.size == size:
            return self._pairs
        for number, latest in enumerate(self._images):
            if latest.size == size:
                self._images.append(self._images.pop(number))
                return latest
        self._images.append(ImageTargets(self._state, size))
        if len(self._images) > len(EYES):
            self._release(self._images.pop(0))
        return self._images[-1]

    def _release(self, outgrown: ImageTargets | None) -> None:
        if outgrown is not None:
            # moderngl binds the framebuffer in use again after making another one, so it must not be one that is gone.
            self._state.context.gl.screen.use()
            outgrown.release()
