"""Subjects: finds photographs that show the same thing, such as both views of a stereo pair, by name and content.

Content is compared at 32 x 24 cells. What counts of a cell is how it stands out from its surroundings, so that
exposure, compression and size do not matter, nor do stripes, which look alike wherever they are. Between two views,
near things shift more than far ones, so the best shift is found for the upper and the lower half separately.
"""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.cache import Entry, cached, file_states, package_versions
from semisynth_gl.inputs.errors import counted
from semisynth_gl.textures.borders import inside_borders
from semisynth_gl.textures.image_files import relative_names
from semisynth_gl.textures.images import OUT_OF_MEMORY, ImageError, read_reduced
from semisynth_gl.textures.view_names import groups_by_name

VERSION = 2
"""Increase this when the same photographs are grouped differently; see `semisynth_gl.cache`."""

ALIKE = 0.6
"""Mean correlation of both halves above which two photographs are of one subject.

Measured: nine stereo pairs, 450 to 741 pixels wide, have 0.74 or more. They keep 0.7 or more with one view three stops
darker, at a fifth of its size or as JPEG of quality 10, but fall to 0.51 where 1.5 stops more light clips much of a
view. 7,000 pairs of different photographs and drawn pictures, cloths among them, have at most 0.43. Of 122,000 pairs of
ninths of these images, two have more than 0.6.
"""

_HALVES, _ROWS, _COLUMNS = 2, 12, 32
# The surroundings of a cell, as the standard deviation of a Gaussian in cells.
_AROUND = 3.0
# Contrast of mere noise, 8-bit levels, and the sum of squares of half a signature that holds little else.
_NOISE_LEVELS, _NOISE_SQUARES = 2.0, 5.0
# Largest shifts, in cells: near things shift by up to a fifth of the width between views, which may not be rectified.
_ACROSS, _ALONG = 6, 1
_SHIFTS = [(down, right) for down in range(-_ALONG, _ALONG + 1) for right in range(-_ACROSS, _ACROSS + 1)]
# Least sides of a reduced JPEG, pixels: several to a cell.
_LEAST_SIDES = (4 * _COLUMNS, 4 * _COLUMNS)
# To compare more photographs than this takes seconds, so the log says so.
_MANY = 100

_Signature = NDArray[np.float32]
"""(2, 12, 32): half (upper, lower), row and column of the cells, and how each stands out from its surroundings."""


class SubjectFinder:
    """Finds out which photographs show one subject: by their names, and by content as their pixels are added.

    Photographs are known by their numbers: those given here are numbered from 0 on, and no file is opened.
    """

    def __init__(self, photographs: Sequence[Path] = ()) -> None:
        self._first: dict[int, int] = {}
        for group in groups_by_name(photographs):
            for number in group[1:]:
                self._join(group[0], number)
        self._added: list[int] = []
        self._signatures = np.empty((_HALVES, 0, _ROWS * _COLUMNS), np.float32)
        self._squares = np.empty((_HALVES, 0, len(_SHIFTS)), np.float32)

    def subject(self, number: int) -> int:
        """Return the subject of a photograph: the smallest number of a photograph that is known to show it."""
        first = self._first.get(number, number)
        while first != (before := self._first.get(first, first)):
            first = before
        return first

    def add(self, number: int, pixels: NDArray[np.uint8]) -> None:
        """Compare a photograph, (H, W, 3) or (H, W) uint8, with all that were added before; join it to those alike."""
        signature = _signature(pixels)
        known = len(self._added)
        if known == self._signatures.shape[1]:
            # Room is doubled: growing by one would copy all rows for every photograph.
            self._signatures, self._squares = (
                np.concatenate([array, np.empty((_HALVES, known + 1, array.shape[2]), np.float32)], axis=1)
                for array in (self._signatures, self._squares)
            )
        # The part that overlaps with earlier photographs at each shift, (2, S, cells), zero elsewhere.
        ours = np.stack([_shifted(signature, down, right) for down, right in _SHIFTS], axis=1)
        ours = ours.reshape(_HALVES, len(_SHIFTS), -1)
        products = self._signatures[:, :known] @ ours.transpose(0, 2, 1)
        squares = (self._squares[:, :known] + _NOISE_SQUARES) * (np.square(ours).sum(axis=2) + _NOISE_SQUARES)[:, None]
        correlations = (products / np.sqrt(squares)).max(axis=2).mean(axis=0)
        for place in np.flatnonzero(correlations > ALIKE).tolist():
            self._join(self._added[place], number)
        self._added.append(number)
        self._signatures[:, known] = signature.reshape(_HALVES, -1)
        for at, (down, right) in enumerate(_SHIFTS):
            self._squares[:, known, at] = np.square(_shifted(signature, -down, -right)).sum(axis=(1, 2))

    def _join(self, one: int, other: int) -> None:
        first, second = sorted((self.subject(one), self.subject(other)))
        if first != second:
            self._first[second] = first


def photographed_subjects(photographs: Sequence[Path]) -> list[list[Path]]:
    """Group photographs by subject, by their names and their content; groups are in the order of their first members.

    All photographs are read, and the cache keeps the result. A photograph that cannot be read is grouped by its name
    only.
    """

    def build() -> tuple[list[int], bool]:
        finder, whole = SubjectFinder(photographs), True
        for number, path in enumerate(photographs if len(photographs) > 1 else ()):
            try:
                finder.add(number, read_reduced(path, _LEAST_SIDES))
            except ImageError as error:
                whole &= error.reason != OUT_OF_MEMORY
        return [finder.subject(number) for number in range(len(photographs))], whole

    def key() -> dict[str, Any]:
        return {
            "names": list(relative_names(photographs).values()),
            "files": file_states(photographs),
            # Names of folders above the folder that all photographs share count, too.
            "groups": groups_by_name(photographs),
            "versions": package_versions("numpy", "Pillow"),
        }

    subjects, _ = cached(
        "subjects",
        VERSION,
        key,
        work=f"comparing {counted(len(photographs), 'photograph')}" if len(photographs) > _MANY else None,
        build=build,
        pack=lambda found: Entry({"subjects": found[0]}, {}) if found[1] else None,
        unpack=lambda entry: ([int(subject) for subject in entry.values["subjects"]], True),
    )
    groups: dict[int, list[Path]] = defaultdict(list)
    for path, subject in zip(photographs, subjects, strict=True):
        groups[subject].append(path)
    return list(groups.values())


def of_subjects(photographs: int, subjects: int) -> str:
    """Return words to follow a number of photographs, such as `` of 12 subjects``; none where all subjects differ."""
    if photographs == subjects:
        return ""
    return f" of {counted(subjects, 'subject')}"


def _signature(pixels: NDArray[np.uint8]) -> _Signature:
    # Rectified photographs of one camera have the same black borders, which would make them alike.
    left, top, width, height = inside_borders(pixels)
    pixels = np.ascontiguousarray(pixels[top : top + height, left : left + width])
    grey = Image.fromarray(pixels).convert("L").resize((_COLUMNS, _HALVES * _ROWS), Image.Resampling.BOX)
    cells = np.asarray(grey, np.float64)
    standing_out = cells - _around(cells)
    contrast = np.sqrt(_around(standing_out**2))
    halves = (standing_out / (contrast + _NOISE_LEVELS)).reshape(_HALVES, _ROWS, _COLUMNS)
    halves -= halves.mean(axis=1, keepdims=True)
    halves -= halves.mean(axis=2, keepdims=True)
    return halves.astype(np.float32)


def _around(cells: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean around each cell, weighted by a Gaussian."""
    down, right = (_weights(extent) for extent in cells.shape)
    means: NDArray[np.float64] = down @ cells @ right.T
    return means


def _weights(extent: int) -> NDArray[np.float64]:
    away = np.subtract.outer(np.arange(extent), np.arange(extent))
    bell = np.exp(-0.5 * (away / _AROUND) ** 2)
    weights: NDArray[np.float64] = bell / bell.sum(axis=1, keepdims=True)
    return weights


def _shifted(signature: _Signature, down: int, right: int) -> _Signature:
    """Return a signature with each half moved down and to the right, zero where it has nothing."""
    moved = np.zeros_like(signature)
    moved[:, max(down, 0) : _ROWS + min(down, 0), max(right, 0) : _COLUMNS + min(right, 0)] = signature[
        :, max(-down, 0) : _ROWS + min(-down, 0), max(-right, 0) : _COLUMNS + min(-right, 0)
    ]
    return moved
