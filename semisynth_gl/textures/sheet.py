"""The sheet of patches: what a network will see, and what was left out of the photographs and why."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from semisynth_gl.textures.atlas import REASONS, Atlas, CropCount, Patch, Reason, Square, TextureReport
from semisynth_gl.textures.crops import CropBox, cut_crop
from semisynth_gl.textures.images import read_image

_WIDTH_PX = 1600
_TILE_PX = 72
_GAP_PX = 4
_MARGIN_PX = 12
_BETWEEN_PX = 12
_STEP_PX = _TILE_PX + _GAP_PX
_COLUMNS = (_WIDTH_PX - 2 * _MARGIN_PX + _GAP_PX) // _STEP_PX
# A group with fewer patches is as wide as its label needs.
_LEAST_COLUMNS = 3
_TEXT_PX, _TITLE_PX = 11, 15
_LINE_PX = 15
_MOST_NAMED = 12

_PAPER, _INK, _FAINT = (250, 250, 248), (30, 30, 30), (110, 110, 110)
_FLAT_FRAME = (230, 130, 20)
_ON_TILE = (255, 255, 255)

_MEANING: Mapping[Reason, str] = {
    "flat": "hardly any texture: textures.min_texture, textures.flat_share",
    "blurred": "out of focus or enlarged: textures.min_sharpness",
    "duplicate": "each beside the crop that it hardly differs from: textures.min_difference",
}


def draw_texture_sheet(atlas: Atlas, files: Mapping[str, Path], title: str) -> Image.Image:
    """Draw all patches by the image that they come from, and below them examples of what was left out.

    Each patch is shown whole, reduced to a tile, its scale (image pixels per patch pixel) in the corner where it is not
    1, and flat ones in an orange frame. Of image sequences the first frame is shown.

    Args:
        atlas: with its report.
        files: the images by their names in the atlas; none where patches are procedural.
        title: shown on top.
    """
    page = _Page()
    page.text(_MARGIN_PX, title, size=_TITLE_PX)
    page.feed(_TITLE_PX + 8)
    for line in atlas.report.summary().splitlines():
        page.text(_MARGIN_PX, line, colour=_FAINT)
        page.feed(_LINE_PX)
    page.feed(8)
    _draw_groups(page, atlas)
    _draw_left_out(page, atlas.report, files)
    return page.drawn()


def scale_names(report: TextureReport) -> dict[int, str]:
    """Return the scale of each side of squares that occurs, such as ``{256: "1x", 512: "2x"}``, by side."""
    return {side: f"{side / report.patch_px:g}x" for side in sorted({count.side_px for count in report.counts})}


def group_of(source: str) -> str:
    """Return what patches are put together by: their image, or of procedural ones their kind."""
    return source.rsplit("/", 1)[0] if source.startswith("procedural/") else source


def printable(name: str) -> str:
    """Return a name in one line: names of files may hold line breaks, and bytes that are no text."""
    return "".join(letter if letter.isprintable() else "?" for letter in name)


def grouped_counts(report: TextureReport) -> dict[str, list[CropCount]]:
    """Return the counts of each group, in their order."""
    groups: dict[str, list[CropCount]] = defaultdict(list)
    for count in report.counts:
        groups[group_of(count.source)].append(count)
    return dict(groups)


@dataclass(slots=True)
class _Page:
    """What is drawn where, from top to bottom; the height is known at the end."""

    y_px: int = _MARGIN_PX
    _tiles: list[tuple[int, int, Image.Image]] = field(default_factory=list)
    _texts: list[tuple[int, int, str, int, tuple[int, int, int]]] = field(default_factory=list)
    _frames: list[tuple[int, int]] = field(default_factory=list)

    def feed(self, height_px: int) -> None:
        self.y_px += height_px

    def text(
        self, x_px: int, text: str, *, down_px: int = 0, size: int = _TEXT_PX, colour: tuple[int, int, int] = _INK
    ) -> None:
        self._texts.append((x_px, self.y_px + down_px, printable(text), size, colour))

    def tile(self, x_px: int, pixels: NDArray[np.uint8], *, down_px: int = 0, framed: bool = False) -> None:
        image = Image.fromarray(pixels)
        image.thumbnail((_TILE_PX, _TILE_PX), Image.Resampling.BOX)
        self._tiles.append((x_px, self.y_px + down_px, image))
        if framed:
            self._frames.append((x_px, self.y_px + down_px))

    def drawn(self) -> Image.Image:
        sheet = Image.new("RGB", (_WIDTH_PX, self.y_px + _MARGIN_PX), _PAPER)
        draw = ImageDraw.Draw(sheet)
        for x, y, image in self._tiles:
            sheet.paste(image, (x, y))
        for x, y in self._frames:
            draw.rectangle((x, y, x + _TILE_PX - 1, y + _TILE_PX - 1), outline=_FLAT_FRAME, width=3)
        for x, y, text, size, colour in self._texts:
            stroke = int(colour == _ON_TILE)  # so that it can be read on any patch
            font = ImageFont.load_default(size)
            draw.text((x, y), text, fill=colour, font=font, stroke_width=stroke, stroke_fill=_INK)
        return sheet


def _draw_groups(page: _Page, atlas: Atlas) -> None:
    """Let groups flow from left to right, each a label above its patches."""
    patches: dict[str, list[Patch]] = defaultdict(list)
    for patch in atlas.patches:
        patches[group_of(patch.source)].append(patch)
    scales = scale_names(atlas.report)
    x, height = _MARGIN_PX, 0
    for group, counts in grouped_counts(atlas.report).items():
        shown = patches[group]
        columns = min(max(len(shown), _LEAST_COLUMNS), _COLUMNS)
        width = columns * _STEP_PX - _GAP_PX
        if x + width > _WIDTH_PX - _MARGIN_PX:
            page.feed(height)
            x, height = _MARGIN_PX, 0
        lines = (group, _kept_line(counts, scales), _left_out_line(counts))
        for number, line in enumerate(lines):
            fitting = _fitting(line, width, keep_end=number == 0)
            page.text(x, fitting, down_px=number * _LINE_PX, colour=_FAINT if number else _INK)
        top = len(lines) * _LINE_PX + 2
        for number, patch in enumerate(shown):
            row, place = divmod(number, columns)
            flat = patch.texture < atlas.report.min_texture
            tile_x, down = x + place * _STEP_PX, top + row * _STEP_PX
            page.tile(tile_x, atlas.layers[patch.first_layer, ..., :3], down_px=down, framed=flat)
            if patch.side_px != atlas.report.patch_px:
                page.text(tile_x + 4, scales[patch.side_px], down_px=down + _TILE_PX - _LINE_PX, colour=_ON_TILE)
        rows = max(-(-len(shown) // columns), 1)
        height = max(height, top + rows * _STEP_PX + 10)
        x += width + _GAP_PX + _BETWEEN_PX
    page.feed(height)


def _kept_line(counts: Sequence[CropCount], scales: Mapping[int, str]) -> str:
    kept = {side: sum(count.kept for count in counts if count.side_px == side) for side in scales}
    parts = ", ".join(f"{number} at {scales[side]}" for side, number in kept.items() if number)
    flat = sum(count.kept_flat for count in counts)
    total = sum(kept.values())
    return f"{total} {'patch' if total == 1 else 'patches'}" + (f": {parts}" if parts else "") + (
        f"; {flat} flat" if flat else ""
    )  # fmt: skip


def _left_out_line(counts: Sequence[CropCount]) -> str:
    reasons = (*REASONS, "surplus")
    left_out = {reason: sum(getattr(count, reason) for count in counts) for reason in reasons}
    parts = ", ".join(f"{number} {reason}" for reason, number in left_out.items() if number)
    return f"left out: {parts}" if parts else ""


def _draw_left_out(page: _Page, report: TextureReport, files: Mapping[str, Path]) -> None:
    totals = {"flat": report.crops_flat, "blurred": report.crops_blurred, "duplicate": report.crops_duplicate}
    pixels = _Squares(report, files)
    for reason in REASONS:
        examples = [example for example in report.examples if example.reason == reason]
        if not examples:
            continue
        page.feed(8)
        page.text(
            _MARGIN_PX,
            f"left out as {reason}: {totals[reason]}, of which {len(examples)} are shown ({_MEANING[reason]})",
            size=13,
        )
        page.feed(20)
        x = _MARGIN_PX
        height = 0
        for example in examples:
            squares = [example.square] if example.like is None else [example.like, example.square]
            if x + len(squares) * _STEP_PX > _WIDTH_PX - _MARGIN_PX:
                page.feed(height)
                x = _MARGIN_PX
            for number, square in enumerate(squares):
                page.tile(x + number * _TILE_PX, pixels.of(square))
                name = _fitting(square.source, _TILE_PX - 2, keep_end=True)
                page.text(x + number * _TILE_PX, name, down_px=_TILE_PX + 1, colour=_FAINT)
            height = _STEP_PX + _LINE_PX
            x += len(squares) * _TILE_PX + 2 * _GAP_PX
        page.feed(height)
    if report.too_small:
        shown = report.too_small[:_MOST_NAMED]
        more = f" and {report.images_too_small - len(shown)} more" if len(shown) < report.images_too_small else ""
        page.feed(8)
        page.text(
            _MARGIN_PX, f"images smaller than a patch ({report.patch_px} pixels): {report.images_too_small}", size=13
        )
        page.feed(20)
        for number, source in enumerate(shown):
            if source in files:
                page.tile(_MARGIN_PX + number * _STEP_PX, read_image(files[source]))
                name = _fitting(source, _TILE_PX, keep_end=True)
                page.text(_MARGIN_PX + number * _STEP_PX, name, down_px=_TILE_PX + 1, colour=_FAINT)
        page.feed(_STEP_PX + _LINE_PX)
        if more:
            page.text(_MARGIN_PX, more, colour=_FAINT)
            page.feed(_LINE_PX)


class _Squares:
    """Squares of images, as patches; each image is read once."""

    def __init__(self, report: TextureReport, files: Mapping[str, Path]) -> None:
        self._patch_px = report.patch_px
        wanted: dict[str, set[Square]] = defaultdict(set)
        for example in report.examples:
            for square in (example.square, example.like):
                if square is not None:
                    wanted[square.source].add(square)
        self._pixels: dict[Square, NDArray[np.uint8]] = {}
        for source, squares in wanted.items():
            image = read_image(files[source])
            for square in squares:
                self._pixels[square] = cut_crop(image, CropBox(*square[1:]), self._patch_px)

    def of(self, square: Square) -> NDArray[np.uint8]:
        return self._pixels[square]


def _fitting(text: str, width_px: int, *, keep_end: bool = False) -> str:
    """Shorten a text to a width; of names the end tells most."""
    font = ImageFont.load_default(_TEXT_PX)
    text = printable(text)
    shown = text
    while shown and font.getlength(shown if shown == text else f"{shown}...") > width_px:
        shown = shown[1:] if keep_end else shown[:-1]
    if shown == text:
        return text
    return f"...{shown}" if keep_end else f"{shown}..."
