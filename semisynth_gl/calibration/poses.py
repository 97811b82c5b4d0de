"""How one camera stands to another: a way between them along the poses that a calibration states."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from semisynth_gl.calibration.names import label_of, words_of
from semisynth_gl.calibration.tree import Array, Name

# What stands for a camera in the name of a pose; anything else is a body, an IMU or the world.
_EYES = {"cam", "camera", "c", "s", "sensor", "left", "right", "l", "r"}
# Names of poses: two frames, the one that the pose leads to first, but in the last.
_BACKWARDS = re.compile(r"(.+?)(?:_to_|To|2)(.+)")
_FRAMES = re.compile(
    r"([A-Za-z]+\d*)_T_([A-Za-z]+\d*)|[A-Za-z]*?_?T_?([A-Za-z]+\d*)_([A-Za-z]+\d*)|T_?([A-Z])([A-Z]\d?)"
    r"|T_?([a-z]\d?)([a-z]\d?)|T_?(\d)_?(\d)|(.+)_from_(.+)"
)

_Link = tuple[str, str, Array]
"""A pose to_from_start, (4, 4), after the labels of its two frames."""


def pose_of(turn: Array, shift: Array) -> Array:
    """Return the pose (4, 4) of a rotation (3, 3) and a translation of three numbers."""
    pose: Array = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift.ravel()
    return pose


def right_from_left(poses: Mapping[Name, Array], cameras: tuple[str, str] | None) -> Array | None:
    """Return the pose right_from_left, (4, 4), of the two cameras; None if the poses do not connect them.

    Where names do not tell a pose's direction, it is the one that puts the right camera more to the right.

    Args:
        poses: poses (4, 4) by name: between cameras, along Kalibr's chain, or against a body.
        cameras: labels of the left and the right camera; None for left and right, or the first two numbers.
    """
    sure, unsure = list[_Link](), list[_Link]()
    for name, pose in poses.items():
        frames = _frames(name, cameras)
        if frames is None:
            # The pose of a camera against whatever all poses of this name are against.
            stem = re.sub(r"\d+|left|right", "", _last_word(name).lower())
            unsure.append((label_of(name, cameras), f"against {stem}", pose))
        else:
            sure.append((*frames, pose))
    labels = {label for link in (*sure, *unsure) for label in link[:2]}
    numbers = sorted(int(label) for label in labels if label.isdigit())
    if cameras is None:
        words = len(numbers) < 2 or {"left", "right"} <= labels
        cameras = ("left", "right") if words else (str(numbers[0]), str(numbers[1]))
    turned = [_inverse(link) for link in unsure]
    ways = [_along([*sure, *others], *cameras) for others in (unsure, turned)]
    if ways[0] is None and len(poses) == len(unsure) == 1:  # the only pose leads from one eye to the other
        ways = [unsure[0][2], turned[0][2]]
    return max((way for way in ways if way is not None), key=_leftwards, default=None)


def leads_to_left(name: Name) -> bool:
    """Return whether the name of a translation says that it leads from the right camera to the left one."""
    return _frames(name, None) == ("left", "right")


def _inverse(link: _Link) -> _Link:
    to, start, pose = link
    return start, to, np.asarray(np.linalg.inv(pose), np.float64)


def _along(links: Sequence[_Link], start: str, end: str) -> Array | None:
    """Return the pose end_from_start, (4, 4), of the shortest path of links or inverses; None without a path."""
    ways: dict[str, Array] = {start: np.eye(4)}
    waiting = [start]
    for here in waiting:
        for to, origin, pose in (*links, *map(_inverse, links)):
            if origin == here and to not in ways:
                ways[to] = pose @ ways[here]
                waiting.append(to)
    return ways.get(end)


def _leftwards(pose: Array) -> float:
    """Return the share of a translation that moves points to the left, as a camera farther to the right sees them."""
    length = np.linalg.norm(pose[:3, 3])
    return float(-pose[0, 3] / length) if length else 0.0


def _last_word(name: Name) -> str:
    """Return the last part of a name that is no number."""
    return next((part for part in reversed(name) if not part.isdigit()), "")


def _frames(name: Name, cameras: tuple[str, str] | None) -> tuple[str, str] | None:
    """Return a pose's target frame and source frame, as labels; None if its name does not state both.

    ``T_cam_imu`` in the section of cam1 leads from imu to 1.
    """
    key = _last_word(name)
    if key == "T_cn_cnm1":
        number = label_of(name[: name.index(key)], None)
        return (number, str(int(number) - 1)) if number.isdigit() else None
    found = _FRAMES.fullmatch(key)
    frames = [frame for frame in found.groups() if frame is not None] if found else []
    if not found and (backwards := _BACKWARDS.fullmatch(key)):
        frames = [backwards[2], backwards[1]]
    eyes = [frame for frame in frames if frame.isdigit() or _EYES & set(words_of((frame,)))]
    if not eyes:
        return None
    to, start = (
        (label_of((frame,), cameras) or label_of(name, cameras)) if frame in eyes else frame.lower() for frame in frames
    )
    return None if to == start else (to, start)
