"""Find the prediction for each pair in a folder."""

from collections.abc import Sequence
from pathlib import Path

from semisynth_gl.codecs.disparity_map import MAP_EXTENSIONS, is_disparity_map
from semisynth_gl.inputs.errors import InputError, counted, no_folder
from semisynth_gl.judge.truth import SCENE_STEMS, TruePair

_SHOWN = 8


def find_predictions(
    folder: Path, pairs: Sequence[TruePair], *, partial: bool
) -> tuple[list[tuple[TruePair, Path]], list[str]]:
    """Find the prediction for each pair.

    A prediction has one of the pair's names (see `TruePair`) and the extension .pfm, .npy or .png. In a scene's folder
    it may also be named ``disp0<METHOD>``, as Middlebury asks for. Middlebury's results lie beside the truth, so a file
    with the truth's name counts only where the folder has no other. If a pair has several files, pictures are
    ignored, since networks write them beside their results.

    Args:
        folder: the folder with the predictions.
        pairs: the pairs of the set.
        partial: whether predictions for some pairs, but not for all, may be missing.

    Returns:
        The pairs with a prediction, in the set's order, each with the prediction's file; and the names of the pairs
        without one.

    Raises:
        InputError: where the folder does not exist, a pair has several predictions, or predictions are missing.
    """
    if not folder.is_dir():
        raise no_folder(folder, "predictions")
    found: list[tuple[TruePair, Path]] = []
    missing: list[TruePair] = []
    for pair in pairs:
        candidates = [path for stem in pair.stems for path in _files(folder / stem)]
        candidates = [path for path in candidates if path.stem not in SCENE_STEMS] or candidates
        if len(candidates) > 1:
            candidates = [path for path in candidates if is_disparity_map(path)] or candidates
        if len(candidates) > 1:
            names = ", ".join(str(path.relative_to(folder)) for path in candidates[:_SHOWN])
            raise InputError(
                f"{folder}: {len(candidates)} predictions for {pair.name}: {names}: keep one file",
                argument="predictions",
            )
        if candidates:
            found.append((pair, candidates[0]))
        else:
            missing.append(pair)
    if missing and (not partial or not found):
        names = ", ".join(pair.name for pair in missing[:_SHOWN]) + (", ..." if len(missing) > _SHOWN else "")
        expected = " or ".join(str(folder / f"{stem}.pfm") for stem in missing[0].stems[:2])
        advice = "; with partial, the pairs that have one are evaluated" if found else ""
        raise InputError(
            f"{folder}: no prediction for {len(missing)} of {counted(len(pairs), 'pair')}: {names}: "
            f"expected {expected} (or .npy, .png), for example{advice}",
            argument="predictions",
        )
    return found, [pair.name for pair in missing]


def _files(path: Path) -> list[Path]:
    """Return the existing maps of a path without extension; for disp0 and disp0GT also disp0<METHOD> beside them."""
    files = [path.with_name(f"{path.name}{extension}") for extension in MAP_EXTENSIONS]
    if path.name in SCENE_STEMS:
        methods = (file for file in sorted(path.parent.glob("disp0?*")) if file.suffix.lower() in MAP_EXTENSIONS)
        files += [file for file in methods if file.stem not in SCENE_STEMS]
    return [file for file in files if file.is_file()]
