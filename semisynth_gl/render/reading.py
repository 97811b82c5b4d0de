"""What is read of a drawn pair: its channels, and the results of passes that compare views and moments."""

from collections.abc import Mapping
from typing import Any

from semisynth_gl.frame.camera import EYES, Crop, Eye
from semisynth_gl.frame.frame import CHANNELS, Moment
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.correspondence import CorrespondencePass
from semisynth_gl.render.flow import FlowPass
from semisynth_gl.render.model_buffers import ModelBuffers
from semisynth_gl.render.placing import Placed, Placing
from semisynth_gl.render.readers import Reader
from semisynth_gl.render.targets import CORRESPONDENCE, EyeTargets
from semisynth_gl.render.visibility import VisibilityPass
from semisynth_gl.render.wanted import Wanted
from semisynth_gl.scene.scene import Motion


class Reading:
    """Runs the visibility, correspondence and flow passes, and reads the channels of a pair.

    Args:
        context: the open context.
        models: the models on the GPU.
        placing: places their instances.
        constants: the context's buffer of constants.
        wanted: what to read.
        read: what takes pixels.

    Raises:
        BackendError: where the driver refuses a program.
    """

    def __init__(
        self,
        context: GraphicsContext,
        models: ModelBuffers,
        placing: Placing,
        constants: ConstantsBuffer,
        wanted: Wanted,
        read: Reader,
    ) -> None:
        self._clock, self._models, self._placing, self._wanted = context.clock, models, placing, wanted
        self._visibility = VisibilityPass(context, models, constants) if wanted.visibility else None
        self._correspondence = CorrespondencePass(context, constants, read) if wanted.corresponds else None
        self._flow = FlowPass(context, constants, read) if wanted.flow else None
        self._size: tuple[int, int] | None = None

    def fits(self, size: tuple[int, int]) -> bool:
        """Return whether there is room for an image size already."""
        return self._size == size

    def resize(self, size: tuple[int, int]) -> None:
        """Make room for an image size; after a failure, there is room for none.

        Raises:
            BackendError: where the driver refuses the size.
        """
        self._size = None
        for sized in (self._visibility, self._flow):
            if sized is not None:
                sized.resize(size)
        self._size = size

    def find_visibility(self, placed: Placed, crop: Crop | None, targets: dict[Eye, EyeTargets]) -> None:
        """Mark what the other eye sees, of a rectified pair; of others the correspondences tell."""
        if self._visibility is None or not placed.scene.camera.rectified:
            return
        for eye in self._wanted.truth_eyes:
            self._visibility.draw(placed, eye, targets, crop)

    def read(
        self,
        placed: Placed,
        crop: Crop | None,
        motions: Mapping[str, Motion | None],
        targets: dict[Eye, EyeTargets],
        views: dict[Eye, dict[str, Any]],
    ) -> None:
        """Read the channels of both views, but for those that the views have already.

        Args:
            placed: the instances.
            crop: the part that was asked for.
            motions: the motions "future" and "past", where they are known.
            targets: what was drawn to.
            views: the channels of each eye, which are added to.
        """
        for eye in EYES:
            self._read_drawn(placed, eye, targets[eye], crop, views[eye])
        if self._correspondence is not None:
            self._read_correspondence(self._correspondence, placed, crop, targets, views)
        for name, motion in motions.items():
            if self._flow is not None and motion is not None and self._wanted.needing(name):
                moment: Moment = "next" if name == "future" else "previous"
                self._read_flow(self._flow, placed, motion, crop, moment, targets, views)

    def _read_drawn(
        self, placed: Placed, eye: Eye, targets: EyeTargets, crop: Crop | None, view: dict[str, Any]
    ) -> None:
        """Copy out one eye's channels of the drawing and the visibility pass, but for what the view has already."""
        image, rectified = CHANNELS["image"], placed.scene.camera.rectified
        with self._clock.timed("read", eye):
            for channel in self._wanted.drawn_by("drawing"):
                drawn = eye in self._wanted.truth_eyes and (rectified or channel.name not in CORRESPONDENCE)
                if channel.name not in view and (channel is image or drawn):
                    view[channel.name] = targets.read(channel.attachment, crop)
            if targets.visibility is not None and rectified:
                for channel in self._wanted.drawn_by("visibility"):
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
        found = [channel for channel in self._wanted.channels if channel.attachment in CORRESPONDENCE]
        if placed.scene.camera.rectified:
            found = self._wanted.drawn_by("correspondence")
        for eye in self._wanted.truth_eyes:
            compared = correspondence.draw(placed, eye, targets, self._models, crop)
            with self._clock.timed("read", eye):
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
        moved = flow_pass.place(placed, motion, self._placing)
        of_moment = [row for row in self._wanted.drawn_by("flow") if row.moment == moment]
        for eye in self._wanted.truth_eyes:
            channels = [row for row in of_moment if row.name not in views[eye]]
            if not channels:
                continue
            targets = flow_pass.draw(placed, moved, eye, own[eye], self._models, crop)
            with self._clock.timed("read", eye):
                for channel in channels:
                    views[eye][channel.name] = targets.read(channel.attachment, crop)
