"""The sheet of patches: all patches of an atlas but the large ones, and examples of rejected crops by reason."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from semisynth_gl.inputs.errors import counted
from semisynth_gl.textures.atlas import Atlas, Patch
from semisynth_gl.textures.crop_report import (
    REASONS,
    REJECTIONS,
    CropCount,
    Reason,
    TextureReport,
    count_crops,
    patch_group,
)
from semisynth_gl.textures.crops import Square, cut_crop
from semisynth_gl.textures.image_files import printable
from semisynth_gl.textures.pictures import TextureImage, pixels_of

_WIDTH_PX = 1600
_TILE_PX = 72
_GAP_PX = 4
_MARGIN_PX = 12
_BETWEEN_PX = 12
_STEP_PX = _TILE_PX + _GAP_PX
_COLUMNS = (_WIDTH_PX - 2 * _MARGIN_PX + _GAP_PX) // _STEP_PX
# A group is at least this wide, so that its label has room.
_LEAST_COLUMNS = 3
_TEXT_PX, _TITLE_PX = 11, 15
_LINE_PX = 15
_MOST_NAMED = 12

_PAPER, _INK, _FAINT = (250, 250, 248), (30, 30, 30), (110, 110, 110)
_ON_TILE = (255, 255, 255)

_MEANING: Mapping[Reason, str] = {
    "flat": "hardly any texture: textures.min_texture",
    "blurred": "out of focus or enlarged: textures.min_sharpness",
    "duplicate": "each beside the crop that it hardly differs from: textures.min_difference",
}


def draw_texture_sheet(atlas: Atlas, images: Mapping[str, TextureImage], title: str) -> Image.Image:
    """Draw all patches but the large ones, grouped by image, and below them examples of rejected crops.

    Each patch is reduced to a tile, with its scale (image pixels per patch pixel) in the corner where it is not 1. A
    patch from an image sequence is shown by its first frame. ``images`` maps names in the atlas to images; it must have
    those of `TextureReport.named_images`.

    Raises ImageError where one of these images can no longer be read.
    """
    page = _Page()
    page.text(_MARGIN_PX, title, size=_TITLE_PX)
    page.feed(_TITLE_PX + 8)
    for line in atlas.report.summary().splitlines():
        page.text(_MARGIN_PX, line, colour=_FAINT)
        page.feed(_LINE_PX)
    page.feed(8)
    _draw_groups(page, atlas)
    _draw_rejected(page, atlas.report, images)
    return page.draw()


@dataclass(slots=True)
class _Page:
    """Tiles and texts with their places, collected from top to bottom; the height is known at the end."""

    y_px: int = _MARGIN_PX
    _tiles: list[tuple[int, int, Image.Image]] = field(default_factory=list)
    _texts: list[tuple[int, int, str, int, tuple[int, int, int]]] = field(default_factory=list)

    def feed(self, height_px: int) -> None:
        self.y_px += height_px

    def text(
        self, x_px: int, text: str, *, down_px: int = 0, size: int = _TEXT_PX, colour: tuple[int, int, int] = _INK
    ) -> None:
        self._texts.append((x_px, self.y_px + down_px, printable(text), size, colour))

    def tile(self, x_px: int, pixels: NDArray[np.uint8], *, down_px: int = 0) -> None:
        image = Image.fromarray(pixels)
        image.thumbnail((_TILE_PX, _TILE_PX), Image.Resampling.BOX)
        self._tiles.append((x_px, self.y_px + down_px, image))

    def draw(self) -> Image.Image:
        sheet = Image.new("RGB", (_WIDTH_PX, self.y_px + _MARGIN_PX), _PAPER)
        draw = ImageDraw.Draw(sheet)
        for x, y, image in self._tiles:
            sheet.paste(image, (x, y))
        for x, y, text, size, colour in self._texts:
            stroke = int(colour == _ON_TILE)  # so that it can be read on any patch
            font = ImageFont.load_default(size)
            draw.text((x, y), text, fill=colour, font=font, stroke_width=stroke, stroke_fill=_INK)
        return sheet


def _draw_groups(page: _Page, atlas: Atlas) -> None:
    """Draw groups from left to right, in rows, each as a label above its patches."""
    patches: dict[str, list[Patch]] = defaultdict(list)
    for patch in atlas.patches:
        if not patch.large:
            patches[patch_group(patch.source)].append(patch)
    scales = atlas.report.scale_names
    x, height = _MARGIN_PX, 0
    for group, counts in atlas.report.grouped_counts.items():
        shown = patches[group]
        columns = min(max(len(shown), _LEAST_COLUMNS), _COLUMNS)
        width = columns * _STEP_PX - _GAP_PX
        if x + width > _WIDTH_PX - _MARGIN_PX:
            page.feed(height)
            x, height = _MARGIN_PX, 0
        lines = (group, _kept_line(counts, scales), _rejected_line(counts))
        for number, line in enumerate(lines):
            fitting = _fitting(line, width, keep_end=number == 0)
            page.text(x, fitting, down_px=number * _LINE_PX, colour=_FAINT if number else _INK)
        top = len(lines) * _LINE_PX + 2
        for number, patch in enumerate(shown):
            row, place = divmod(number, columns)
            tile_x, down = x + place * _STEP_PX, top + row * _STEP_PX
            page.tile(tile_x, atlas.layers[patch.first_layer, ..., :3], down_px=down)
            if patch.side_px != atlas.report.patch_px:
                page.text(tile_x + 4, scales[patch.side_px], down_px=down + _TILE_PX - _LINE_PX, colour=_ON_TILE)
        rows = max(-(-len(shown) // columns), 1)
        height = max(height, top + rows * _STEP_PX + 10)
        x += width + _GAP_PX + _BETWEEN_PX
    page.feed(height)


def _kept_line(counts: Sequence[CropCount], scales: Mapping[int, str]) -> str:
    total = count_crops(counts, "kept")
    kept = {name: count_crops(counts, "kept", side) for side, name in scales.items()}
    parts = ", ".join(f"{number} at {name}" for name, number in kept.items() if number)
    return counted(total, "patch") + (f": {parts}" if parts else "")


def _rejected_line(counts: Sequence[CropCount]) -> str:
    numbers = {outcome: count_crops(counts, outcome) for outcome in REJECTIONS}
    parts = ", ".join(f"{number} {outcome}" for outcome, number in numbers.items() if number)
    return f"left out: {parts}" if parts else ""


def _draw_rejected(page: _Page, report: TextureReport, images: Mapping[str, TextureImage]) -> None:
    pixels = _read_squares(report, images)
    for reason in REASONS:
        examples = [example for example in report.examples if example.reason == reason]
        heading = f"left out as {reason}: {report.total(reason)}, of which {len(examples)} are shown"
        tiles = [[(square.source, pixels[square]) for square in example.squares] for example in examples]
        _draw_examples(page, f"{heading} ({_MEANING[reason]})", tiles)
    shown = report.too_small[:_MOST_NAMED]
    heading = f"images smaller than a patch ({report.patch_px} pixels): {len(report.too_small)}"
    _draw_examples(page, heading, [[(source, pixels_of(images[source]))] for source in shown if source in images])
    if len(shown) < len(report.too_small):
        page.text(_MARGIN_PX, f" and {len(report.too_small) - len(shown)} more", colour=_FAINT)
        page.feed(_LINE_PX)


def _draw_examples(page: _Page, heading: str, examples: Sequence[Sequence[tuple[str, NDArray[np.uint8]]]]) -> None:
    """Draw examples under a heading, each of one or more tiles with their names below."""
    if not examples:
        return
    page.feed(8)
    page.text(_MARGIN_PX, heading, size=13)
    page.feed(20)
    x = _MARGIN_PX
    for example in examples:
        if x + len(example) * _STEP_PX > _WIDTH_PX - _MARGIN_PX:
            page.feed(_STEP_PX + _LINE_PX)
            x = _MARGIN_PX
        for source, pixels in example:
            page.tile(x, pixels)
            page.text(x, _fitting(source, _TILE_PX - 2, keep_end=True), down_px=_TILE_PX + 1, colour=_FAINT)
            x += _TILE_PX
        x += 2 * _GAP_PX
    page.feed(_STEP_PX + _LINE_PX)


def _read_squares(report: TextureReport, images: Mapping[str, TextureImage]) -> dict[Square, NDArray[np.uint8]]:
    """Cut the squares of all examples out of their images; each image is read once."""
    squares: dict[str, set[Square]] = defaultdict(set)
    for square in chain.from_iterable(example.squares for example in report.examples):
        squares[square.source].add(square)
    pixels: dict[Square, NDArray[np.uint8]] = {}
    for source, image_squares in squares.items():
        image = pixels_of(images[source])
        pixels |= {square: cut_crop(image, square.box, report.patch_px) for square in image_squares}
    return pixels


def _fitting(text: str, width_px: int, *, keep_end: bool = False) -> str:
    """Shorten a text to a width, at its end or, for names, at its beginning."""
    font = ImageFont.load_default(_TEXT_PX)
    text = printable(text)
    shown = text
    while shown and font.getlength(shown if shown == text else f"{shown}...") > width_px:
        shown = shown[1:] if keep_end else shown[:-1]
    if shown == text:
        return text
    return f"...{shown}" if keep_end else f"{shown}..."
