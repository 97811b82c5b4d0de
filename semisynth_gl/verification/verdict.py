"""Findings: the faults that checks report, and the measurements behind them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

DATASET = "dataset"
"""Stands for the scene's name in findings about the dataset itself."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault.

    Attributes:
        scene: the scene's name, or `DATASET`.
        check: the name of the check that reports it, a word or two.
        message: what was expected and what came, with numbers, on one line.
    """

    scene: str
    check: str
    message: str

    def __str__(self) -> str:
        return f"{self.scene}: {self.check}: {self.message}"


@dataclass(slots=True)
class Verdict:
    """The results of all checks of one scene, or of the dataset itself.

    Attributes:
        scene: the scene's name, or `DATASET`.
        findings: faults, in the order of the checks.
        measures: measured numbers by name; the unit is part of the name.
    """

    scene: str
    findings: list[Finding] = field(default_factory=list)
    measures: dict[str, float] = field(default_factory=dict)

    def add(self, check: str, message: str) -> None:
        """Add a finding; line breaks become blanks."""
        self.findings.append(Finding(self.scene, check, " ".join(message.split())))

    def add_pixels(self, check: str, array: str, fault: str, wrong: NDArray[np.bool_], detail: str = "") -> None:
        """Add a finding with the number of an array's wrong pixels and the first of them, if there is any.

        Args:
            check: the name of the check.
            array: the name of the array.
            fault: the sentence from its verb to "in 12 pixels", such as "is NaN".
            wrong: (H, W) bool.
            detail: the end of the message.
        """
        if wrong.any():
            y, x = np.argwhere(wrong)[0]
            self.add(check, f"{array} {fault} in {count_pixels(wrong)}, the first at ({x}, {y}){detail}")


def count_pixels(where: NDArray[np.bool_]) -> str:
    """Write the number of pixels that are set in a mask of any shape."""
    number = int(where.sum())
    return f"{number} pixel{'' if number == 1 else 's'}"


def format_vector(values: NDArray[np.floating]) -> str:
    """Write a vector (C,): a plain number, or several in parentheses."""
    numbers = ", ".join(f"{float(value):.6g}" for value in values)
    return numbers if len(values) == 1 else f"({numbers})"
