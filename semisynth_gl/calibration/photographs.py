"""What the photographs tell: sizes, whether they fit the calibration, and whether all of them are grey."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from semisynth_gl.calibration.kinds import Size
from semisynth_gl.inputs.errors import InputError, abbreviate, counted
from semisynth_gl.textures.images import ImageError, read_image, stored_size

_SIZES_SHOWN = 3


def photograph_sizes(images: Sequence[Path]) -> list[Size]:
    """Return the sizes in the headers of photographs; files that cannot be read are left out."""
    sizes = list[Size]()
    for path in images:
        with suppress(ImageError):
            sizes.append(Size(*stored_size(path)[::-1]))
    return sizes


def are_grey(images: Sequence[Path]) -> bool:
    """Return whether all readable photographs have one channel or three equal ones; False if none is readable."""
    seen = False
    for path in images:
        with suppress(ImageError):
            pixels = read_image(path)
            if not (pixels == pixels[..., :1]).all():
                return False
            seen = True
    return seen


def check_sizes(photographs: Sequence[Size], calibrated: Sequence[Size], scale: float | None = None) -> None:
    """Check that a photograph has a calibrated size, which ``scale`` multiplies if it is given.

    Raises InputError, with advice, where there are photographs but none of them has such a size.
    """
    wanted = [size.scaled(scale or 1) for size in calibrated]
    if not photographs or set(photographs) & set(wanted):
        return
    ((most, _),) = Counter(photographs).most_common(1)
    better = most.width_px / calibrated[0].width_px
    fits = calibrated[0].scaled(better) == most
    advice = f"give the scale {better:.6g}" if fits else "give the calibration of these images"
    raise InputError(
        f"the calibration is for images of {_listed(wanted)}{f' times {scale:g}' if scale else ''}, but none of "
        f"{counted(len(photographs), 'photograph')} has that size: they have {_listed(photographs)}: {advice}; or, if "
        "another camera took them, say so (other_camera)"
    )


def _listed(sizes: Sequence[Size]) -> str:
    return abbreviate([str(size) for size, _ in Counter(sizes).most_common()], _SIZES_SHOWN)
