"""An atlas as an entry of the cache, and back."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from semisynth_gl.cache.store import Entry
from semisynth_gl.errors import Skipped
from semisynth_gl.textures.atlas import Atlas, CropCount, LeftOut, Patch, Square, TextureReport
from semisynth_gl.textures.images import OUT_OF_MEMORY

_SKIPPED = "images_skipped"


def packed_atlas(atlas: Atlas, images: Sequence[Path]) -> Entry | None:
    """Turn an atlas into an entry.

    Args:
        atlas: the atlas.
        images: what it was built from; the entry tells them by their numbers, so that the folder may move.

    Returns:
        The entry; None where an image was left out for a reason that may not hold the next time.
    """
    skipped = atlas.report.images_skipped
    if any(each.reason == OUT_OF_MEMORY or str(each.path) in each.reason for each in skipped):
        return None
    number = {path: index for index, path in enumerate(images)}
    report = asdict(atlas.report) | {_SKIPPED: [[number[each.path], each.reason] for each in skipped]}
    values = {"patches": [asdict(patch) for patch in atlas.patches], "report": report}
    return Entry(values, {"layers": atlas.layers})


def unpacked_atlas(entry: Entry, images: Sequence[Path]) -> Atlas:
    """Turn an entry back into the atlas that it was made from; for ``images`` see `packed_atlas`."""
    report = entry.values["report"]
    whole = {
        _SKIPPED: tuple(Skipped(images[index], reason) for index, reason in report[_SKIPPED]),
        "too_small": tuple(report["too_small"]),
        "counts": tuple(CropCount(**count) for count in report["counts"]),
        "examples": tuple(
            LeftOut(reason, Square(*square), like and Square(*like)) for reason, square, like in report["examples"]
        ),
    }
    return Atlas(
        entry.arrays["layers"],
        tuple(Patch(**patch) for patch in entry.values["patches"]),
        TextureReport(**report | whole),
    )
