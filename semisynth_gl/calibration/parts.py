"""Camera matrices and lenses of single numbers: fx and cx, k1 and p1, and vectors of them."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from semisynth_gl.calibration.arrays import camera_matrix
from semisynth_gl.calibration.kinds import are_numbers, is_camera_matrix
from semisynth_gl.calibration.names import LEFT, RIGHT, Entry, words_of
from semisynth_gl.calibration.tree import Name

# Names of single numbers, without separators: the entries of K, and of D in OpenCV's order.
_SCALARS = {
    "fx": "fx fcx focallengthx focalx flx mu fu focallengthpx focalpx f focal focallength",
    "fy": "fy fcy focallengthy focaly fly mv fv",
    "cx": "cx ccx ppx u0 cu principalpointx opticalcenterx px0",
    "cy": "cy ccy ppy v0 cv principalpointy opticalcentery py0",
    **{name: name for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")},
}
# Vectors of such numbers: Kalibr's intrinsics, Bouguet's and MATLAB's.
_VECTORS = {
    ("fx", "fy", "cx", "cy"): "intrinsics intrinsic intrinsicsvector projectionparameters cameramatrix",
    ("fx", "fy"): "fc focallength focal focallengths",
    ("cx", "cy"): "cc principalpoint opticalcenter",
    ("k1", "k2"): "radialdistortion",
    ("k1", "k2", "k3"): "radialdistortion",
    ("p1", "p2"): "tangentialdistortion",
}
_PARTS_OF = {
    **{(alias, 1): (name,) for name, aliases in _SCALARS.items() for alias in aliases.split()},
    **{(alias, len(names)): names for names, aliases in _VECTORS.items() for alias in aliases.split()},
}
_COEFFICIENTS = tuple(name for name in _SCALARS if name[0] in "kps")


def by_columns(entries: Sequence[Entry]) -> list[Entry]:
    """Return entries with matrices that multiply from the right, as MATLAB's do, turned to ones from the left."""
    square = [e.value for e in entries if e.value.shape == (3, 3)]
    if not any(is_camera_matrix(each.T) and not is_camera_matrix(each) for each in square):
        return list(entries)
    return [Entry(e.name, e.value.T if e.value.shape == (3, 3) else e.value) for e in entries]


def with_parts(entries: Sequence[Entry]) -> Iterator[Entry]:
    """Yield entries, and what parts make together: T_0 to T_2, fx and cx of a camera matrix, k1 and k2 of a lens."""
    groups: dict[Name, dict[str, dict[str, float]]] = {}
    for entry in (*entries, *_numbered(entries)):
        yield entry
        if not are_numbers(entry.value, 1, 2, 3, 4):
            continue
        words, size = words_of(entry.name[-1:]), entry.value.size
        eye = next((word for word in words if word in LEFT | RIGHT), "")
        key = "".join(word for word in words if word not in LEFT | RIGHT)
        if size == 1 and (key, 1) not in _PARTS_OF and (numbered := re.fullmatch(r"([a-z]+)(\d)", key)):
            key, eye = numbered[1], numbered[2]
        for part, value in zip(_PARTS_OF.get((key, size), ()), entry.value.ravel().tolist(), strict=False):
            groups.setdefault(entry.name[:-1], {}).setdefault(eye, {}).setdefault(part, value)
    for name, eyes in groups.items():
        for eye in [each for each in eyes if each] or [""]:
            named = eyes.get("", {}) | eyes[eye]
            own = (*name, eye) if eye else name
            if {"fx", "cx", "cy"} <= named.keys():
                k = camera_matrix(named["fx"], named.get("fy", named["fx"]), named["cx"], named["cy"])
                yield Entry((*own, "K"), k)
            yield from _coefficients(own, named)


def _numbered(entries: Iterable[Entry]) -> Iterator[Entry]:
    """Yield the vectors that numbers count from 0 in their names: T_0, T_1 and T_2."""
    vectors: dict[Name, dict[int, float]] = {}
    for entry in entries:
        if entry.value.size == 1 and (counted := re.fullmatch(r"(.*?[A-Za-z])_?(\d{1,2})", entry.key)):
            numbers = vectors.setdefault((*entry.name[:-1], counted[1]), {})
            numbers[int(counted[2])] = float(entry.value.ravel()[0])
    for name, numbers in vectors.items():
        if len(numbers) > 2 and sorted(numbers) == [*range(len(numbers))]:
            yield Entry(name, np.array([numbers[k] for k in range(len(numbers))]))


def _coefficients(name: Name, values: Mapping[str, float]) -> Iterator[Entry]:
    named = {key: value for key, value in values.items() if key in _COEFFICIENTS}
    if {"k1", "k2", "p1"} <= named.keys():
        last = max(_COEFFICIENTS.index(key) for key in named)
        count = next(count for count in (4, 5, 8, 12) if count > last)
        yield Entry((*name, "radtan"), np.array([named.get(key, 0.0) for key in _COEFFICIENTS[:count]]))
    for keys in (("k1", "k2", "k3", "k4"), ("k2", "k3", "k4", "k5")):
        if named.keys() == set(keys):
            yield Entry((*name, "equidistant"), np.array([named[key] for key in keys]))
