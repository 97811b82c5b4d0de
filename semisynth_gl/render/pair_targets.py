"""The targets to which images and pairs of one size are drawn, their cache, and a pair while the passes work on it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from semisynth_gl.frame.camera import EYES, Crop, Eye, StereoCamera
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.state import RenderState
from semisynth_gl.render.targets import CORRESPONDENCE, FLOW, VISIBILITY, Attachment, EyeTargets, Targets

COLOUR = ("colour",)
# Pairs have one size, and images for lenses another one for each eye.
_MOST_SIZES = 3


class SizedTargets:
    """All targets for images and pairs of one size; a pass's targets are made when it first draws.

    Making any of them raises BackendError where the driver refuses the size.

    Args:
        state: the renderer's context, and what it is to draw.
        size: width and height, px.
    """

    def __init__(self, state: RenderState, size: tuple[int, int]) -> None:
        self._state, self.size = state, size
        self._made: list[Targets] = []

    @cached_property
    def eyes(self) -> dict[Eye, EyeTargets]:
        """Targets of each eye's drawing pass."""
        return {eye: self._eye(self._state.options.attachments(eye)) for eye in EYES}

    @cached_property
    def shared(self) -> EyeTargets:
        """Targets of the same pass for left views that pairs share, with 1 / Z in the place of the disparity."""
        names = self._state.options.attachments("left")
        return self._eye(tuple("inverse_depth" if name == "disparity" else name for name in names))

    @cached_property
    def image(self) -> EyeTargets:
        """Targets of one eye's image without truth."""
        return self._eye(COLOUR)

    @cached_property
    def fine(self) -> EyeTargets:
        """Targets of one eye's image with several pixels for one, for supersampling."""
        return self._eye(COLOUR, self._state.options.factor)

    @cached_property
    def mean(self) -> Targets:
        """Targets of the means of these pixels."""
        return self._targets({"colour": self.fine.attachments["colour"]})

    @cached_property
    def visibility(self) -> dict[Eye, Targets]:
        """Targets of the visibility pass for each eye that has truth."""
        return {eye: self._targets(VISIBILITY) for eye in self._state.options.truth_eyes}

    @cached_property
    def correspondence(self) -> Targets:
        """Targets of the correspondence pass."""
        return self._targets(CORRESPONDENCE)

    @cached_property
    def then(self) -> EyeTargets:
        """Targets to which the flow pass draws the other moment."""
        return self._eye(("depth", "surface"))

    @cached_property
    def flow(self) -> Targets:
        """Targets of the flow pass."""
        return self._targets(FLOW)

    def release(self) -> None:
        """Free all targets."""
        for targets in self._made:
            targets.release()

    def _eye(self, names: tuple[str, ...], factor: int = 1) -> EyeTargets:
        state, size = self._state, (self.size[0] * factor, self.size[1] * factor)
        blended = state.options.outlines and "colour" in names
        made = EyeTargets(state.context, size, names, grey=state.patches.grey, blended=blended, read=state.read)
        self._made.append(made)
        return made

    def _targets(self, attachments: dict[str, Attachment]) -> Targets:
        made = Targets(self._state.context, self.size, attachments, self._state.read)
        self._made.append(made)
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
    sized: SizedTargets
    eyes: dict[Eye, EyeTargets]
    views: dict[Eye, dict[str, Any]]

    @property
    def area(self) -> Crop:
        """The part of both images that the caller wants, as a rectangle."""
        return self.crop or Crop(0, 0, *self.sized.size)


class TargetCache:
    """Caches the targets of the image sizes that were drawn last. Use the cache while its context is current.

    Args:
        state: the renderer's context, and what it is to draw.
    """

    def __init__(self, state: RenderState) -> None:
        self._state = state
        self._sized: dict[tuple[int, int], SizedTargets] = {}  # the latest last

    def of(self, camera: StereoCamera) -> SizedTargets:
        """Return the targets of a camera's image size."""
        size = camera.width_px, camera.height_px
        self._sized[size] = self._sized.pop(size) if size in self._sized else SizedTargets(self._state, size)
        if len(self._sized) > _MOST_SIZES:
            # moderngl binds the framebuffer in use again after making another one, so it must not be one that is gone.
            self._state.context.gl.screen.use()
            self._sized.pop(next(iter(self._sized))).release()
        return self._sized[size]
