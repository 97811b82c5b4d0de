"""Reports the outcome of every image and crop: counts, a summary, and the sheet of patches."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from semisynth_gl.inputs.errors import SkippedFile, counted
from semisynth_gl.textures.image_files import printable
from semisynth_gl.textures.subjects import of_subjects, patch_chances

Rejection = Literal["flat", "blurred", "duplicate", "surplus"]
Outcome = Literal["kept", Rejection]
REJECTIONS: tuple[Rejection, ...] = get_args(Rejection)
_OUTCOMES: tuple[Outcome, ...] = ("kept", *REJECTIONS)

# The summary has a note if there are fewer subjects than this.
_FEW = 4

_WIDTH_PX, _TILE_PX, _GAP_PX, _TEXT_PX = 1600, 72, 4, 11
# Minimum width of a label, in tiles.
_LEAST_COLUMNS = 3
_PAPER, _INK = (250, 250, 248), (30, 30, 30)


@dataclass(frozen=True, slots=True)
class CropCount:
    """Numbers of an image's crops of one size by their `Outcome`; a square of a clip is one crop."""

    source: str
    side_px: int
    kept: int = 0
    flat: int = 0
    blurred: int = 0
    duplicate: int = 0
    surplus: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureReport:
    """The outcome of all images and their crops. A frame of an image sequence counts as an image.

    Attributes:
        images_used: images with at least one patch in the atlas.
        images_unused: images that were read, but have no patch in the atlas.
        images_too_small: images narrower or lower than a patch.
        images_skipped: images that could not be used, and why.
        images_not_opened: images that were not needed, because there were enough patches.
        counts: one entry for each image and each side of its squares, in this order.
        subjects: name of the subject by the image's name, only for subjects that several images share; see `Patch`.
        patch_px: side of a patch.
    """

    images_used: int
    images_unused: int = 0
    images_too_small: int = 0
    images_skipped: tuple[SkippedFile, ...] = ()
    images_not_opened: int = 0
    counts: tuple[CropCount, ...]
    subjects: Mapping[str, str] = field(default_factory=dict)
    patch_px: int

    @property
    def surface_shares(self) -> dict[str, float]:
        """The expected share of the surfaces that show an image, by the image's name, sum 1, without large patches."""
        kept = [count.source for count in self.counts for _ in range(count.kept)]
        chances = patch_chances([self.subjects.get(source, source) for source in kept])
        shares: dict[str, float] = defaultdict(float)
        for source, chance in zip(kept, chances.tolist(), strict=True):
            shares[source] += chance
        return dict(shares)

    def total(self, outcome: Outcome) -> int:
        """Return the number of crops with an outcome, over all images."""
        return count_crops(self.counts, outcome)

    @property
    def grouped_counts(self) -> dict[str, list[CropCount]]:
        """The counts grouped by image, or by kind of procedural patch, in their order."""
        groups: dict[str, list[CropCount]] = defaultdict(list)
        for count in self.counts:
            groups[_group(count.source)].append(count)
        return dict(groups)

    def summary(self) -> str:
        """Return a few lines on patches, rejected crops, and unused images."""
        shown = len({self.subjects.get(count.source, count.source) for count in self.counts if count.kept})
        shared = of_subjects(self.images_used, shown) if self.subjects else ""
        rejected = ", ".join(f"{self.total(reason)} {reason}" for reason in REJECTIONS)
        patches, used = counted(self.total("kept"), "patch"), counted(self.images_used, "image")
        size = f"{self.patch_px} x {self.patch_px} pixels"
        lines = [f"{patches} of {size} from {used}{shared}; crops left out: {rejected}"]
        if shown < _FEW:
            lines.append("note: these are few subjects: give a few dozen photographs")
        unused = {
            "not usable": len(self.images_skipped),
            f"smaller than {self.patch_px} pixels": self.images_too_small,
            "without a patch in the atlas": self.images_unused,
            "not opened, enough patches had been found": self.images_not_opened,
        }
        if any(unused.values()):
            lines.append(f"images left out: {'; '.join(f'{count} {why}' for why, count in unused.items() if count)}")
        return "\n".join([*lines, *(f"not usable: {skipped}" for skipped in self.images_skipped)])


def count_crops(counts: Collection[CropCount], outcome: Outcome, side_px: int | None = None) -> int:
    """Return the number of crops with an outcome, of one side or of all sides."""
    return sum(getattr(count, outcome) for count in counts if side_px in (None, count.side_px))


def _group(source: str) -> str:
    return source.rsplit("/", 1)[0] if source.startswith("procedural/") else source


def make_texture_sheet(
    report: TextureReport, patches: Iterable[tuple[str, NDArray[np.uint8]]], title: str
) -> Image.Image:
    """Make an image of all patches, grouped by the image that they are cut from.

    Args:
        report: the report of the atlas.
        patches: each patch's image name and pixels, (P, P, 3) uint8.
        title: the sheet's first line.
    """
    tiles: dict[str, list[Image.Image]] = defaultdict(list)
    for source, pixels in patches:
        tile = Image.fromarray(pixels)
        tile.thumbnail((_TILE_PX, _TILE_PX), Image.Resampling.BOX)
        tiles[_group(source)].append(tile)
    parts = [_label(line, _WIDTH_PX) for line in (title, *report.summary().splitlines())]
    groups = []
    for group, counts in report.grouped_counts.items():
        columns = min(max(len(tiles[group]), _LEAST_COLUMNS), _WIDTH_PX // (_TILE_PX + _GAP_PX))
        numbers = ((count_crops(counts, outcome), outcome) for outcome in _OUTCOMES)
        lines = (group, ", ".join(f"{number} {outcome}" for number, outcome in numbers if number))
        width = columns * (_TILE_PX + _GAP_PX)
        groups.append(_flow([*(_label(line, width - _GAP_PX) for line in lines), *tiles[group]], width))
    return _flow([*parts, *groups], _WIDTH_PX)


def _label(text: str, width_px: int) -> Image.Image:
    """Return an image of a line of text. A long text loses its beginning, since names differ more at their ends."""
    font, text = ImageFont.load_default(_TEXT_PX), printable(text)
    while font.getlength(text) > width_px:
        text = f"...{text.removeprefix('...')[1:]}"
    image = Image.new("RGB", (width_px, _TEXT_PX + 4), _PAPER)
    ImageDraw.Draw(image).text((0, 0), text, fill=_INK, font=font)
    return image


def _flow(images: Sequence[Image.Image], width_px: int) -> Image.Image:
    """Arrange images in as many rows as they need."""
    places, x, y, height = [], 0, 0, 0
    for each in images:
        if x + each.width > width_px:
            x, y, height = 0, y + height, 0
        places.append((x, y))
        x, height = x + each.width + _GAP_PX, max(height, each.height + _GAP_PX)
    sheet = Image.new("RGB", (width_px, y + height), _PAPER)
    for each, place in zip(images, places, strict=True):
        sheet.paste(each, place)
    return sheet
