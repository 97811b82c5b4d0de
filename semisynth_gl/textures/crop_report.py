"""What became of every image and crop: counts, a summary, and the sheet of patches and of rejected crops."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, zip_longest
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from semisynth_gl.inputs.errors import Skipped, counted
from semisynth_gl.textures.crops import Square, cut_crop
from semisynth_gl.textures.image_files import printable
from semisynth_gl.textures.pictures import TextureImage, pixels_of
from semisynth_gl.textures.shares import patch_chances
from semisynth_gl.textures.subjects import of_subjects

Rejection = Literal["flat", "blurred", "duplicate", "surplus"]
Outcome = Literal["kept", Rejection]
REJECTIONS: tuple[Rejection, ...] = get_args(Rejection)

# The summary notes when there are fewer subjects than this.
_FEW = 4

_MEANING: Mapping[Rejection, str] = {
    "flat": "hardly any texture: textures.min_texture",
    "blurred": "out of focus or enlarged: textures.min_sharpness",
    "duplicate": "each beside the crop that it hardly differs from: textures.min_difference",
}
_EXAMPLES = 12

_WIDTH_PX, _TILE_PX, _GAP_PX = 1600, 72, 4
_TEXT_PX, _TITLE_PX, _LINE_PX = 11, 15, 15
# Tiles beside each other that a label is at least as wide as.
_LEAST_COLUMNS = 3
_PAPER, _INK, _ON_TILE = (250, 250, 248), (30, 30, 30), (255, 255, 255)


class Example(NamedTuple):
    """A rejected crop to look at; ``like`` is the crop that a duplicate hardly differs from."""

    reason: Rejection
    square: Square
    like: Square | None

    @property
    def squares(self) -> list[Square]:
        """The square, after that of the crop that it hardly differs from, if there is one."""
        return [self.square] if self.like is None else [self.like, self.square]


@dataclass(frozen=True, slots=True)
class CropCount:
    """Numbers of crops of one side in one image; a square that is followed through several frames counts once.

    ``kept`` counts the crops that became patches. The other numbers count rejected crops; ``surplus`` are those beyond
    the wanted number of patches.
    """

    source: str
    side_px: int
    kept: int = 0
    flat: int = 0
    blurred: int = 0
    duplicate: int = 0
    surplus: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureReport:
    """What became of all images and their crops. Each frame of an image sequence counts as an image.

    The numbers of images add up to that of the given images, and ``counts`` has every crop of the images that were
    opened.

    Attributes:
        images_used: images with at least one patch in the atlas.
        images_unused: images that were read, but have no patch in the atlas.
        images_too_small: images that are smaller than a patch along a side.
        images_skipped: images that could not be read, and why.
        images_not_opened: images that were not needed, because there were enough patches.
        counts: one entry for each image and each side of its squares, in this order.
        subjects: the subject's name by the image's name, for images that share their subject; see `Patch`.
        examples: a few rejected crops, from different images where possible.
        patch_px: side of a patch.
    """

    images_used: int
    images_unused: int = 0
    images_too_small: int = 0
    images_skipped: tuple[Skipped, ...] = ()
    images_not_opened: int = 0
    counts: tuple[CropCount, ...]
    subjects: Mapping[str, str] = field(default_factory=dict)
    examples: tuple[Example, ...] = ()
    patch_px: int

    @property
    def surface_shares(self) -> dict[str, float]:
        """The share of the surfaces that wear patches of an image, by its name, sum 1; without large patches."""
        kept = [count.source for count in self.counts for _ in range(count.kept)]
        chances = patch_chances([self.subjects.get(source, source) for source in kept])
        shares: dict[str, float] = defaultdict(float)
        for source, chance in zip(kept, chances.tolist(), strict=True):
            shares[source] += chance
        return dict(shares)

    def total(self, outcome: Outcome) -> int:
        """Return the number of crops of all images with an outcome."""
        return count_crops(self.counts, outcome)

    @property
    def scale_names(self) -> dict[int, str]:
        """The scales of the crops, such as ``{256: "1x", 512: "2x"}``, by side."""
        return {side: f"{side / self.patch_px:g}x" for side in sorted({count.side_px for count in self.counts})}

    @property
    def example_images(self) -> set[str]:
        """The names of the images that examples come from."""
        return {square.source for example in self.examples for square in example.squares}

    @property
    def grouped_counts(self) -> dict[str, list[CropCount]]:
        """The counts by image, or by the kind of procedural patches, in their order."""
        groups: dict[str, list[CropCount]] = defaultdict(list)
        for count in self.counts:
            groups[_group(count.source)].append(count)
        return dict(groups)

    def summary(self) -> str:
        """Return a few lines: patches, rejected crops, and images that were not used."""
        shown = len({self.subjects.get(count.source, count.source) for count in self.counts if count.kept})
        shared = of_subjects(self.images_used, shown) if self.subjects else ""
        rejected = ", ".join(f"{self.total(reason)} {reason}" for reason in REJECTIONS)
        patches, used = counted(self.total("kept"), "patch"), counted(self.images_used, "image")
        size = f"{self.patch_px} x {self.patch_px} pixels"
        lines = [f"{patches} of {size} from {used}{shared}; crops left out: {rejected}"]
        if shown < _FEW:
            lines.append("note: that is few: give a few dozen photographs")
        unused = {
            "not readable": len(self.images_skipped),
            f"smaller than {self.patch_px} pixels": self.images_too_small,
            "without a patch in the atlas": self.images_unused,
            "not opened, enough patches had been found": self.images_not_opened,
        }
        if any(unused.values()):
            lines.append(f"images left out: {'; '.join(f'{count} {why}' for why, count in unused.items() if count)}")
        return "\n".join([*lines, *(f"not readable: {skipped}" for skipped in self.images_skipped)])


def choose_examples(rejected: Iterable[Sequence[Example]]) -> tuple[Example, ...]:
    """Choose a few of the rejected crops of each image: for each reason, one of each image in turn."""
    examples: list[Example] = []
    images = list(rejected)
    for reason in _MEANING:
        crops = [[example for example in image if example.reason == reason] for image in images]
        # Evenly spread: the first crops would all show the upper border.
        spread = [of_one[:: -(-len(of_one) // _EXAMPLES) or 1] for of_one in crops]
        in_turn = [example for example in chain.from_iterable(zip_longest(*spread)) if example is not None]
        examples += sorted(in_turn[:_EXAMPLES])
    return tuple(examples)


def count_crops(counts: Collection[CropCount], outcome: Outcome, side_px: int | None = None) -> int:
    """Return the number of crops with an outcome, of one side or of all sides."""
    return sum(getattr(count, outcome) for count in counts if side_px in (None, count.side_px))


def _group(source: str) -> str:
    return source.rsplit("/", 1)[0] if source.startswith("procedural/") else source


def draw_texture_sheet(
    report: TextureReport,
    patches: Iterable[tuple[str, int, NDArray[np.uint8]]],
    images: Mapping[str, TextureImage],
    title: str,
) -> Image.Image:
    """Draw patches by image, and below them examples of rejected crops by reason.

    Args:
        report: of the atlas.
        patches: image, side in the image and pixels, (P, P, 3) uint8, of each. A tile names its scale unless that is 1.
        images: by their names in the atlas; those that examples come from.
        title: the sheet's first line.

    Raises ImageError where one of these images can no longer be read.
    """
    tiles: dict[str, list[Image.Image]] = defaultdict(list)
    for source, side, pixels in patches:
        scale = "" if side == report.patch_px else report.scale_names[side]
        tiles[_group(source)].append(_tile(pixels, scale))
    groups = []
    for group, counts in report.grouped_counts.items():
        columns = min(max(len(tiles[group]), _LEAST_COLUMNS), _WIDTH_PX // (_TILE_PX + _GAP_PX) - 1)
        width = columns * (_TILE_PX + _GAP_PX)
        left_out = {reason: count_crops(counts, reason) for reason in REJECTIONS}
        lines = (
            group,
            counted(count_crops(counts, "kept"), "patch"),
            ", ".join(f"{number} {reason}" for reason, number in left_out.items() if number),
        )
        groups.append(_column([*(_label(line, width) for line in lines), _flow(tiles[group], width)]))
    parts = [_label(title, _WIDTH_PX, _TITLE_PX)]
    parts += [_label(line, _WIDTH_PX) for line in report.summary().splitlines()]
    parts.append(_flow(groups, _WIDTH_PX))
    squares = _cut_squares(report, images)
    for reason, meaning in _MEANING.items():
        shown = []
        for example in report.examples:
            if example.reason == reason:
                width = len(example.squares) * (_TILE_PX + _GAP_PX)
                pair = _flow([_tile(squares[square]) for square in example.squares], width)
                shown.append(_column([pair, _label(example.square.source, width)]))
        if shown:
            heading = f"left out as {reason}: {report.total(reason)}, of which {len(shown)} are shown ({meaning})"
            parts += [_label(heading, _WIDTH_PX, _TITLE_PX), _flow(shown, _WIDTH_PX)]
    return _column(parts)


def _cut_squares(report: TextureReport, images: Mapping[str, TextureImage]) -> dict[Square, NDArray[np.uint8]]:
    """Cut the squares of all examples out of their images; each image is read once."""
    squares: dict[str, set[Square]] = defaultdict(set)
    for square in chain.from_iterable(example.squares for example in report.examples):
        squares[square.source].add(square)
    cut: dict[Square, NDArray[np.uint8]] = {}
    for source, of_image in squares.items():
        image = pixels_of(images[source])
        cut |= {square: cut_crop(image, square, report.patch_px) for square in of_image}
    return cut


def _tile(pixels: NDArray[np.uint8], text: str = "") -> Image.Image:
    image = Image.fromarray(pixels)
    image.thumbnail((_TILE_PX, _TILE_PX), Image.Resampling.BOX)
    # The stroke is there so that the text can be read on any patch.
    at, font = (4, image.height - _LINE_PX), ImageFont.load_default(_TEXT_PX)
    ImageDraw.Draw(image).text(at, text, fill=_ON_TILE, font=font, stroke_width=1, stroke_fill=_INK)
    return image


def _label(text: str, width_px: int, size_px: int = _TEXT_PX) -> Image.Image:
    """Draw a line of text; its beginning is left out where it is too long, as the ends of names tell more."""
    font, text = ImageFont.load_default(size_px), printable(text)
    while font.getlength(text) > width_px:
        text = f"...{text.removeprefix('...')[1:]}"
    image = Image.new("RGB", (width_px, size_px + 4), _PAPER)
    ImageDraw.Draw(image).text((0, 0), text, fill=_INK, font=font)
    return image


def _column(images: Sequence[Image.Image]) -> Image.Image:
    """Stack images."""
    sheet = Image.new("RGB", (max(each.width for each in images), sum(each.height for each in images)), _PAPER)
    top = 0
    for each in images:
        sheet.paste(each, (0, top))
        top += each.height
    return sheet


def _flow(images: Sequence[Image.Image], width_px: int) -> Image.Image:
    """Put images beside each other, in as many rows as they need."""
    places, x, y, height = [], 0, 0, 0
    for each in images:
        if x + each.width > width_px:
            x, y = 0, y + height
            height = 0
        places.append((x, y))
        x, height = x + each.width + _GAP_PX, max(height, each.height + _GAP_PX)
    sheet = Image.new("RGB", (width_px, y + height), _PAPER)
    for each, place in zip(images, places, strict=True):
        sheet.paste(each, place)
    return sheet
