"""Times of the passes that the stages draw, visibility and readback of a pair consist of."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from semisynth_gl.frame.camera import EYES
from semisynth_gl.render.pass_clock import PASSES, PassName, PassSeconds

PASS_TEXTS: Mapping[PassName, str] = {
    "draw": "colour, disparity and surfaces, one sample a pixel",
    "edges": "outlines smoothed",
    "samples": "colour once more, several samples a pixel",
    "resolve": "one sample of several",
    "masks": "what the other eye sees",
    "correspondence": "where the other eye sees it, and whether, in pairs that are not rectified",
    "moment": "depth and surfaces at the other moment",
    "flow": "the way to the other moment",
    "read": "into arrays",
}


def pass_rows(pairs: Sequence[PassSeconds]) -> list[dict[str, Any]]:
    """Average the times of each pass of pairs: a row of each pass that ran, for each eye, in their order."""
    rows = []
    for name in PASSES:
        for eye in EYES:
            seconds = [pair[name, eye] for pair in pairs if (name, eye) in pair]
            if seconds:
                mean = float(np.sum(seconds)) / len(pairs)
                rows.append({"name": name, "eye": eye, "text": PASS_TEXTS[name], "seconds": mean})
    return rows


def clock_text(*, queries: bool) -> str:
    """Say whose clock timed the passes."""
    if queries:
        return "Passes by the GPU's own clock (timer queries), without a wait between them."
    return "Passes in CPU time, each finished before the next begins: timer queries of software are not to be trusted."
