"""Subjects: photographs that show the same thing, such as both views of a stereo pair, by the names of their files."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from semisynth_gl.inputs.errors import counted
from semisynth_gl.textures.view_names import groups_by_name


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
