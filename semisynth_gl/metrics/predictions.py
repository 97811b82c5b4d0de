"""Which file of a folder is the prediction for which pair."""

from collections.abc import Iterator, Sequence
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
        pairs: what they are for.

    Returns:
        The predictions, by the pair's name; none for pairs that have none.

    Raises:
        InputError: where there is no such folder, or a pair has several.
    """
    if not folder.is_dir():
        raise InputError(f"--pred {folder}: {'is a file' if folder.exists() else 'there is no such folder'}")
    found: dict[str, Prediction] = {}
    for pair in pairs:
        own = [Prediction(path, png_scale) for stem, png_scale in pair.stems.items() for path in _files(folder, stem)]
        by_method = [
            Prediction(path, png_scale) for stem, png_scale in pair.stems.items() for path in _methods(folder, stem)
        ]
        others = [each for each in own if each.path.stem not in _SCENE_STEMS]
        paths = by_method + others or own
        if len(paths) > 1:
            names = ", ".join(str(each.path.relative_to(folder)) for each in paths[:_SHOWN])
            raise InputError(f"--pred {folder}: {len(paths)} predictions for {pair.name}: {names}: keep one of them")
        if paths:
            found[pair.name] = paths[0]
    return found


def require_all(folder: Path, pairs: Sequence[TruePair], found: dict[str, Prediction], *, partial: bool) -> list[str]:
    """Return the names of pairs without a prediction.

    Args:
        folder: of the predictions.
        pairs: what they are for.
        found: those that are there.
        partial: whether some may be missing.

    Raises:
        InputError: where some are missing and may not, or all are.
    """
    missing = [pair for pair in pairs if pair.name not in found]
    if missing and (not partial or not found):
        names = ", ".join(pair.name for pair in missing[:_SHOWN]) + (", ..." if len(missing) > _SHOWN else "")
        wanted = " or ".join(str(folder / f"{stem}.pfm") for stem in list(missing[0].stems)[:2])
        advice = "; --partial evaluates the others" if found else ""
        raise InputError(
            f"--pred {folder}: no prediction for {len(missing)} of {len(pairs)} pairs: {names}: expected {wanted} (or "
            f".npy, .png), for example{advice}"
        )
    return [pair.name for pair in missing]


def _files(folder: Path, stem: str) -> Iterator[Path]:
    for extension in MAP_EXTENSIONS:
        path = folder / f"{stem}{extension}"
        if path.is_file():
            yield path


def _methods(folder: Path, stem: str) -> Iterator[Path]:
    """Files disp0<METHOD> in a scene's folder."""
    path = folder / stem
    if path.name in _SCENE_STEMS and path.parent.is_dir():
        yield from (
            each
            for each in sorted(path.parent.glob("disp0?*"))
            if each.suffix.lower() in MAP_EXTENSIONS and each.stem not in _SCENE_STEMS
        )
