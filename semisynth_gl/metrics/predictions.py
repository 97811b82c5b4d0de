"""The files of a folder that are predictions for pairs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from semisynth_gl.errors import InputError
from semisynth_gl.metrics.truth import TruePair
from semisynth_gl.read.disparity import MAP_EXTENSIONS

_SHOWN = 8
_SCENE_STEMS = ("disp0GT", "disp0")


@dataclass(frozen=True, slots=True)
class Prediction:
    """A file with a prediction.

    Attributes:
        path: .pfm, .npy or 16-bit .png.
        png_scale: levels of a PNG per pixel of disparity.
    """

    path: Path
    png_scale: float


def find_predictions(folder: Path, pairs: Sequence[TruePair]) -> dict[str, Prediction]:
    """Find the prediction for each pair.

    A prediction has one of the pair's names, see `TruePair`, and ends in .pfm, .npy or .png. In a scene's folder it may
    also be ``disp0<METHOD>.pfm``, as Middlebury wants it; the truth's own name counts only where there is no such file,
    since Middlebury's results lie beside the truth.

    Args:
        folder: of the predictions.
        pairs: the pairs.

    Returns:
        The predictions, by the pair's name; pairs without a prediction are missing.

    Raises:
        InputError: where there is no such folder, or a pair has several predictions.
    """
    if not folder.is_dir():
        raise InputError(f"--pred {folder}: {'is a file' if folder.exists() else 'there is no such folder'}")
    predictions: dict[str, Prediction] = {}
    for pair in pairs:
        candidates = [
            Prediction(path, png_scale) for stem, png_scale in pair.stems.items() for path in _files(folder / stem)
        ]
        better = [prediction for prediction in candidates if prediction.path.stem not in _SCENE_STEMS]
        candidates = better or candidates
        if len(candidates) > 1:
            names = ", ".join(str(prediction.path.relative_to(folder)) for prediction in candidates[:_SHOWN])
            raise InputError(f"--pred {folder}: {len(candidates)} predictions for {pair.name}: {names}: keep one file")
        if candidates:
            predictions[pair.name] = candidates[0]
    return predictions


def missing_predictions(
    folder: Path, pairs: Sequence[TruePair], predictions: Mapping[str, Prediction], *, partial: bool
) -> list[str]:
    """Return the names of pairs without a prediction.

    Args:
        folder: of the predictions.
        pairs: the pairs.
        predictions: by the pair's name.
        partial: whether some predictions may be missing.

    Raises:
        InputError: where predictions are missing against ``partial``, or all are missing.
    """
    missing = [pair for pair in pairs if pair.name not in predictions]
    if missing and (not partial or not predictions):
        names = ", ".join(pair.name for pair in missing[:_SHOWN]) + (", ..." if len(missing) > _SHOWN else "")
        expected = " or ".join(str(folder / f"{stem}.pfm") for stem in list(missing[0].stems)[:2])
        advice = "; --partial evaluates the others" if predictions else ""
        raise InputError(
            f"--pred {folder}: no prediction for {len(missing)} of {len(pairs)} pairs: {names}: expected {expected} "
            f"(or .npy, .png), for example{advice}"
        )
    return [pair.name for pair in missing]


def _files(path: Path) -> list[Path]:
    """Return the files of a name without ending; of disp0 and disp0GT also those named disp0<METHOD> beside them."""
    files = [path.with_name(f"{path.name}{extension}") for extension in MAP_EXTENSIONS]
    if path.name in _SCENE_STEMS:
        methods = (file for file in sorted(path.parent.glob("disp0?*")) if file.suffix.lower() in MAP_EXTENSIONS)
        files += [file for file in methods if file.stem not in _SCENE_STEMS]
    return [file for file in files if file.is_file()]
