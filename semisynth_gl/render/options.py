"""A renderer's options: the channels and views that it makes of every pair, and the passes that these need."""

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

_OF_MOTIONS = {"future": FUTURE_OUTPUTS, "past": PAST_OUTPUTS}

OF_BOTH_VIEWS = frozenset({"disparity", "visibility", "correspondence", "disparity_change"})
"""The channels of a view that depend on the other eye. Pairs that share a view share all its other channels."""


def pass_of(channel: Channel[Any]) -> str:
    """Return the pass that writes a channel. The renderer does not make the channels of "lens"; the caller does."""
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
    factor: int  # factor of the width and height at which colour is drawn for supersampling; 1 for none

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

    def needing(self, motion: str) -> list[str]:
        """Return the outputs that need a motion of the scene, "future" or "past"."""
        return sorted(self.outputs & _OF_MOTIONS[motion])

    def drawn_by(self, name: str) -> list[Channel[Any]]:
        """Return the channels that a pass writes."""
        return [channel for channel in self.channels if pass_of(channel) == name]

    @property
    def visibility(self) -> bool:
        """Whether the visibility pass runs."""
        return "visibility" in self.outputs

    @property
    def flow(self) -> bool:
        """Whether the flow pass runs."""
        return bool(self.outputs & MOTION_OUTPUTS)

    @property
    def corresponds(self) -> bool:
        """Whether the correspondence pass runs."""
        return not self.rectified or "correspondence" in self.outputs

    @property
    def reads_triangles(self) -> bool:
        """Whether any pass looks up triangles."""
        return self.corresponds or any(
            channel.name == "normals" or pass_of(channel) != "drawing" for channel in self.channels
        )

    def attachments(self, eye: Eye) -> tuple[str, ...]:
        """Return the attachments that the drawing pass of an eye writes."""
        own = eye in self.truth_eyes
        flow = own and self.flow
        # Exceptions: a later pass needs the attachment, or another pass draws it.
        needed = {
            "colour": self.factor == 1,  # with supersampling, colour is drawn to separate targets
            "disparity": own or self.visibility,
            "depth": flow or self.corresponds or (own and "depth" in self.outputs),
            "surface": self.visibility or flow or self.corresponds,
        }
        names = {attachment_of(channel): own for channel in self.drawn_by("drawing")} | needed
        return tuple(name for name, drawn in names.items() if drawn)
