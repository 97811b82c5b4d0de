"""The results of checks: findings, which are faults, and measured numbers."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.inputs.errors import counted


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault of a pair, or of the dataset as a whole.

    Attributes:
        scene: the pair's name, with its split in a dataset of several splits; or ``dataset``.
        check: name of the check, such as ``files``. The comparison with rays is named ``oracle``; any other check of
            one array is named after the array's channel.
        message: the fault, on one line.
    """

    scene: str
    check: str
    message: str

    def __str__(self) -> str:
        return f"{self.scene}: {self.check}: {self.message}"


@dataclass(slots=True)
class CheckResults:
    """The results of all checks of a pair, or of the dataset as a whole; ``scene`` is as in `Finding`.

    Findings are in the order of the checks. Measures are numbers by name; a measure's name ends in its unit.
    """

    scene: str
    findings: list[Finding] = field(default_factory=list)
    measures: dict[str, float] = field(default_factory=dict)

    def add(self, check: str, message: str) -> None:
        """Add a finding; line breaks become blanks."""
        self.findings.append(Finding(self.scene, check, " ".join(message.split())))

    def add_pixels(self, channel: str, eye: Eye, fault: str, wrong: NDArray[np.bool_]) -> None:
        """Add a finding if any pixel of an eye's channel is ``wrong`` (H, W); ``fault`` is a text such as "is NaN".

        The message has the number of wrong pixels, and column and row of the first.
        """
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            pixels = counted(int(wrong.sum()), "pixel")
            self.add(channel, f"{channel}_{eye} {fault} in {pixels}, the first at ({column}, {row})")
