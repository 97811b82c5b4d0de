"""Camera matrices and lenses of single numbers: fx and cx, k1 and p1, and vectors of them."""

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from semisynth_gl.calibration.kinds import are_numbers, as_camera_matrix
from semisynth_gl.calibration.names import LEFT, RIGHT, Entry, words_of
from semisynth_gl.calibration.tree import Array, Name

_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
# Names, without separators, of K's entries, of D's in OpenCV's order, and of vectors of them.
_ALIASES: dict[tuple[str, ...], str] = {
    ("fx",): "fx fcx focallengthx focalx flx mu fu focallengthpx focalpx f focal focallength",
    ("fy",): "fy fcy focallengthy focaly fly mv fv",
    ("cx",): "cx ccx ppx u0 cu principalpointx opticalcenterx px0",
    ("cy",): "cy ccy ppy v0 cv principalpointy opticalcentery py0",
    **{(name,): name for name in _COEFFICIENTS},
    ("fx", "fy", "cx", "cy"): "intrinsics intrinsic intrinsicsvector projectionparameters cameramatrix",
    ("fx", "fy"): "fc focallength focal focallengths",
    ("cx", "cy"): "cc principalpoint opticalcenter",
    ("k1", "k2"): "radialdistortion",
    ("k1", "k2", "k3"): "radialdistortion",
    ("p1", "p2"): "tangentialdistortion",
}
_PARTS = {(alias, len(parts)): parts for parts, aliases in _ALIASES.items() for alias in aliases.split()}


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Array:
    """Return K (3, 3) of focal lengths and a principal point, px."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def by_columns(entries: Sequence[Entry]) -> list[Entry]:
    """Transpose all 3 x 3 matrices if K is stored for row vectors, as by MATLAB."""
    turned = [Entry(e.name, e.value.reshape(3, 3).T) if e.value.size == 9 else e for e in entries]
    pairs = zip(entries, turned, strict=True)
    is_turned = any(as_camera_matrix(e.value) is None and as_camera_matrix(t.value) is not None for e, t in pairs)
    return turned if is_turned else [*entries]


def with_parts(entries: Sequence[Entry]) -> Iterator[Entry]:
    """Yield entries, and what numbers make together: fx and cx a camera matrix, k1 and k2 a lens."""
    groups: dict[tuple[Name, str], dict[str, float]] = {}
    for entry in entries:
        yield entry
        words, value = words_of(entry.name[-1:]), entry.value.ravel()
        eye = next((word for word in words if word in LEFT | RIGHT), "")
        key = "".join(word for word in words if word not in LEFT | RIGHT)
        if value.size == 1 and (key, 1) not in _PARTS and (numbered := re.fullmatch(r"([a-z]+)(\d)", key)):
            key, eye = numbered[1], numbered[2]
        if are_numbers(value, 1, 2, 3, 4):
            for part, number in zip(_PARTS.get((key, value.size), ()), value.tolist(), strict=False):
                groups.setdefault((entry.name[:-1], eye), {}).setdefault(part, number)
    both = {name for name, eye in groups if eye}  # where numbers without an eye are of both
    for (name, eye), own in groups.items():
        if eye or name not in both:
            yield from _made((*name, eye) if eye else name, groups.get((name, ""), {}) | own)


def _made(name: Name, parts: Mapping[str, float]) -> Iterator[Entry]:
    if {"fx", "cx", "cy"} <= parts.keys():
        yield Entry((*name, "K"), camera_matrix(parts["fx"], parts.get("fy", parts["fx"]), parts["cx"], parts["cy"]))
    coefficients = parts.keys() & {*_COEFFICIENTS}
    if {"k1", "k2", "p1"} <= coefficients:
        last = max(map(_COEFFICIENTS.index, coefficients))
        names = _COEFFICIENTS[: next(count for count in (4, 5, 8, 12) if count > last)]
        yield Entry((*name, "radtan"), np.array([parts.get(each, 0.0) for each in names]))
    elif coefficients in ({"k1", "k2", "k3", "k4"}, {"k2", "k3", "k4", "k5"}):
        yield Entry((*name, "equidistant"), np.array([parts[each] for each in sorted(coefficients)]))
