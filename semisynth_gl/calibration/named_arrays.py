"""The arrays of a calibration: most kinds are recognised by values, the other kinds and the eyes by names.

Camera matrices, lenses and sizes may also be single numbers, such as fx and cx, k1 and p1, or vectors of them.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from semisynth_gl.calibration.tree import Array, Name, rotation_of_quaternion
from semisynth_gl.frame.camera import camera_matrix
from semisynth_gl.frame.raw_camera import rotation_of

LEFT, RIGHT = {"left", "l", "first"}, {"right", "r", "second"}
_ROTATIONS = r"rot|rvec|om\b|rodrigues|rmat|quat|orientation"
# Words after which a letter means an eye, as in mtxL and KR.
_BEFORE_A_LETTER = {
    *("k", "d", "m", "p", "r", "mtx", "dist", "cam", "mat", "matrix", "kc", "rot", "rect", "cm"),
    *("coeffs", "coefficients", "distortion", "intrinsic", "intrinsics"),
}
# Tolerance of values that are printed with six digits.
_PRINTED = 1e-4
_LARGEST = 1e9
COEFFICIENT_WORDS = "d$|dist|coef|kc|radtan|equidistant"
"""Beginnings of words in the names of lens coefficients, as a regular expression."""
# Names of image sizes, without separators; and beginnings of words in the names of other sizes.
_SIZE = r"(image|img|im|imager|frame)?size|(image)?resolution|srect|s|wh|(image)?dimensions?|((image|img)?shape|hw)"
_OTHER_SIZES = "board|pattern|chess|checker|grid|tag|marker|roi|crop"
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
# Names, without separators, of entries of K and D, of sides of images, and of vectors of these.
_ALIASES: dict[tuple[str, ...], str] = {
    ("fx",): "fx fcx focallengthx focalx flx mu fu focallengthpx focalpx f focal focallength",
    ("fy",): "fy fcy focallengthy focaly fly mv fv",
    ("cx",): "cx ccx ppx u0 cu principalpointx opticalcenterx px0",
    ("cy",): "cy ccy ppy v0 cv principalpointy opticalcentery py0",
    **{(name,): name for name in _COEFFICIENTS},
    ("width",): "width imagewidth imgwidth imagew w cols resx",
    ("height",): "height imageheight imgheight imageh h rows resy",
    ("fx", "fy", "cx", "cy"): "intrinsics intrinsic intrinsicsvector projectionparameters cameramatrix matrix k",
    ("fx", "fy"): "fc focallength focal focallengths",
    ("cx", "cy"): "cc principalpoint opticalcenter",
    ("k1", "k2"): "radialdistortion",
    ("k1", "k2", "k3"): "radialdistortion",
    ("p1", "p2"): "tangentialdistortion",
}
# Words beside an eye in names, as in fx_cam_left.
_CAMERAS = {"cam", "camera", "c", "sensor", "stereo", "eye"}
_PARTS = {(alias, len(parts)): parts for parts, aliases in _ALIASES.items() for alias in aliases.split()}


class NamedArray(NamedTuple):
    """An array of a tree, and its name."""

    name: Name
    value: Array

    @property
    def key(self) -> str:
        """The last part of the name that is not a number: its letters in lower case, without text in parentheses."""
        return re.sub(r"\(.*?\)|[^a-z]", "", last_part(self.name).lower())

    def has(self, beginnings: str) -> bool:
        """Return whether a word of the name begins with a match of a regular expression."""
        return any(re.match(beginnings, word) for word in words_of(self.name))

    @property
    def is_rotation(self) -> bool:
        """Whether the name means a rotation, but not angles."""
        return self.has(rf"r$|q$|qvec|{_ROTATIONS}") and not self.has("angle|euler|rpy|roll|deg")

    @property
    def is_translation(self) -> bool:
        """Whether the name means a translation. A lone letter r is allowed, since it may mean right."""
        is_named = self.has("tr$|trans(?!form)|trns|tvec|shift|position") or "t" in words_of((last_part(self.name),))
        return is_named and not self.has(_ROTATIONS)


def last_part(name: Name) -> str:
    """Return the last part of a name that is not a number; an empty text if all are numbers."""
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
    """Return which camera a name states: left, right, a number, one of two chosen names, or "" for none or both.

    In a rotation's name, a lone ``r`` means R; after a word such as ``rot``, or beside a second ``r``, it means right.
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
    return str(int(numbers[-1][-9:])) if numbers else ""  # Python converts at most 4,300 digits


def kind_of(named: NamedArray) -> tuple[str, Array] | None:
    """Return the kind of an array, and the array in that kind's shape; None for other arrays.

    Kinds are K, R (3, 3), P (3, 4), Q, pose (4, 4), T (3,), D (N,) in OpenCV's order, and size (2,), width first.
    """
    value = named.value.ravel()
    if not (np.abs(value) <= _LARGEST).all():  # written so that nan fails too
        return None
    return _kind_of_matrix(value) or _kind_by_name(named, value)


def _kind_of_matrix(value: Array) -> tuple[str, Array] | None:
    if value.size == 9:
        square = value.reshape(3, 3)
        return ("K", square) if is_camera_matrix(square) else ("R", square) if is_rotation(square) else None
    if value.size not in (12, 16):
        return None
    rows = value.reshape(-1, 4)
    if len(rows) == 3 and is_camera_matrix(rows[:, :3]):
        return "P", rows
    if len(rows) == 4 and rows[0, 0] == rows[1, 1] == 1 and rows[2, 3] > 1 and rows[3, 2] and not rows[2, :3].any():
        return "Q", rows
    is_pose = is_rotation(rows[:3, :3]) and np.allclose(rows[3:], (0, 0, 0, 1))
    return ("pose", np.vstack([rows[:3], (0, 0, 0, 1)])) if is_pose else None


def _kind_by_name(named: NamedArray, value: Array) -> tuple[str, Array] | None:
    count = value.size
    if count == 3 and named.is_translation:
        return "T", value
    if named.is_rotation and (rotation := _rotation(value)) is not None:
        return "R", rotation
    if max(named.value.shape, default=0) == count and count in (0, *range(4, 33)) and named.has(COEFFICIENT_WORDS):
        return "D", value
    if count == 3 and named.has("t$"):
        return "T", value
    if count in (2, 3, 4) and not named.has(_OTHER_SIZES) and (match := re.fullmatch(_SIZE, named.key)):
        return "size", value[:2][:: -1 if match[4] else 1]  # group 4 is a shape, which has the height first
    return None


def is_camera_matrix(k: Array) -> bool:
    """Return whether (3, 3) numbers are [fx s cx; 0 fy cy; 0 0 1]."""
    return bool(min(k[0, 0], k[1, 1]) > 1 and np.abs([k[1, 0], *(k[2] - (0, 0, 1))]).sum() < _PRINTED)


def is_rotation(r: Array) -> bool:
    """Return whether (3, 3) numbers are a rotation."""
    # No number of a rotation exceeds 1, and much larger numbers would overflow.
    small = np.abs(r).max() < 1 + _PRINTED
    return bool(small and np.allclose(r @ r.T, np.eye(3), atol=_PRINTED) and np.linalg.det(r) > 0)


def _rotation(value: Array) -> Array | None:
    """Return the rotation of a rotation vector, or of a quaternion whose w, which is near 1, is first or last."""
    if value.size == 3 and np.linalg.norm(value) < 2 * np.pi:
        x, y, z = value.tolist()
        return np.array(rotation_of((x, y, z)))
    if value.size == 4 and abs(np.linalg.norm(value) - 1) < 1e-3 and np.abs(value[[0, 3]]).max() > 0.9:
        return rotation_of_quaternion(value if abs(value[3]) > abs(value[0]) else np.roll(value, -1))
    return None


def by_columns(named_arrays: Sequence[NamedArray]) -> Sequence[NamedArray]:
    """Transpose all 3 x 3 matrices if K is stored for row vectors, as MATLAB stores it."""
    turned = [NamedArray(e.name, e.value.reshape(3, 3).T) if e.value.size == 9 else e for e in named_arrays]
    is_turned = (is_camera_matrix(e.value) and not is_camera_matrix(e.value.T) for e in turned if e.value.size == 9)
    return turned if any(is_turned) else named_arrays


def with_parts(named_arrays: Sequence[NamedArray]) -> Iterator[NamedArray]:
    """Yield the arrays, and those made of single numbers: a camera matrix of fx and cx, coefficients of k1 and k2."""
    groups: dict[tuple[Name, str], dict[str, float]] = {}
    for named in named_arrays:
        yield named
        # The last parts of a name may state only the camera, as in fx.left.
        keys = [_part_key(part, named.value.size) for part in named.name]
        index = max((index for index, (key, _) in enumerate(keys) if key), default=0)
        key, eye = keys[index]
        for part, number in zip(_PARTS.get((key, named.value.size), ()), named.value.ravel().tolist(), strict=False):
            group = named.name[:index] + named.name[index + 1 :], eye
            groups.setdefault(group, {}).setdefault(part, number)
    both = {name for name, eye in groups if eye}  # here, numbers without an eye belong to both eyes
    for (name, eye), own in groups.items():
        if eye or name not in both:
            yield from _made((*name, eye) if eye else name, groups.get((name, ""), {}) | own)


def _part_key(part: str, count: int) -> tuple[str, str]:
    """Return the key in `_PARTS` of a part of a name, and the word or number that states its eye; both may be empty."""
    words = [word for word in words_of((part,)) if word not in LEFT | RIGHT]
    eye = next((word for word in words_of((part,)) if word in LEFT | RIGHT), "")
    short = "".join(word for word in words if word not in _CAMERAS)
    for each in ("".join(words), short):
        for form in (r"(\d*)([a-z]+)(\d*)", r"(\d*)([a-z]+\d)(\d*)"):
            if (found := re.fullmatch(form, each)) and (found[2], count) in _PARTS:
                return found[2], eye or found[1] or found[3]
    return re.sub(r"\d", "", short), eye


def _made(name: Name, parts: Mapping[str, float]) -> Iterator[NamedArray]:
    if {"fx", "cx", "cy"} <= parts.keys():
        k = camera_matrix(parts["fx"], parts.get("fy", parts["fx"]), parts["cx"], parts["cy"])
        yield NamedArray((*name, "K"), k)
    if {"width", "height"} <= parts.keys():
        yield NamedArray((*name, "size"), np.array([parts["width"], parts["height"]]))
    coefficients = parts.keys() & {*_COEFFICIENTS}
    if {"k1", "k2", "p1"} <= coefficients:
        last = max(map(_COEFFICIENTS.index, coefficients))
        names = _COEFFICIENTS[: next(count for count in (4, 5, 8, 12) if count > last)]
        yield NamedArray((*name, "radtan"), np.array([parts.get(each, 0.0) for each in names]))
    elif coefficients in ({"k1", "k2", "k3", "k4"}, {"k2", "k3", "k4", "k5"}):
        yield NamedArray((*name, "equidistant"), np.array([parts[each] for each in sorted(coefficients)]))
