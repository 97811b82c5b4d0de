"""Evaluates predictions pair by pair, against the truth or against predictions for the right views."""

from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.png import RGB8
from semisynth_gl.inputs.arguments import check_one_of
from semisynth_gl.inputs.errors import InputError, ReadError, abbreviate
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.judge.protocol import PROTOCOLS, PixelComparison, ProtocolName, shown_size
from semisynth_gl.judge.score import Sums, figures, mean_figures, tally
from semisynth_gl.judge.truth import disparity_maps, find_predictions, find_truth
from semisynth_gl.listener import Listener
from semisynth_gl.seeds.splits import SplitName

CONFIRMED_PX = 1.0
"""Maximum difference, px, between the disparities of a point in both views that confirm each other."""

# KITTI's colours of error maps, and the bounds between them, in multiples of the smallest error of an outlier.
_BOUNDS = np.array([1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, 16], np.float32)
_COLOURS = np.array(
    [
        *((49, 54, 149), (69, 117, 180), (116, 173, 209), (171, 217, 233), (224, 243, 248)),
        *((254, 224, 144), (253, 174, 97), (244, 109, 67), (215, 48, 39), (165, 0, 38)),
    ],
    np.uint8,
)
# The ten colours, the same colours at half brightness for occluded pixels, and black.
_PALETTE = np.concatenate([_COLOURS, _COLOURS // 2, np.zeros((1, 3), np.uint8)])


def evaluate(
    predictions: str | PathLike[str],
    truth: str | PathLike[str],
    protocol: ProtocolName | None = None,
    *,
    split: SplitName | None = None,
    maps: str | PathLike[str] | None = None,
    listener: Listener | None = None,
) -> dict[str, Any]:
    """Evaluate a folder of predictions, as ``semisynth-gl evaluate`` does.

    Args:
        predictions: a folder of .pfm, .npy or 16-bit .png files, named after the pairs or after the files of the truth;
            see `find_predictions`.
        truth: a dataset of this program or a folder of Middlebury, ETH3D or KITTI; see `find_truth`.
        protocol: name of one of `PROTOCOLS`; by default ``kitti`` or ``eth3d`` if the truth has that layout, else
            ``middlebury``.
        split: a split of a dataset of this program; None for all pairs.
        maps: a folder for an error map of each pair; None for no maps.
        listener: is called with the number of pairs, and with each evaluated pair.

    Returns:
        The content of ``--json``, in JSON's types: ``protocol``, ``source``, ``unit``, the number of ``pairs``,
        ``mean`` (figures by name, see `score`, for the regions ``all`` and ``non-occluded``) and ``images`` (for each
        pair its ``name``, ``prediction``, counts of ``pixels`` by region, and ``figures`` as in ``mean``). Figures that
        are not finite are None.

    Raises:
        InputError: where a folder or a protocol does not exist, names or sizes do not fit, or a prediction is missing
            or is a file of the truth.
        ReadError: where a file cannot be read.
    """
    listener = listener or Listener()
    folder, found = expanded(fspath(predictions)), find_truth(fspath(truth), split)
    protocol = found.protocol if protocol is None else protocol
    check_one_of("protocol", protocol, PROTOCOLS)
    rules = PROTOCOLS[protocol]
    files = find_predictions(folder, found.pairs)
    for path, pair in zip(files, found.pairs, strict=True):
        if path.resolve() == Path(pair.source).resolve():
            raise InputError(f"{path}: is the truth's own file, not a prediction", argument="predictions")
    if maps is not None and expanded(fspath(maps)).resolve() in (folder.resolve(), expanded(fspath(truth)).resolve()):
        raise InputError(f"{maps}: has predictions or truth; choose a different folder", argument="maps")
    regions: dict[str, dict[str, Sums]] = {}
    images: list[dict[str, Any]] = []
    listener.on_total(len(files))
    for pair, path in zip(found.pairs, files, strict=True):
        pair_truth = pair.read()
        prediction = read_disparity_map(path, found.png_scale, signed=pair_truth.signed)
        try:
            comparison = rules.compare(prediction, pair_truth)
        except InputError as error:
            raise InputError(f"{path}: {error} ({pair.source})") from None
        if not (np.isfinite(prediction).any() and comparison.estimated.any()):
            raise ReadError(path, f"has no disparity that is valid by the definitions of {rules.source}")
        image: dict[str, Any] = {"name": pair.name, "prediction": str(path), "pixels": {}, "figures": {}}
        for region, mask in {"all": None, "non-occluded": pair_truth.visible}.items():
            if region == "all" or mask is not None:
                regions.setdefault(region, {})[pair.name] = sums = tally(comparison, rules, mask)
                image["pixels"][region] = {name: sums[name] for name in ("judged", "estimated", "scored")}
                image["figures"][region] = _finite(figures(sums, rules))
        images.append(image)
        if maps is not None:
            picture = expanded(fspath(maps)) / f"{pair.name}.png"
            picture.parent.mkdir(parents=True, exist_ok=True)
            picture.write_bytes(RGB8.encode(paint_error_map(comparison)))
        listener.on_pair()
    return {
        "protocol": rules.name,
        "source": rules.source,
        "unit": "percent" if rules.full_share == 100 else "fraction",
        "pairs": len(images),
        "mean": {region: _finite(mean_figures(of_region, rules)) for region, of_region in regions.items()},
        "images": images,
    }


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    return {name: float(value) if np.isfinite(value) else None for name, value in values.items()}


def paint_error_map(comparison: PixelComparison) -> NDArray[np.uint8]:
    """Paint the errors of a prediction as an image (H, W, 3) uint8 RGB, in ten colours from blue to red.

    The error e of a pixel with the true disparity d becomes the magnitude min(e / 3 px, e / (0.05 d)). Each colour
    covers magnitudes up to twice the bound of the previous colour. Magnitudes of 1 and above, the outliers of D1, are
    yellow to red. A pixel without a valid prediction has the last colour. Occluded pixels are half as bright. Pixels
    without truth are black.

    Source: ``errorImage`` in io_disp.h and log_colormap.h of KITTI's development kit, which paints 3 x 3 pixels for
    each pixel with truth.
    """
    error = np.where(comparison.scored, comparison.error, np.float32(np.inf))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # An error of 0 at a true disparity of 0 would be NaN.
        relative = np.where(error == 0, 0.0, 20.0 * error.astype(np.float64) / np.abs(comparison.truth.disparity))
        magnitude = np.minimum(error / 3.0, relative).astype(np.float32)
    # NaN sorts after all bounds and so gets the last colour.
    colour = np.searchsorted(_BOUNDS, magnitude, side="right").astype(np.uint8)
    if comparison.truth.visible is not None:
        colour[~comparison.truth.visible] += len(_COLOURS)
    colour[~comparison.judged] = len(_PALETTE) - 1
    return np.asarray(_PALETTE[colour])


def evaluate_views(predictions: Path, predictions_right: Path) -> dict[str, Any]:
    """Compare predictions for left views with predictions for right views.

    A pair's two disparity maps have the same path in the two folders, apart from the extension. Raises InputError if
    the folders have no maps, or maps of different names or sizes.

    Returns:
        The content of ``--json``, in JSON's types: ``confirmed_px`` (see `CONFIRMED_PX`), the number of ``pairs``,
        ``images`` (for each pair its ``name``, its files ``left`` and ``right``, and the percentage ``unconfirmed``)
        and ``mean`` (the mean of the pairs' ``unconfirmed``).
    """
    left, right = expanded(predictions), expanded(predictions_right)
    lefts, rights = (
        {path.relative_to(folder).with_suffix("").as_posix(): path for path in disparity_maps(folder, argument)}
        for argument, folder in (("predictions", left), ("predictions_right", right))
    )
    if not lefts and not rights:
        raise InputError(f"{left}: no disparity maps there: expected .pfm, .npy or 16-bit .png", argument="predictions")
    if unmatched := sorted(lefts.keys() ^ rights.keys()):
        raise InputError(f"expected the same names in both folders; only one folder has {abbreviate(unmatched)}")
    images = []
    for name in sorted(lefts):
        try:
            percent = unconfirmed(read_disparity_map(lefts[name]), read_disparity_map(rights[name]))
        except InputError as error:
            raise InputError(f"{lefts[name]}: {error}") from None
        images.append({"name": name, "left": str(lefts[name]), "right": str(rights[name]), "unconfirmed": percent})
    mean = float(np.mean([image["unconfirmed"] for image in images]))
    return {"confirmed_px": CONFIRMED_PX, "pairs": len(images), "mean": {"unconfirmed": mean}, "images": images}


def unconfirmed(left: NDArray[np.float32], right: NDArray[np.float32]) -> float:
    """Return the percentage of a left view's pixels whose disparity (H, W) the right view's (H, W) does not confirm.

    The disparity d in column x is confirmed if the right pixel nearest to x - d has the same disparity within
    `CONFIRMED_PX`. Pixels without a disparity and occluded pixels are unconfirmed. Pixels whose x - d lies outside the
    right image are ignored. Raises InputError if the sizes differ, or no disparity points into the right image.
    """
    if left.shape != right.shape:
        raise InputError(f"the left view has {shown_size(left)}, the right one {shown_size(right)}: expected one size")
    known, width = np.isfinite(left), left.shape[1]
    columns = np.rint(np.arange(width) - np.where(known, left, 0)).astype(np.int64)
    inside = (columns >= 0) & (columns < width)
    if not (known & inside).any():
        raise InputError("no left disparity points into the right image: expected x_left - x_right, in px")
    right_disparity = np.take_along_axis(right, np.clip(columns, 0, width - 1), axis=1)
    with np.errstate(invalid="ignore"):
        confirmed = known & (np.abs(left - right_disparity) <= CONFIRMED_PX)
    return float(100 * (1 - np.mean(confirmed[inside])))
