"""Sizes of images: those that a calibration states, and those of photographs."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from semisynth_gl.calibration.kinds import are_numbers
from semisynth_gl.calibration.names import Entry, label_of
from semisynth_gl.calibration.tree import Array, FormatError, Name
from semisynth_gl.inputs.errors import InputError, abbreviate, counted
from semisynth_gl.textures.images import ImageError, stored_size

_LARGEST_SIDE_PX = 99_999
# A principal point farther from the centre than this, as a fraction of the side, may be that of another size.
_NEAR_CENTRE = 0.1
# Names of sizes, letters only.
_WIDTHS = ("width", "imagewidth", "imgwidth", "imagew", "w", "cols", "resx")
_HEIGHTS = ("height", "imageheight", "imgheight", "imageh", "h", "rows", "resy")
_SIZE = r"(image|img|im|imager|frame)?size|(image)?resolution|srect|s|wh|dimensions|(image|img)?shape|hw"
# Words in names of sizes of other things.
_OTHERS = "board|pattern|chess|checker|grid|tag|marker|roi|crop"
_SIZES_SHOWN = 3


class Size(NamedTuple):
    """Size of an image, pixels."""

    width_px: int
    height_px: int

    def __str__(self) -> str:
        return f"{self.width_px} x {self.height_px}"

    def scaled(self, scale: float) -> "Size":
        """Return the size times a factor, rounded to whole pixels."""
        return Size(*(max(1, int(side * scale + 0.5)) for side in self))


def stated_sizes(entries: Iterable[Entry], matrices: Sequence[Array], *, rectified: bool) -> list[Size]:
    """Return the different sizes of rectified or of raw images, `upright`; 0 x 0 is OpenCV's unknown size.

    Raises FormatError where a side is no number of pixels.
    """
    sides: dict[Name, list[float]] = {}
    for entry in entries:
        value = entry.value.ravel()
        if not are_numbers(value, 1, 2, 3, 4) or entry.has(_OTHERS) or entry.has("rect") != rectified:
            continue
        if value.size > 1 and re.fullmatch(_SIZE, entry.key):
            sides[entry.name] = value[:2].tolist()[:: -1 if entry.key.endswith(("shape", "hw")) else 1]
        elif value.size == 1 and entry.key in (*_WIDTHS, *_HEIGHTS):
            found = sides.setdefault((*entry.name[:-1], label_of(entry.name)), [0.0, 0.0])
            found[entry.key in _HEIGHTS] = float(value[0])
    for width, height in sides.values():
        if not all(0 <= side <= _LARGEST_SIDE_PX and side == int(side) for side in (width, height)):
            raise FormatError(f"expected a width and height of whole pixels, got {width:g} x {height:g}")
    sizes = (Size(int(width), int(height)) for width, height in sides.values() if width and height)
    return [*dict.fromkeys(upright(size, matrices) for size in sizes)]


def upright(size: Size, matrices: Sequence[Array]) -> Size:
    """Return the size, or with width and height swapped if the principal points of K or P say so.

    They do if they are far from the centre of such images, and near the centre of the turned ones.
    """

    def distance(sides: Size) -> float:
        return max((float(abs(m[k, 2] / side - 0.5)) for m in matrices for k, side in enumerate(sides)), default=0.0)

    turned = Size(size.height_px, size.width_px)
    far = distance(size)
    return turned if far > _NEAR_CENTRE and distance(turned) <= min(_NEAR_CENTRE, far / 2) else size


def photograph_sizes(images: Sequence[Path]) -> list[Size]:
    """Return the sizes in the headers of photographs; files that cannot be read are left out."""
    sizes = list[Size]()
    for path in images:
        with suppress(ImageError):
            sizes.append(Size(*stored_size(path)[::-1]))
    return sizes


def most_common_size(photographs: Sequence[Size]) -> Size | None:
    """Return the size that more than half of the photographs have; None if no size does."""
    return next((size for size, count in Counter(photographs).items() if 2 * count > len(photographs)), None)


def check_sizes(photographs: Sequence[Size], calibrated: Sequence[Size], scale: float = 1.0) -> None:
    """Raise InputError where there are photographs, but none of them has a calibrated size times ``scale``."""
    wanted = [size.scaled(scale) for size in calibrated]
    if not photographs or {*photographs} & {*wanted}:
        return
    sizes = [size for size, _ in Counter(photographs).most_common()]
    there, expected = (abbreviate([*dict.fromkeys(map(str, each))], _SIZES_SHOWN) for each in (sizes, wanted))
    fitting = sizes[0].width_px / calibrated[0].width_px
    raise InputError(
        f"the calibration is for images of {expected}, but none of {counted(len(photographs), 'photograph')} has that "
        f"size: they have {there}. If they are reduced, give a scale of {fitting:.6g}; if another camera took them, "
        "say so",
        argument="images",
    )
