"""Matching points of two views by OpenCV's SIFT; OpenCV is an extra."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration.vertical import Matches
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.inputs.opencv import open_opencv
from semisynth_gl.textures.atlas import to_grey
from semisynth_gl.textures.image_files import find_images
from semisynth_gl.textures.images import read_image

MOST_PAIRS = 24
"""Largest number of pairs that are matched; more pairs are sampled evenly."""

# Largest number of features per image.
_FEATURES = 4000
# Lowe's ratio: a match is kept if its distance is less than this times that of the second nearest feature.
_RATIO = 0.75
# What the right view is called, by the left view's name: files of one folder (Middlebury, ETH3D), folders (KITTI).
_RIGHT_OF_NAME = {"im0": "im1"}
_RIGHT_OF_FOLDER = {"image_2": "image_3", "image_0": "image_1", "colored_0": "colored_1"}


def open_matcher() -> Any:  # noqa: ANN401 - a module without types
    """Return the module of OpenCV; raises InputError where it cannot be imported."""
    return open_opencv("matching both views of pairs")


def given_pairs(left: str, right: str) -> list[tuple[Path, Path]]:
    """Return pairs of left and right images from two sources, each a file, a folder or a glob.

    Images are paired in the order of their names. Raises InputError where the numbers of images differ, or an image is
    on both sides.
    """
    lefts, rights = find_images([left]), find_images([right])
    if len(lefts) != len(rights):
        raise InputError(
            f"{left} {right}: {counted(len(lefts), 'left image')} and {counted(len(rights), 'right image')}: "
            "expected equal numbers, in the same order by name",
            argument="pairs",
        )
    same = [path for path in lefts if path in set(rights)]
    if same:
        raise InputError(
            f"{left} {right}: {same[0]} is on both sides: expected left views, then right views", argument="pairs"
        )
    return list(zip(lefts, rights, strict=True))


def pairs_among(images: Sequence[Path]) -> list[tuple[Path, Path]]:
    """Return the pairs of left and right images that are named as in Middlebury, ETH3D or KITTI."""
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
    """Return the matches of a pair's features, some of them wrong, and the images' width and height.

    Raises InputError where an image cannot be read, the sizes differ, or OpenCV is missing.
    """
    images = [to_grey(read_image(path)) for path in (left, right)]
    height, width = images[0].shape
    if images[0].shape != images[1].shape:
        other = images[1].shape
        raise InputError(f"{left} has {width} x {height} pixels, {right} {other[1]} x {other[0]}: expected one size")
    return match_images(images[0], images[1]), (width, height)


def match_images(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Matches:
    """Match features of two grey images, (H, W) uint8 each. Features match if each is the other's nearest."""
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
    # OpenCV returns a feature with several orientations several times, at the same place.
    places = {(points[one].pt, others[other].pt) for one, other in kept}
    if not places:
        return Matches(none, none)
    found = np.array(sorted(places), np.float64)
    return Matches(found[:, 0], found[:, 1])
