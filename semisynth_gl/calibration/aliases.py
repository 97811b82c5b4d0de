"""Finds what each array of a tree is, and of which camera: matrices by their values, other arrays by name and shape.

A name has a camera and a key. The key is the last part of the name that is more than a camera, in small letters and
without digits: ``left.K`` has the camera left and the key k, ``distCoeffsR`` right and distcoeffs, ``cam1.intrinsics``
1 and intrinsics, and ``R`` has no camera and the key r.
"""

import re
from collections.abc import Iterator

import numpy as np

from semisynth_gl.calibration.tree import UNNAMED, Array, Name, Tree
from semisynth_gl.frame.camera import camera_matrix
from semisynth_gl.frame.raw_camera import rotation_of

Arrays = dict[str, dict[str, Array]]
"""Arrays by kind and camera, such as ``arrays["K"]["left"]``.

Cameras are "left", "right", numbers, and "" for arrays whose names state no camera. Kinds are

- K (3, 3), P (3, 4), Q (4, 4), R (3, 3) as in OpenCV, and R_rect for an R whose name says that it rectifies,
- T (3,), a translation; D (N,), coefficients of a lens in OpenCV's order; size (2,), width and height of images,
- fx, width, k1 and others (1,): the single numbers in `_NUMBERS`,
- fisheye (N,): the D of numbers k1 to k4, or k2 to k5, without p1 and p2.
"""

ArrayPair = tuple[Array, Array]
"""An array of the left eye, and one of the right eye."""

# Keys of arrays that are known by name, as regular expressions.
_KEYS = {
    "T": r"t|tvec|trns|trans(lation(vec(tor)?)?)?",
    "R": r"r|om|rvec|rot(ation(vec(tor)?)?)?",  # rotation vectors
    "D": r"d|dist(ortion)?(vec(tor)?|param(eter)?s?)?|.*coeff.*|kc",
    "size": r"(im(age|g|ager)?|frame)?(size|shape)|s|srect|resolution",
}
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
# Keys of single numbers.
_NUMBERS = {
    "fx": "fx mu",
    "fy": "fy mv",
    "cx": "cx ppx u0",
    "cy": "cy ppy v0",
    "width": "width imagewidth imgwidth cols nx",
    "height": "height imageheight imgheight rows ny",
    "baseline": f"baseline b {UNNAMED}",  # in an unknown unit
    "baseline_m": "baselinem baselinemeters",
    "baseline_cm": "baselinecm",
    "baseline_mm": "baselinemm",
    "focal_baseline": "bf focalxbaseline",
    **{name: name for name in _COEFFICIENTS},
}
_NUMBER_OF = {alias: kind for kind, aliases in _NUMBERS.items() for alias in aliases.split()}
# Keys of vectors of these numbers.
_VECTORS = {"intrinsics": ("fx", "fy", "cx", "cy"), "fc": ("fx", "fy"), "cc": ("cx", "cy")}
# Beginnings of words in the names of sizes of other things than images.
_OTHER_SIZES = "board|pattern|chess|checker|grid|tag|marker|roi|crop"
# Words in keys of K of undistorted images, such as newcameramtx. Files have it beside K of the camera.
_UNDISTORTED = "new|optimal|rect|undist"
_EYES = {"left": "left", "right": "right", "l": "left", "r": "right"}
# Tolerance of values that are printed with six digits.
_PRINTED = 1e-4


def find_arrays(tree: Tree) -> Arrays:
    """Return the arrays of a tree, without arrays of one kind and camera that differ."""
    candidates: dict[tuple[str, str], list[Array]] = {}
    for name, value in tree.items():
        if isinstance(value, np.ndarray):
            key, camera = key_and_camera(name, value)
            spaced = re.sub("([A-Z]|_)", r" \1", " ".join(name)).lower().replace("_", " ")
            is_other = re.search(rf"\b({_OTHER_SIZES})", spaced)
            for kind, array in _kinds_of(key, value.ravel()):
                if not (is_other and kind in {"size", "width", "height"}):
                    candidates.setdefault((kind, camera), []).append(array)
    arrays: Arrays = {}
    for (kind, camera), found in candidates.items():
        if all(len(each) == len(found[0]) and np.allclose(each, found[0], _PRINTED, _PRINTED) for each in found):
            arrays.setdefault(kind, {})[camera] = found[0]
    for camera in {camera for cameras in arrays.values() for camera in cameras}:
        for kind, array in _made_of_numbers(arrays, camera):
            arrays.setdefault(kind, {}).setdefault(camera, array)
    return arrays


def key_and_camera(name: Name, value: Array | str = "") -> tuple[str, str]:
    """Return the key and the camera of a name, "" for none. The key of a single number may have digits, such as k1.

    The letters l and r mean an eye at the end of a part, as in ``mtxL``, ``KL`` and ``K_r``. ``stereo.R`` is a
    rotation, but the R in ``R.K`` is the right eye.
    """
    key, eye, number = "", "", ""
    last = re.sub(r"[^a-z0-9]", "", "".join(name[-1:]).lower())
    if last in _NUMBER_OF and isinstance(value, np.ndarray) and value.size == 1:
        key, name = last, name[:-1]
    for part in reversed(name):
        words = [word.lower() for word in re.findall(r"[A-Z](?=[LR]$)|[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", part)]
        digits = [word for word in words if word.isdigit()]
        letters = [word for word in words if not word.isdigit() and word != "stereo"]
        eyes = [word for word in letters if word in {"left", "right"}]
        if not eyes and letters[-1:] in (["l"], ["r"]) and (key or len(letters) > 1):
            eyes = letters[-1:]
        if eyes:
            letters.remove(eyes[0])
            eye = eye or _EYES[eyes[0]]
        number = number or (str(int(digits[-1][-9:])) if digits else "")
        key = key or "".join(letters)
    return key, eye or number


def _kinds_of(key: str, values: Array) -> Iterator[tuple[str, Array]]:
    """Yield what an array of N ``values`` is: its kind and the array in the shape of this kind."""
    count = values.size
    numbers = (_NUMBER_OF[key],) if count == 1 and key in _NUMBER_OF else _VECTORS.get(key, ())
    if numbers and len(numbers) == count:
        yield from zip(numbers, values[:, None], strict=True)
    elif (matrix := _matrix(key, values)) is not None:
        yield matrix
    else:
        kind = next((kind for kind, pattern in _KEYS.items() if re.fullmatch(pattern, key)), "")
        if kind == "R" and count == 3:
            x, y, z = values.tolist()
            yield "R", np.array(rotation_of((x, y, z)))
        elif kind == "size" and count in (2, 3):
            yield "size", values[1::-1] if key.endswith("shape") else values[:2]  # NumPy's shapes have the height first
        elif (kind == "T" and count == 3) or (kind == "D" and count != 1):
            yield kind, values


def _matrix(key: str, values: Array) -> tuple[str, Array] | None:
    """Return the kind of a matrix of N ``values``, and the matrix; None for other arrays."""
    if values.size == 9:
        square = values.reshape(3, 3)
        if is_rotation(square):
            return "R_rect" if "rect" in key else "R", square
        return ("K", square) if is_camera_matrix(square) and not re.search(_UNDISTORTED, key) else None
    if values.size == 12 and is_camera_matrix(values.reshape(3, 4)[:, :3]):
        return "P", values.reshape(3, 4)
    # Q is [1 0 0 -cx; 0 1 0 -cy; 0 0 0 f; 0 0 -1/Tx (cx-cx')/Tx].
    if values.size == 16 and values[[0, 5]].all() and values[11] > 1 and values[14] and not values[8:11].any():
        return "Q", values.reshape(4, 4)
    return None


def _made_of_numbers(arrays: Arrays, camera: str) -> Iterator[tuple[str, Array]]:
    """Yield K, size, D and fisheye of a camera's single numbers; K also of numbers without a camera."""
    own = {kind: float(arrays[kind][camera][0]) for kind in _NUMBERS if camera in arrays.get(kind, {})}
    shared = {kind: float(arrays[kind][""][0]) for kind in _NUMBERS if "" in arrays.get(kind, {})}
    pinhole = shared | own
    if own.keys() & {"fx", "fy", "cx", "cy"} and {"fx", "cx", "cy"} <= pinhole.keys():
        fx, cx, cy = pinhole["fx"], pinhole["cx"], pinhole["cy"]
        yield "K", camera_matrix(fx, pinhole.get("fy", fx), cx, cy)
    if {"width", "height"} <= own.keys():
        yield "size", np.array([own["width"], own["height"]])
    if {"k1", "k2", "p1"} <= own.keys():
        count = 8 if own.keys() & {"k4", "k5", "k6"} else 5 if "k3" in own else 4
        yield "D", np.array([own.get(name, 0.0) for name in _COEFFICIENTS[:count]])
    elif {"k2", "k3", "k4"} <= own.keys():
        d = np.array([own[name] for name in ("k1", "k2", "k3", "k4", "k5") if name in own])
        yield from (("D", d), ("fisheye", d))


def lens_arrays(tree: Tree) -> Tree:
    """Return the values of a tree that seem to be coefficients of lenses, also under names that no kind has."""
    found: Tree = {}
    for name, value in tree.items():
        if isinstance(value, np.ndarray) and value.size:
            kinds = {kind for kind, _ in _kinds_of(key_and_camera(name, value)[0], value.ravel())}
            pattern = "k1" if value.size == 1 else "dist|coef"
            if kinds & {"D", *_COEFFICIENTS} or re.search(pattern, ".".join(name).lower()):
                found[name] = value
    return found


def is_camera_matrix(k: Array) -> bool:
    """Return whether (3, 3) numbers are [fx s cx; 0 fy cy; 0 0 1]."""
    return bool(min(k[0, 0], k[1, 1]) > 1 and np.abs([k[1, 0], *(k[2] - (0, 0, 1))]).sum() < _PRINTED)


def is_rotation(r: Array) -> bool:
    """Return whether (3, 3) numbers are a rotation."""
    # No number of a rotation exceeds 1, and much larger numbers would overflow.
    small = np.abs(r).max() < 1 + _PRINTED
    return bool(small and np.allclose(r @ r.T, np.eye(3), atol=_PRINTED) and np.linalg.det(r) > 0)
