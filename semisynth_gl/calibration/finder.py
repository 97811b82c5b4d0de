"""Finds the arrays of a rig in a tree of values.

Most arrays are told by their numbers: a camera matrix ends in 0 0 1, a rotation is orthonormal, a pose is a rotation
with a translation. Names tell the eye, and which of several arrays of a kind is meant.
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from semisynth_gl.calibration.entries import (
    COEFFICIENT_WORDS,
    Entry,
    by_columns,
    camera_matrix,
    kind_of,
    label_of,
    with_parts,
    words_of,
)
from semisynth_gl.calibration.poses import Link, link_of, pose_of, right_from_left
from semisynth_gl.calibration.sizes import Size, upright
from semisynth_gl.calibration.tree import Array, FormatError, Tree, listing
from semisynth_gl.frame.raw_camera import COEFFICIENTS, LensModel

UNITS: Mapping[str, float] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""Metres per unit of a translation, by the unit's name."""

# Largest baseline, m, that a number without a unit stands for; larger ones are in cm or in mm, whichever is nearer to
# 12 cm, the baseline of most rigs.
_LARGEST_M, _BETWEEN_CM_AND_MM = 2.5, 38.0
# Words in names of derived arrays, such as the matrix of rectified images, which lie beside the calibrated ones.
_DERIVED = "new|opt|rect|undist|roi|virtual"
_BASELINE = r"(?:stereo)?baseline(?:lr)?(mm|cm|m|meters|metres)?|b|bl|numbers"
_FOCAL_TIMES_BASELINE = {"bf", "fb", "focalxbaseline"}
_LARGEST_SIDE_PX = 99_999
# Relative tolerance for equal baselines; translations up to this length count as zero.
_SAME_BASELINE, _NO_SHIFT_M = 0.02, 1e-6
# Texts by which a flag says that a lens is no fisheye.
_FALSE = {"", "false", "no", "off", "none", "0.0", "[0.]"}
# Images of radial-tangential lenses are hardly wider than this times the focal length, 100 degrees.
_WIDE = 2.4

# What tools call the two models of a lens that are read, and other models; letters and digits only.
_MODELS: Mapping[LensModel, str] = {
    "radial-tangential": r"plumbbob|rationalpolynomial|(pinhole)?rad(ial)?tan(gential)?8?|(modified)?brown(conrady)?"
    r"|lensmodel(pinhole|opencv\d+)",
    "fisheye": r"fisheye|(pinhole)?equi(distant)?|kannalabrandt\d?|kb\d",
}
_OTHER_MODELS = (
    r"omni.*|(ds|eucm)(none)?|(pinhole)?fov|atan|doublesphere|ucm|mei|scaramuzza|ocam"
    r"|lensmodel(?!pinhole$|opencv\d+$).*"
)
_MOST_SKEW = 1e-4

Pair = tuple[Array, Array]
"""An array of the left eye, and one of the right eye."""


class StereoArrays:
    """What a tree of values says of a rig, by OpenCV's names; None for what it does not say.

    Args:
        tree: values by name.
        source: name of the file or files, for messages.
        cameras: the left and the right camera of a tree of several.
        unit: the unit of lengths, a key of `UNITS`; None for the likeliest.
        size: the size of the images where the tree does not state it.

    Attributes:
        size: the stated size of the images.
        k: camera matrices (3, 3) before rectification.
        d: coefficients (N,) of both lenses in OpenCV's order.
        model: their model.
        pose: R and T as one pose (4, 4), right_from_left, metres.
        rectification: R1 and R2, rectified_from_raw of both eyes, (3, 3).
        p: projection matrices (3, 4) of the rectified images, the last column in pixels times metres.
        notes: sentences on what was concluded and not read.

    Raises:
        FormatError: where there are more than two cameras, or what is there contradicts itself.
    """

    d: Pair | None = None
    model: LensModel | None = None

    def __init__(
        self, tree: Tree, source: str, cameras: tuple[str, str] | None, unit: str | None, size: Size | None
    ) -> None:
        self.source = source
        self.notes: list[str] = []
        self._unit = unit
        self._cameras = cameras and (label_of(cameras[:1]) or cameras[0], label_of(cameras[1:]) or cameras[1])
        entries = [*with_parts(_entries(tree))]
        kinds = [(entry, *found) for entry in entries if (found := kind_of(entry)) is not None]
        self._links = [link_of(entry.name, pose, self._cameras) for entry, kind, pose in kinds if kind == "pose"]
        self._entries = [entry for entry in entries if self._is_of_rig(entry.name)]
        self._texts = {name: value for name, value in tree.items() if self._is_of_rig(name)}
        self._found: dict[str, list[Entry]] = {}
        for entry, kind, array in sorted(kinds, key=_unlikeliness):
            if self._is_of_rig(entry.name):
                self._found.setdefault(kind, []).append(Entry(entry.name, array))
        self.k, self.p, self.rectification = (self._eyes(key) for key in "KPR")
        self.size, raw_size = self._sizes()
        self.p = self.p or self._right_alone()
        self.pose = self._stereo_pose()
        if self.p is None and self.pose is None:
            self._project_rectified()
        if not self.is_rig:
            self._model()  # a lens of another model may be why nothing was found
            return
        if self.k is not None and self.k[0] is self.k[1] and self.pose is not None:
            self.notes.append("one K was taken for both cameras")
        self._to_metres()
        try:
            self._find_lenses(self.size or size, raw_size)
        except FormatError as error:
            if self.p is None:
                raise
            self.notes.append(f"the lenses were left out: {error}")

    @property
    def is_rig(self) -> bool:
        """Whether the arrays are enough for a rig."""
        return self.p is not None or (self.k is not None and self.pose is not None)

    def _is_of_rig(self, name: tuple[str, ...]) -> bool:
        return self._cameras is None or label_of(name, self._cameras, rotation=True) in {"", *self._cameras}

    # --- arrays of both eyes ---

    def _of(self, key: str, *, raw: bool = False) -> dict[str, Entry]:
        """Return the arrays of a kind by eye or number of the camera; if ``raw``, none of rectified cameras."""
        found = [each for each in reversed(self._found.get(key, [])) if not (raw and each.has("rect"))]
        return {label_of(each.name, self._cameras, rotation=key == "R"): each for each in found}

    def _eyes(self, key: str) -> Pair | None:
        """Return two arrays of a kind, left and right; None if the tree lacks either. The only K or D is of both."""
        found = self._of(key)
        numbered = sorted((label for label in found if label.isdigit()), key=int)
        left, right = self._cameras or ("left", "right")
        if self._cameras is None and len(numbered) > 1 and not {"left", "right"} <= found.keys():
            if len(numbered) > 2 and key in "KP":
                labels = ", ".join(numbered)
                raise FormatError(f"has {len(numbered)} cameras ({labels}): choose two, --pair LEFT,RIGHT or cameras")
            left, right = numbered[:2]
        if key in "KD" and found.keys() == {""}:
            others = (each.value for each in self._found[key] if not each.has(_DERIVED))
            if all(np.array_equal(each, found[""].value) for each in others):
                left = right = ""
        return (found[left].value, found[right].value) if {left, right} <= found.keys() else None

    # --- how the cameras stand ---

    def _stereo_pose(self) -> Array | None:
        """Find R and T as one pose (4, 4), right_from_left, in the file's unit; None without both."""
        turned, moved = self._of("R", raw=True), self._of("T")
        if len(turned) == len(moved) == 1:  # "rotation (R)" is no eye
            turned = dict.fromkeys(moved, *turned.values())
        pairs = {each: pose_of(turned[each].value, moved[each].value) for each in moved if each in turned}
        links = {each: link_of(moved[each].name, pose, self._cameras) for each, pose in pairs.items()}
        if "" in links and not links[""].sure:
            return pairs[""]
        all_links = [*self._links, *(links.values() if len(links) > 1 or "" in links else ())]
        found = right_from_left(all_links, self._cameras)
        # Without P, a single pose that names no frames leads from one eye to the other.
        if found is None and self.p is None and [each.sure for each in all_links] == [False]:
            found = right_from_left([Link("right", "left", all_links[0].pose, sure=False)], ("left", "right"))
        # Calibrations of one camera against the other keep R and T beside the second camera.
        return next(iter(pairs.values())) if found is None and len(pairs) == 1 else found

    def _to_metres(self) -> None:
        """Bring pose and projections to metres; where their baselines differ, the translation's counts.

        DrivingStereo's small images have projections of twice the baseline.
        """
        baseline = 0.0 if self.p is None else abs(float(np.subtract(*(each[0, 3] / each[0, 0] for each in self.p))))
        shift = 0.0 if self.pose is None else float(np.linalg.norm(self.pose[:3, 3]))
        length = shift if shift > _NO_SHIFT_M else baseline
        unit = self._unit or ("m" if length <= _LARGEST_M else "cm" if length <= _BETWEEN_CM_AND_MM else "mm")
        length_m = length * UNITS[unit]
        unit_of_p = min(UNITS.values(), key=lambda each: abs(baseline * each - length_m))
        if length and baseline and abs(baseline * unit_of_p / length_m - 1) > _SAME_BASELINE:
            self.notes.append(f"the cameras are {baseline:.6g} apart by P, and {length:.6g} by T, which was taken")
            unit_of_p = length_m / baseline
        if self._unit is None and unit != "m":
            self.notes.append(f"the cameras are {length:g} apart, taken for {unit}: if that is wrong, give --unit")
        if self.pose is not None:
            self.pose = pose_of(self.pose[:3, :3], self.pose[:3, 3] * UNITS[unit])
        if self.p is not None:
            self.p = self.p[0] * (1, 1, 1, unit_of_p), self.p[1] * (1, 1, 1, unit_of_p)

    # --- projections of rectified images ---

    def _right_alone(self) -> Pair | None:
        """Derive both projections from a lone right P; the left one is P without its last column."""
        found = self._found.get("P", ())
        left = "left" if self._cameras is None else self._cameras[0]
        if len(found) != 1 or label_of(found[0].name, self._cameras) == left or found[0].value[0, 3] == 0:
            return None
        return found[0].value * (1, 1, 1, 0), found[0].value

    def _project_rectified(self) -> None:
        """Set the projections that follow from a baseline or from Q; then only raw cameras keep their matrices."""
        found = self._of("K")
        alone = found.get("", next(iter(found.values()), None))
        # OpenVSLAM's and Stella's K is of the rectified cameras, beside both raw ones and how they were turned.
        raw = self.k if self.rectification is not None and "" in found else None
        of = self.k if raw is None and self.k is not None else alone and (alone.value, alone.value)
        if of is not None and (baseline := self._baseline(float(of[0][0, 0]))) is not None:
            if raw is None and any(each.value.any() for each in self._of("D").values()):
                self.notes.append("D was left out: with a baseline and without R, images are taken to be rectified")
            self.p, self.k = projections(*of, baseline), raw
        elif "Q" in self._found:
            q = self._found["Q"][0].value
            focal_px, cx_left, cy = q[2, 3], -q[0, 3], -q[1, 3]
            # Q's last row ends in -1 / Tx and (cx - cx') / Tx.
            left, right = (camera_matrix(focal_px, focal_px, cx, cy) for cx in (cx_left, cx_left + q[3, 3] / q[3, 2]))
            self.p = projections(left, right, abs(1 / q[3, 2]))

    def _baseline(self, focal_px: float) -> float | None:
        """Return a stated baseline in the file's unit: it, its product with the focal length, or a number alone."""
        for entry in self._entries:
            if entry.value.size != 1 or not np.isfinite(entry.value).all():
                continue
            value = abs(float(entry.value.ravel()[0]))
            if found := re.fullmatch(_BASELINE, entry.key):
                self._unit = self._unit or (found[1] and (found[1] if found[1] in UNITS else "m"))
                return value
            if entry.key in _FOCAL_TIMES_BASELINE:
                return value / focal_px
        return None

    # --- lenses and sizes ---

    def _model(self) -> LensModel | None:
        """Return the stated lens model; raises FormatError for a model that is not read, or for two models."""
        stated = [each.key for each in self._entries if each.key in {"radtan", "equidistant"}]
        for name, value in self._texts.items():
            words = " ".join(words_of(name))
            if isinstance(value, str) and re.search(r"\b(model|type|lens|distortion|projection)", words):
                stated.append(value)
            if re.search(r"\b(fisheye|equidistant)\b", words) and str(value).lower() not in _FALSE:
                stated.append("fisheye")
        models: set[LensModel] = set()
        for text in stated:
            key = re.sub(r"[^a-z0-9]", "", text.lower()).removeprefix("distortion").removeprefix("camera")
            if re.fullmatch(_OTHER_MODELS, key):
                known = "a radial-tangential or equidistant (fisheye) lens"
                raise FormatError(f"its lens is {text}: calibrate with {known}")
            models |= {model for model, pattern in _MODELS.items() if re.fullmatch(pattern, key)}
        if len(models) > 1:
            raise FormatError("expected lenses of one model, got radial-tangential and fisheye ones")
        return next(iter(models), None)

    def _find_lenses(self, size: Size | None, raw_size: Size | None) -> None:
        """Set the coefficients of both lenses and their model; raises FormatError where they cannot be used."""
        if self.k is None:
            return
        model, d = self._model(), self._eyes("D")
        if size is not None and raw_size not in {None, size}:
            raise FormatError(f"expected raw images of {size}, as rectified ones, got {raw_size}")
        stated = {
            each.name: each.value for each in self._entries if each.has(COEFFICIENT_WORDS) and each.value.size > 1
        }
        if d is None and stated:
            raise FormatError(f"expected 4, 5, 8, 12 or 14 coefficients of both lenses, got {listing(stated)}")
        if d is None:
            self.notes.append("no coefficients of lenses were found: the cameras are taken for pinholes")
            d = np.zeros(0), np.zeros(0)
        is_wide = size is not None and size.width_px > _WIDE * float(self.k[0][0, 0])
        if model is None and is_wide and d[0].any() and len(d[0]) == 4:
            raise FormatError(
                "a wide lens with 4 coefficients may be radial-tangential or a fisheye: add the value "
                "distortion_model, fisheye or radtan, to the file"
            )
        model = model or "radial-tangential"
        left, right = (_coefficients(own, model, k) for own, k in zip(d, self.k, strict=True))
        self.d, self.model = (left, right), model

    def _sizes(self) -> tuple[Size | None, Size | None]:
        """Return the size of the images, and of the raw images; None for an unknown size."""
        sizes: dict[bool, dict[Size, None]] = {True: {}, False: {}}
        for entry in self._found.get("size", ()):
            width, height = entry.value.tolist()
            if not all(0 <= side <= _LARGEST_SIDE_PX and side == int(side) for side in (width, height)):
                raise FormatError(f"expected a width and height of whole pixels, got {width:g} x {height:g}")
            if width and height:  # 0 x 0 is OpenCV's unknown size
                size = upright(Size(int(width), int(height)), [*(self.k or ()), *(self.p or ())])
                sizes[entry.has("rect")][size] = None
        known = [*(sizes[self.p is not None] or sizes[self.p is None])]
        if len(known) > 1:
            raise FormatError(f"has images of {known[0]} and of {known[1]}: expected one size of both cameras")
        return next(iter(known), None), next(iter(sizes[False]), None)


def sizes_in(tree: Tree) -> list[Array]:
    """Return the sizes of images, (2,), that a tree states."""
    kinds = map(kind_of, with_parts(_entries(tree)))
    return [array for kind, array in filter(None, kinds) if kind == "size"]


def _entries(tree: Tree) -> Sequence[Entry]:
    return by_columns([Entry(name, value) for name, value in tree.items() if isinstance(value, np.ndarray)])


def _unlikeliness(found: tuple[Entry, str, Array]) -> tuple[bool, bool, int]:
    """Return how unlikely an array is the calibrated one of its kind, or of rotations the rectifying one."""
    entry, kind, array = found
    is_vector = entry.value.size != array.size  # of a rotation
    return entry.has(_DERIVED) == (kind in "KD"), is_vector, len(entry.name)


def projections(left: Array, right: Array, baseline: float) -> Pair:
    """Return P (3, 4) of both rectified cameras from K (3, 3) of each and their distance."""
    shift = np.array([[-right[0, 0] * baseline], [0], [0]])
    return np.hstack([left, np.zeros((3, 1))]), np.hstack([right, shift])


def _coefficients(d: Array, model: LensModel, k: Array) -> Array:
    """Return the coefficients (N,) of a lens in as many numbers as OpenCV's model takes; zeros for none.

    Raises FormatError if their number does not fit the model, or if the camera matrix K (3, 3) has skew.
    """
    if abs(k[0, 1]) > _MOST_SKEW * k[0, 0]:
        raise FormatError(f"a camera matrix has a skew of {k[0, 1]:g}: expected [fx 0 cx; 0 fy cy; 0 0 1]")
    counts = COEFFICIENTS[model]
    if not d[counts[-1] :].any():  # files may end in zeros that the model has no place for
        d = d[: counts[-1]] if len(d) else np.zeros(counts[0])
    if len(d) not in counts:
        tilt = ": the last two, a tilted sensor's, must be 0" if len(d) == 14 else ""
        raise FormatError(
            f"expected {' or '.join(map(str, counts))} coefficients of a {model} lens, got {len(d)}{tilt}"
        )
    return d
