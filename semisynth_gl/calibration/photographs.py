"""Checks of the user's photographs: whether they fit the calibration, and which splits they are too few for."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from semisynth_gl.calibration.arrays import Size
from semisynth_gl.config.dataset_sections import SplitsSection
from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.errors import InputError, abbreviate, counted
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.textures.images import ImageError, read_image, stored_size
from semisynth_gl.textures.prepare import share_photographs

_SIZES_SHOWN = 3
# Largest side of large patches, px. Two dozen patches of this side take 100 MB.
_LARGEST_SIDE = 1024
_SMALLEST_PATCH = 16
# A cropped mode of a camera leaves at least this share of a side.
_LEAST_OF_SIDE = 0.5
_ROUND_SCALES = tuple(sorted({part / whole for whole in range(2, 9) for part in (1, 2, 3)} | {2.0, 4.0}))


def photograph_sizes(images: Sequence[Path]) -> list[Size]:
    """Return the sizes in the headers of photographs; files that cannot be read are left out."""
    sizes = list[Size]()
    for path in images:
        with suppress(ImageError):
            height, width = stored_size(path)
            sizes.append(Size(width, height))
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


def check_sizes(photographs: Sequence[Size], calibrated: Sequence[Size], scale: float | None = None) -> int:
    """Count the photographs whose size equals a calibrated size, which ``scale`` multiplies first if it is given.

    Raises InputError, with advice, where there are photographs but none of them has such a size.
    """
    sizes, wanted = Counter(photographs), [size.scaled(scale or 1) for size in calibrated]
    fitting = sum(count for size, count in sizes.items() if size in wanted)
    if fitting or not sizes:
        return fitting
    better = _scale_that_fits(sizes, calibrated)
    if better is None:
        advice = "no scale gives even half of them a calibrated size: give the calibration of these images; or, if"
    elif better == 1:
        advice = "without a scale they fit; or, if"
    else:
        advice = f"if the photographs are the rig's images reduced or enlarged, give the scale {better:.6g}; if"
    of_scale = "" if scale is None else f" times {scale:g}"
    raise InputError(
        f"the calibration is for images of {_listed(wanted)}{of_scale}, but of "
        f"{counted(sizes.total(), 'photograph')} none has that size: they have {_listed(photographs)}; {advice} "
        "they were taken with another camera, say so (other_camera)"
    )


def centre_crop(photographs: Sequence[Size], calibrated: Sequence[Size], scale: float | None) -> Size | None:
    """Return the part of calibrated images, px, that a cropped mode of the camera leaves; None without a sign of one.

    The sign is that no photograph has a calibrated size, and most have one that is as wide, or as high, and less in the
    other direction. ``scale`` multiplies calibrated sizes.
    """
    whole, *others = set(calibrated)
    seen = whole.scaled(scale or 1)
    if others or not photographs or seen in photographs:
        return None
    part, count = Counter(photographs).most_common(1)[0]
    shares = sorted(own / side for own, side in zip(part, seen, strict=True))
    if 2 * count <= len(photographs) or not _LEAST_OF_SIDE <= shares[0] < shares[1] == 1:
        return None
    sides = (
        side if own == all_px else round(own / (scale or 1))
        for side, own, all_px in zip(whole, part, seen, strict=True)
    )
    crop = Size(*sides)
    return crop if crop.scaled(scale or 1) == part else None


def patch_sides(photographs: Sequence[Size], width_px: int) -> tuple[int, int]:
    """Return the sides of patches and of large patches, px.

    Patches have the usual side, or the largest power of two that fits into half of the photographs. The side of large
    patches is the median over photographs of the shorter side, but at most 1024 and at most the width of the rig's
    images, ``width_px``.
    """
    sides = sorted(map(min, photographs))
    median = sides[len(sides) // 2] if sides else 0
    usual = TexturesSection().patch_px
    side = usual if median >= usual or median < _SMALLEST_PATCH else 1 << median.bit_length() - 1
    return side, max(min(median, width_px, _LARGEST_SIDE), side)


def impossible_splits(subjects: int) -> list[str]:
    """Return the splits that have too few subjects, such as ``["test"]`` or ``["both validation and test"]``."""

    def enough(*splits: SplitName) -> bool:
        try:
            share_photographs(SplitsSection().split("train", splits, 0), [()] * subjects, "photographs")
        except InputError:
            return False
        return True

    single: list[SplitName] = ["validation", "test"]
    failing = [str(name) for name in single if not enough(name)]
    return failing or ([] if enough(*single) else ["both validation and test"])


def _scale_that_fits(sizes: Counter[Size], calibrated: Sequence[Size]) -> float | None:
    """Return a scale at which half of the photographs have a calibrated size, preferably a round one; None without."""
    for scale in (1.0, *_ROUND_SCALES, *(size[0] / rig_size[0] for size in sizes for rig_size in calibrated)):
        if 2 * sum(sizes[size] for size in {rig_size.scaled(scale) for rig_size in calibrated}) >= sizes.total():
            return scale
    return None


def _listed(sizes: Sequence[Size]) -> str:
    return abbreviate([str(size) for size, _ in Counter(sizes).most_common()], _SIZES_SHOWN)
