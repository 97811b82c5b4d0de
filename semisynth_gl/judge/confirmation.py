"""Judges predictions without truth: the share of left disparities that the right view does not confirm."""

from os import PathLike, fspath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.inputs.errors import InputError, abbreviate
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.judge.protocol import shown_size
from semisynth_gl.judge.truth import disparity_maps

CONFIRMED_PX = 1.0
"""Largest difference at which the two disparities of a point confirm each other, px: the bound of bad-1."""


def unconfirmed(left: NDArray[np.float32], right: NDArray[np.float32]) -> float:
    """Return the share of a left view's pixels, in percent, whose disparity the right view does not confirm.

    A left pixel with disparity d is compared with the right view's pixel nearest to x - d. A pixel without a disparity
    counts as unconfirmed. A pixel whose point lies outside the right image does not count. Occluded pixels do count,
    since only a truth could tell them from wrong pixels; their share is about the same for every network.

    Args:
        left: (H, W) float32 px, predicted for the left view; not finite where there is no disparity.
        right: (H, W) float32 px, predicted for the right view; both views have disparities of x_left - x_right.

    Raises:
        InputError: where the sizes differ, or no disparity leads into the right image.
    """
    if left.shape != right.shape:
        raise InputError(f"the left view has {shown_size(left)}, the right one {shown_size(right)}: expected one size")
    known, width = np.isfinite(left), left.shape[1]
    columns = np.rint(np.arange(width) - np.where(known, left, 0)).astype(np.int64)
    inside = (columns >= 0) & (columns < width)
    if not (known & inside).any():
        raise InputError("no disparity leads into the right image: expected x_left - x_right in px, which is positive")
    there = np.take_along_axis(right, np.clip(columns, 0, width - 1), axis=1)
    with np.errstate(invalid="ignore"):
        confirmed = known & (np.abs(left - there) <= CONFIRMED_PX)
    return float(100 * (1 - np.mean(confirmed[inside])))


def evaluate_views(predictions: str | PathLike[str], predictions_right: str | PathLike[str]) -> dict[str, Any]:
    """Judge predictions for both views of some pairs, as ``semisynth-gl evaluate --pred-right`` does.

    Args:
        predictions: a folder with a .pfm, .npy or 16-bit .png file for each pair's left view, in it or in its
            subfolders.
        predictions_right: a folder with a file for each pair's right view, under the same name; the extension may
            differ.

    Returns:
        The content of ``--json``, in JSON's types: ``confirmed_px`` (see `CONFIRMED_PX`), the number of ``pairs``,
        ``mean`` with the mean of the pairs as ``unconfirmed``, and ``images`` with each pair's ``name``, its files
        ``left`` and ``right``, and ``unconfirmed`` in percent (see `unconfirmed`).

    Raises:
        InputError: where a folder does not exist or has no disparity map, a pair has no file or several files in a
            folder, or the sizes of a pair's maps differ.
        ReadError: where a file cannot be read.
    """
    lefts, rights = (
        {path.relative_to(folder).with_suffix("").as_posix(): path for path in disparity_maps(folder, argument)}
        for argument, folder in (
            ("predictions", expanded(fspath(predictions))),
            ("predictions_right", expanded(fspath(predictions_right))),
        )
    )
    if not lefts or lefts.keys() != rights.keys():
        alone = abbreviate(sorted(lefts.keys() ^ rights.keys()))
        raise InputError(f"expected disparity maps of the same names in both folders; in one are {alone or 'none'}")
    images = []
    for name in sorted(lefts):
        try:
            share = unconfirmed(read_disparity_map(lefts[name]), read_disparity_map(rights[name]))
        except InputError as error:
            raise InputError(f"{lefts[name]}: {error}") from None
        images.append({"name": name, "left": str(lefts[name]), "right": str(rights[name]), "unconfirmed": share})
    mean = float(np.mean([image["unconfirmed"] for image in images]))
    return {"confirmed_px": CONFIRMED_PX, "pairs": len(images), "mean": {"unconfirmed": mean}, "images": images}
