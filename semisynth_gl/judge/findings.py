"""Findings: the faults that checks report, and the numbers that they measure."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.inputs.errors import counted

DATASET = "dataset"
"""The scene's name in findings about the dataset itself."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a scene, or of the `DATASET`.

    Attributes:
        scene: name of the pair's scene, with its split in a dataset of several splits; or `DATASET`.
        check: name of the check; a check of one array is named after the array's channel.
        message: the fault, on one line.
    """

    scene: str
    check: str
    message: str

    def __str__(self) -> str:
        return f"{self.scene}: {self.check}: {self.message}"


@dataclass(slots=True)
class Verdict:
    """The results of all checks of one scene, or of the `DATASET`.

    Findings are in the order of the checks. Measures are numbers by name; a measure's name ends in its unit.
    """

    scene: str
    findings: list[Finding] = field(default_factory=list)
    measures: dict[str, float] = field(default_factory=dict)

    def add(self, check: str, message: str) -> None:
        """Add a finding; line breaks become blanks."""
        self.findings.append(Finding(self.scene, check, " ".join(message.split())))

    def add_pixels(self, channel: str, eye: Eye, fault: str, wrong: NDArray[np.bool_]) -> None:
        """Add a finding if any pixel (H, W) of an eye's channel is ``wrong``; the ``fault`` is text such as "is NaN".

        The finding has the number of these pixels and the position of the first.
        """
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            pixels = counted(int(wrong.sum()), "pixel")
            self.add(channel, f"{channel}_{eye} {fault} in {pixels}, the first at ({column}, {row})")
