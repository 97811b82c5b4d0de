"""Groups photographs by subject: photographs of one subject show the same thing, such as both views of a stereo pair.

Photographs show one subject if their names differ only in parts that distinguish views, such as ``left`` and ``right``.
All subjects have equal shares of the surfaces, but a subject with few patches has a smaller share.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.errors import counted

MOST_TIMES = 4
"""Maximum chance of a patch, relative to the mean over all patches: it limits subjects with few patches."""

_MARK = "\0"  # replaces the part that distinguishes views; no name contains it

# A whole word of a name, as in scene_left, 0001R or imageLeft, but not a part of a word, as in bright.
_SIDE = re.compile(
    r"(?:(?<![^\W\d_])|(?<=[a-z])(?=[A-Z]))(?:(?:left|right|Left|Right|LEFT|RIGHT)(?![a-z])|[lrLR](?![^\W\d_]))"
)
# ETH3D: delivery_area_1l and delivery_area_1s are one moment, seen through wide and narrow lenses.
_LENS = re.compile(r"(_\d+)[ls]$")
# Middlebury: im0, im1E, im0e3, view5; also after the name of a scene.
_VIEW = re.compile(r"(?<![^\W_])(im|view)[0-8](?:[EL]|e\d)?$", re.IGNORECASE)
_CAMERA = re.compile(r"(?<![^\W\d_])cam(?:era)?[ _-]?\d{1,2}(?!\d)", re.IGNORECASE)
# KITTI's folders, in which 000017_10 and 000017_11 are a tenth of a second apart.
_KITTI_FOLDER = re.compile(r"image_0?[0-3]|colored_[01]")
_FRAME = re.compile(r"(\d{6})_\d\d")
# Middlebury: folders of one scene under different light.
_LIGHT = re.compile(r"/(?:Illum\d|Exp\d|ambient/[FLT]\d)(?=/)")


def subject_numbers(photographs: Sequence[Path]) -> list[int]:
    """Return the subject of each photograph: the position of the first photograph that shows it.

    Only names decide; no file is opened. The rules recognise the names of Middlebury, ETH3D, KITTI, EuRoC, SceneFlow
    and Cityscapes, numbers of cameras, and the words ``left``, ``right``, ``l`` and ``r`` in file and folder names.
    Photographs in one folder need not show one subject.
    """
    first: dict[str, int] = {}
    return [first.setdefault(_subject(path), number) for number, path in enumerate(photographs)]


def group_by_subject(photographs: Sequence[Path]) -> list[list[Path]]:
    """Group photographs by subject; groups are in the order of their first members."""
    groups: dict[int, list[Path]] = defaultdict(list)
    for path, subject in zip(photographs, subject_numbers(photographs), strict=True):
        groups[subject].append(path)
    return list(groups.values())


def of_subjects(photographs: int, subjects: int) -> str:
    """Return words such as " of 12 subjects", which follow a number of photographs; "" if all subjects differ."""
    return "" if photographs == subjects else f" of {counted(subjects, 'subject')}"


def _subject(path: Path) -> str:
    """Return a photograph's path without the parts that distinguish views."""
    stem = _VIEW.sub(_MARK, path.stem)
    frame = _FRAME.fullmatch(stem)
    if frame is not None and _KITTI_FOLDER.fullmatch(path.parent.name):
        stem = frame[1]
    camera = _CAMERA.sub(_MARK, stem)
    # A name that is only a camera's number, such as cam02, stays: its number counts photographs of one camera.
    if re.search(r"[^\W_]", camera):
        stem = camera
    parts = [
        _MARK if _CAMERA.fullmatch(part) or _KITTI_FOLDER.fullmatch(part) else part
        for part in _LIGHT.sub("", f"{path.parent.as_posix()}/").split("/")
    ]
    return "/".join(_SIDE.sub(_MARK, _LENS.sub(rf"\1{_MARK}", part)) for part in (*parts, stem)) + path.suffix


def patch_chances(subjects: Sequence[str]) -> NDArray[np.float64]:
    """Return the probability with which a surface gets each patch: (N,) float64, sum 1.

    ``subjects``, (N,), names the subject of each patch. The patches of a subject are equally likely.
    """
    counts = Counter(subjects)
    shares = equal_shares(counts)
    return np.array([shares[subject] / counts[subject] for subject in subjects])


def equal_shares(counts: Mapping[str, int]) -> dict[str, float]:
    """Return each subject's share of the surfaces, sum 1, given the subject's number of patches.

    Shares are equal, except for subjects whose patches would be used too often (see `MOST_TIMES`).
    """
    patches, rest = sum(counts.values()), 1.0
    shares = {}
    # Subjects with few patches come first: what exceeds their limit is shared by subjects with more patches.
    for number, name in enumerate(sorted(counts, key=lambda name: (counts[name], name))):
        shares[name] = min(rest / (len(counts) - number), MOST_TIMES * counts[name] / patches)
        rest -= shares[name]
    return shares
