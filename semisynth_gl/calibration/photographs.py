"""Reads the sizes of photographs, and compares them with a calibration's."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from semisynth_gl.calibration.kinds import Size
from semisynth_gl.inputs.errors import InputError, abbreviate, counted
from semisynth_gl.textures.images import ImageError, stored_size

_SIZES_SHOWN = 3


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
    if not photographs or set(photographs) & set(wanted):
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
