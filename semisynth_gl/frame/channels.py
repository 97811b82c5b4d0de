"""The table of channels: what a view has of every pixel."""

from collections.abc import Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from math import inf
from typing import Any, Generic, Literal, Self, TypeVar, get_args, overload

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.inputs.errors import InputError

VISIBLE = 255
OCCLUDED = 128
OUTSIDE = 0
SKY = 255

Moment = Literal["now", "next", "previous"]
Pass = Literal["drawing", "visibility", "correspondence", "flow", "lens"]

Colour = Literal["rgb", "grey"]
TruthViews = Literal["both", "left"]
TRUTH_VIEWS: tuple[TruthViews, ...] = get_args(TruthViews)

ANTIALIAS_PATTERN = r"^(none|edges|ssaa[2-8])$"

Value = TypeVar("Value", bound=np.generic)
_UINT8, _FLOAT32 = np.dtype(np.uint8), np.dtype(np.float32)


@dataclass(eq=False)
class Channel(Generic[Value]):
    """A quantity of every pixel of a view: a row of the table in the class `View`.

    Attributes:
        dtype: the dtype of the values.
        meaning: the meaning of a value, with ``{view}`` and ``{other}`` for the names of the view and the other view.
        components: values per pixel; the array is (H, W) for 1, else (H, W, components).
        or_grey: whether the array is (H, W) in spite of its components where the cameras are monochrome.
        nothing: the value of a pixel that shows nothing, or for which the quantity does not exist.
        output: the output that a user asks for to get the channel; None for a channel of every view that has truth.
        moment: "next" or "previous" for a channel that compares the scene with that frame, which needs its motion.
        drawn_by: the renderer's pass that writes the channel.
        attachment: the pass's attachment that holds the channel; by default it has the channel's name.
        reads_triangles: whether that pass looks up the scene's triangles, as all passes after the drawing do.
        mask: the channel that says whether the other view, or the other moment, shows the same point.
        of_own_view: whether the channel does not depend on the other eye, so that pairs that share a view share it.
        is_truth: whether ``truth`` decides which views have the channel; else both views have it.
        of_sensor: whether the array has the size of the raw image before rectification, not of the pair.
        name: the channel's name in `View`.
    """

    dtype: np.dtype[Value]
    meaning: str
    _: KW_ONLY
    components: int = 1
    or_grey: bool = False
    nothing: float = 0
    output: str | None = None
    moment: Moment = "now"
    drawn_by: Pass = "drawing"
    attachment: str = ""
    reads_triangles: bool = False
    mask: str | None = None
    of_own_view: bool = False
    is_truth: bool = True
    of_sensor: bool = False
    name: str = field(init=False)

    def __set_name__(self, owner: type["View"], name: str) -> None:
        self.name = name
        self.attachment = self.attachment or name
        self.reads_triangles |= self.drawn_by not in ("drawing", "lens")

    @overload
    def __get__(self, view: None, owner: type["View"]) -> Self: ...

    @overload
    def __get__(self, view: "View", owner: type["View"]) -> NDArray[Value]: ...

    def __get__(self, view: "View | None", owner: type["View"]) -> Self | NDArray[Value]:
        if view is None:
            return self
        array: NDArray[Value] | None = view.get(self.name)
        if array is None:
            hint = "truth of this view" if self.output is None else f"the output {self.output}, in this view,"
            raise AttributeError(f"this view has no {self.name}: {hint} was not made")
        return array

    def fits(self, shape: tuple[int, ...]) -> bool:
        """Return whether an array of the channel may have this shape; only what follows (H, W) is checked."""
        return shape[2:] in {() if self.components == 1 else (self.components,), *([()] if self.or_grey else [])}

    def role(self, eye: Eye) -> str:
        """Return the name of one eye's array in a frame: the eye for an image, or a name such as ``disparity_left``."""
        return eye if self.name == "image" else f"{self.name}_{eye}"

    @property
    def beyond_key(self) -> str:
        """The key of a pair's provenance with the number of pixels per view whose value the codec cannot store."""
        return f"{self.name}_beyond"


class View(Mapping[str, NDArray[Any]]):
    """One eye's view: the arrays that were made, by the names of their channels.

    ``view.disparity`` and ``view["disparity"]`` are the same array; ``"flow" in view`` says whether there is flow.

    Args:
        channels: (H, W) or (H, W, C) arrays by name, with the dtypes and components of the table below. Objects that
            are not arrays, such as tensors, are not checked.

    Raises:
        InputError: where there is no channel of a name, or an array has another dtype or number of components.
    """

    image = Channel(
        _UINT8,
        "{view} image, 8-bit",
        components=3,
        or_grey=True,
        attachment="colour",
        of_own_view=True,
        is_truth=False,
    )
    disparity = Channel(_FLOAT32, "disparity of the {view} view's pixels", nothing=inf, mask="visibility")
    visibility = Channel(
        _UINT8,
        f"8-bit: {VISIBLE} where the {{other}} view sees the point too, {OCCLUDED} where something hides it there, "
        f"{OUTSIDE} where it is outside the {{other}} image or has no disparity",
        nothing=OUTSIDE,
        output="visibility",
        drawn_by="visibility",
    )
    correspondence = Channel(
        _FLOAT32,
        "way from the {view} view's pixels to the same points in the {other} view, right and down",
        components=2,
        nothing=inf,
        output="correspondence",
        drawn_by="correspondence",
    )
    instances = Channel(
        np.dtype(np.uint16),
        "16-bit: k + 1 where instance k of the scene is seen, 0 where there is none",
        output="instances",
        of_own_view=True,
    )
    depth = Channel(
        _FLOAT32,
        "planar depth in metres, float32; inf where nothing is seen",
        nothing=inf,
        output="depth",
        of_own_view=True,
    )
    sky = Channel(
        _UINT8,
        f"8-bit: {SKY} where the sky is seen, a backdrop that is infinitely far away, else 0",
        output="sky",
        of_own_view=True,
    )
    valid = Channel(
        _UINT8,
        f"8-bit: {VISIBLE} where the {{view}} sensor saw what the rectified pixel shows, else 0: a border of the "
        "rectification",
        output="valid",
        drawn_by="lens",
        of_own_view=True,
    )
    raw = replace(
        image,
        meaning="{view} image before rectification, 8-bit; black beyond what the rectified image shows",
        output="raw",
        drawn_by="lens",
        attachment="",
        of_sensor=True,
    )
    raw_map = Channel(
        _FLOAT32,
        "position in the raw image that the {view} view's pixels show, column and row, float32 px; inf behind "
        "the raw camera",
        components=2,
        nothing=inf,
        output="raw_map",
        drawn_by="lens",
        of_own_view=True,
        is_truth=False,
    )
    normals = Channel(
        _FLOAT32,
        "unit normal of the surface seen, towards the camera and in its frame (x right, y down, z forward), float32; 0 "
        "where nothing is seen",
        components=3,
        output="normals",
        reads_triangles=True,
        of_own_view=True,
    )
    flow = Channel(
        _FLOAT32,
        "flow of the {view} view's pixels to the next frame",
        components=2,
        nothing=inf,
        output="flow",
        moment="next",
        drawn_by="flow",
        mask="flow_visibility",
        of_own_view=True,
    )
    flow_visibility = Channel(
        _UINT8,
        f"8-bit: {VISIBLE} where the {{view}} view shows the point at the next frame too, {OCCLUDED} where it does "
        f"not, {OUTSIDE} where the point has left the image or has no flow",
        nothing=OUTSIDE,
        output="flow",
        moment="next",
        drawn_by="flow",
        of_own_view=True,
    )
    flow_backward = replace(
        flow,
        meaning=flow.meaning.replace("next", "previous"),
        output="flow_backward",
        moment="previous",
        attachment="flow",
        mask="flow_backward_visibility",
    )
    flow_backward_visibility = replace(
        flow_visibility,
        meaning=flow_visibility.meaning.replace("next", "previous"),
        output="flow_backward",
        moment="previous",
        attachment="flow_visibility",
    )
    disparity_change = Channel(
        _FLOAT32,
        "disparity of the point at the next frame minus the one here, float32 px; inf for none",
        nothing=inf,
        output="disparity_change",
        moment="next",
        drawn_by="flow",
    )

    def __init__(self, channels: Mapping[str, NDArray[Any]]) -> None:
        self._arrays = dict(channels)
        for name, array in self._arrays.items():
            channel = CHANNELS.get(name)
            if channel is None:
                raise InputError(f"expected channels of {', '.join(CHANNELS)}, got {name}", argument="view")
            if not isinstance(array, np.ndarray):
                continue  # the renderer's reader may return tensors
            if array.ndim < 2 or not channel.fits(array.shape) or array.dtype != channel.dtype:
                expected = "(H, W)" if channel.components == 1 else f"(H, W, {channel.components})"
                expected += " or (H, W)" if channel.or_grey else ""
                raise InputError(
                    f"{name} must be {expected} {channel.dtype}, got {array.shape} {array.dtype}", argument="view"
                )

    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def with_channels(self, channels: Mapping[str, NDArray[Any]]) -> "View":
        """Return a view in which some arrays are added or replaced."""
        return View(self._arrays | dict(channels))


CHANNELS: Mapping[str, Channel[Any]] = {
    name: channel for name, channel in vars(View).items() if isinstance(channel, Channel)
}
"""All channels by name, in the order of the table."""

OUTPUTS: tuple[str, ...] = tuple(
    dict.fromkeys(channel.output for channel in CHANNELS.values() if channel.output is not None)
)
"""The outputs that a user may ask for beside images and disparities."""
DEFAULT_OUTPUTS = ("visibility",)
DRAWN_OUTPUTS: tuple[str, ...] = tuple(
    output
    for output in OUTPUTS
    if all(channel.drawn_by != "lens" for channel in CHANNELS.values() if channel.output == output)
)
"""The outputs that a renderer makes; the others come with the lenses of a config's pairs."""


FUTURE_OUTPUTS, PAST_OUTPUTS = (
    frozenset(channel.output for channel in CHANNELS.values() if channel.output and channel.moment == moment)
    for moment in ("next", "previous")
)
FLOW_OUTPUTS = FUTURE_OUTPUTS | PAST_OUTPUTS
"""The outputs that need a scene's motion."""

ROLES: Mapping[str, tuple[Eye, Channel[Any]]] = {
    channel.role(eye): (eye, channel) for channel in CHANNELS.values() for eye in EYES
}
"""Eye and channel of each array of a frame, by role."""
