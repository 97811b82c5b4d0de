"""Sizes of images that a calibration states, told by their names from sizes of boards and of parts of images."""

import re
from collections.abc import Iterable, Iterator, Sequence

from semisynth_gl.calibration.arrays import Size
from semisynth_gl.calibration.kinds import are_numbers, checked_size
from semisynth_gl.calibration.names import Entry, eye_of
from semisynth_gl.calibration.rig import turned_size_fault
from semisynth_gl.calibration.tree import Array, Name

# Names of a size, letters only.
_WIDTHS = ("width", "imagewidth", "imgwidth", "imagew", "w", "cols", "resx")
_HEIGHTS = ("height", "imageheight", "imgheight", "imageh", "h", "rows", "resy")
_SIZES = (
    *("size", "imagesize", "imgsize", "imsize", "imagersize", "framesize", "resolution", "imageresolution"),
    *("srect", "s", "wh", "dimensions", "shape", "imageshape", "imgshape", "hw"),
)
_HEIGHT_FIRST = ("shape", "hw")
# Words in names of sizes of other things.
_OTHERS = {"board", "pattern", "chessboard", "checkerboard", "chess", "grid", "tag", "marker", "roi", "crop"}


def stated_sizes(
    entries: Iterable[Entry], cameras: tuple[str, str] | None, matrices: Sequence[Array]
) -> tuple[list[Size], list[Size]]:
    """Return the sizes of rectified images, and those of raw ones.

    Args:
        entries: the arrays of a calibration.
        cameras: the left and the right camera by number or name, where others do not count; None for all.
        matrices: camera matrices; their principal points tell whether a shape begins with the height.

    Raises:
        FormatError: where a side is no number of pixels.
    """
    sizes: dict[bool, list[Size | None]] = {True: [], False: []}
    sides: dict[tuple[Name, str], dict[str, float]] = {}
    for entry in entries:
        key = re.sub(r"\(.*?\)|[^a-z]", "", entry.key.lower())
        of_rig = cameras is None or eye_of(entry.name) in {"", *cameras}
        if not of_rig or _OTHERS & set(entry.words) or not are_numbers(entry.value, 1, 2, 3, 4):
            continue
        if entry.value.size > 1 and key in _SIZES:
            sizes["rect" in entry.words] += _listed(entry.value, key, matrices)
        elif entry.value.size == 1 and key in (*_WIDTHS, *_HEIGHTS):
            side = "width" if key in _WIDTHS else "height"
            sides.setdefault((entry.name[:-1], eye_of(entry.name)), {})[side] = float(entry.value.ravel()[0])
    sizes[False] += [checked_size(found["width"], found["height"]) for found in sides.values() if len(found) == 2]
    rectified, raw = ([size for size in sizes[key] if size is not None] for key in (True, False))
    return rectified, raw


def is_turned(size: Size, matrices: Sequence[Array]) -> bool:
    """Return whether the principal points of camera matrices say that a size is height and width."""
    return bool(matrices) and turned_size_fault(size, *matrices) is not None


def _listed(value: Array, key: str, matrices: Sequence[Array]) -> Iterator[Size | None]:
    """Yield the size that a list states, or the sizes of both cameras, as Basalt lists them."""
    # NumPy's shape begins with the height, unless a script wrote shape[::-1], and ends with the number of channels.
    shape = any(key.endswith(each) for each in _HEIGHT_FIRST)
    for first, second in (value if value.shape == (2, 2) else value.reshape(1, -1))[:, :2].tolist():
        size = checked_size(second, first) if shape else checked_size(first, second)
        yield Size(*reversed(size)) if shape and size is not None and is_turned(size, matrices) else size
