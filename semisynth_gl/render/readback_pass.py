"""Reads a drawn pair: the channels of the drawing pass, and the results of passes that compare views and moments."""

from collections.abc import Mapping

from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import ViewArrays
from semisynth_gl.render.flow import FlowPass, place_moved
from semisynth_gl.render.instance_transforms import TransformComposer
from semisynth_gl.render.options import attachment_of
from semisynth_gl.render.other_eye import CorrespondencePass, VisibilityPass
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.target_set import DrawnPair
from semisynth_gl.render.targets import CORRESPONDENCE, VISIBILITY
from semisynth_gl.scene.scene import Motion


class ReadbackPass:
    """Runs the visibility, correspondence and flow passes, and reads the channels of a pair."""

    def __init__(self, resources: RenderResources, composer: TransformComposer) -> None:
        options = resources.options
        self._composer, self._options = composer, options
        self._visibility = VisibilityPass(resources) if options.visibility else None
        self._correspondence = CorrespondencePass(resources) if options.corresponds else None
        self._flow = FlowPass(resources) if options.flow else None

    def find_visibility(self, pair: DrawnPair) -> None:
        """Run the visibility pass on a rectified pair; for others, `read` computes visibility by correspondences."""
        if self._visibility is not None and pair.transforms.scene.camera.rectified:
            for eye in self._options.truth_eyes:
                self._visibility.draw(pair, eye)

    def read(self, pair: DrawnPair, motions: Mapping[str, Motion | None]) -> None:
        """Read all channels that the drawing pass has not read, and add them to the pair's views.

        ``motions`` has the motions "future" and "past", for the channels of flow; None means no flow.
        """
        for eye in EYES:
            self._read_drawn(pair, eye)
        if self._correspondence is not None:
            self._read_correspondence(self._correspondence, pair)
        for name, motion in motions.items():
            outputs = self._options.needing(name)
            if self._flow is not None and motion is not None and outputs:
                self._read_flow(self._flow, pair, motion, outputs)

    def _read_drawn(self, pair: DrawnPair, eye: Eye) -> None:
        """Read one eye's channels from the drawing pass and the visibility pass."""
        targets, view = pair.eyes[eye], pair.views[eye]
        rectified = pair.transforms.scene.camera.rectified
        for channel in self._options.drawn_by("drawing"):
            drawn = eye in self._options.truth_eyes and (rectified or channel.name not in CORRESPONDENCE)
            if channel.name not in view and (channel is ViewArrays.image or drawn):
                view[channel.name] = targets.read(attachment_of(channel), pair.crop)
        if self._visibility is not None and rectified and eye in self._options.truth_eyes:
            view["visibility"] = pair.targets.without_depth(f"visibility {eye}", VISIBILITY).read(
                "visibility", pair.crop
            )

    def _read_correspondence(self, correspondence: CorrespondencePass, pair: DrawnPair) -> None:
        """Compute and read the correspondences and, for a pair that deviates, disparities and masks."""
        names = ("correspondence",) if pair.transforms.scene.camera.rectified else CORRESPONDENCE
        found = [channel for channel in self._options.channels if attachment_of(channel) in names]
        for eye in self._options.truth_eyes:
            compared = correspondence.draw(pair, eye)
            for channel in found:
                pair.views[eye][channel.name] = compared.read(attachment_of(channel), pair.crop)

    def _read_flow(self, flow_pass: FlowPass, pair: DrawnPair, motion: Motion, outputs: list[str]) -> None:
        """Compute the flow to the motion's target moment, and read its channels."""
        then, moves = place_moved(pair.transforms, motion, self._composer)
        of_moment = [row for row in self._options.drawn_by("flow") if row.output in outputs]
        for eye in self._options.truth_eyes:
            channels = [row for row in of_moment if row.name not in pair.views[eye]]
            if not channels:
                continue
            targets = flow_pass.draw(pair, then, moves, eye)
            for channel in channels:
                pair.views[eye][channel.name] = targets.read(attachment_of(channel), pair.crop)
