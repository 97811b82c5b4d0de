"""Predictions judged without truth: the share of left disparities that the right view's disparities do not confirm."""

from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.disparity_map import MAP_EXTENSIONS, is_disparity_map, read_disparity_map
from semisynth_gl.inputs.errors import InputError, counted, no_folder
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.judge.protocol import shown_size

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
    lefts, rights = _maps("predictions", predictions), _maps("predictions_right", predictions_right)
    missing = sorted(lefts.keys() ^ rights.keys())
    if missing:
        side = "right" if missing[0] in lefts else "left"
        raise InputError(
            f"{counted(len(missing), 'pair')} with a prediction for only one view: {missing[0]} has none for the "
            f"{side} view, for example; expected the same names in both folders"
        )
    images = []
    for name in sorted(lefts):
        maps = (read_disparity_map(files[name]) for files in (lefts, rights))
        try:
            share = unconfirmed(*maps)
        except InputError as error:
            raise InputError(f"{lefts[name]}: {error}") from None
        images.append({"name": name, "left": str(lefts[name]), "right": str(rights[name]), "unconfirmed": share})
    mean = float(np.mean([image["unconfirmed"] for image in images]))
    return {"confirmed_px": CONFIRMED_PX, "pairs": len(images), "mean": {"unconfirmed": mean}, "images": images}


def _maps(name: str, folder: str | PathLike[str]) -> dict[str, Path]:
    """Return the disparity maps of a folder and its subfolders, by their relative paths without extension."""
    root = expanded(fspath(folder))
    if not root.is_dir():
        raise no_folder(root, name)
    maps: dict[str, Path] = {}
    for path in sorted(path for path in root.rglob("*") if path.suffix.lower() in MAP_EXTENSIONS and path.is_file()):
        stem = path.relative_to(root).with_suffix("").as_posix()
        if not is_disparity_map(path):
            continue
        if stem in maps:
            raise InputError(
                f"{folder}: {maps[stem].name} and {path.name} are for one pair: keep one file", argument=name
            )
        maps[stem] = path
    if not maps:
        raise InputError(f"{folder} has no disparity map: expected {', '.join(MAP_EXTENSIONS)}", argument=name)
    return maps
