"""Points that both photographs of a pair show, by OpenCV's SIFT, which is an extra."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.vertical import Matches
from semisynth_gl.inputs.errors import InputError, counted, how_to_install
from semisynth_gl.textures.atlas import to_grey
from semisynth_gl.textures.image_files import find_images
from semisynth_gl.textures.images import read_image

MOST_PAIRS = 24
"""Pairs that are matched, evenly spread over all."""

_FEATURES = 4000
# Lowe's ratio: a match is kept where the second nearest feature is that much farther away.
_RATIO = 0.75
# Names of the views of a pair beside each other, as Middlebury, ETH3D and KITTI have them: files, then folders.
_RIGHT_OF_NAME = {"im0": "im1"}
_RIGHT_OF_FOLDER = {"image_2": "image_3", "image_0": "image_1", "colored_0": "colored_1"}


def open_matcher() -> Any:  # noqa: ANN401 - a module without types
    """Return OpenCV; raises InputError where it is not installed."""
    try:
        return import_module("cv2")
    except ImportError as error:
        raise InputError(
            f"matching both views of pairs needs OpenCV, which cannot be imported ({error}): "
            f"{how_to_install('matching')}"
        ) from None


def given_pairs(left: str, right: str) -> list[tuple[Path, Path]]:
    """Return the pairs of two sources, each a file, a folder or a glob, in the order of their names."""
    lefts, rights = find_images([left]), find_images([right])
    if len(lefts) != len(rights):
        raise InputError(
            f"`pairs` {left} {right}: {counted(len(lefts), 'left image')} and {counted(len(rights), 'right image')}: "
            "expected one of each, in the same order by name"
        )
    same = [path for path in lefts if path in set(rights)]
    if same:
        raise InputError(f"`pairs` {left} {right}: {same[0]} is on both sides: expected the left views, then the right")
    return list(zip(lefts, rights, strict=True))


def pairs_among(images: Sequence[Path]) -> list[tuple[Path, Path]]:
    """Return the pairs among images whose names tell left and right, as in Middlebury, ETH3D and KITTI."""
    given, pairs = set(images), []
    for path in images:
        right = None
        if path.stem in _RIGHT_OF_NAME:
            right = path.with_stem(_RIGHT_OF_NAME[path.stem])
        elif path.parent.name in _RIGHT_OF_FOLDER:
            right = path.parent.with_name(_RIGHT_OF_FOLDER[path.parent.name]) / path.name
        if right is not None and right in given:
            pairs.append((path, right))
    return pairs


def match_pair(left: Path, right: Path) -> tuple[Matches, tuple[int, int]]:
    """Match features of both views, some of them wrongly; also return the images' width and height."""
    images = [to_grey(read_image(path)) for path in (left, right)]
    height, width = images[0].shape
    if images[0].shape != images[1].shape:
        other = images[1].shape
        raise InputError(f"{left} has {width} x {height} pixels, {right} {other[1]} x {other[0]}: expected one size")
    return match_images(images[0], images[1]), (width, height)


def match_images(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Matches:
    """Match features of two grey images, (H, W) uint8 each: those that are each other's nearest."""
    cv2 = open_matcher()
    detector = cv2.SIFT_create(_FEATURES)
    (points, own), (others, foreign) = (detector.detectAndCompute(image, None) for image in (left, right))
    none = np.empty((0, 2))
    if own is None or foreign is None or min(len(own), len(foreign)) < 2:
        return Matches(none, none)
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = {match.queryIdx: match.trainIdx for (match, _) in matcher.knnMatch(foreign, own, k=2)}
    kept = [
        (first.queryIdx, first.trainIdx)
        for first, second in matcher.knnMatch(own, foreign, k=2)
        if first.distance < _RATIO * second.distance and back.get(first.trainIdx) == first.queryIdx
    ]
    # A feature with several orientations is several, at one place.
    places = {(points[one].pt, others[other].pt) for one, other in kept}
    if not places:
        return Matches(none, none)
    found = np.array(sorted(places), np.float64)
    return Matches(found[:, 0], found[:, 1])
