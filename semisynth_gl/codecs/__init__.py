"""Codecs: one module and one class for each file format, and tables of the formats that a config can choose."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from semisynth_gl.codecs.codec import Codec, read_bytes
from semisynth_gl.codecs.flo import Flo
from semisynth_gl.codecs.jpeg import GREY_JPEG, JPEG
from semisynth_gl.codecs.pfm import PFM, PFM3, FlowPfm
from semisynth_gl.codecs.png import GREY8, GREY16, RGB8, GreyAsRgb
from semisynth_gl.codecs.png16 import KITTI_DISPARITY, SIGNED_DISPARITY, FlowPng16
from semisynth_gl.frame.channels import Channel

__all__ = ["DISPARITY_CODECS", "FLOW_CODECS", "IMAGE_CODECS", "Codec", "Encodings", "read_bytes"]

IMAGE_CODECS: Mapping[str, Codec[Any]] = {"png": RGB8}
"""Codecs of (H, W, 3) uint8 RGB for the config's ``files.image``."""

DISPARITY_CODECS: Mapping[str, Codec[Any]] = {"pfm": PFM, "png16": KITTI_DISPARITY}
"""Codecs of (H, W) float32 px for ``files.disparity``; all store inf as "no disparity"."""

FLOW_CODECS: Mapping[str, Codec[Any]] = {"flo": Flo(), "pfm": FlowPfm(), "png16": FlowPng16()}
"""Codecs of (H, W, 2) float32 px for ``files.flow``; all store inf as "no flow"."""

# From the codec of RGB images to the codec of grey images in the same file format.
_GREY_CODECS: Mapping[Codec[Any], Codec[Any]] = {RGB8: GREY8, JPEG: GREY_JPEG}

# Codecs of all channels but images, disparities and flow, by the channel's dtype and number of components.
_CHANNEL_CODECS: Mapping[tuple[str, int], Codec[Any]] = {
    ("uint8", 1): GREY8,
    ("uint16", 1): GREY16,
    ("float32", 1): PFM,
    ("float32", 2): FLOW_CODECS["flo"],
    ("float32", 3): PFM3,
}


@dataclass(frozen=True, slots=True)
class Encodings:
    """The codecs of a dataset's images, disparities and flow.

    ``signed`` says whether disparities are signed, so that 0 and below are valid.
    """

    image: Codec[Any] = RGB8
    disparity: Codec[Any] = PFM
    flow: Codec[Any] = FLOW_CODECS["flo"]
    signed: bool = False

    @classmethod
    def from_names(
        cls, image: str = "png", disparity: str = "pfm", flow: str = "flo", *, signed: bool = False
    ) -> "Encodings":
        """Return the codecs with these names in a config; raises KeyError for an unknown name."""
        chosen = SIGNED_DISPARITY if signed and disparity == "png16" else DISPARITY_CODECS[disparity]
        return cls(IMAGE_CODECS[image], chosen, FLOW_CODECS[flow], signed)

    def in_grey(self, *, three: bool) -> "Encodings":
        """Return encodings for images of monochrome cameras, which are (H, W) uint8.

        If ``three`` is set, or the format has no grey images, files get three equal channels.
        """
        grey = None if three else _GREY_CODECS.get(self.image)
        return replace(self, image=grey or GreyAsRgb(self.image))

    def codec(self, channel: Channel[Any]) -> Codec[Any]:
        """Return the codec of a channel's files."""
        own = {"image": self.image, "raw": self.image, "disparity": self.disparity}
        own |= {"flow": self.flow, "flow_backward": self.flow}
        return own.get(channel.name) or _CHANNEL_CODECS[channel.dtype.name, channel.components]
