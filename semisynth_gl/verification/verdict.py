"""Findings: the faults that checks report, and the measurements behind them."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

DATASET = "dataset"
"""Stands for the scene's name in findings about the dataset itself."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a scene, or of the `DATASET`: what a check expected and what came, with numbers, on one line."""

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
        """Add a finding with the number of an array's wrong pixels (H, W) and the first of them, if there is any.

        The fault is the sentence from its verb to "in 12 pixels", such as "is NaN". The detail ends the message; as a
        function it gets row and column of the first wrong pixel.
        """
        if wrong.any():
            row, column = np.argwhere(wrong)[0].tolist()
            end = detail if isinstance(detail, str) else detail((row, column))
            self.add(check, f"{array} {fault} in {count_pixels(wrong)}, the first at ({column}, {row}){end}")


def count_pixels(where: NDArray[np.bool_]) -> str:
    """Write the number of pixels that are set in a mask of any shape."""
    number = int(where.sum())
    return f"{number} pixel{'' if number == 1 else 's'}"


def format_vector(values: NDArray[np.floating]) -> str:
    """Write a vector (C,): a plain number, or several in parentheses."""
    numbers = ", ".join(f"{float(value):.6g}" for value in values)
    return numbers if len(values) == 1 else f"({numbers})"
