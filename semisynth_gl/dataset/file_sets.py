"""A dataset's files as patterns: one for each role in each split, for readers that understand globs but not layouts."""

from collections.abc import Sequence
from dataclasses import dataclass
from os.path import commonprefix
from typing import Any

from semisynth_gl.codecs import Codec
from semisynth_gl.dataset.plan import Plan
from semisynth_gl.seeds.splits import SplitName

_DIGITS = "0123456789"
# Numbers of a few sequences whose names differ in every place in which names of sequences can differ.
_SEQUENCES = (0, 1, 3, 123_456)


@dataclass(frozen=True, slots=True)
class FileSet:
    """The files of one role (see `semisynth_gl.layouts.roles`) in one split; ``meaning`` is their content in words.

    ``pattern`` is a glob of the paths, below the dataset's folder or inside a tar, whose stars stand for the pair.
    """

    split: SplitName
    role: str
    pattern: str
    codec: Codec[Any]
    meaning: str


def list_file_sets(plan: Plan, split: SplitName) -> list[FileSet]:
    """Return a file set for each role of a split."""
    layout = plan.layout
    encodings = plan.encodings
    length, views = plan.key(split, 0).sequence_length, plan.views
    if length is None:
        length = views = 1
    first = [number // views * views * length + number % views for number in _SEQUENCES]
    pairs = [plan.files(split, index) for index in (*first, views * min(1, length - 1))]
    patterns = {role: _pattern([files[role] for files in pairs]) for role in pairs[0]}
    return [
        FileSet(split, role, pattern, layout.role(role).codec(encodings), layout.role(role).described(encodings))
        for role, pattern in patterns.items()
    ]


def _pattern(paths: Sequence[str]) -> str:
    """Return the paths as one, with a star where names of files or folders differ; a star takes a number as a whole."""
    parts = []
    for names in zip(*(path.split("/") for path in paths), strict=True):
        turned = [name[::-1] for name in names]
        begin, end = (commonprefix(texts) for texts in (names, turned))  # noqa: RUF071 - names, not paths
        parts.append(names[0] if len(set(names)) == 1 else f"{begin.rstrip(_DIGITS)}*{end[::-1].lstrip(_DIGITS)}")
    return "/".join(parts)
