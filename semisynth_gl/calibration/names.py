"""Names of a calibration's values, in words: they tell the eye, and which of several arrays of a kind is meant."""

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from semisynth_gl.calibration.tree import Array, Name

LEFT, RIGHT = {"left", "l", "first"}, {"right", "r", "second"}
ROTATION_WORDS = ("rot", "rvec", "om", "rodrigues", "rmat")
# Words that an eye's letter may end, as in mtxL and KR.
_BEFORE_A_LETTER = {"k", "d", "m", "p", "r", "mtx", "dist", "cam", "matrix", "coeffs", "kc", "rot", "cm"}


class Entry(NamedTuple):
    """One array of a tree under its name."""

    name: Name
    value: Array

    @property
    def words(self) -> tuple[str, ...]:
        """The name in lower-case words; numbers are words, and an eye's letter at the end of a word is one."""
        return words_of(self.name)

    @property
    def key(self) -> str:
        """The last part of the name."""
        return self.name[-1] if self.name else ""


def words_of(name: Name) -> tuple[str, ...]:
    """Return a name's words: ``("cameraMatrixL",)`` gives camera, matrix, l."""
    words: list[str] = []
    for part in name:
        for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", part):
            lower = word.lower()
            words += [lower[:-1], lower[-1]] if lower[-1] in "lr" and lower[:-1] in _BEFORE_A_LETTER else [lower]
    return tuple(words)


def eye_of(name: Name, *, rotation: bool = False) -> str:
    """Return ``"left"``, ``"right"``, the number of the camera that a name says, or "" for none or both."""
    words = words_of(name)
    left, right = bool(LEFT & set(words)), bool(RIGHT - {"r"} & set(words))
    # The r of a rotation is its own name, unless another word says so, or there are two.
    right = right or words.count("r") > (rotation and not starts(words, ROTATION_WORDS))
    if left or right:
        return "" if left and right else "left" if left else "right"
    numbers = next((numbers for part in reversed(name) if (numbers := re.findall(r"\d+", part))), [])
    return str(int(numbers[-1])) if numbers else ""


def label_of(name: Name, cameras: tuple[str, str] | None, *, rotation: bool = False) -> str:
    """Return which camera a name is of: one of two chosen by a name of their own, else what `eye_of` says."""
    named = (each for each in cameras or () if not each.isdigit() and each.lower() in map(str.lower, name))
    return next(named, None) or eye_of(name, rotation=rotation)


def starts(words: Iterable[str], beginnings: Sequence[str]) -> bool:
    """Return whether a word is one of those of one letter or two, or begins with a longer one."""
    return any(word == each or (len(each) > 2 and word.startswith(each)) for word in words for each in beginnings)
