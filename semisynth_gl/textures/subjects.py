"""Subjects: photographs that show the same thing, such as both views of a stereo pair, by the names of their files.

Photographs show one subject where their names differ only in parts that distinguish views, such as ``left`` and
``right``.
"""

import re
from collections import defaultdict
from collections.abc import Collection, Sequence
from itertools import chain
from pathlib import Path

from semisynth_gl.inputs.errors import counted

_MARK = "\0"  # stands for the part that distinguishes views; no name contains it

# A whole word of a name, as in scene_left, 0001R or imageLeft, but not a part of a word, as in bright.
_SIDE = re.compile(
    r"(?:(?<![^\W\d_])|(?<=[a-z])(?=[A-Z]))(?:(?:left|right|Left|Right|LEFT|RIGHT)(?![a-z])|[lrLR](?![^\W\d_]))"
)
# ETH3D: delivery_area_1l and delivery_area_1s are one moment, seen through wide and narrow lenses.
_LENS = re.compile(r"(_\d+)[ls]$")
# Middlebury: im0, im1E, im0e3, view5; also after the name of a scene.
_VIEW = re.compile(r"(?<![^\W_])(im|view)(\d+)(?:[EL]|e\d)?$", re.IGNORECASE)
_LAST_VIEW = 8
_CAMERA = re.compile(r"(?<![^\W\d_])cam(?:era)?[ _-]?\d{1,2}(?!\d)", re.IGNORECASE)
# KITTI's folders, in which 000017_10 and 000017_11 are a tenth of a second apart.
_KITTI_FOLDER = re.compile(r"image_0?[0-3]|colored_[01]")
# Of two cameras: im0 and im1, cam0 and cam1, image_0 to image_3.
_NUMBERED = re.compile(r"(?<![^\W_])(?:im|cam(?:era)?[ _-]?|image_0?|colored_)([0-3])(?!\d)")
_FRAME = re.compile(r"(\d{6})_\d\d")
# Middlebury: folders of one scene under different light.
_LIGHT = re.compile(r"/(?:Illum\d|Exp\d|ambient/[FLT]\d)(?=/)")

# Three or more folders of at most eight photographs, with the same file names in each, are taken for a scene each.
_FEWEST_FOLDERS, _MOST_IN_FOLDER = 3, 8


def subject_numbers(photographs: Sequence[Path]) -> list[int]:
    """Return the subject of each photograph: the smallest position of a photograph that shows it.

    No file is opened; `groups_by_name` has the rules.
    """
    first = list(range(len(photographs)))

    def subject(number: int) -> int:
        while first[number] != number:
            number = first[number]
        return number

    # A photograph may be in two groups, which are then one subject.
    for group in groups_by_name(photographs):
        subjects = {subject(number) for number in group}
        for each in subjects:
            first[each] = min(subjects)
    return [subject(number) for number in first]


def photographed_subjects(photographs: Sequence[Path]) -> list[list[Path]]:
    """Group photographs by subject; groups are in the order of their first members."""
    groups: dict[int, list[Path]] = defaultdict(list)
    for path, subject in zip(photographs, subject_numbers(photographs), strict=True):
        groups[subject].append(path)
    return list(groups.values())


def of_subjects(photographs: int, subjects: int) -> str:
    """Return words to follow a number of photographs, such as `` of 12 subjects``; none where all subjects differ."""
    if photographs == subjects:
        return ""
    return f" of {counted(subjects, 'subject')}"


def groups_by_name(photographs: Sequence[Path]) -> list[list[int]]:
    """Group photographs that show one subject, judging by their names; photographs are known by their positions.

    Groups of one photograph are left out, and a photograph may be in two groups. The rules know the names of
    Middlebury, ETH3D, KITTI, EuRoC, SceneFlow and Cityscapes; ``left`` and ``right`` or ``l`` and ``r`` as words of a
    file or folder name; and folders of a few photographs each whose files have the same names. Sharing a folder
    makes no group. No file is opened.
    """
    # Where numbers go beyond the views of a scene, they number photographs, not views.
    series = {place for path in photographs for place, number in [_view(path)] if number > _LAST_VIEW}
    by_key: dict[tuple[str, str], list[int]] = defaultdict(list)
    for number, path in enumerate(photographs):
        by_key[_key(path, series)].append(number)
    return [group for group in chain(by_key.values(), _folders_of_scenes(photographs)) if len(group) > 1]


def is_right(path: Path) -> bool:
    """Return whether a photograph is a right view by its name: the last part of its path that names a side.

    A part does so by a word ``left``, ``right``, ``l`` or ``r``, by EuRoC's ``cam0`` and ``cam1``, by KITTI's folders
    and by Middlebury's ``im0`` and ``im1``. A path should begin where photographs differ: /mnt/r is no side.
    """
    for part in (path.stem, *(folder.name for folder in path.parents)):
        # Cameras number their photographs R0010123 and so on.
        sides = [word for word in _SIDE.findall(part) if len(word) > 1 or not re.match(rf"{word}\d", part)]
        if sides:
            return sides[-1][0] in "rR"
        numbered = _NUMBERED.search(part)
        if numbered is not None:
            return numbered[1] in "13"
    return False


def _view(path: Path) -> tuple[tuple[Path, str] | None, int]:
    """Return the folder and name that numbered views share, and the view's number; None and 0 where there is none."""
    found = _VIEW.search(path.stem)
    return (None, 0) if found is None else ((path.parent, path.stem[: found.start(2)]), int(found[2]))


def _key(path: Path, series: Collection[tuple[Path, str] | None]) -> tuple[str, str]:
    """Return a photograph's folder and name without the parts that distinguish views; numbers in ``series`` stay."""
    stem = path.stem
    if _view(path)[0] not in series:
        stem = _VIEW.sub(_MARK, stem)
    frame = _FRAME.fullmatch(stem)
    if frame is not None and _KITTI_FOLDER.fullmatch(path.parent.name):
        stem = frame[1]
    camera = _CAMERA.sub(_MARK, stem)
    # A name with nothing else in it, such as cam02, stays: it numbers the photographs of one camera.
    if re.search(r"[^\W_]", camera):
        stem = camera
    folders = (
        _MARK if _is_of_camera(folder) else _SIDE.sub(_MARK, _LENS.sub(rf"\1{_MARK}", folder))
        for folder in _LIGHT.sub("", f"{path.parent.as_posix()}/").split("/")
    )
    return "/".join(folders), _SIDE.sub(_MARK, _LENS.sub(rf"\1{_MARK}", stem)) + path.suffix


def _is_of_camera(folder: str) -> bool:
    return bool(_CAMERA.fullmatch(folder) or _KITTI_FOLDER.fullmatch(folder))


def _folders_of_scenes(photographs: Sequence[Path]) -> list[list[int]]:
    """Return the photographs of each folder that holds one scene: folders beside each other with equal file names."""
    inside: dict[Path, list[int]] = defaultdict(list)
    for number, path in enumerate(photographs):
        inside[path.parent].append(number)
    alike: dict[tuple[Path, frozenset[str]], list[list[int]]] = defaultdict(list)
    for folder, numbers in inside.items():
        if len(numbers) <= _MOST_IN_FOLDER and not (_is_of_camera(folder.name) or _SIDE.search(folder.name)):
            names = frozenset(photographs[number].name for number in numbers)
            alike[folder.parent, names].append(numbers)
    return list(chain.from_iterable(folders for folders in alike.values() if len(folders) >= _FEWEST_FOLDERS))
