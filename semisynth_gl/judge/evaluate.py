"""Evaluate the predictions for a set against its truth, pair by pair."""

from collections.abc import Callable, Iterable, Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.png import RGB8
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.judge.error_map import draw_error_map
from semisynth_gl.judge.protocol import ProtocolName, find_protocol
from semisynth_gl.judge.score import Score, mean_figures, tally
from semisynth_gl.judge.truth import TruePair, find_predictions, find_truth
from semisynth_gl.seeds.splits import SplitName

_Found = tuple[TruePair, Path]


def evaluate(
    predictions: str | PathLike[str],
    truth: str | PathLike[str],
    protocol: ProtocolName | None = None,
    *,
    split: SplitName | None = None,
    partial: bool = False,
    maps: str | PathLike[str] | None = None,
    progress: Callable[[Sequence[_Found]], Iterable[_Found]] = iter,
) -> dict[str, Any]:
    """Evaluate a folder of predictions, as ``semisynth-gl evaluate`` does.

    Args:
        predictions: a folder of .pfm, .npy or 16-bit .png files, named after the pairs or after the files of the truth;
            see `find_predictions`.
        truth: a dataset of this program or a folder of Middlebury, ETH3D or KITTI; see `find_truth`.
        protocol: name of one of `PROTOCOLS`; by default of the benchmark whose layout the truth has.
        split: a split of a dataset of this program; None for all pairs.
        partial: whether predictions for some pairs may be missing.
        maps: a folder for an error map of each pair; None for no maps.
        progress: wraps the sequence of pairs, to show progress; tqdm is one.

    Returns:
        The content of ``--json``, in JSON's types: ``protocol``, ``source``, ``unit``, the number of ``pairs``, the
        names of ``missing`` pairs, ``mean`` (figures by name, for the regions ``all`` and ``non-occluded``) and
        ``images`` (for each pair its ``name``, ``prediction``, counts of ``pixels`` by region, and ``figures`` as in
        ``mean``). `Score.figures` explains the figures; figures that are not finite are None.

    Raises:
        InputError: where a folder or a protocol does not exist, names or sizes do not fit, or predictions are missing.
        ReadError: where a file cannot be read.
    """
    address, folder = fspath(truth), expanded(fspath(predictions))
    address = address if "://" in address else str(expanded(address))
    true_set = find_truth(address, split)
    rules = find_protocol(true_set.protocol if protocol is None else protocol)
    found, missing = find_predictions(folder, true_set.pairs, partial=partial)
    if maps is not None and expanded(fspath(maps)).resolve() in (folder.resolve(), Path(address).resolve()):
        raise InputError(f"{maps}: has predictions or truth; name another folder", argument="maps")
    scores: dict[str, dict[str, Score]] = {}
    images: list[dict[str, Any]] = []
    for pair, path in progress(found):
        known = pair.read()
        prediction = read_disparity_map(path, true_set.png_scale, signed=known.limits.signed)
        try:
            comparison = rules.compare(prediction, known.disparity, known.limits)
            masks = {"all": None, "non-occluded": known.visible}
            of_pair = {
                region: tally(comparison, rules, mask, known.objects)
                for region, mask in masks.items()
                if region == "all" or mask is not None
            }
        except InputError as error:
            raise InputError(f"{path}: {error} ({pair.source})") from None
        if not (np.isfinite(prediction).any() and comparison.estimated.any()):
            raise ReadError(path, f"has no disparity that is valid by the definitions of {rules.source}")
        if not comparison.judged.any():
            raise InputError(f"{pair.source}: the truth of {pair.name} has no disparity")
        image: dict[str, Any] = {"name": pair.name, "prediction": str(path), "pixels": {}, "figures": {}}
        for region, score in of_pair.items():
            scores.setdefault(region, {})[pair.name] = score
            image["pixels"][region] = {name: score.sums[name] for name in ("judged", "estimated", "scored")}
            image["figures"][region] = _finite(score.figures())
        images.append(image)
        if maps is not None:
            picture = expanded(fspath(maps)) / f"{pair.name}.png"
            picture.parent.mkdir(parents=True, exist_ok=True)
            picture.write_bytes(RGB8.encode(draw_error_map(comparison, known.visible)))
    return {
        "protocol": rules.name,
        "source": rules.source,
        "unit": "percent" if rules.full_share == 100 else "fraction",
        "pairs": len(images),
        "missing": missing,
        "mean": {region: _finite(mean_figures(of_region)) for region, of_region in scores.items()},
        "images": images,
    }


def _finite(figures: dict[str, float]) -> dict[str, float | None]:
    return {name: float(value) if np.isfinite(value) else None for name, value in figures.items()}
