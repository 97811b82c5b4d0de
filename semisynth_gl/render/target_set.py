"""All targets of one image size, and a pair that was drawn to them."""

from dataclasses import dataclass
from typing import Any

from semisynth_gl.frame.camera import Crop, Eye
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.targets import Attachment, EyeTargets, Targets

COLOUR = ("colour",)


class TargetSet:
    """The targets for images of one size, one for each purpose. They are made when a pass first asks for them.

    All calls with one ``purpose`` must ask for the same attachments and factor. ``size`` is width and height, px.
    Methods raise BackendError if the driver refuses the size.
    """

    def __init__(self, resources: RenderResources, size: tuple[int, int]) -> None:
        self._resources, self.size = resources, size
        self._with_depth: dict[str, EyeTargets] = {}
        self._without_depth: dict[str, Targets] = {}

    def with_depth(self, purpose: str, names: tuple[str, ...], factor: int = 1) -> EyeTargets:
        """Return the targets of a drawing pass with attachments of these names, ``factor`` times as wide and high."""
        if purpose not in self._with_depth:
            resources, size = self._resources, (self.size[0] * factor, self.size[1] * factor)
            blended = resources.options.outlines and "colour" in names
            self._with_depth[purpose] = EyeTargets(
                resources.context, size, names, grey=resources.patches.grey, blended=blended, read=resources.read
            )
        return self._with_depth[purpose]

    def without_depth(self, purpose: str, attachments: dict[str, Attachment]) -> Targets:
        """Return the targets of a pass that needs no depth buffer."""
        if purpose not in self._without_depth:
            self._without_depth[purpose] = Targets(
                self._resources.context, self.size, attachments, self._resources.read
            )
        return self._without_depth[purpose]

    def release(self) -> None:
        """Free all targets."""
        for targets in (*self._with_depth.values(), *self._without_depth.values()):
            targets.release()


@dataclass(frozen=True, slots=True)
class DrawnPair:
    """A pair whose drawing passes are done."""

    transforms: InstanceTransforms  # the scene's instances
    crop: Crop | None  # the part of both images that the caller wants, or None for all of it
    targets: TargetSet  # the targets of the pair's image size
    eyes: dict[Eye, EyeTargets]  # the targets with each eye's view
    views: dict[Eye, dict[str, Any]]  # the channels of each eye's view that were read so far, by name

    @property
    def area(self) -> Crop:
        """The part of both images that the caller wants, as a rectangle."""
        return self.crop or Crop(0, 0, *self.targets.size)
