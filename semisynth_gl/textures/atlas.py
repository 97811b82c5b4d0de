"""The patch atlas: what the renderer samples, and where each patch comes from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import InputError, Skipped
from semisynth_gl.textures.crops import texture_measure


@dataclass(frozen=True, slots=True)
class Patch:
    """One square of texture: a run of layers of the atlas, and its provenance.

    Attributes:
        source: name of the image, relative to the folder that all images share; of an image sequence its first frame.
        left_px: column of the square's first pixel in the upright image.
        top_px: row of it.
        side_px: width and height in the image; the patch was reduced where this exceeds the size of a layer.
        first_layer: index of its first layer in the atlas.
        layer_count: successive frames it has; 1 for a still image.
        texture: its `texture_measure` in 8-bit levels; of several frames the least.
    """

    source: str
    left_px: int
    top_px: int
    side_px: int
    first_layer: int
    layer_count: int
    texture: float


Reason = Literal["flat", "blurred", "duplicate"]
REASONS: tuple[Reason, ...] = get_args(Reason)


@dataclass(frozen=True, slots=True)
class CropCount:
    """What became of the squares of one side in one image; a square followed through several frames counts once.

    Attributes:
        source: name of the image, as in `Patch`.
        side_px: side of the squares in the image.
        kept: became patches, ``kept_flat`` included.
        kept_flat: became patches although they are flat, as ``flat_share`` wants.
        flat: left out, less texture than ``min_texture`` in any frame.
        blurred: left out, less sharp than ``min_sharpness`` in any frame.
        duplicate: left out, differs less than ``min_difference`` from another crop.
        surplus: left out, as there were more than wanted.
    """

    source: str
    side_px: int
    kept: int = 0
    kept_flat: int = 0
    flat: int = 0
    blurred: int = 0
    duplicate: int = 0
    surplus: int = 0


class Square(NamedTuple):
    """Where a crop lies.

    Attributes:
        source: name of the image, as in `Patch`.
        left_px: column of its first pixel in the upright image.
        top_px: row of it.
        side_px: width and height.
    """

    source: str
    left_px: int
    top_px: int
    side_px: int


class LeftOut(NamedTuple):
    """A crop that was left out, as an example of its reason.

    Attributes:
        reason: why.
        square: the crop.
        like: of a duplicate, the crop that it hardly differs from.
    """

    reason: Reason
    square: Square
    like: Square | None = None


@dataclass(frozen=True, slots=True)
class TextureReport:
    """What became of the images and of their crops. Where frames form a sequence, each frame counts as an image.

    ``images_used + images_unused + images_too_small + len(images_skipped) + images_not_opened`` is all that were given,
    and ``crops_kept`` with those left out (``crops_flat``, ``crops_blurred``, ``crops_duplicate``, ``crops_surplus``)
    is every square of the images that were opened.

    Attributes:
        images_used: gave at least one patch.
        images_unused: read, but none of their crops is in the atlas.
        too_small: names of the images that are shorter than a patch along a side.
        images_skipped: could not be read, and why.
        images_not_opened: left in the folder because enough patches had been found.
        counts: by image and side of the squares, in this order; of images without a square there is none.
        examples: a few crops that were left out, of different images where there are some.
        patch_px: side of a patch, pixels.
        min_texture: threshold that crops had to reach, 8-bit levels of `texture_measure`.
        flat_share: share of flat patches that was wanted.
        longest_run: most layers that one patch has.
    """

    images_used: int
    images_unused: int
    too_small: tuple[str, ...]
    images_skipped: tuple[Skipped, ...]
    images_not_opened: int
    counts: tuple[CropCount, ...]
    examples: tuple[LeftOut, ...]
    patch_px: int
    min_texture: float
    flat_share: float
    longest_run: int

    @property
    def images_too_small(self) -> int:
        """How many images were shorter than a patch along a side."""
        return len(self.too_small)

    @property
    def crops_kept(self) -> int:
        """How many crops became patches."""
        return sum(count.kept for count in self.counts)

    @property
    def crops_kept_flat(self) -> int:
        """How many of these are flat."""
        return sum(count.kept_flat for count in self.counts)

    @property
    def crops_flat(self) -> int:
        """How many were left out as flat."""
        return sum(count.flat for count in self.counts)

    @property
    def crops_blurred(self) -> int:
        """How many were left out as blurred."""
        return sum(count.blurred for count in self.counts)

    @property
    def crops_duplicate(self) -> int:
        """How many were left out as duplicates."""
        return sum(count.duplicate for count in self.counts)

    @property
    def crops_surplus(self) -> int:
        """How many were good enough, but more than wanted."""
        return sum(count.surplus for count in self.counts)

    def summary(self) -> str:
        """Return a few plain lines: what was used, what was left out, and by which measure."""
        frames = f" of up to {self.longest_run} frames" if self.longest_run > 1 else ""
        lines = [
            (
                f"{_count(self.crops_kept, 'patch')} of {self.patch_px} x {self.patch_px} pixels{frames} from "
                f"{_count(self.images_used, 'image')}; {_count(self.crops_flat, 'crop')} left out as flat (median over "
                f"8 x 8 cells of the standard deviation of luminance below {self.min_texture:g} levels), "
                f"{self.crops_blurred} as blurred, {self.crops_duplicate} as duplicates, "
                f"{self.crops_surplus} as more than wanted"
            )
        ]
        if self.flat_share:
            lines.append(
                f"{_count(self.crops_kept_flat, 'patch')} nearly without texture, "
                f"{self.crops_kept_flat / max(self.crops_kept, 1):.1%} of all ({self.flat_share:.1%} were wanted)"
            )
        left_out = [
            f"{count} {what}"
            for count, what in (
                (len(self.images_skipped), "not readable"),
                (self.images_too_small, f"smaller than {self.patch_px} pixels"),
                (self.images_unused, "without a patch in the atlas"),
                (self.images_not_opened, "not opened, enough patches had been found"),
            )
            if count
        ]
        if left_out:
            lines.append(f"images left out: {'; '.join(left_out)}")
        lines += [f"not readable: {skipped}" for skipped in self.images_skipped]
        return "\n".join(lines)


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """All patches of a dataset, ready for a texture array.

    Attributes:
        layers: (L, P, P, 4) uint8 RGBA, C-contiguous, top row first, A = 255 everywhere. RGBA although no layer is
            transparent, because rows of 4-byte pixels need no padding on the way to OpenGL.
        patches: which layers belong together, in the order of their layers.
        report: what was kept and what was left out.
    """

    layers: NDArray[np.uint8]
    patches: tuple[Patch, ...]
    report: TextureReport


def atlas_from_arrays(patches: Sequence[NDArray[Any]], sources: Sequence[str] | None = None) -> Atlas:
    """Make an atlas of squares made by hand; all are kept, whatever texture they have.

    Args:
        patches: each (P, P, 3) uint8 RGB, all of one size.
        sources: what provenance calls them; ``array/00000`` and so on where not given.

    Returns:
        An atlas with one patch of one layer for each array, in their order.

    Raises:
        InputError: where there are none, one is not (P, P, 3) uint8 of the first one's size, or the numbers of patches
            and sources differ.
    """
    if len(patches) == 0:
        raise InputError("an atlas needs at least one patch, got none")
    if sources is None:
        sources = [f"array/{i:05d}" for i in range(len(patches))]
    if len(sources) != len(patches):
        raise InputError(f"expected one source for each patch, got {len(sources)} sources for {len(patches)} patches")
    side = patches[0].shape[0] if patches[0].ndim else 0
    for i, patch in enumerate(patches):
        if side < 1 or patch.shape != (side, side, 3) or patch.dtype != np.uint8:
            raise InputError(
                f"patches must be (P, P, 3) uint8, all of one size P; patch 0 has P = {side}, "
                f"patch {i} is {patch.shape} {patch.dtype}"
            )
    described = tuple(
        Patch(source, 0, 0, side, layer, 1, texture_measure(patch))
        for layer, (source, patch) in enumerate(zip(sources, patches, strict=True))
    )
    report = TextureReport(
        images_used=len(patches),
        images_unused=0,
        too_small=(),
        images_skipped=(),
        images_not_opened=0,
        counts=tuple(CropCount(source, side, kept=1) for source in sources),
        examples=(),
        patch_px=side,
        min_texture=0.0,
        flat_share=0.0,
        longest_run=1,
    )
    return Atlas(opaque_layers([patch[np.newaxis] for patch in patches]), described, report)


def opaque_layers(runs: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Stack runs of frames, each (F, P, P, 3) uint8 RGB, into layers (sum of F, P, P, 4) uint8 RGBA with A = 255."""
    side = runs[0].shape[1]
    layers = np.full((sum(len(run) for run in runs), side, side, 4), 255, dtype=np.uint8)
    at = 0
    for run in runs:
        layers[at : at + len(run), ..., :3] = run
        at += len(run)
    return layers


def _count(number: int, noun: str) -> str:
    plural = noun + ("es" if noun.endswith("ch") else "s")
    return f"{number} {noun if number == 1 else plural}"
