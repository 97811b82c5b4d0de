"""Finds the arrays of a rig in a tree of values.

Most arrays are recognised by their values: a camera matrix ends in 0 0 1, a rotation is orthonormal, a pose is a
rotation with a translation. Names say which eye an array belongs to, and decide between several arrays of one kind.
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from semisynth_gl.calibration.named_arrays import (
    COEFFICIENT_WORDS,
    NamedArray,
    by_columns,
    kind_of,
    label_of,
    with_parts,
    words_of,
)
from semisynth_gl.calibration.poses import RelativePose, pose_of, relative_pose, right_from_left
from semisynth_gl.calibration.sizes import ImageSize, upright
from semisynth_gl.calibration.tree import Array, FormatError, Tree, listing
from semisynth_gl.frame.camera import camera_matrix
from semisynth_gl.frame.raw_camera import COEFFICIENTS, LensModel

UNITS: Mapping[str, float] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""Metres per unit of a translation, by the unit's name."""

# A baseline without a unit is taken as metres up to the first value, as cm up to the second, and as mm above. So it is
# cm or mm, whichever is nearer to 12 cm, the baseline of most rigs.
_LARGEST_M, _BETWEEN_CM_AND_MM = 2.5, 38.0
# Words in the names of derived arrays, such as the matrix of rectified images. Files have them beside calibrated ones.
_DERIVED = "new|opt|rect|undist|roi|virtual"
_BASELINE = r"(?:stereo)?baseline(?:lr)?(mm|cm|m|meters|metres)?|b|bl|numbers"
_FOCAL_TIMES_BASELINE = {"bf", "fb", "focalxbaseline"}
_LARGEST_SIDE_PX = 99_999
# Relative tolerance of equal baselines, and the length up to which a translation is zero.
_SAME_BASELINE, _NO_SHIFT_M = 0.02, 1e-6
# Values of a flag such as `fisheye` that mean false.
_FALSE = {"", "false", "no", "off", "none", "0.0", "[0.]"}
# Images of radial-tangential lenses are hardly wider than this times the focal length, 100 degrees.
_WIDE = 2.4

# The names that tools use for the two supported lens models, and for others; letters and digits only.
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

ArrayPair = tuple[Array, Array]
"""An array of the left eye, and one of the right eye."""


class StereoArrays:
    """The arrays of a rig in a tree of values, by OpenCV's names; None for what the tree does not have.

    Args:
        tree: values by name.
        source: name of the file or files, for messages.
        cameras: labels of the left and the right camera, if the tree has more than two.
        unit: the unit of lengths, a key of `UNITS`; None to guess it.
        size: the size of the images, if the tree does not state it.

    Attributes:
        size: the stated size of the images.
        k: camera matrices (3, 3) before rectification.
        d: coefficients (N,) of both lenses in OpenCV's order.
        model: the model of both lenses.
        pose: R and T as one pose (4, 4), right_from_left, metres.
        rectification: R1 and R2, rectified_from_raw of both eyes, (3, 3).
        p: projection matrices (3, 4) of the rectified images, the last column in pixels times metres.
        notes: sentences on what was guessed, and what was ignored.

    Raises:
        FormatError: if there are more than two cameras, or values contradict each other.
    """

    d: ArrayPair | None = None
    model: LensModel | None = None

    def __init__(
        self, tree: Tree, source: str, cameras: tuple[str, str] | None, unit: str | None, size: ImageSize | None
    ) -> None:
        self.source = source
        self.notes: list[str] = []
        self._unit = unit
        self._cameras = cameras and (label_of(cameras[:1]) or cameras[0], label_of(cameras[1:]) or cameras[1])
        named_arrays = [*with_parts(_named_arrays(tree))]
        kinds = [(named, *found) for named in named_arrays if (found := kind_of(named)) is not None]
        self._stated_poses = [
            relative_pose(named.name, pose, self._cameras) for named, kind, pose in kinds if kind == "pose"
        ]
        self._named_arrays = [named for named in named_arrays if self._is_of_rig(named.name)]
        self._texts = {name: value for name, value in tree.items() if self._is_of_rig(name)}
        self._found: dict[str, list[NamedArray]] = {}
        for named, kind, array in sorted(kinds, key=_unlikeliness):
            if self._is_of_rig(named.name):
                self._found.setdefault(kind, []).append(NamedArray(named.name, array))
        # Each step uses results of the steps before it.
        self.k, self.p, self.rectification = (self._eyes(key) for key in "KPR")
        self.size, raw_size = self._sizes()
        self.p = self.p or self._p_from_right()
        self.pose = self._stereo_pose()
        if self.p is None and self.pose is None:
            self._project_rectified()
        if not self.is_rig:
            self._model()  # only to raise: with an unsupported lens model, the message names the model
            return
        if self.k is not None and self.k[0] is self.k[1] and self.pose is not None:
            self.notes.append("one K was taken for both cameras")
        self._to_metres()
        try:
            self._find_lenses(self.size or size, raw_size)
        except FormatError as error:
            if self.p is None:
                raise
            self.notes.append(f"the lenses were ignored: {error}")

    @property
    def is_rig(self) -> bool:
        """Whether the arrays are enough for a rig."""
        return self.p is not None or (self.k is not None and self.pose is not None)

    def _is_of_rig(self, name: tuple[str, ...]) -> bool:
        return self._cameras is None or label_of(name, self._cameras, rotation=True) in {"", *self._cameras}

    # --- arrays of both eyes ---

    def _of(self, key: str, *, raw: bool = False) -> dict[str, NamedArray]:
        """Return the likeliest array of a kind for each camera's label; if ``raw``, only of raw cameras."""
        found = [each for each in reversed(self._found.get(key, [])) if not (raw and each.has("rect"))]
        return {label_of(each.name, self._cameras, rotation=key == "R"): each for each in found}

    def _eyes(self, key: str) -> ArrayPair | None:
        """Return two arrays of a kind, left and right, or None. A single K or D without an eye is used for both."""
        found = self._of(key)
        numbered = sorted((label for label in found if label.isdigit()), key=int)
        left, right = self._cameras or ("left", "right")
        if self._cameras is None and len(numbered) > 1 and not {"left", "right"} <= found.keys():
            if len(numbered) > 2 and key in "KP":
                labels = ", ".join(numbered)
                raise FormatError(f"has {len(numbered)} cameras ({labels}): choose two, --pair LEFT,RIGHT or cameras")
            left, right = numbered[:2]
        if key in "KD" and found.keys() == {""}:
            calibrated = (each.value for each in self._found[key] if not each.has(_DERIVED))
            if all(np.array_equal(each, found[""].value) for each in calibrated):
                left = right = ""
        return (found[left].value, found[right].value) if {left, right} <= found.keys() else None

    # --- the pose of the right camera ---

    def _stereo_pose(self) -> Array | None:
        """Find R and T as one pose (4, 4), right_from_left, in the file's unit; None without both."""
        rotations, translations = self._of("R", raw=True), self._of("T")
        if len(rotations) == len(translations) == 1:
            # The R in a name such as "rotation (R)" does not mean the right eye: T's label holds for both.
            rotations = dict.fromkeys(translations, *rotations.values())
        poses = {eye: pose_of(rotations[eye].value, t.value) for eye, t in translations.items() if eye in rotations}
        relative = {eye: relative_pose(translations[eye].name, pose, self._cameras) for eye, pose in poses.items()}
        # 1. R and T whose names state neither an eye nor frames.
        if "" in relative and not relative[""].sure:
            return poses[""]
        # 2. A chain of poses. R and T of only one camera are left to step 4.
        is_of_one_camera = len(relative) == 1 and "" not in relative
        chain = self._stated_poses if is_of_one_camera else [*self._stated_poses, *relative.values()]
        found = right_from_left(chain, self._cameras)
        # 3. Without P, a single pose whose name states no frames leads from one eye to the other.
        if found is None and self.p is None and [each.sure for each in chain] == [False]:
            found = right_from_left([RelativePose("right", "left", chain[0].pose, sure=False)], ("left", "right"))
        # 4. Some files store R and T, from the first camera to the second, beside the second camera.
        return next(iter(poses.values())) if found is None and len(poses) == 1 else found

    def _to_metres(self) -> None:
        """Convert pose and projections to metres; if their baselines differ, use that of the translation.

        The projections of DrivingStereo's small images have twice the baseline.
        """
        baseline = 0.0 if self.p is None else abs(float(np.subtract(*(each[0, 3] / each[0, 0] for each in self.p))))
        shift = 0.0 if self.pose is None else float(np.linalg.norm(self.pose[:3, 3]))
        length = shift if shift > _NO_SHIFT_M else baseline
        unit = self._unit or ("m" if length <= _LARGEST_M else "cm" if length <= _BETWEEN_CM_AND_MM else "mm")
        length_m = length * UNITS[unit]
        unit_of_p = min(UNITS.values(), key=lambda each: abs(baseline * each - length_m))
        if length and baseline and abs(baseline * unit_of_p / length_m - 1) > _SAME_BASELINE:
            self.notes.append(f"P gives a baseline of {baseline:.6g}, and T gives {length:.6g}, which was used")
            unit_of_p = length_m / baseline
        if self._unit is None and unit != "m":
            self.notes.append(f"the baseline of {length:g} was taken to be in {unit}: if that is wrong, give --unit")
        if self.pose is not None:
            self.pose = pose_of(self.pose[:3, :3], self.pose[:3, 3] * UNITS[unit])
        if self.p is not None:
            self.p = self.p[0] * (1, 1, 1, unit_of_p), self.p[1] * (1, 1, 1, unit_of_p)

    # --- projections of rectified images ---

    def _p_from_right(self) -> ArrayPair | None:
        """Derive both projections from the right P, if it is the only one; the left P has zeros in the last column."""
        found = self._found.get("P", ())
        left = "left" if self._cameras is None else self._cameras[0]
        if len(found) != 1 or label_of(found[0].name, self._cameras) == left or found[0].value[0, 3] == 0:
            return None
        return found[0].value * (1, 1, 1, 0), found[0].value

    def _project_rectified(self) -> None:
        """Set P from K and a baseline, or from Q. After K and a baseline, ``k`` is None unless it is of raw cameras."""
        found = self._of("K")
        # OpenVSLAM and Stella store both raw K, the rectifying rotations, and one K of the rectified cameras.
        has_both = self.k is not None and self.rectification is not None and "" in found
        rectified, raw = (None, self.k) if has_both else (self.k, None)
        if rectified is None and found:
            single = found.get("") or next(iter(found.values()))
            rectified = single.value, single.value
        if rectified is not None and (baseline := self._baseline(float(rectified[0][0, 0]))) is not None:
            if raw is None and any(each.value.any() for each in self._of("D").values()):
                self.notes.append("D was ignored: with a baseline and without R, images are taken to be rectified")
            self.p, self.k = projections(*rectified, baseline), raw
        elif "Q" in self._found:
            q = self._found["Q"][0].value
            focal_px, cx_left, cy = q[2, 3], -q[0, 3], -q[1, 3]
            # Q's last row ends in -1 / Tx and (cx - cx') / Tx.
            left, right = (camera_matrix(focal_px, focal_px, cx, cy) for cx in (cx_left, cx_left + q[3, 3] / q[3, 2]))
            self.p = projections(left, right, abs(1 / q[3, 2]))

    def _baseline(self, focal_px: float) -> float | None:
        """Return the baseline in the file's unit: a number of that name, an unnamed number, or f B divided by f."""
        for named in self._named_arrays:
            if named.value.size != 1 or not np.isfinite(named.value).all():
                continue
            value = abs(float(named.value.ravel()[0]))
            if found := re.fullmatch(_BASELINE, named.key):
                self._unit = self._unit or (found[1] and (found[1] if found[1] in UNITS else "m"))
                return value
            if named.key in _FOCAL_TIMES_BASELINE:
                return value / focal_px
        return None

    # --- lenses and sizes ---

    def _model(self) -> LensModel | None:
        """Return the stated lens model; raises FormatError for an unsupported model, or for two models."""
        stated = [each.key for each in self._named_arrays if each.key in {"radtan", "equidistant"}]
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
            raise FormatError("expected lenses of one model, got radial-tangential and fisheye lenses")
        return next(iter(models), None)

    def _find_lenses(self, size: ImageSize | None, raw_size: ImageSize | None) -> None:
        """Set the coefficients of both lenses and their model; raises FormatError if they cannot be used."""
        if self.k is None:
            return
        model, d = self._model(), self._eyes("D")
        if size is not None and raw_size not in {None, size}:
            raise FormatError(f"expected raw images of {size}, the size of rectified images, got {raw_size}")
        stated = {
            each.name: each.value for each in self._named_arrays if each.has(COEFFICIENT_WORDS) and each.value.size > 1
        }
        if d is None and stated:
            raise FormatError(f"expected 4, 5, 8, 12 or 14 coefficients of both lenses, got {listing(stated)}")
        if d is None:
            self.notes.append("no lens coefficients were found: the cameras are taken to be pinholes")
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

    def _sizes(self) -> tuple[ImageSize | None, ImageSize | None]:
        """Return the size of the images (with P, of rectified images) and the size of raw images; None if unknown."""
        rectified, raw = dict[ImageSize, None](), dict[ImageSize, None]()  # used as ordered sets
        for named in self._found.get("size", ()):
            width, height = named.value.tolist()
            if not all(0 <= side <= _LARGEST_SIDE_PX and side == int(side) for side in (width, height)):
                raise FormatError(f"expected a width and height of whole pixels, got {width:g} x {height:g}")
            if width and height:  # 0 x 0 is OpenCV's unknown size
                size = upright(ImageSize(int(width), int(height)), [*(self.k or ()), *(self.p or ())])
                (rectified if named.has("rect") else raw)[size] = None
        known = [*((rectified or raw) if self.p is not None else (raw or rectified))]
        if len(known) > 1:
            raise FormatError(f"has images of {known[0]} and of {known[1]}: expected the same size for both cameras")
        return next(iter(known), None), next(iter(raw), None)


def sizes_in(tree: Tree) -> list[Array]:
    """Return the sizes of images, (2,), that a tree states."""
    kinds = map(kind_of, with_parts(_named_arrays(tree)))
    return [array for kind, array in filter(None, kinds) if kind == "size"]


def _named_arrays(tree: Tree) -> Sequence[NamedArray]:
    return by_columns([NamedArray(name, value) for name, value in tree.items() if isinstance(value, np.ndarray)])


def _unlikeliness(found: tuple[NamedArray, str, Array]) -> tuple[bool, bool, int]:
    """Return a sort key: least for the likeliest array of its kind: calibrated K and D, rectifying rotations and P."""
    named, kind, array = found
    is_derived = named.has(_DERIVED)
    is_rotation_vector = named.value.size != array.size
    return is_derived if kind in "KD" else not is_derived, is_rotation_vector, len(named.name)


def projections(left: Array, right: Array, baseline: float) -> ArrayPair:
    """Return P (3, 4) of both rectified cameras from K (3, 3) of each and their distance."""
    shift = np.array([[-right[0, 0] * baseline], [0], [0]])
    return np.hstack([left, np.zeros((3, 1))]), np.hstack([right, shift])


def _coefficients(d: Array, model: LensModel, k: Array) -> Array:
    """Return the coefficients (N,) of a lens in a number that OpenCV's model takes; zeros if there are none.

    Raises FormatError if their number does not fit the model, or if the camera matrix K (3, 3) has skew.
    """
    if abs(k[0, 1]) > _MOST_SKEW * k[0, 0]:
        raise FormatError(f"a camera matrix has a skew of {k[0, 1]:g}: expected [fx 0 cx; 0 fy cy; 0 0 1]")
    counts = COEFFICIENTS[model]
    if not d[counts[-1] :].any():  # files may end in zeros beyond the model's coefficients
        d = d[: counts[-1]] if len(d) else np.zeros(counts[0])
    if len(d) not in counts:
        tilt = ": the last two, a tilted sensor's, must be 0" if len(d) == 14 else ""
        raise FormatError(
            f"expected {' or '.join(map(str, counts))} coefficients of a {model} lens, got {len(d)}{tilt}"
        )
    return d
