"""Finds the arrays of a rig in a tree of values.

Most arrays are told by their numbers: a camera matrix ends in 0 0 1, a rotation is orthonormal, a pose is a rotation
with a translation. Names tell the eye, and which of several arrays of a kind is meant.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from semisynth_gl.calibration.arrays import UNITS, EyeArrays, Size, StereoArrays, lens_of, unit_of
from semisynth_gl.calibration.kinds import (
    are_numbers,
    checked_size,
    is_camera_matrix,
    is_coefficients,
    is_pose,
    is_projection,
    is_reprojection,
    is_rotation,
    is_rotation_vector,
)
from semisynth_gl.calibration.names import ROTATION_WORDS, Entry, eye_of, last_word, starts, words_of
from semisynth_gl.calibration.parts import by_columns, with_parts
from semisynth_gl.calibration.poses import along_chain, between_eyes, by_name, from_body
from semisynth_gl.calibration.sizes import is_turned, stated_sizes
from semisynth_gl.calibration.tree import Array, FormatError, Name, Tree, text_of
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.raw_camera import rotation_of

KEYS = ("K1", "D1", "R1", "P1", "K2", "D2", "R2", "P2", "R", "T", "Q", "size")
"""Names that a user can give to values of a file: OpenCV's, and the size of the images."""

# Words of arrays that stand beside the ones meant: a matrix of the rectified images, an optimal one.
_REDERIVED = {"new", "optimal", "opt", "rect", "rectified", "rectification", "undistorted", "roi", "virtual"}
_SHIFT_WORDS = ("t", "tr", "trans", "trns", "tvec", "shift", "position")
# Words of angles about axes, which are no rotation vector.
_ANGLE_WORDS = ("angle", "euler", "rpy", "roll", "deg")
_LENS_WORDS = ("d", "dist", "coef", "kc", "radtan", "equidistant")
_BASELINES = ("baseline", "stereobaseline", "b", "bl")
# Relative differences of the translation's length and the baseline of P: up to the first one both say the same, from
# the second one on the translation is of something else.
_SAME_BASELINE, _MOST_BASELINE = 0.02, 0.8
_LISTED = 40


_Pair = tuple[Array, Array]


class Finder:
    """The arrays of a rig in one tree.

    Args:
        tree: the values.
        given: names in the tree by `KEYS`, which the user gives.
        cameras: the left and the right camera by name or number, where there are more than two; None for any.
        unit: unit of the translation; None for the likeliest.
        size: size of the images, where the tree does not say it.
    """

    def __init__(
        self,
        tree: Tree,
        given: Mapping[str, str],
        cameras: tuple[str, str] | None,
        unit: str | None,
        size: Size | None,
    ) -> None:
        self.tree, self.unit, self.user_size = tree, unit, size
        self.cameras: tuple[str, str] | None = None
        if cameras is not None:
            left, right = (eye_of((each,)) or each for each in cameras)
            self.cameras = left, right
        arrays = [Entry(name, value) for name, value in tree.items() if isinstance(value, np.ndarray)]
        self.entries = [*with_parts(by_columns(arrays))]
        self.given = {key: self._named(key, name) for key, name in given.items()}
        self.notes: list[str] = []
        self.lens_fault: str | None = None

    def arrays(self, source: str) -> StereoArrays | None:
        """Return the arrays that the tree has of a rig; None where they make no rig.

        Raises:
            FormatError: where there are more than two cameras, or what is there contradicts itself.
        """
        self._check_windows()
        k, p = self._eyes("K", is_camera_matrix, 3), self._eyes("P", is_projection, 3)
        size = self._size(k, p)
        p = p or self._right_alone()
        rotation, shift = self._stereo_pose()
        turns = self._eyes("R", is_rotation, 3, rotation=True)
        if p is None and rotation is None:
            p, k = self._projections(k, turns)
        if p is None and k is None and rotation is not None:
            k = self._shared("K", is_camera_matrix)
        if p is None and (k is None or rotation is None or shift is None):
            return None
        moved_m, p = self._in_metres(shift, p)
        lenses = self._lenses(k, size, required=p is None)
        eyes = [
            replace(
                lens,
                k=None if k is None else k[number],
                r=None if turns is None or p is None else turns[number],
                p=None if p is None else p[number],
            )
            for number, lens in enumerate(lenses)
        ]
        return StereoArrays(source, eyes[0], eyes[1], size, rotation, moved_m, notes=tuple(self.notes))

    def check_lenses(self) -> None:
        """Raise FormatError where the tree names a lens that is not read."""
        lens_of(None, (value for value in self.tree.values() if isinstance(value, str)))

    def listing(self) -> str:
        """Return the arrays of the tree with their shapes, as text for a message."""
        arrays = [(name, value) for name, value in self.tree.items() if isinstance(value, np.ndarray)]
        shown = [
            f"{text_of(name)} ({' x '.join(map(str, value.shape)) or 'a number'})" for name, value in arrays[:_LISTED]
        ]
        more = f" and {len(arrays) - _LISTED} more" if len(arrays) > _LISTED else ""
        return (", ".join(shown) + more) or "no numbers"

    def _named(self, key: str, name: str) -> Array:
        for entry in self.entries:
            if text_of(entry.name) == name:
                return entry.value
        raise FormatError(f"has no {name}, which {key} was to be: it has {self.listing()}")

    def _projections(self, k: _Pair | None, turns: _Pair | None) -> tuple[_Pair | None, _Pair | None]:
        """Return the projections that follow from a baseline or from Q, and the raw cameras' matrices beside them."""
        # OpenVSLAM's and Stella's K is of the rectified cameras, beside both raw ones and how they were turned.
        middle = self._one("K", is_camera_matrix)
        if turns is not None and middle is not None and eye_of(middle.name) == "":
            return self._plain(None), k
        if (plain := self._plain(k)) is not None:
            self.notes += [
                f"{text_of(e.name)} was left out: with a baseline and without R, images are taken to be rectified"
                for e in self._of("D", is_coefficients, _LENS_WORDS).values()
                if e.value.any()
            ]
            return plain, None
        q = self._one("Q", is_reprojection)
        return (None if q is None else _from_q(q.value.reshape(4, 4))), k

    def _lenses(self, k: _Pair | None, size: Size | None, *, required: bool) -> list[EyeArrays]:
        """Return both eyes with their lenses, or with what is wrong with these; raises FormatError if ``required``."""
        if k is None or self.lens_fault is not None:
            return [EyeArrays(fault=None if k is None else self.lens_fault)] * 2
        found = self._eyes("D", is_coefficients, 1, words=_LENS_WORDS)
        found = found or self._other_coefficients(shared=k[0] is k[1])
        eyes = []
        for number, (own, stated) in enumerate(zip(k, found or (None, None), strict=True)):
            try:
                d, model, note = lens_of(stated, self._lens_names(EYES[number], number), own, size or self.user_size)
            except FormatError as error:
                if required:
                    raise
                eyes.append(EyeArrays(fault=str(error)))
                continue
            self.notes += [note] if note and note not in self.notes else []
            eyes.append(EyeArrays(d=d, model=model))
        return eyes

    def _lens_names(self, eye: str, number: int) -> Iterator[str]:
        """Yield what the tree calls the lens of an eye, and the model that the names of its values tell."""
        kind = {"model", "type", "lens", "lensmodel", "distortion", "projection"}
        labels = self._labels(("left", "right")) if self.cameras is None else self.cameras
        for name, value in self.tree.items():
            if isinstance(value, str) and kind & set(words_of(name[-1:])) and eye_of(name) in {"", eye, labels[number]}:
                yield value
            is_switch = isinstance(value, str) or value.size == 1
            if not is_switch and {"fisheye", "equidistant"} & set(words_of(name)):
                yield "fisheye"
        for entry in self.entries:
            if entry.key in {"radtan", "equidistant"} and eye_of(entry.name) in {"", eye, labels[number]}:
                yield entry.key

    def _labels(self, default: tuple[str, str]) -> tuple[str, str]:
        """Return what the tree calls its two cameras."""
        numbers = sorted({int(eye) for e in self.entries if e.value.size > 1 and (eye := eye_of(e.name)).isdigit()})
        return (str(numbers[0]), str(numbers[1])) if len(numbers) >= 2 else default

    def _of(
        self, key: str, fits: Callable[[Array], bool], words: Sequence[str] = (), *, rotation: bool = False
    ) -> dict[str, Entry]:
        """Return the entries of a kind by eye or number of the camera, the likeliest of each."""
        found: dict[str, Entry] = {}
        fitting = [e for e in self.entries if fits(e.value) and (not words or starts(e.words, words))]
        for entry in sorted(fitting, key=lambda e: (bool(_REDERIVED & set(e.words)) == (key in "KD"), len(e.name))):
            found.setdefault(eye_of(entry.name, rotation=rotation), entry)
        return found

    def _eyes(
        self,
        key: str,
        fits: Callable[[Array], bool],
        rows: int,
        words: Sequence[str] = (),
        *,
        rotation: bool = False,
    ) -> _Pair | None:
        """Return the left and the right eye's array of a kind, each with ``rows`` rows; None where one is missing."""
        given = [self.given.get(f"{key}{number}") for number in "12"]
        found = self._of(key, fits, words, rotation=rotation)
        pair = self._pair(found, key)
        arrays = []
        for own, entry in zip(given, pair or (None, None), strict=True):
            value = own if own is not None else None if entry is None else entry.value
            if value is None:
                return None
            arrays.append(value.ravel() if rows == 1 else value.reshape(rows, -1))
        return arrays[0], arrays[1]

    def _pair(self, found: Mapping[str, Entry], key: str) -> tuple[Entry, Entry] | None:
        if self.cameras is not None:
            left, right = (found.get(each) or self._by_word(each, found) for each in self.cameras)
            return None if left is None or right is None else (left, right)
        if {"left", "right"} <= found.keys():
            return found["left"], found["right"]
        numbered = sorted((int(label), entry) for label, entry in found.items() if label.isdigit())
        if len(numbered) > 2 and key in {"K", "P"}:
            names = ", ".join(text_of(entry.name) for _, entry in numbered)
            raise FormatError(f"has {len(numbered)} cameras ({names}): choose two, --pair LEFT,RIGHT or cameras")
        return (numbered[0][1], numbered[1][1]) if len(numbered) >= 2 else None

    def _by_word(self, name: str, found: Mapping[str, Entry]) -> Entry | None:
        return next((entry for entry in found.values() if name.lower() in map(str.lower, entry.name)), None)

    def _one(self, key: str, fits: Callable[[Array], bool], words: Sequence[str] = ()) -> Entry | None:
        """Return the entry of a kind that is of both eyes."""
        if key in self.given:
            return Entry((key,), self.given[key])
        fitting = [e for e in self.entries if fits(e.value) and (not words or starts(e.words, words))]
        unlabelled = [e for e in fitting if eye_of(e.name, rotation=key == "R") == ""]
        return min(unlabelled or fitting, key=lambda e: len(e.name), default=None)

    def _stereo_pose(self) -> tuple[Array | None, Array | None]:
        """Return R (3, 3) and T (3,), right_from_left, in the file's unit; None for what is not there."""
        turned, moved = self._rotations(), self._shifts()
        if {"R", "T"} & self.given.keys():
            r = self.given.get("R", turned[""].value if "" in turned else None)
            t = self.given.get("T", moved[""].value if "" in moved else None)
            return None if r is None else _rotation(r), None if t is None else t.ravel()
        if "" in turned and "" in moved:
            return by_name(moved[""].name, turned[""].value, moved[""].value)
        poses = {e.name: e.value.reshape(-1, 4)[:3] for e in self.entries if is_pose(e.value)}
        if (found := along_chain(poses, self.cameras) or between_eyes(poses, self.cameras)) is not None:
            return found
        return self._against_others(poses, turned, moved)

    def _against_others(
        self, poses: Mapping[Name, Array], turned: Mapping[str, Entry], moved: Mapping[str, Entry]
    ) -> tuple[Array | None, Array | None]:
        """Return R and T, right_from_left, from poses, or rotations and translations, against a body or a camera."""
        groups: dict[str, dict[str, Entry]] = {}
        for name, pose in poses.items():
            groups.setdefault(_stem(name), {}).setdefault(eye_of(name), Entry(name, pose))
        labels = [label for label in moved if label in turned]
        groups["R and T"] = {
            label: Entry(moved[label].name, np.hstack([turned[label].value, moved[label].value[:, None]]))
            for label in labels
        }
        for group in groups.values():
            if (pair := self._pair(group, "pose")) is not None:
                return from_body(*pair)
        # Calibrations of one camera against the other keep R and T beside the second camera; "rotation (R)" is no eye.
        if not labels and len(turned) == len(moved) == 1 and "" in moved:
            return next(iter(turned.values())).value, moved[""].value
        return (turned[labels[0]].value, moved[labels[0]].value) if len(labels) == 1 else (None, None)

    def _rotations(self) -> dict[str, Entry]:
        """Return rotations (3, 3) that do not rectify, by eye: matrices rather than vectors."""
        found: dict[str, Entry] = {}
        for entry in sorted(self.entries, key=lambda e: e.value.size != 9):
            named = starts(entry.words, ("r", *ROTATION_WORDS)) and not starts(entry.words, _ANGLE_WORDS)
            fits = is_rotation(entry.value) or (named and is_rotation_vector(entry.value))
            if fits and not starts(entry.words, ("rect", "rectif")):
                turned = Entry(entry.name, _rotation(entry.value))
                found.setdefault(eye_of(entry.name, rotation=True), turned)
        return found

    def _shifts(self) -> dict[str, Entry]:
        """Return translations (3,) by eye."""
        found: dict[str, Entry] = {}
        for entry in (e for e in self.entries if are_numbers(e.value, 3)):
            if starts(entry.words, _SHIFT_WORDS) and not starts(entry.words, ROTATION_WORDS):
                found.setdefault(eye_of(entry.name), Entry(entry.name, entry.value.ravel()))
        return found

    def _shared(self, key: str, fits: Callable[[Array], bool], words: Sequence[str] = ()) -> _Pair | None:
        """Return the only array of a kind for both eyes."""
        found = self._of(key, fits, words)
        if len(found) != 1:
            return None
        ((_, entry),) = found.items()
        self.notes.append(f"{text_of(entry.name)} was taken for both cameras, since no other {key} was found")
        value = entry.value.reshape(3, 3) if key == "K" else entry.value.ravel()
        return value, value

    def _other_coefficients(self, *, shared: bool) -> _Pair | None:
        """Return the coefficients that both eyes share; raises FormatError where they are of one eye, or too few."""
        named = [e for e in self.entries if starts(e.words, _LENS_WORDS) and e.value.size > 1]
        if not named:
            self.notes.append("no coefficients of lenses were found: the cameras are taken for pinholes")
            return None
        if shared or {eye_of(entry.name) for entry in named} == {""}:
            return self._shared("D", is_coefficients, _LENS_WORDS)
        raise FormatError(
            f"{text_of(named[-1].name)}: expected 4, 5, 8, 12 or 14 coefficients of both lenses, got "
            f"{', '.join(f'{entry.value.size} in {text_of(entry.name)}' for entry in named[:2])}"
        )

    def _right_alone(self) -> _Pair | None:
        """Return the projections where only the right eye's is stated, which holds the baseline."""
        entries = [entry for entry in self.entries if is_projection(entry.value)]
        found = [entry.value.reshape(3, 4) for entry in entries]
        lefts = {"left"} if self.cameras is None else {self.cameras[0]}
        if len(found) != 1 or found[0][0, 3] == 0 or eye_of(entries[0].name) in lefts:
            return None
        left = found[0].copy()
        left[:, 3] = 0
        return left, found[0]

    def _plain(self, k: _Pair | None) -> _Pair | None:
        """Return the projections of rectified cameras of which camera matrix and baseline are stated."""
        if k is None:
            alone = self._one("K", is_camera_matrix)
            if alone is None:
                return None
            k = alone.value.reshape(3, 3), alone.value.reshape(3, 3)
        baseline = self._baseline(float(k[0][0, 0]))
        if baseline is None:
            return None
        left, right = (np.hstack([each, np.zeros((3, 1))]) for each in k)
        right[0, 3] = -right[0, 0] * baseline
        return left, right

    def _baseline(self, fx: float) -> float | None:
        """Return the baseline in the file's unit, by its name, or as the only number beside a matrix of bare rows."""
        for entry in self.entries:
            if not are_numbers(entry.value, 1):
                continue
            value, key = abs(float(entry.value.ravel()[0])), re.sub(r"[^a-z]", "", entry.key.lower())
            stem = next((unit for unit in ("meters", "metres", "mm", "cm", "m") if key == f"baseline{unit}"), None)
            if key in _BASELINES or stem is not None or re.fullmatch(r"rows \d+", entry.key):
                self.unit = self.unit or (None if stem is None else stem if stem in UNITS else "m")
                return value
            if key in {"bf", "fb", "focalxbaseline"}:
                return value / fx
        return None

    def _in_metres(self, shift: Array | None, p: _Pair | None) -> tuple[Array | None, _Pair | None]:
        """Return the translation and the projections in metres; where their baselines differ, the translation's counts.

        DrivingStereo's small images have projections of twice the baseline.
        """
        moved_m = None if shift is None else shift.ravel() * self._factor(float(np.linalg.norm(shift)))
        if p is None:
            return moved_m, None
        left, right = (each[0, 3] / each[0, 0] for each in p)
        factor = self._factor(abs(left - right), noted=moved_m is None)
        baseline_m = abs(left - right) * factor
        length_m = 0.0 if moved_m is None else float(np.linalg.norm(moved_m))
        if _SAME_BASELINE < abs(length_m / (baseline_m or np.inf) - 1) < _MOST_BASELINE:
            self.notes.append(
                f"the cameras are {baseline_m:.6g} m apart by P, and {length_m:.6g} m by T, which was taken: if P is "
                "right, leave T out"
            )
            factor *= length_m / baseline_m
        scale = np.array([1, 1, 1, factor])
        return moved_m, (p[0] * scale, p[1] * scale)

    def _factor(self, length: float, *, noted: bool = True) -> float:
        """Return metres per unit of a length."""
        if self.unit is not None:
            return UNITS[self.unit]
        unit = unit_of(length)
        if unit != "m" and noted:
            self.notes.append(
                f"the cameras are {length:g} apart, which was taken for {unit}: if that is wrong, give --unit"
            )
        return UNITS[unit]

    def _check_windows(self) -> None:
        """Refuse messages of ROS whose images are binned, or a window of the calibrated images."""
        for entry in self.entries:
            if entry.key in {"binning_x", "binning_y"} and entry.value.size == 1 and entry.value > 1:
                raise FormatError(
                    f"{text_of(entry.name)} is {entry.value:g}: binned images are smaller than the calibrated ones. "
                    "Take images without binning; or, if both sides are binned alike, write 1 here and give the scale"
                )
            if entry.key in {"x_offset", "y_offset"} and "roi" in entry.name and entry.value.any():
                raise FormatError(
                    f"{text_of(entry.name)} is {entry.value:g}: the images are a window of the calibrated images. "
                    "Take whole images; or write 0 here, and subtract the offsets from cx and cy of P"
                )

    def _size(self, k: _Pair | None, p: _Pair | None) -> Size | None:
        """Return the size of the images, by the principal points of K and P where its sides may be in any order."""
        if "size" in self.given:
            return checked_size(*self.given["size"].ravel()[:2])
        matrices = [*(k or ()), *(p or ())]
        of_rectified, of_raw = stated_sizes(self.entries, self.cameras, matrices)
        if p is not None and of_rectified and of_raw and of_rectified[0] != of_raw[0]:
            self.lens_fault = f"expected raw images of {of_rectified[0]}, as rectified ones, got {of_raw[0]}"
        known = [*dict.fromkeys((of_raw or of_rectified) if p is None else (of_rectified or of_raw))]
        if len(known) > 1:
            raise FormatError(f"has images of {known[0]} and of {known[1]}: expected one size of both cameras")
        if known and self.user_size == tuple(reversed(known[0])) and is_turned(known[0], matrices):
            self.notes.append(f"its size, {known[0]}, was taken for height and width, as the photographs are")
            return self.user_size
        return known[0] if known else None


def _rotation(value: Array) -> Array:
    """Return a rotation (3, 3) from nine numbers, or from a vector of three."""
    if value.size == 9:
        return value.reshape(3, 3)
    x, y, z = value.ravel().tolist()
    return np.array(rotation_of((x, y, z)))


def _stem(name: Name) -> str:
    """Return the last word of a name without its eye, so that the names of both eyes' arrays give the same."""
    return re.sub(r"\d+|left|right", "", last_word(name).lower())


def _from_q(q: Array) -> tuple[Array, Array]:
    """Return the projections that OpenCV's Q (4, 4) inverts."""
    focal, baseline = q[2, 3], abs(1 / q[3, 2])
    left = np.array([[focal, 0, -q[0, 3], 0], [0, focal, -q[1, 3], 0], [0, 0, 1, 0]])
    right = left.copy()
    # Q's last row ends in -1 / Tx and (cx - cx') / Tx.
    right[0, 2] += q[3, 3] / q[3, 2]
    right[0, 3] = -focal * baseline
    return left, right
