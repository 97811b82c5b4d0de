"""Findings: the faults that checks report, and the numbers that they measure."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

DATASET = "dataset"
"""The scene's name in findings about the dataset itself."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a scene, or of the `DATASET`.

    Attributes:
        scene: name of the pair's scene, with its split in a dataset of several splits; or `DATASET`.
        check: name of the check.
        message: the expected and the found values, on one line.
    """

    scene: str
    check: str
    message: str

    def __str__(self) -> str:
        return f"{self.scene}: {self.check}: {self.message}"


@dataclass(slots=True)
class Verdict:
    """The results of all checks of one scene, or of the `DATASET`.

    Findings are in the order of the checks. Measures are numbers by name; the unit is part of the name.
    """

    scene: str
    findings: list[Finding] = field(default_factory=list)
    measures: dict[str, float] = field(default_factory=dict)

    def add(self, check: str, message: str) -> None:
        """Add a finding; line breaks become blanks."""
        self.findings.append(Finding(self.scene, check, " ".join(message.split())))

    def add_pixels(
        self,
        check: str,
        array: str,
        fault: str,
        wrong: NDArray[np.bool_],
        detail: str | Callable[[tuple[int, int]], str] = "",
    ) -> None:
        """Add a finding with the number of an array's wrong pixels and the place of the first; none if all are right.

        Args:
            check: name of the check.
            array: name of the array.
            fault: the part of the sentence between the array's name and "in 12 pixels", such as "is NaN".
            wrong: (H, W) bool.
            detail: end of the message; a function gets row and column of the first wrong pixel and returns it.
        """
        if wrong.any():
            row, column = np.argwhere(wrong)[0].tolist()
            end = detail if isinstance(detail, str) else detail((row, column))
            self.add(check, f"{array} {fault} in {count_pixels(wrong)}, the first at ({column}, {row}){end}")


def count_pixels(where: NDArray[np.bool_]) -> str:
    """Return the number of pixels that are True in a mask of any shape, as text: "12 pixels"."""
    number = int(where.sum())
    return f"{number} pixel{'' if number == 1 else 's'}"


def format_vector(values: NDArray[np.floating]) -> str:
    """Return a vector (C,) as text: one plain number, or several numbers in parentheses."""
    numbers = ", ".join(f"{float(value):.6g}" for value in values)
    return numbers if len(values) == 1 else f"({numbers})"
