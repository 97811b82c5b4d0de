"""What a check finds, and what it measured on the way."""

from dataclasses import dataclass, field

DATASET = "dataset"
"""Stands for the scene's name in findings about the whole dataset."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault.

    Attributes:
        scene: the scene's name, or `DATASET`.
        check: the check that found it, a word or two.
        message: what was expected and what came, with numbers, on one line.
    """

    scene: str
    check: str
    message: str

    def __str__(self) -> str:
        return f"{self.scene}: {self.check}: {self.message}"


@dataclass(slots=True)
class Verdict:
    """All that was found in one scene, or in the dataset as a whole.

    Attributes:
        scene: the scene's name, or `DATASET`.
        findings: faults, in the order of the checks.
        measures: what the checks measured, by name; the unit is part of the name.
    """

    scene: str
    findings: list[Finding] = field(default_factory=list)
    measures: dict[str, float] = field(default_factory=dict)

    def add(self, check: str, message: str) -> None:
        """Add a finding; line breaks become blanks."""
        self.findings.append(Finding(self.scene, check, " ".join(message.split())))
