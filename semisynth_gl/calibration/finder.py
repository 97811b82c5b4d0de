"""Finds the arrays of a rig in a tree of values.

Most arrays are told by their numbers: a camera matrix ends in 0 0 1, a rotation is orthonormal, a pose is a rotation
with a translation. Names tell the eye, and which of several arrays of a kind is meant.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from semisynth_gl.calibration.arrays import (
    UNITS,
    Lens,
    Pair,
    StereoArrays,
    camera_matrix,
    make_lens,
    models_of,
    projections,
    unit_of,
)
from semisynth_gl.calibration.kinds import KINDS, Size, are_numbers, is_pose, is_rotation, stated_sizes
from semisynth_gl.calibration.names import Entry, label_of, words_of
from semisynth_gl.calibration.parts import by_columns, with_parts
from semisynth_gl.calibration.poses import frames_of, more_rightwards, pose_of, right_from_left
from semisynth_gl.calibration.tree import Array, FormatError, Name, Tree, rotation_of_quaternion
from semisynth_gl.frame.raw_camera import rotation_of
from semisynth_gl.inputs.errors import abbreviate

KEYS = ("K1", "D1", "R1", "P1", "K2", "D2", "R2", "P2", "R", "T", "Q", "size")
"""Names that a user can give to values of a file: OpenCV's, and the size of the images."""

_GIVEN = "given"
# Words in names of derived arrays, such as the matrix of rectified images, which lie beside the calibrated ones.
_DERIVED = "new|opt|rect|undist|roi|virtual"
_BASELINE = r"(?:stereo)?baseline(?:lr)?(mm|cm|m|meters|metres)?|b|bl|numbers"
# Relative tolerance for equal baselines; translations up to this length count as zero.
_SAME_BASELINE, _NO_SHIFT_M = 0.02, 1e-6
_LISTED = 40


class Given(NamedTuple):
    """What a user says of a calibration: names of values by `KEYS`, two of several cameras, the unit and the size."""

    keys: Mapping[str, str]
    cameras: tuple[str, str] | None
    unit: str | None
    size: Size | None


class Finder:
    """The arrays of a rig in one tree."""

    def __init__(self, tree: Tree, given: Given) -> None:
        self.tree, self.unit, self.user_size, cameras = tree, given.unit, given.size, given.cameras
        self.cameras = cameras and (label_of(cameras[:1]) or cameras[0], label_of(cameras[1:]) or cameras[1])
        arrays = [Entry(name, value) for name, value in tree.items() if isinstance(value, np.ndarray)]
        self.poses = {e.name: np.vstack([e.value.reshape(-1, 4)[:3], [0, 0, 0, 1]]) for e in arrays if is_pose(e.value)}
        self.values = {name: value for name, value in tree.items() if self._is_of_rig(name)}
        self.entries = [*with_parts(by_columns([each for each in arrays if each.name in self.values]))]
        self.entries = [*(self._named(key, name) for key, name in given.keys.items()), *self.entries]
        self.notes: list[str] = []

    def arrays(self) -> StereoArrays | None:
        """Return the arrays that the tree has of a rig; None where they make no rig.

        Raises:
            FormatError: where there are more than two cameras, or what is there contradicts itself.
        """
        k, p = self._eyes("K"), self._eyes("P")
        size, fault = self._size(k, p)
        p = p or self._right_alone()
        turn, shift = self._stereo_pose(lone=p is None)
        rectification = self._eyes("R")
        if p is None and turn is None:
            p, k = self._projections(k, rectification)
        if k is not None and k[0] is k[1] and turn is not None:
            self.notes.append("one K was taken for both cameras")
        if p is None and (k is None or shift is None):
            return None
        shift_m, p = self._in_metres(shift, p)
        lenses = None
        if k is not None and fault is None:
            try:
                lenses = self._lenses(k, size or self.user_size)
            except FormatError as error:
                if p is None:
                    raise
                fault = str(error)
        rectification, fault = (None if p is None else rectification), (None if k is None else fault)
        return StereoArrays(size, k, lenses, turn, shift_m, rectification, p, fault, notes=tuple(self.notes))

    def _is_of_rig(self, name: Name) -> bool:
        return self.cameras is None or label_of(name, self.cameras, rotation=True) in {"", *self.cameras}

    def _named(self, key: str, name: str) -> Entry:
        """Return an array that the user named, under a name that tells its kind and its eye."""
        found = next((entry.value for entry in self.entries if ".".join(entry.name) == name), None)
        if found is None:
            raise FormatError(f"has no {name}, which {key} was to be: it has {listing(self.tree)}")
        labels = self.cameras or ("left", "right")
        eye = [labels[int(key[-1]) - 1]] if key[-1].isdigit() else []
        return Entry((_GIVEN, *eye, key.rstrip("12")), found)

    # --- arrays of both eyes ---

    def _fitting(self, key: str) -> list[Entry]:
        """Return the entries of a kind, the likeliest first."""
        kind = KINDS[key]
        found = (e for e in self.entries if kind.fits(e.value) and (not kind.words or e.has(kind.words)))
        return sorted(
            (Entry(e.name, e.value.reshape(kind.shape)) for e in found),
            key=lambda e: (e.name[0] != _GIVEN, e.has(_DERIVED) == (key in "KD"), len(e.name)),
        )

    def _of(self, key: str) -> dict[str, Array]:
        """Return the arrays of a kind by eye or number of the camera."""
        found: dict[str, Array] = {}
        for entry in self._fitting(key):
            found.setdefault(label_of(entry.name, self.cameras, rotation=key == "R"), entry.value)
        return found

    def _eyes(self, key: str) -> Pair | None:
        """Return two arrays of a kind, left and right; None if the tree lacks either. The only K or D is of both."""
        found = self._of(key)
        numbered = sorted((label for label in found if label.isdigit()), key=int)
        left, right = self.cameras or ("left", "right")
        if self.cameras is None and len(numbered) > 1 and not {"left", "right"} <= found.keys():
            if len(numbered) > 2 and key in "KP":
                labels = ", ".join(numbered)
                raise FormatError(f"has {len(numbered)} cameras ({labels}): choose two, --pair LEFT,RIGHT or cameras")
            left, right = numbered[:2]
        if key in "KD" and found.keys() == {""}:
            left = right = ""
        return (found[left], found[right]) if {left, right} <= found.keys() else None

    # --- how the cameras stand ---

    def _stereo_pose(self, *, lone: bool) -> tuple[Array | None, Array | None]:
        """Find R (3, 3) and T (3,), right_from_left, in the file's unit. If the tree lacks one, both are None.

        ``lone``: a single pose (4, 4) that names no frames may lead from one eye to the other.
        """
        turned: dict[str, Array] = {}
        for entry in sorted(self.entries, key=lambda e: (e.name[0] != _GIVEN, e.value.size != 9)):
            if not entry.has("rect") and (turn := _rotation(entry)) is not None:
                turned.setdefault(label_of(entry.name, self.cameras, rotation=True), turn)
        moved: dict[str, Entry] = {}
        for entry in self._fitting("T"):
            if not entry.is_rotation:
                moved.setdefault(label_of(entry.name, self.cameras), entry)
        both = [label for label in moved if label in turned]
        if "" in both and frames_of(moved[""].name) is None:
            return turned[""], moved[""].value
        poses = dict(self.poses)
        if len(both) > 1 or "" in both:
            poses |= {moved[each].name: pose_of(turned[each], moved[each].value) for each in both}
        pose = right_from_left(poses, self.cameras)
        if lone and pose is None and [frames_of(name) for name in poses] == [None]:
            pose = more_rightwards(way for each in poses.values() for way in (each, np.linalg.inv(each)))
        if pose is not None:
            return pose[:3, :3], pose[:3, 3]
        # Calibrations of one camera against the other keep R and T beside the second camera; "rotation (R)" is no eye.
        if len(turned) == len(moved) == 1:
            both, turned = [*moved], dict.fromkeys(moved, next(iter(turned.values())))
        return (turned[both[0]], moved[both[0]].value) if len(both) == 1 else (None, None)

    # --- projections of rectified images ---

    def _right_alone(self) -> Pair | None:
        """Derive both projections from a lone right P; the left one is P without its last column."""
        found = self._fitting("P")
        left_label = "left" if self.cameras is None else self.cameras[0]
        if len(found) != 1 or found[0].value[0, 3] == 0 or label_of(found[0].name, self.cameras) == left_label:
            return None
        return found[0].value * (1, 1, 1, 0), found[0].value

    def _projections(self, k: Pair | None, rectification: Pair | None) -> tuple[Pair | None, Pair | None]:
        """Return the projections that follow from a baseline or from Q, and the raw cameras' matrices beside them."""
        found = self._of("K")
        alone = found.get("", next(iter(found.values()), None))
        # OpenVSLAM's and Stella's K is of the rectified cameras, beside both raw ones and how they were turned.
        raw = k if rectification is not None and "" in found else None
        of = k if raw is None and k is not None else None if alone is None else (alone, alone)
        if of is not None and (p := self._of_baseline(of)) is not None:
            if raw is None and any(each.any() for each in self._of("D").values()):
                self.notes.append("D was left out: with a baseline and without R, images are taken to be rectified")
            return p, raw
        return next((_from_q(each) for each in self._of("Q").values()), None), k

    def _of_baseline(self, k: Pair) -> Pair | None:
        """Return the projections of rectified cameras with a stated baseline, in the file's unit; None without one.

        A file names its baseline, names the product of focal length and baseline, or has one number beside a matrix.
        """
        for entry in self.entries:
            if not are_numbers(entry.value, 1):
                continue
            value = abs(float(entry.value.ravel()[0]))
            if found := re.fullmatch(_BASELINE, entry.key):
                self.unit = self.unit or (found[1] and (found[1] if found[1] in UNITS else "m"))
                return projections(*k, value)
            if entry.key in {"bf", "fb", "focalxbaseline"}:
                return projections(*k, value / float(k[0][0, 0]))
        return None

    def _in_metres(self, shift: Array | None, p: Pair | None) -> tuple[Array | None, Pair | None]:
        """Return the translation and the projections in metres; where their baselines differ, the translation's counts.

        DrivingStereo's small images have projections of twice the baseline.
        """
        length = 0.0 if shift is None else float(np.linalg.norm(shift))
        baseline = 0.0 if p is None else abs(float(p[0][0, 3] / p[0][0, 0] - p[1][0, 3] / p[1][0, 0]))
        length_m, baseline_m = (each * UNITS[self.unit or unit_of(each)] for each in (length, baseline))
        if length_m > _NO_SHIFT_M and baseline and abs(baseline_m / length_m - 1) > _SAME_BASELINE:
            self.notes.append(f"the cameras are {baseline:.6g} apart by P, and {length:.6g} by T, which was taken")
            baseline_m = length_m
        if self.unit is None and (unit := unit_of(length or baseline)) != "m":
            apart = f"the cameras are {length or baseline:g} apart"
            self.notes.append(f"{apart}, which was taken for {unit}: if that is wrong, give --unit")
        scale = (1, 1, 1, baseline_m / (baseline or 1))
        shift_m = None if shift is None else shift * (length_m / (length or 1))
        return shift_m, None if p is None else (p[0] * scale, p[1] * scale)

    # --- lenses and sizes ---

    def _lenses(self, k: Pair, size: Size | None) -> tuple[Lens, Lens]:
        """Return the lenses of both eyes; raises FormatError where they cannot be used."""
        names = [each.key for each in self.entries if each.key in {"radtan", "equidistant"}]
        for name, value in self.values.items():
            words = " ".join(words_of(name))
            if isinstance(value, str) and re.search(r"\b(model|type|lens|distortion|projection)", words):
                names.append(value)
            if re.search(r"\b(fisheye|equidistant)\b", words) and _is_true(value):
                names.append("fisheye")
        models = models_of(names)
        if len(models) > 1:
            raise FormatError("expected lenses of one model, got radial-tangential and fisheye ones")
        d = self._eyes("D")
        named = [each for each in self.entries if each.has(KINDS["D"].words) and each.value.size > 1]
        if d is None and named:
            counts = ", ".join(f"{each.value.size} in {'.'.join(each.name)}" for each in named[:2])
            raise FormatError(f"expected 4, 5, 8, 12 or 14 coefficients of both lenses, got {counts}")
        if d is None:
            self.notes.append("no coefficients of lenses were found: the cameras are taken for pinholes")
            d = np.zeros(0), np.zeros(0)
        left, right = (make_lens(own, next(iter(models), None), of, size) for own, of in zip(d, k, strict=True))
        return left, right

    def _size(self, k: Pair | None, p: Pair | None) -> tuple[Size | None, str | None]:
        """Return the size of the images, and why the raw images cannot be used if they have another size."""
        entries = [entry for entry in self.entries if entry.name == (_GIVEN, "size")]
        of_rectified, of_raw = stated_sizes(entries or self.entries, [*(k or ()), *(p or ())])
        fault = None
        if p is not None and of_rectified and of_raw and of_rectified[0] != of_raw[0]:
            fault = f"expected raw images of {of_rectified[0]}, as rectified ones, got {of_raw[0]}"
        known = [*dict.fromkeys((of_raw or of_rectified) if p is None else (of_rectified or of_raw))]
        if len(known) > 1:
            raise FormatError(f"has images of {known[0]} and of {known[1]}: expected one size of both cameras")
        return (known[0] if known else None), fault


def listing(tree: Tree) -> str:
    """Return the arrays of a tree with their shapes, as text for a message."""
    arrays = [(".".join(name), value.shape) for name, value in tree.items() if isinstance(value, np.ndarray)]
    shown = [f"{name} ({' x '.join(map(str, shape)) or 'a number'})" for name, shape in arrays]
    return abbreviate(shown, _LISTED) or "no numbers"


def _is_true(value: Array | str) -> bool:
    if isinstance(value, str):
        return value.strip().lower() not in {"", "false", "no", "off", "none"}
    return value.size == 1 and bool(value.any())


def _rotation(entry: Entry) -> Array | None:
    """Return a rotation (3, 3) from nine numbers, or by its name from a vector or a quaternion; None for no rotation.

    The part of a quaternion that is nearly 1 is w, which is the first or the last one.
    """
    value = entry.value.ravel()
    if is_rotation(value):
        return value.reshape(3, 3)
    if not entry.is_rotation:
        return None
    if are_numbers(value, 3) and np.linalg.norm(value) < 2 * np.pi:
        x, y, z = value.tolist()
        return np.array(rotation_of((x, y, z)))
    if are_numbers(value, 4) and abs(np.linalg.norm(value) - 1) < 1e-3 and np.abs(value[[0, 3]]).max() > 0.9:
        return rotation_of_quaternion(value if abs(value[3]) > abs(value[0]) else np.roll(value, -1))
    return None


def _from_q(q: Array) -> Pair:
    """Return the projections that OpenCV's Q (4, 4) inverts."""
    # Q's last row ends in -1 / Tx and (cx - cx') / Tx.
    k = [camera_matrix(q[2, 3], q[2, 3], cx, -q[1, 3]) for cx in (-q[0, 3], q[3, 3] / q[3, 2] - q[0, 3])]
    return projections(k[0], k[1], abs(1 / q[3, 2]))
