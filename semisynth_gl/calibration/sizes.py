"""Sizes of images and photographs."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from semisynth_gl.calibration.tree import Array
from semisynth_gl.inputs.errors import InputError, abbreviate, counted
from semisynth_gl.textures.images import ImageError, stored_size

# Farther from the centre than this fraction of the side, a principal point may belong to a different image size.
_NEAR_CENTRE = 0.1
_SIZES_SHOWN = 3


class ImageSize(NamedTuple):
    """Size of an image, pixels."""

    width_px: int
    height_px: int

    def __str__(self) -> str:
        return f"{self.width_px} x {self.height_px}"

    def scaled(self, scale: float) -> "ImageSize":
        """Return the size times a factor, rounded to whole pixels."""
        return ImageSize(*(max(1, int(side * scale + 0.5)) for side in self))


def upright(size: ImageSize, matrices: Sequence[Array]) -> ImageSize:
    """Return the size; width and height are swapped if the principal points of K or P fit only the swapped size.

    They do if one is far from the centre of images of ``size``, and all are near the centre of swapped images.
    """

    def distance(sides: ImageSize) -> float:
        return max((float(abs(m[k, 2] / side - 0.5)) for m in matrices for k, side in enumerate(sides)), default=0.0)

    swapped = ImageSize(size.height_px, size.width_px)
    far = distance(size)
    return swapped if far > _NEAR_CENTRE and distance(swapped) <= min(_NEAR_CENTRE, far / 2) else size


def photograph_sizes(images: Sequence[Path]) -> list[ImageSize]:
    """Return the sizes in the headers of photographs; files that cannot be read are skipped."""
    sizes = list[ImageSize]()
    for path in images:
        with suppress(ImageError):
            sizes.append(ImageSize(*stored_size(path)[::-1]))
    return sizes


def majority_size(photographs: Sequence[ImageSize], scale: float = 1.0) -> ImageSize | None:
    """Return the size, divided by ``scale``, that more than half of the photographs have; None if no size does."""
    usual = (size for size, count in Counter(photographs).items() if 2 * count > len(photographs))
    return next((size.scaled(1 / scale) for size in usual), None)


def check_sizes(photographs: Sequence[ImageSize], calibrated: ImageSize, scale: float = 1.0) -> None:
    """Raise InputError if there are photographs, but none has the calibrated size times ``scale``."""
    expected = calibrated.scaled(scale)
    if not photographs or expected in photographs:
        return
    sizes = [size for size, _ in Counter(photographs).most_common()]
    there, fitting = abbreviate([*map(str, sizes)], _SIZES_SHOWN), sizes[0].width_px / calibrated.width_px
    reduced = f"If they are reduced, give --scale {fitting:.6g}; if" if calibrated.scaled(fitting) == sizes[0] else "If"
    raise InputError(
        f"the calibration is for images of {expected}, but none of {counted(len(photographs), 'photograph')} has that "
        f"size: they have {there}. {reduced} a different camera took them, give --other-camera",
        argument="images",
    )
