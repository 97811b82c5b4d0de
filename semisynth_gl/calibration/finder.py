"""Finds the arrays of a rig in a tree of values.

Most arrays are told by their numbers: a camera matrix ends in 0 0 1, a rotation is orthonormal, a pose is a rotation
with a translation. Names tell the eye, and which of several arrays of a kind is meant.
"""

import re
from collections.abc import Iterator, Mapping

import numpy as np

from semisynth_gl.calibration.arrays import (
    UNITS,
    Lens,
    Pair,
    StereoArrays,
    camera_matrix,
    make_lens,
    model_of,
    projections,
    unit_of,
)
from semisynth_gl.calibration.kinds import (
    Size,
    are_numbers,
    checked_size,
    is_camera_matrix,
    is_coefficients,
    is_pose,
    is_projection,
    is_reprojection,
    is_rotation,
    is_rotation_vector,
    is_turned,
    stated_sizes,
)
from semisynth_gl.calibration.names import ROTATION_WORDS, Entry, eye_of, label_of, starts, words_of
from semisynth_gl.calibration.parts import by_columns, with_parts
from semisynth_gl.calibration.poses import leads_to_left, pose_of, right_from_left
from semisynth_gl.calibration.tree import Array, FormatError, Tree, text_of
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.raw_camera import rotation_of

KEYS = ("K1", "D1", "R1", "P1", "K2", "D2", "R2", "P2", "R", "T", "Q", "size")
"""Names that a user can give to values of a file: OpenCV's, and the size of the images."""

_SHIFT_WORDS = ("t", "tr", "trans", "trns", "tvec", "shift", "position")
_LENS_WORDS = ("d", "dist", "coef", "kc", "radtan", "equidistant")
# What arrays of a kind are: a test of their numbers, beginnings of words of which their names have one, and a shape.
_KINDS = {
    "K": (is_camera_matrix, (), (3, 3)),
    "D": (is_coefficients, _LENS_WORDS, (-1,)),
    "R": (is_rotation, (), (3, 3)),
    "P": (is_projection, (), (3, 4)),
    "Q": (is_reprojection, (), (4, 4)),
}
# Words in names of derived arrays, such as the matrix of rectified images, which lie beside the calibrated ones.
_REDERIVED = {"new", "optimal", "opt", "rect", "rectified", "rectification", "undistorted", "roi", "virtual"}
# Words of angles about axes, which are no rotation vector.
_ANGLE_WORDS = ("angle", "euler", "rpy", "roll", "deg")
# Words of text that names the model of a lens.
_MODEL_WORDS = {"model", "type", "lens", "lensmodel", "distortion", "projection"}
_BASELINE = re.compile(r"(?:stereo)?baseline(mm|cm|m|meters|metres)?|b|bl")
# Relative differences of the translation's length and the baseline of P: up to the first one both say the same, above
# the second one the finder ignores the translation.
_SAME_BASELINE, _MOST_BASELINE = 0.02, 0.8
_LISTED = 40


class Finder:
    """The arrays of a rig in one tree.

    Its arguments are a tree, the user's names in it by `KEYS`, the left and the right camera where there are more than
    two, the unit of the translation, and the size of the images where the tree does not say it; None for unknown ones.
    """

    def __init__(
        self,
        tree: Tree,
        given: Mapping[str, str] | None = None,
        cameras: tuple[str, str] | None = None,
        unit: str | None = None,
        size: Size | None = None,
    ) -> None:
        self.tree, self.unit, self.user_size = tree, unit, size
        self.cameras = cameras and (eye_of(cameras[:1]) or cameras[0], eye_of(cameras[1:]) or cameras[1])
        arrays = [Entry(name, value) for name, value in tree.items() if isinstance(value, np.ndarray)]
        self.entries = [*with_parts(by_columns(arrays))]
        self.given = {key: self._named(key, name) for key, name in (given or {}).items()}
        self.notes: list[str] = []

    def arrays(self) -> StereoArrays | None:
        """Return the arrays that the tree has of a rig; None where they make no rig.

        Raises:
            FormatError: where there are more than two cameras, or what is there contradicts itself.
        """
        self._check_windows()
        k, p = self._eyes("K"), self._eyes("P")
        size, fault = self._size(k, p)
        p = p or self._right_alone()
        turn, shift = self._stereo_pose()
        rectification = self._eyes("R")
        if p is None and turn is None:
            p, k = self._projections(k, rectification)
        if p is None and k is None and turn is not None:
            k = self._shared("K")
        if p is None and (k is None or turn is None or shift is None):
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

    def listing(self) -> str:
        """Return the arrays of the tree with their shapes, as text for a message."""
        arrays = [(name, value) for name, value in self.tree.items() if isinstance(value, np.ndarray)]
        shown = [
            f"{text_of(name)} ({'a number' if value.size == 1 else ' x '.join(map(str, value.shape))})"
            for name, value in arrays[:_LISTED]
        ]
        more = f" and {len(arrays) - _LISTED} more" if len(arrays) > _LISTED else ""
        return (", ".join(shown) + more) or "no numbers"

    def _named(self, key: str, name: str) -> Array:
        found = next((entry.value for entry in self.entries if text_of(entry.name) == name), None)
        if found is None:
            raise FormatError(f"has no {name}, which {key} was to be: it has {self.listing()}")
        kind = None if key == "R" else _KINDS.get(key.rstrip("12"))
        if kind is not None and not kind[0](found):
            raise FormatError(f"{name} is no {key}: it is {found.tolist()}")
        return found

    # --- arrays of both eyes ---

    def _fitting(self, key: str) -> list[Entry]:
        fits, words, shape = _KINDS[key]
        found = [e for e in self.entries if fits(e.value) and (not words or starts(e.words, words))]
        return [Entry(e.name, e.value.reshape(shape)) for e in found]

    def _of(self, key: str) -> dict[str, Entry]:
        """Return the entries of a kind by eye or number of the camera, the likeliest of each."""
        found: dict[str, Entry] = {}

        def unlikely(entry: Entry) -> tuple[bool, int]:
            return bool(_REDERIVED & set(entry.words)) == (key in "KD"), len(entry.name)

        for entry in sorted(self._fitting(key), key=unlikely):
            found.setdefault(label_of(entry.name, self.cameras, rotation=key == "R"), entry)
        return found

    def _eyes(self, key: str) -> Pair | None:
        """Return two arrays of a kind, left and right; None if the tree lacks either."""
        pair = self._pair(self._of(key), key) or (None, None)
        left, right = (
            self.given[key + number].reshape(_KINDS[key][2]) if key + number in self.given else entry and entry.value
            for number, entry in zip("12", pair, strict=True)
        )
        return None if left is None or right is None else (left, right)

    def _pair(self, found: Mapping[str, Entry], key: str) -> tuple[Entry, Entry] | None:
        numbered = sorted(int(label) for label in found if label.isdigit())
        if self.cameras is not None:
            labels = self.cameras
        elif {"left", "right"} <= found.keys() or len(numbered) < len(EYES):
            labels = ("left", "right")
        elif len(numbered) > len(EYES) and key in {"K", "P"}:
            names = ", ".join(text_of(found[str(number)].name) for number in numbered)
            raise FormatError(f"has {len(numbered)} cameras ({names}): choose two, --pair LEFT,RIGHT or cameras")
        else:
            labels = str(numbered[0]), str(numbered[1])
        return (found[labels[0]], found[labels[1]]) if set(labels) <= found.keys() else None

    def _one(self, key: str) -> Entry | None:
        """Return the entry of a kind that is of both eyes."""
        if key in self.given:
            return Entry((key,), self.given[key].reshape(_KINDS[key][2]))
        fitting = self._fitting(key)
        unlabelled = [e for e in fitting if eye_of(e.name) == ""]
        return min(unlabelled or fitting, key=lambda e: len(e.name), default=None)

    def _shared(self, key: str) -> Pair | None:
        """Return the only array of a kind for both eyes."""
        found = [*self._of(key).values()]
        if len(found) != 1:
            return None
        self.notes.append(f"{text_of(found[0].name)} was taken for both cameras, since no other {key} was found")
        return found[0].value, found[0].value

    # --- how the cameras stand ---

    def _stereo_pose(self) -> tuple[Array | None, Array | None]:
        """Return R (3, 3) and T (3,), right_from_left, in the file's unit; None for what is not there."""
        turned, moved = self._rotations(), self._shifts()
        if {"R", "T"} & self.given.keys():
            r = self.given.get("R", turned.get(""))
            t = self.given.get("T", moved[""].value if "" in moved else None)
            return None if r is None else _rotation(r), None if t is None else t.ravel()
        if "" in turned and "" in moved:
            r, t = turned[""], moved[""].value
            return (r.T, -r.T @ t) if leads_to_left(moved[""].name) else (r, t)
        matrices = {e.name: e.value.reshape(-1, 4) for e in self.entries if is_pose(e.value)}
        poses = {name: pose_of(each[:3, :3], each[:3, 3]) for name, each in matrices.items()}
        labels = [label for label in moved if label in turned]
        if len(labels) > 1:
            poses |= {moved[each].name: pose_of(turned[each], moved[each].value) for each in labels}
        if (pose := right_from_left(poses, self.cameras)) is not None:
            return pose[:3, :3], pose[:3, 3]
        # Calibrations of one camera against the other keep R and T beside the second camera; "rotation (R)" is no eye.
        if not labels and len(turned) == len(moved) == 1 and "" in moved:
            return next(iter(turned.values())), moved[""].value
        return (turned[labels[0]], moved[labels[0]].value) if len(labels) == 1 else (None, None)

    def _rotations(self) -> dict[str, Array]:
        """Return rotations (3, 3) that do not rectify, by eye: matrices rather than vectors."""
        found: dict[str, Array] = {}
        for entry in sorted(self.entries, key=lambda e: e.value.size != 9):
            named = starts(entry.words, ("r", *ROTATION_WORDS)) and not starts(entry.words, _ANGLE_WORDS)
            fits = is_rotation(entry.value) or (named and is_rotation_vector(entry.value))
            if fits and not starts(entry.words, ("rect", "rectif")):
                found.setdefault(label_of(entry.name, self.cameras, rotation=True), _rotation(entry.value))
        return found

    def _shifts(self) -> dict[str, Entry]:
        """Return translations (3,) by eye."""
        found: dict[str, Entry] = {}
        for entry in (e for e in self.entries if are_numbers(e.value, 3)):
            if starts(entry.words, _SHIFT_WORDS) and not starts(entry.words, ROTATION_WORDS):
                found.setdefault(label_of(entry.name, self.cameras), Entry(entry.name, entry.value.ravel()))
        return found

    # --- projections of rectified images ---

    def _right_alone(self) -> Pair | None:
        """Return the projections where only the right eye's is stated, which holds the baseline."""
        found = self._fitting("P")
        left_label = "left" if self.cameras is None else self.cameras[0]
        if len(found) != 1 or found[0].value[0, 3] == 0 or label_of(found[0].name, self.cameras) == left_label:
            return None
        left = found[0].value.copy()
        left[:, 3] = 0
        return left, found[0].value

    def _projections(self, k: Pair | None, rectification: Pair | None) -> tuple[Pair | None, Pair | None]:
        """Return the projections that follow from a baseline or from Q, and the raw cameras' matrices beside them."""
        alone = self._one("K")
        # OpenVSLAM's and Stella's K is of the rectified cameras, beside both raw ones and how they were turned.
        if rectification is not None and alone is not None and eye_of(alone.name) == "":
            return self._of_baseline((alone.value, alone.value)), k
        found = self._of_baseline(k or (alone and (alone.value, alone.value)))
        if found is not None:
            self.notes += [
                f"{text_of(e.name)} was left out: with a baseline and without R, images are taken to be rectified"
                for e in self._of("D").values()
                if e.value.any()
            ]
            return found, None
        q = self._one("Q")
        return (None if q is None else _from_q(q.value)), k

    def _of_baseline(self, k: Pair | None) -> Pair | None:
        """Return the projections of rectified cameras with a stated baseline, in the file's unit; None without one.

        A file names its baseline, names the product of focal length and baseline, or has one number beside a matrix.
        """
        if k is None:
            return None
        for entry in self.entries:
            if are_numbers(entry.value, 1):
                value, key = abs(float(entry.value.ravel()[0])), re.sub(r"[^a-z]", "", entry.key.lower())
                key = "baseline" if re.fullmatch(r"rows \d+", entry.key) else key
                if found := _BASELINE.fullmatch(key):
                    self.unit = self.unit or (found[1] and (found[1] if found[1] in UNITS else "m"))
                    return projections(*k, value)
                if key in {"bf", "fb", "focalxbaseline"}:
                    return projections(*k, value / float(k[0][0, 0]))
        return None

    def _in_metres(self, shift: Array | None, p: Pair | None) -> tuple[Array | None, Pair | None]:
        """Return the translation and the projections in metres; where their baselines differ, the translation's counts.

        DrivingStereo's small images have projections of twice the baseline.
        """
        shift_m = None if shift is None else shift * self._factor(float(np.linalg.norm(shift)), noted=True)
        if p is None:
            return shift_m, None
        length_m = 0.0 if shift_m is None else float(np.linalg.norm(shift_m))
        left, right = (each[0, 3] / each[0, 0] for each in p)
        factor = self._factor(abs(left - right), noted=shift is None)
        baseline_m = abs(left - right) * factor
        if _SAME_BASELINE < abs(length_m / (baseline_m or np.inf) - 1) < _MOST_BASELINE:
            self.notes.append(
                f"the cameras are {baseline_m:.6g} m apart by P, and {length_m:.6g} m by T, which was taken: if P is "
                "right, leave T out"
            )
            factor *= length_m / baseline_m
        scale = np.array([1, 1, 1, factor])
        return shift_m, (p[0] * scale, p[1] * scale)

    def _factor(self, length: float, *, noted: bool) -> float:
        """Return metres per unit of a length."""
        unit = self.unit or unit_of(length)
        if self.unit is None and unit != "m" and noted:
            self.notes.append(
                f"the cameras are {length:g} apart, which was taken for {unit}: if that is wrong, give --unit"
            )
        return UNITS[unit]

    # --- lenses ---

    def _lenses(self, k: Pair, size: Size | None) -> tuple[Lens, Lens]:
        """Return the lenses of both eyes; raises FormatError where they cannot be used."""
        found = self._eyes("D") or self._other_coefficients(shared=k[0] is k[1]) or (None, None)
        models = [model_of(self._lens_names(number)) for number in range(len(EYES))]
        left, right = (make_lens(d, model, own, size) for d, model, own in zip(found, models, k, strict=True))
        if left.model != right.model:
            raise FormatError(f"expected lenses of one model, got {left.model} left and {right.model} right")
        if None in models and left.coefficients.any() and len(left.coefficients) == 4:
            self.notes.append(
                "4 coefficients were taken for a radial-tangential lens; for a fisheye, add `distortion_model: fisheye`"
            )
        return left, right

    def _lens_names(self, number: int) -> Iterator[str]:
        """Yield what the tree calls the lens of an eye, and the model that the names of its values tell."""
        numbers = sorted({int(eye) for e in self.entries if e.value.size > 1 and (eye := eye_of(e.name)).isdigit()})
        labels = self.cameras or (numbers if len(numbers) >= len(EYES) else EYES)
        own = {"", EYES[number], str(labels[number])}
        for name, value in self.tree.items():
            if isinstance(value, str) and _MODEL_WORDS & {*words_of(name[-1:])} and label_of(name, self.cameras) in own:
                yield value
            flag = {"fisheye", "equidistant"} & set(words_of(name)) and (isinstance(value, str) or value.size == 1)
            if flag and not _is_false(value):
                yield "fisheye"
        for entry in self.entries:
            if entry.key in {"radtan", "equidistant"} and label_of(entry.name, self.cameras) in own:
                yield entry.key

    def _other_coefficients(self, *, shared: bool) -> Pair | None:
        """Return the coefficients that both eyes share; raises FormatError where they are of one eye, or too few."""
        named = [e for e in self.entries if starts(e.words, _LENS_WORDS) and e.value.size > 1]
        if not named:
            self.notes.append("no coefficients of lenses were found: the cameras are taken for pinholes")
            return None
        if shared or {eye_of(entry.name) for entry in named} == {""}:
            return self._shared("D")
        counts = ", ".join(f"{entry.value.size} in {text_of(entry.name)}" for entry in named[:2])
        raise FormatError(f"expected 4, 5, 8, 12 or 14 coefficients of both lenses, got {counts}")

    # --- images ---

    def _check_windows(self) -> None:
        """Refuse messages of ROS whose images are binned, or a window of the calibrated images."""
        for entry in self.entries:
            binned = entry.key in {"binning_x", "binning_y"} and entry.value.size == 1 and entry.value.max() > 1
            if binned or (entry.key in {"x_offset", "y_offset"} and "roi" in entry.name and entry.value.any()):
                raise FormatError(
                    f"{text_of(entry.name)} is {entry.value.max():g}: binned images, or a window of the calibrated "
                    "ones. Take whole images without binning"
                )

    def _size(self, k: Pair | None, p: Pair | None) -> tuple[Size | None, str | None]:
        """Return the size of the images, and why the raw images cannot be used if they have another size.

        The principal points of K and P tell the size where its sides may be in any order.
        """
        if "size" in self.given:
            return checked_size(*self.given["size"].ravel()[:2]), None
        matrices, fault = [*(k or ()), *(p or ())], None
        of_rectified, of_raw = stated_sizes(self.entries, self.cameras, matrices)
        if p is not None and of_rectified and of_raw and of_rectified[0] != of_raw[0]:
            fault = f"expected raw images of {of_rectified[0]}, as rectified ones, got {of_raw[0]}"
        known = [*dict.fromkeys((of_raw or of_rectified) if p is None else (of_rectified or of_raw))]
        if len(known) > 1:
            raise FormatError(f"has images of {known[0]} and of {known[1]}: expected one size of both cameras")
        if known and self.user_size == tuple(reversed(known[0])) and is_turned(known[0], matrices):
            self.notes.append(f"its size, {known[0]}, was taken for height and width, as the photographs are")
            return self.user_size, fault
        return (known[0] if known else None), fault


def _is_false(value: Array | str) -> bool:
    return value.strip().lower() in {"", "false", "no", "off", "none"} if isinstance(value, str) else not value.any()


def _rotation(value: Array) -> Array:
    """Return a rotation (3, 3) from nine numbers, or from a vector of three."""
    if value.size == 9:
        return value.reshape(3, 3)
    x, y, z = value.ravel().tolist()
    return np.array(rotation_of((x, y, z)))


def _from_q(q: Array) -> Pair:
    """Return the projections that OpenCV's Q (4, 4) inverts."""
    # Q's last row ends in -1 / Tx and (cx - cx') / Tx.
    k = [camera_matrix(q[2, 3], q[2, 3], cx, -q[1, 3]) for cx in (-q[0, 3], q[3, 3] / q[3, 2] - q[0, 3])]
    return projections(k[0], k[1], abs(1 / q[3, 2]))
