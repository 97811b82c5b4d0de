"""Runs the passes that compare views and moments of a drawn pair, and reads the channels of all passes."""

from collections.abc import Mapping

from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import ViewArrays
from semisynth_gl.render.both_eyes import CorrespondencePass, VisibilityMaskPass
from semisynth_gl.render.flow import FlowPass, compose_moves
from semisynth_gl.render.instance_transforms import TransformComposer
from semisynth_gl.render.options import attachment_of
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.target_set import DrawnPair
from semisynth_gl.render.targets import CORRESPONDENCE, VISIBILITY
from semisynth_gl.scene.scene import SceneMotion


class ReadbackPass:
    """Runs the visibility, correspondence and flow passes, and reads the channels of a pair."""

    def __init__(self, resources: RenderResources, composer: TransformComposer) -> None:
        options = resources.options
        self._composer, self._options = composer, options
        self._visibility = VisibilityMaskPass(resources) if options.visibility else None
        self._correspondence = CorrespondencePass(resources) if options.correspondence else None
        self._flow = FlowPass(resources) if options.flow else None

    def compute_visibility(self, pair: DrawnPair) -> None:
        """Run the visibility pass on a rectified pair. For others, `read` runs the correspondence pass instead."""
        if self._visibility is not None and pair.transforms.scene.camera.rectified:
            for eye in self._options.truth_eyes:
                self._visibility.compute(pair, eye)

    def read(self, pair: DrawnPair, motions: Mapping[str, SceneMotion | None]) -> None:
        """Read the channels that ``pair.views`` lack, and add them there.

        ``motions`` has the scene's motions "future" and "past"; with None, the channels that need it are left out.
        """
        for eye in EYES:
            self._read_drawn(pair, eye)
        if self._correspondence is not None:
            self._read_correspondence(self._correspondence, pair)
        for name, motion in motions.items():
            outputs = self._options.outputs_of(name)
            if self._flow is not None and motion is not None and outputs:
                self._read_flow(self._flow, pair, motion, outputs)

    def _read_drawn(self, pair: DrawnPair, eye: Eye) -> None:
        """Read one eye's channels from the drawing pass and the visibility pass."""
        targets, view = pair.eyes[eye], pair.views[eye]
        rectified = pair.transforms.scene.camera.rectified
        for channel in self._options.channels_of("drawing"):
            is_truth = eye in self._options.truth_eyes and (rectified or channel.name not in CORRESPONDENCE)
            if channel.name not in view and (channel is ViewArrays.image or is_truth):
                view[channel.name] = targets.read(attachment_of(channel), pair.crop)
        if self._visibility is not None and rectified and eye in self._options.truth_eyes:
            visibility = pair.targets.without_depth(f"visibility {eye}", VISIBILITY)
            view["visibility"] = visibility.read("visibility", pair.crop)

    def _read_correspondence(self, correspondence: CorrespondencePass, pair: DrawnPair) -> None:
        """Compute and read the correspondences and, if the right camera deviates, disparities and visibility."""
        names = ("correspondence",) if pair.transforms.scene.camera.rectified else CORRESPONDENCE
        channels = [channel for channel in self._options.channels if attachment_of(channel) in names]
        for eye in self._options.truth_eyes:
            targets = correspondence.compute(pair, eye)
            for channel in channels:
                pair.views[eye][channel.name] = targets.read(attachment_of(channel), pair.crop)

    def _read_flow(self, flow_pass: FlowPass, pair: DrawnPair, motion: SceneMotion, outputs: list[str]) -> None:
        """Compute the flow to the motion's target moment, and read its channels."""
        moves, then = compose_moves(pair.transforms, motion), self._composer.compose(motion.scene)
        for eye in self._options.truth_eyes:
            channels = [
                channel
                for channel in self._options.channels_of("flow")
                if channel.output in outputs and channel.name not in pair.views[eye]
            ]
            if channels:
                targets = flow_pass.compute(pair, then, moves, eye)
                for channel in channels:
                    pair.views[eye][channel.name] = targets.read(attachment_of(channel), pair.crop)
