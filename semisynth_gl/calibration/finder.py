"""Finds the arrays of a stereo rig in the tree of a calibration.

The steps from a file to a rig:

1. `tree` reads a file as a tree: values by name, such as ``("left", "K")``.
2. An adapter of `adapters` renames the values of a tool whose names alone do not say enough, such as Basalt.
3. `aliases` finds what each array is, and of which camera, such as ``arrays["K"]["left"]``.
4. `find_stereo_arrays` makes `StereoArrays` of them: K, D and P of both eyes, and the pose between the cameras.
5. `rig` makes the rectified rig of these.
"""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from semisynth_gl.calibration.aliases import ArrayPair, Arrays, find_arrays, is_rotation, key_and_camera
from semisynth_gl.calibration.lenses import lens_model, usable_lenses
from semisynth_gl.calibration.sizes import ImageSize, upright
from semisynth_gl.calibration.tree import Array, FormatError, Tree
from semisynth_gl.frame.camera import camera_matrix
from semisynth_gl.frame.raw_camera import LensModel

UNITS: Mapping[str, float] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""Metres per unit of a translation, by the unit's name."""

# A baseline without a unit is taken as metres up to the first value, as cm up to the second, and as mm above. Most rigs
# have a baseline of about 12 cm: 38 cm is 3.2 times as long, and 38 mm is shorter by the same factor.
_LARGEST_M, _BETWEEN_CM_AND_MM = 2.5, 38.0
# Maximum number of corners along a side of a calibration board.
_LARGEST_BOARD = 32
# Relative tolerance of equal baselines, and the length up to which a translation is zero.
_SAME_BASELINE, _NO_SHIFT_M = 0.02, 1e-6
# Keys of poses, with target frame and source frame; "camera" stands for the number in the name, 0 for T_cam0_imu.
_POSES = {
    "tcamimu": ("camera", "body"),  # Kalibr
    "timucam": ("body", "camera"),  # OpenVINS
    "tbs": ("body", "camera"),  # EuRoC, Kimera
    "bodytcam": ("body", "camera"),  # VINS-Fusion
    "tcc": ("1", "2"),  # T_c1_c2 of ORB-SLAM3
    "tcamref": ("camera", "ref"),  # mrcal, by its adapter
}
# Maximum number of poses in a chain from the left to the right camera.
_LONGEST_CHAIN = 9

Frames = tuple[str, str]
"""Target frame and source frame of a pose, such as ("0", "body")."""
Cameras = tuple[str, str] | None
"""The left and the right camera as in `Arrays`.

None means the cameras "left" and "right"; if the tree lacks them, its two numbered cameras, the lower number left.
"""


@dataclass(frozen=True, slots=True, eq=False)
class StereoArrays:
    """The arrays of a rig by OpenCV's names; None for what the calibration does not have.

    Attributes:
        source: name of the file or files, for messages.
        size: the stated size of the images.
        p: projection matrices (3, 4) of the rectified images, the last column in pixels times metres.
        pose: R and T as one pose (4, 4), right_from_left, metres.
        rectification: R1 and R2, rectified_from_raw of both eyes, (3, 3).
        k: camera matrices (3, 3) before rectification.
        d: coefficients (N,) of both lenses in OpenCV's order.
        model: the model of both lenses.
        notes: sentences on what was guessed, and what was ignored.
    """

    source: str
    size: ImageSize | None = None
    p: ArrayPair | None = None
    pose: Array | None = None
    rectification: ArrayPair | None = None
    k: ArrayPair | None = None
    d: ArrayPair | None = None
    model: LensModel | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def is_rig(self) -> bool:
        """Whether the arrays are enough for a rig."""
        return self.p is not None or (self.k is not None and self.pose is not None)


def find_stereo_arrays(
    tree: Tree, source: str, cameras: Cameras, unit: str | None, size: ImageSize | None
) -> StereoArrays:
    """Return the arrays of a rig in a tree; an array that the tree lacks is None.

    If the tree has more than two cameras, ``cameras`` must choose two. A ``unit`` of None is guessed. ``size`` is the
    size of the photographs; it is used if the tree states none. Raises FormatError if values contradict each other.
    """
    poses = _named_poses(tree)
    if cameras is not None:
        tree = {name: value for name, value in tree.items() if key_and_camera(name, value)[1] in {"", *cameras}}
    arrays, notes = find_arrays(tree), list[str]()
    k, p, d = (_pair(arrays, kind, cameras) for kind in ("K", "P", "D"))
    rectification = _pair(arrays, "R_rect", cameras)
    if rectification is None and _pair(arrays, "T", cameras) is None:  # beside T of both cameras, R is of their poses
        rectification = _pair(arrays, "R", cameras)
    pose = _stereo_pose(arrays, poses, cameras)
    p = p or _projections_of_right(arrays, cameras)
    if p is None and pose is None:
        p, unit = _projections_of_rectified(arrays, k, unit, notes)
        k = None
    pose, p = _to_metres(pose, p, unit, notes)
    stated_size = _size(arrays, [*(k or ()), *(p or ())], notes)
    model: LensModel | None = None
    try:
        model = lens_model(tree) or ("fisheye" if "fisheye" in arrays else None)
        if k is not None:
            model, d = usable_lenses(model, k, d, stated_size or size, tree, notes)
    except FormatError as error:
        if p is None:
            raise
        notes.append(f"the lenses were ignored: {error}")
        d = None
    return StereoArrays(source, stated_size, p, pose, rectification, k, d, model, notes)


def _pair(arrays: Arrays, kind: str, cameras: Cameras) -> ArrayPair | None:
    """Return the left and the right array of a kind; None if one is missing."""
    of_kind = arrays.get(kind, {})
    left, right = (of_kind.get(camera) for camera in cameras or _left_and_right(of_kind.keys()))
    return None if left is None or right is None else (left, right)


def _left_and_right(cameras: AbstractSet[str]) -> tuple[str, str]:
    """Return the names of the left and the right camera, see `Cameras`.

    Raises FormatError if there are more than two numbered cameras.
    """
    numbers = sorted((camera for camera in cameras if camera.isdigit()), key=int)
    if {"left", "right"} <= cameras or len(numbers) < 2:
        return "left", "right"
    if len(numbers) > 2:
        text = ", ".join(numbers)
        advice = "choose two with --pair LEFT,RIGHT (in Python: the argument cameras)"
        raise FormatError(f"has {len(numbers)} cameras ({text}): {advice}")
    return numbers[0], numbers[1]


# --- the pose of the right camera ---


def _stereo_pose(arrays: Arrays, poses: Mapping[Frames, Array], cameras: Cameras) -> Array | None:
    """Return the pose (4, 4), right_from_left, in the file's unit: from R and T, or from a chain of poses."""
    rotations, translations = arrays.get("R", {}), arrays.get("T", {})
    if "" in rotations and "" in translations:
        return pose_of(rotations[""], translations[""])
    of_cameras = {each: pose_of(rotations[each], translations[each]) for each in rotations if each in translations}
    if not poses and len(of_cameras) == 1:  # R and T of the pair, stored beside the right camera
        return next(iter(of_cameras.values()))
    poses = {**poses} | {(camera, "reference"): pose for camera, pose in of_cameras.items()}
    left, right = cameras or _left_and_right({*chain.from_iterable(poses)})
    from_left = {left: np.eye(4)}
    for _ in range(_LONGEST_CHAIN):
        for (to, start), pose in poses.items():
            if start in from_left:
                from_left.setdefault(to, pose @ from_left[start])
            elif to in from_left:
                from_left[start] = np.linalg.inv(pose) @ from_left[to]
    return from_left.get(right)


def _named_poses(tree: Tree) -> dict[Frames, Array]:
    """Return the poses (4, 4) whose names are in `_POSES` or from an adapter."""
    poses: dict[Frames, Array] = {}
    for name, value in tree.items():
        if not isinstance(value, np.ndarray) or value.size not in (12, 16):
            continue
        key, camera = key_and_camera(name)
        rows, frames = value.reshape(-1, 4), name[1:] if name[0] == "pose" else _POSES.get(key, ())
        if len(frames) == 2 and is_rotation(rows[:3, :3]):
            to, start = (camera if frame == "camera" else frame for frame in frames)
            poses.setdefault((to, start), pose_of(rows[:3, :3], rows[:3, 3]))
    return poses


def pose_of(turn: Array, shift: Array) -> Array:
    """Return the pose (4, 4) of a rotation (3, 3) and a translation of three numbers."""
    pose: Array = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift.ravel()
    return pose


def _to_metres(
    pose: Array | None, p: ArrayPair | None, unit: str | None, notes: list[str]
) -> tuple[Array | None, ArrayPair | None]:
    """Convert a pose and projections to metres; if their baselines differ, use that of the pose.

    For example, P of DrivingStereo's small images states twice the true baseline.
    """
    of_p = 0.0 if p is None else abs(float(p[0][0, 3] / p[0][0, 0] - p[1][0, 3] / p[1][0, 0]))
    shift = 0.0 if pose is None else float(np.linalg.norm(pose[:3, 3]))
    length = shift if shift > _NO_SHIFT_M else of_p
    if unit is None:
        unit = "m" if length <= _LARGEST_M else "cm" if length <= _BETWEEN_CM_AND_MM else "mm"
        if unit != "m":
            notes.append(f"the baseline of {length:g} was taken to be in {unit}: if that is wrong, give --unit")
    if pose is not None:
        pose = pose_of(pose[:3, :3], pose[:3, 3] * UNITS[unit])
    if p is not None:
        factor = UNITS[unit]
        if length and of_p and abs(of_p / length - 1) > _SAME_BASELINE:
            notes.append(f"P gives a baseline of {of_p:.6g}, and T gives {length:.6g}, which was used")
            factor *= length / of_p
        p = p[0] * (1, 1, 1, factor), p[1] * (1, 1, 1, factor)
    return pose, p


# --- projections of rectified images ---


def projections(left: Array, right: Array, baseline: float) -> ArrayPair:
    """Return P (3, 4) of both rectified cameras from K (3, 3) of each and their distance."""
    shift = np.array([[-right[0, 0] * baseline], [0], [0]])
    return np.hstack([left, np.zeros((3, 1))]), np.hstack([right, shift])


def _projections_of_right(arrays: Arrays, cameras: Cameras) -> ArrayPair | None:
    """Return both projections if the only P is the right one, with the baseline in its last column."""
    matrices = arrays.get("P", {})
    left = "left" if cameras is None else cameras[0]
    if len(matrices) != 1 or left in matrices:
        return None
    (right,) = matrices.values()
    return (right * (1, 1, 1, 0), right) if right[0, 3] else None


def _projections_of_rectified(
    arrays: Arrays, k: ArrayPair | None, unit: str | None, notes: list[str]
) -> tuple[ArrayPair | None, str | None]:
    """Return both projections from K of the rectified cameras and a baseline, or from Q; None without these.

    Also returns ``unit``, or if it is None, the unit that the baseline's name states.
    """
    matrices = arrays.get("K", {})
    if k is None and len(matrices) == 1:
        (single,) = matrices.values()
        k = single, single
    baseline, stated_unit = (None, None) if k is None else _baseline(arrays, float(k[0][0, 0]))
    if k is not None and baseline is not None:
        if any(d.any() for d in arrays.get("D", {}).values()):
            notes.append("D was ignored: with a baseline and without R, images are taken to be rectified")
        return projections(*k, baseline), unit or stated_unit
    for q in arrays.get("Q", {}).values():
        focal_px, cx_left, cy = q[2, 3], -q[0, 3], -q[1, 3]
        # The last row of Q ends in -1 / Tx and (cx - cx') / Tx.
        left, right = (camera_matrix(focal_px, focal_px, cx, cy) for cx in (cx_left, cx_left + q[3, 3] / q[3, 2]))
        return projections(left, right, abs(1 / q[3, 2])), unit
    return None, unit


def _baseline(arrays: Arrays, focal_px: float) -> tuple[float | None, str | None]:
    """Return the baseline and the unit that its name states, or else a stated product f B, divided by ``focal_px``."""
    kinds = {f"baseline_{unit}": unit for unit in UNITS} | {"baseline": None, "focal_baseline": None}
    for kind, unit in kinds.items():
        for number in arrays.get(kind, {}).values():
            return abs(float(number[0])) / (focal_px if kind == "focal_baseline" else 1), unit
    return None, None


def _size(arrays: Arrays, matrices: Sequence[Array], notes: list[str]) -> ImageSize | None:
    """Return the size of the images; None if it is unknown. Raises FormatError if the cameras have two sizes.

    A small size that does not contain the principal points of ``matrices``, K or P, is ignored.
    """
    sizes = set[ImageSize]()
    for width, height in (size.tolist() for size in arrays.get("size", {}).values()):
        if not all(0 <= side == int(side) for side in (width, height)) or (width > 0) != (height > 0):
            raise FormatError(f"expected a width and height of whole pixels, got {width:g} x {height:g}")
        if width == height == 0:  # OpenCV's unknown size
            continue
        size = upright(ImageSize(int(width), int(height)), matrices)
        if max(size) <= _LARGEST_BOARD and any((each[:2, 2] > size).any() for each in matrices):
            notes.append(f"the size {size} was taken to be that of a calibration board")
        else:
            sizes.add(size)
    if len(sizes) > 1:
        two = " and of ".join(map(str, sorted(sizes)[:2]))
        raise FormatError(f"has images of {two}: expected the same size for both cameras")
    return next(iter(sizes), None)
