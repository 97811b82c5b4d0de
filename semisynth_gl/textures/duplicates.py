"""Crops that show what another one shows already: the same photograph twice, or the frames of a burst."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.textures.crops import FINGERPRINT_NORM, CropBox

Found = tuple[int, CropBox]
"""The number of an image or run, and a square in it."""


class Seen:
    """The crops that were good enough so far.

    Args:
        min_difference: crops that differ less from one of them are duplicates; see `fingerprint`. 0 finds none.
    """

    def __init__(self, min_difference: float) -> None:
        self._min_difference = min_difference
        self._least_alike = (1 - min_difference) * FINGERPRINT_NORM**2
        self._prints = np.empty((0, 0), np.float32)
        self._squares: list[Found] = []

    def sort_out(
        self, run: int, boxes: Sequence[CropBox], prints: Mapping[int, NDArray[np.float32]], order: Sequence[int]
    ) -> dict[int, Found]:
        """Return which crops of a run are duplicates, and of what; the others are remembered.

        Args:
            run: number of the run.
            boxes: its squares.
            prints: fingerprints of those that are judged, by index.
            order: their indexes; of two that are alike the first one counts.
        """
        if not (order and self._min_difference):
            return {}
        own = np.stack([prints[i] for i in order])
        known = len(self._squares)
        self._make_room(known + len(order), own.shape[1])
        before, among = own @ self._prints[:known].T, own @ own.T
        duplicates: dict[int, Found] = {}
        fresh: list[int] = []
        for row, i in enumerate(order):
            likest_before = before[row].max(initial=-np.inf)
            likest_own = among[row, fresh].max(initial=-np.inf)
            if max(likest_before, likest_own) <= self._least_alike:
                fresh.append(row)
            elif likest_before >= likest_own:
                duplicates[i] = self._squares[int(before[row].argmax())]
            else:
                duplicates[i] = (run, boxes[order[fresh[int(among[row, fresh].argmax())]]])
        self._prints[known : known + len(fresh)] = own[fresh]
        self._squares += [(run, boxes[order[row]]) for row in fresh]
        return duplicates

    def _make_room(self, rows: int, columns: int) -> None:
        """Make room for so many, twice as much as before: growing by each image's would copy all of them each time."""
        known = len(self._squares)
        if rows > len(self._prints):
            larger = np.empty((max(rows, 2 * len(self._prints)), columns), np.float32)
            larger[:known] = self._prints[:known].reshape(known, columns)
            self._prints = larger
