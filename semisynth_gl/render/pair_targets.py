"""The targets to which images and pairs of one size are drawn, and a pair while the passes work on it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import moderngl

from semisynth_gl.frame.camera import EYES, Crop, Eye
from semisynth_gl.render.antialias import ColourTargets
from semisynth_gl.render.loaded import Loaded
from semisynth_gl.render.placing import Placed
from semisynth_gl.render.slivers import OpenPoints
from semisynth_gl.render.targets import CORRESPONDENCE, FLOW, EyeTargets, Targets

COLOUR = ("colour",)

_Part = TypeVar("_Part", ColourTargets, EyeTargets, OpenPoints, Targets)


class ImageTargets:
    """All targets for images of one size without truth.

    Args:
        loaded: the renderer's context, and what it is to draw.
        size: width and height, px.

    Attributes:
        size: width and height, px.
        samples: targets of colour with several samples a pixel; None where the caller wants one sample.

    Raises:
        BackendError: where the driver refuses the size.
    """

    def __init__(self, loaded: Loaded, size: tuple[int, int]) -> None:
        self._loaded, self.size = loaded, size
        self._parts: list[ColourTargets | OpenPoints | Targets] = []
        self.samples = self._keep(ColourTargets(loaded, size)) if loaded.wanted.antialias.redraws else None

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
        loaded = self._loaded
        return self._keep(
            EyeTargets(
                loaded.context,
                self.size,
                names,
                visibility=visibility,
                grey=loaded.patches.grey,
                blended=loaded.wanted.antialias.kind == "edges",
                read=loaded.read,
            )
        )

    def _keep(self, part: _Part) -> _Part:
        self._parts.append(part)
        return part


class PairTargets(ImageTargets):
    """All targets for pairs of one image size that the renderer's passes need; targets that no pass needs are None.

    Args:
        loaded: the renderer's context, and what it is to draw.
        size: width and height, px.
        shared: whether pairs share left views; see `Renderer.render_rig`.

    Attributes:
        eyes: targets of each eye's drawing pass and visibility pass.
        shared: targets of the same passes for shared left views, with 1 / Z in the place of the disparity.
        open_points: the points that the visibility pass leaves open.
        correspondence: targets of the correspondence pass.
        then: targets to which the flow pass draws the other moment.
        flow: targets of the flow pass.

    Raises:
        BackendError: where the driver refuses the size.
    """

    def __init__(self, loaded: Loaded, size: tuple[int, int], *, shared: bool) -> None:
        super().__init__(loaded, size)
        context, wanted, read = loaded.context, loaded.wanted, loaded.read
        visible: dict[Eye, bool] = {eye: wanted.visibility and eye in wanted.truth_eyes for eye in EYES}
        # A comprehension would keep `self` alive after a failure, and with it all targets that were made before.
        self.eyes: dict[Eye, EyeTargets] = {}
        for eye in EYES:
            self.eyes[eye] = self._drawn_to(wanted.attachments(eye), visibility=visible[eye])
        self.shared: EyeTargets | None = None
        if shared:
            names = ("inverse_depth" if name == "disparity" else name for name in wanted.attachments("left"))
            self.shared = self._drawn_to(tuple(names), visibility=visible["left"])
        self.open_points = self._keep(OpenPoints(context, size)) if wanted.visibility else None
        self.correspondence: Targets | None = None
        if wanted.corresponds:
            self.correspondence = self._keep(Targets(context, size, CORRESPONDENCE, read))
        self.then: EyeTargets | None = None
        self.flow: Targets | None = None
        if wanted.flow:
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
        placed: the scene's instances.
        crop: the part of both images that the caller wants, or None for all of it.
        sized: the targets of the pair's image size.
        eyes: the targets to which each eye's view was drawn.
        views: the channels of each eye's view that have been read so far, by name.
    """

    placed: Placed
    crop: Crop | None
    sized: PairTargets
    eyes: dict[Eye, EyeTargets]
    views: dict[Eye, dict[str, Any]]

    @property
    def area(self) -> Crop:
        """The part of both images that the caller wants, as a rectangle."""
        return self.crop or Crop(0, 0, *self.sized.size)
