"""The patch atlas: the textures of all surfaces, and the square of an image from which each patch is cut."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.textures.crop_report import CropCount, TextureReport
from semisynth_gl.textures.crops import texture_measure


@dataclass(frozen=True, slots=True)
class Patch:
    """A texture for surfaces: a square of an image, scaled to the size of a layer of the atlas.

    A patch of a still image has one layer; a patch of an image sequence has one layer per frame. Larger squares are
    averaged. Only squares of large patches may be smaller than a layer; they are enlarged.

    Attributes:
        source: name of the image, as in `Square`.
        left_px: first column of the square in the upright image.
        top_px: first row of the square.
        side_px: side of the square, in image pixels.
        first_layer: number of the patch's first layer; `Atlas` says how layers are numbered.
        layer_count: number of successive layers.
        texture: the smallest `texture_measure` of its layers.
        large: whether it is a large patch, for walls and grounds; large patches come last in the atlas.
        subject: name of the subject's first image, if several images in the atlas show the subject; else empty.
    """

    source: str
    left_px: int
    top_px: int
    side_px: int
    first_layer: int
    layer_count: int
    texture: float
    large: bool = False
    subject: str = ""

    @property
    def subject_name(self) -> str:
        """The name of the patch's subject; the image's name if no other image shows the subject."""
        return self.subject or self.source

    def as_json(self) -> dict[str, Any]:
        """Return the attributes by name, in JSON's types; ``large`` and ``subject`` only if they are not defaults."""
        defaults = {"large": False, "subject": ""}
        return {key: value for key, value in asdict(self).items() if defaults.get(key) != value}


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """All patches of a dataset, ready for a texture array.

    Attributes:
        layers: (L, P, P, 4) uint8 RGBA, C-contiguous, top row first. A = 255 everywhere; with four components, OpenGL
            needs no padding of rows. For monochrome cameras (L, P, P) uint8, see `in_grey`.
        patches: in the order of their layers.
        report: the outcome of all images and crops.
        pictures: hexadecimal SHA-256 of the pixels of each painted picture with a patch, by the picture's name.
        large_layers: (M, Q, Q, 4) uint8 RGBA, or (M, Q, Q) uint8 for monochrome cameras: the layers of large patches,
            with the numbers L to L + M - 1; M may be 0.
    """

    layers: NDArray[np.uint8]
    patches: tuple[Patch, ...]
    report: TextureReport
    pictures: Mapping[str, str] = field(default_factory=dict)
    large_layers: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 1, 1, 4), np.uint8))

    def pixels(self, patch: Patch) -> NDArray[np.uint8]:
        """Return the F layers of a patch, (F, P, P, 4) uint8 RGBA or (F, P, P) uint8 grey; Q for P if it is large."""
        layers, first = self.layers, patch.first_layer
        if patch.large:
            layers, first = self.large_layers, first - len(self.layers)
        return layers[first : first + patch.layer_count]

    def in_grey(self) -> "Atlas":
        """Return the atlas with all layers in grey, as monochrome cameras see them; see `to_grey`."""
        return replace(self, layers=_in_grey(self.layers), large_layers=_in_grey(self.large_layers))


def to_grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the luminance of (H, W, 3) RGB or (H, W, 4) RGBA by ITU-R BT.601, as Pillow rounds it: (H, W) uint8."""
    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).convert("L"))


def _in_grey(layers: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.array([to_grey(layer) for layer in layers], np.uint8).reshape(layers.shape[:3])


def atlas_from_arrays(patches: Sequence[NDArray[np.uint8]], sources: Sequence[str]) -> Atlas:
    """Make an atlas of squares of one size, (P, P, 3) uint8 RGB each, even of squares with little texture.

    ``sources`` names the image of each patch.
    """
    side = len(patches[0])
    described = tuple(
        Patch(source, 0, 0, side, layer, 1, texture_measure(patch))
        for layer, (source, patch) in enumerate(zip(sources, patches, strict=True))
    )
    counts = tuple(CropCount(source, side, kept=1) for source in sources)
    report = TextureReport(images_used=len(patches), counts=counts, patch_px=side)
    return Atlas(opaque_layers([patch[np.newaxis] for patch in patches]), described, report)


def opaque_layers(stacks: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Join stacks of frames, each (F, P, P, 3) uint8 RGB, into layers (sum of F, P, P, 4) uint8 RGBA with A = 255."""
    side = stacks[0].shape[1]
    layers = np.full((sum(map(len, stacks)), side, side, 4), 255, dtype=np.uint8)
    np.concatenate(stacks, out=layers[..., :3])
    return layers
