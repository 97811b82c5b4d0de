"""A renderer's options: the channels that it makes of each eye's view, and the passes and attachments for them."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import (
    ANTIALIASING,
    CHANNELS,
    FUTURE_OUTPUTS,
    LENS_OUTPUTS,
    MOTION_OUTPUTS,
    PAST_OUTPUTS,
    RENDERED_OUTPUTS,
    TRUTH_VIEWS,
    Channel,
    TruthViews,
    ViewArrays,
)
from semisynth_gl.inputs.arguments import check_one_of
from semisynth_gl.inputs.errors import InputError, shown

_OUTPUTS_OF_MOTION = {"future": FUTURE_OUTPUTS, "past": PAST_OUTPUTS}

CHANNELS_OF_BOTH_EYES = frozenset({"disparity", "visibility", "correspondence", "disparity_change"})
"""The channels of a view that depend on the other eye. Pairs that share a view share all its other channels."""


def pass_of(channel: Channel[Any]) -> str:
    """Return the pass that writes a channel. "lens" is not a pass of the renderer: its callers make these channels."""
    if channel.name in LENS_OUTPUTS:
        return "lens"
    if channel.output in MOTION_OUTPUTS:
        return "flow"
    return channel.name if channel.name in ("visibility", "correspondence") else "drawing"


def attachment_of(channel: Channel[Any]) -> str:
    """Return the name of the attachment that holds a channel after its pass."""
    return "colour" if channel is ViewArrays.image else channel.name.replace("flow_backward", "flow")


@dataclass(frozen=True)
class RenderOptions:
    """The options of a renderer; see also the arguments of `Renderer`."""

    outputs: frozenset[str]  # the outputs to make besides images and disparities
    truth_eyes: tuple[Eye, ...]  # the eyes whose views have disparity and outputs
    rectified: bool  # whether all right cameras are rectified
    signed: bool  # whether disparities of 0 and below are valid
    outlines: bool  # whether colour is antialiased along outlines
    factor: int  # colour is drawn at this factor times the width and height, and averaged; 1 without supersampling

    @classmethod
    def of(cls, outputs: Collection[str], truth: TruthViews, antialias: str, *, rectified: bool, signed: bool) -> Self:
        """Check a caller's options, and return them; see `Renderer` for the arguments.

        Raises:
            InputError: where an option is unknown, or two options exclude each other.
        """
        if isinstance(outputs, str) or not isinstance(outputs, Collection):
            raise InputError(
                f"expected some of {', '.join(RENDERED_OUTPUTS)}, got {shown(outputs)}", argument="outputs"
            )
        for output in outputs:
            check_one_of("outputs", output, RENDERED_OUTPUTS)
        if not rectified and "disparity_change" in outputs:
            raise InputError(
                "the output disparity_change needs rectified pairs: drop this output, or let no right camera deviate"
            )
        check_one_of("truth", truth, TRUTH_VIEWS)
        eyes: tuple[Eye, ...] = EYES if truth == "both" else ("left",)
        check_one_of("antialias", antialias, ANTIALIASING)
        factor = int(antialias[4:]) if antialias.startswith("ssaa") else 1
        return cls(frozenset(outputs), eyes, rectified, signed, antialias == "edges", factor)

    @cached_property
    def channels(self) -> list[Channel[Any]]:
        """All channels of a view that has truth."""
        return [row for row in CHANNELS.values() if row.output is None or row.output in self.outputs]

    def outputs_of(self, motion: str) -> list[str]:
        """Return the outputs that need a motion of the scene, "future" or "past"."""
        return sorted(self.outputs & _OUTPUTS_OF_MOTION[motion])

    def channels_of(self, pass_name: str) -> list[Channel[Any]]:
        """Return the channels that a pass writes."""
        return [channel for channel in self.channels if pass_of(channel) == pass_name]

    @property
    def visibility(self) -> bool:
        """Whether the visibility pass runs."""
        return "visibility" in self.outputs

    @property
    def flow(self) -> bool:
        """Whether the flow pass runs."""
        return bool(self.outputs & MOTION_OUTPUTS)

    @property
    def correspondence(self) -> bool:
        """Whether the correspondence pass runs."""
        return not self.rectified or "correspondence" in self.outputs

    @property
    def reads_triangles(self) -> bool:
        """Whether any pass looks up triangles by number."""
        return self.visibility or self.correspondence or self.flow or "normals" in self.outputs

    def attachments(self, eye: Eye) -> tuple[str, ...]:
        """Return the attachments that the drawing pass of an eye writes."""
        has_truth = eye in self.truth_eyes
        flow = has_truth and self.flow
        is_written = {attachment_of(channel): has_truth for channel in self.channels_of("drawing")}
        # Later passes compare both eyes' disparities, depths and surfaces. Supersampled colour has separate targets.
        is_written |= {
            "colour": self.factor == 1,
            "disparity": has_truth or self.visibility,
            "depth": flow or self.correspondence or (has_truth and "depth" in self.outputs),
            "surface": self.visibility or flow or self.correspondence,
        }
        return tuple(name for name, written in is_written.items() if written)
