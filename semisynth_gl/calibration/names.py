"""Names of a calibration's values, in words: they tell the eye, and which of several arrays of a kind is meant."""

import re
from typing import NamedTuple

from semisynth_gl.calibration.tree import Array, Name

LEFT, RIGHT = {"left", "l", "first"}, {"right", "r", "second"}
_ROTATIONS = r"rot|rvec|om\b|rodrigues|rmat|quat|orientation"
# Words that an eye's letter may end, as in mtxL and KR.
_BEFORE_A_LETTER = {
    *("k", "d", "m", "p", "r", "mtx", "dist", "cam", "mat", "matrix", "kc", "rot", "rect", "cm"),
    *("coeffs", "coefficients", "distortion", "intrinsic", "intrinsics"),
}


class Entry(NamedTuple):
    """One array of a tree under its name."""

    name: Name
    value: Array

    @property
    def key(self) -> str:
        """The last part of the name that is no number, in lower-case letters, without what is in parentheses."""
        return re.sub(r"\(.*?\)|[^a-z]", "", last_part(self.name).lower())

    def has(self, beginnings: str) -> bool:
        """Return whether a word of the name begins as a regular expression says."""
        return any(re.match(beginnings, word) for word in words_of(self.name))

    @property
    def is_rotation(self) -> bool:
        """Whether the name is one of a rotation, and of no angles."""
        return self.has(rf"r$|q$|qvec|{_ROTATIONS}") and not self.has("angle|euler|rpy|roll|deg")

    @property
    def is_translation(self) -> bool:
        """Whether the name is one of a translation, and of no rotation but for a letter r, which may mean right."""
        is_named = self.has("tr$|trans(?!form)|trns|tvec|shift|position") or "t" in words_of((last_part(self.name),))
        return is_named and not self.has(_ROTATIONS)


def last_part(name: Name) -> str:
    """Return the last part of a name that is no number; empty for none."""
    return next((part for part in reversed(name) if not part.isdigit()), "")


def words_of(name: Name) -> list[str]:
    """Return a name's words in lower case: ``("cameraMatrixL", "1")`` gives camera, matrix, l, 1."""
    words: list[str] = []
    for part in name:
        spaced = re.sub("LEFT|RIGHT", r" \g<0> ", part)  # as in KLEFT
        for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", spaced):
            lower = word.lower()
            words += [lower[:-1], lower[-1]] if lower[-1] in "lr" and lower[:-1] in _BEFORE_A_LETTER else [lower]
    return words


def label_of(name: Name, cameras: tuple[str, str] | None = None, *, rotation: bool = False) -> str:
    """Return which camera a name is of: left, right, a number, one of two chosen names, or "" for none or both.

    In a rotation's name, a lone ``r`` means R. It means right after a word such as ``rot``, or beside a second ``r``.
    """
    for each in cameras or ():
        if not each.isdigit() and each.lower() in map(str.lower, name):
            return each
    words = words_of(name)
    left, right = bool(LEFT & {*words}), bool(RIGHT - {"r"} & {*words})
    means_rotation = rotation and not re.search(rf"\b(rect\b|{_ROTATIONS}).* r\b", " ".join(words))
    right = right or words.count("r") > means_rotation
    if left or right:
        return "" if left and right else "left" if left else "right"
    numbers = next((numbers for part in reversed(name) if (numbers := re.findall(r"\d+", part))), [])
    return str(int(numbers[-1])) if numbers else ""
