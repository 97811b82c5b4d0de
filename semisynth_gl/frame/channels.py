"""The table of channels, the quantities that a view has at every pixel."""

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

Colour = Literal["rgb", "grey"]
TruthViews = Literal["both", "left"]
TRUTH_VIEWS: tuple[TruthViews, ...] = get_args(TruthViews)

ANTIALIASING = ("none", "edges", *(f"ssaa{samples}" for samples in range(2, 9)))

Value = TypeVar("Value", bound=np.generic)
_UINT8, _FLOAT32 = np.dtype(np.uint8), np.dtype(np.float32)


@dataclass(eq=False)
class Channel(Generic[Value]):
    """A quantity of every pixel of a view: a row of the table in the class `ViewArrays`.

    Attributes:
        dtype: the dtype of the values.
        meaning: the meaning of a value, with ``{view}`` and ``{other}`` for the names of the view and the other view.
        components: values per pixel; the array is (H, W) for 1, else (H, W, components).
        fill: the value of a pixel that shows nothing, or for which the quantity does not exist.
        output: the output by which a user requests the channel, by default its name; None if no request is needed.
        mask: the channel that says whether the other view, or the next or previous frame, shows the same point.
        is_truth: whether the channel is truth, which the config's ``truth`` limits to the left view.
        name: the channel's name in `ViewArrays`.
    """

    dtype: np.dtype[Value]
    meaning: str
    components: int = 1
    _: KW_ONLY
    fill: float = 0
    output: str | None = ""
    mask: str | None = None
    is_truth: bool = True
    name: str = field(init=False)

    def __set_name__(self, owner: type["ViewArrays"], name: str) -> None:
        self.name = name
        self.output = name if self.output == "" else self.output

    @overload
    def __get__(self, view: None, owner: type["ViewArrays"]) -> Self: ...

    @overload
    def __get__(self, view: "ViewArrays", owner: type["ViewArrays"]) -> NDArray[Value]: ...

    def __get__(self, view: "ViewArrays | None", owner: type["ViewArrays"]) -> Self | NDArray[Value]:
        if view is None:
            return self
        array: NDArray[Value] | None = view.get(self.name)
        if array is None:
            hint = "truth of this view" if self.output is None else f"the output {self.output} of this view"
            raise AttributeError(f"this view has no {self.name}: {hint} was not made")
        return array

    @property
    def is_image(self) -> bool:
        """Whether the array is an image, which monochrome cameras make grey, (H, W)."""
        return self.name in ("image", "raw")

    def role(self, eye: Eye) -> str:
        """Return the name of one eye's array in a frame: the eye for an image, or a name such as ``disparity_left``."""
        return eye if self.name == "image" else f"{self.name}_{eye}"

    @property
    def beyond_key(self) -> str:
        """The key under which a pair's provenance counts, for each view, the values beyond the range of the codec."""
        return f"{self.name}_beyond"


class ViewArrays(Mapping[str, NDArray[Any]]):
    """One eye's view: its arrays by the names of their channels.

    ``view.disparity`` and ``view["disparity"]`` are the same array; ``"flow" in view`` says whether there is flow.

    Args:
        channels: (H, W) or (H, W, C) arrays by name, with the dtypes and components of the table below. Objects that
            are not arrays, such as tensors, are not checked.

    Raises:
        InputError: where there is no channel of a name, or an array has the wrong dtype or number of components.
    """

    image = Channel(_UINT8, "{view} image, 8-bit", 3, output=None, is_truth=False)
    disparity = Channel(_FLOAT32, "disparity of the {view} view's pixels", fill=inf, output=None, mask="visibility")
    visibility = Channel(
        _UINT8,
        f"8-bit: {VISIBLE} where the {{other}} view sees the point too, {OCCLUDED} where something hides it there, "
        f"{OUTSIDE} where it is outside the {{other}} image or has no disparity",
    )
    correspondence = Channel(
        _FLOAT32,
        "vector from the {view} view's pixels to the same points in the {other} view, px to the right and px down",
        2,
        fill=inf,
    )
    instances = Channel(
        np.dtype(np.uint16), "16-bit: k + 1 where instance k of the scene is seen, 0 where there is none"
    )
    depth = Channel(_FLOAT32, "planar depth in metres, float32; inf where nothing is seen", fill=inf)
    sky = Channel(_UINT8, f"8-bit: {SKY} where the sky is seen, a backdrop that is infinitely far away, else 0")
    valid = Channel(
        _UINT8,
        f"8-bit: {VISIBLE} where the {{view}} sensor saw what the rectified pixel shows, else 0: a border of the "
        "rectification",
    )
    raw = Channel(
        _UINT8,
        "{view} image before rectification, 8-bit; black beyond what the rectified image shows",
        3,
        is_truth=False,
    )
    raw_map = Channel(
        _FLOAT32,
        "position in the raw image that the {view} view's pixels show, column and row, float32 px; inf behind "
        "the raw camera",
        2,
        fill=inf,
        is_truth=False,
    )
    normals = Channel(
        _FLOAT32,
        "unit normal of the surface seen, towards the camera and in its frame (x right, y down, z forward), float32; 0 "
        "where nothing is seen",
        3,
    )
    flow = Channel(_FLOAT32, "flow of the {view} view's pixels to the next frame", 2, fill=inf, mask="flow_visibility")
    flow_visibility = Channel(
        _UINT8,
        f"8-bit: {VISIBLE} where the {{view}} view shows the point at the next frame too, {OCCLUDED} where it does "
        f"not, {OUTSIDE} where the point has left the image or has no flow",
        output="flow",
    )
    flow_backward = replace(flow, meaning=flow.meaning.replace("next", "previous"), mask="flow_backward_visibility")
    flow_backward_visibility = replace(
        flow_visibility, meaning=flow_visibility.meaning.replace("next", "previous"), output="flow_backward"
    )
    disparity_change = Channel(
        _FLOAT32, "disparity of the point at the next frame minus the one here, float32 px; inf for none", fill=inf
    )

    def __init__(self, channels: Mapping[str, NDArray[Any]]) -> None:
        self._arrays = dict(channels)
        for name, array in self._arrays.items():
            channel = CHANNELS.get(name)
            if channel is None:
                raise InputError(f"expected channels of {', '.join(CHANNELS)}, got {name}", argument="view")
            if not isinstance(array, np.ndarray):
                continue  # the renderer's reader may return tensors
            components = (channel.components,) if channel.components > 1 else ()
            allowed = [components, ()] if channel.is_image else [components]
            if array.ndim < 2 or array.shape[2:] not in allowed or array.dtype != channel.dtype:
                expected = " or ".join(str(("H", "W", *shape)).replace("'", "") for shape in allowed)
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

    def with_channels(self, channels: Mapping[str, NDArray[Any]]) -> "ViewArrays":
        """Return a view in which some arrays are added or replaced."""
        return ViewArrays(self._arrays | dict(channels))


CHANNELS: Mapping[str, Channel[Any]] = {
    name: channel for name, channel in vars(ViewArrays).items() if isinstance(channel, Channel)
}
"""All channels by name, in the order of the table."""

OUTPUTS: tuple[str, ...] = tuple(
    dict.fromkeys(channel.output for channel in CHANNELS.values() if channel.output is not None)
)
"""The outputs that a user may request besides images and disparities."""
DEFAULT_OUTPUTS = ("visibility",)
LENS_OUTPUTS = ("valid", "raw", "raw_map")
"""The outputs that need lenses."""
RENDERED_OUTPUTS = tuple(output for output in OUTPUTS if output not in LENS_OUTPUTS)
"""The outputs that the renderer makes."""
FUTURE_OUTPUTS, PAST_OUTPUTS = frozenset({"flow", "disparity_change"}), frozenset({"flow_backward"})
MOTION_OUTPUTS = FUTURE_OUTPUTS | PAST_OUTPUTS
"""The outputs that need the motion to the next or the previous frame."""

ROLES: Mapping[str, tuple[Eye, Channel[Any]]] = {
    channel.role(eye): (eye, channel) for channel in CHANNELS.values() for eye in EYES
}
"""Eye and channel of each array of a frame, by role."""
