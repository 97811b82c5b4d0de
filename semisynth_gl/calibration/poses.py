"""How two cameras stand to each other, from poses between them, along a chain, or against a body."""

import re
from collections.abc import Mapping

import numpy as np

from semisynth_gl.calibration.names import Entry, eye_of, last_word, words_of
from semisynth_gl.calibration.tree import Array, FormatError, Name

# What stands for a camera in the name of a pose; anything else is a body, an IMU or the world.
_EYES = {"cam", "camera", "c", "s", "sensor", "left", "right", "l", "r", "cn", "cnm"}
# Names of poses: two frames, the one that the pose leads to first, but in the last.
_BACKWARDS = re.compile(r"(.+?)(?:_to_|To|2)(.+)")
_FRAMES = (
    re.compile(r"([A-Za-z]+\d*)_T_([A-Za-z]+\d*)"),
    re.compile(r"[A-Za-z]*?_?T_?([A-Za-z]+\d*)_([A-Za-z]+\d*)"),
    re.compile(r"T_?([A-Z])([A-Z]\d?)"),
    re.compile(r"T_?([a-z]\d?)([a-z]\d?)"),
    re.compile(r"T_?(\d)_?(\d)"),
    re.compile(r"(.+)_from_(.+)"),
)


def along_chain(poses: Mapping[Name, Array], cameras: tuple[str, str] | None) -> tuple[Array, Array] | None:
    """Return R and T along Kalibr's chain, in which each camera's pose leads from the camera before it.

    Args:
        poses: poses (3, 4) or (4, 4) by name.
        cameras: numbers of the left and the right camera; None for the first two.

    Raises:
        FormatError: where the chain has a gap.
    """
    chain = {eye_of(name[:-1]): pose for name, pose in poses.items() if name[-1] == "T_cn_cnm1"}
    links = {int(number): pose for number, pose in chain.items() if number.isdigit()}
    if not links:
        return None
    if not all(each.isdigit() for each in cameras or ()):
        raise FormatError(f"has cameras by number: expected two of cam{min(links) - 1} to cam{max(links)} as --pair")
    first, last = (min(links) - 1, min(links)) if cameras is None else map(int, cameras)
    whole: Array = np.eye(4)
    for number in range(min(first, last) + 1, max(first, last) + 1):
        if number not in links:
            raise FormatError(f"cam{number}.T_cn_cnm1: missing: expected how cam{number} stands to cam{number - 1}")
        whole = _whole(links[number]) @ whole
    return _parts(_inverse(whole) if last < first else whole)


def between_eyes(poses: Mapping[Name, Array], cameras: tuple[str, str] | None) -> tuple[Array, Array] | None:
    """Return R (3, 3) and T (3,), right_from_left, of a pose from one eye to the other; None where there is none.

    Args:
        poses: poses (3, 4) or (4, 4) by name.
        cameras: the left and the right camera by number or name; None for any two.
    """
    for name, pose in poses.items():
        frames = _frames(name)
        if frames is None or not all(map(_is_eye, frames)):
            continue
        to, start = (eye_of((each,)) for each in frames)
        if cameras is not None:
            if {to, start} != set(cameras):
                continue
            backwards = to == cameras[0]
        elif {to, start} == {"left", "right"}:
            backwards = to == "left"
        elif to.isdigit() and start.isdigit():
            backwards = int(to) < int(start)
        else:
            continue
        return _parts(_inverse(pose) if backwards else pose)
    if len(poses) == 1:
        ((name, pose),) = poses.items()
        frames = _frames(name)
        if frames is not None and (cameras is not None or not all(map(_is_eye, frames))):
            return None  # where one camera stands on a body, or how other cameras stand
        return _likelier(_whole(pose), _inverse(pose))
    return None


def by_name(name: Name, turn: Array, shift: Array) -> tuple[Array, Array]:
    """Return R and T, right_from_left, turned round where the translation's name leads from right to left."""
    frames = _frames(name)
    if frames is not None and [eye_of((each,)) for each in frames] == ["left", "right"]:
        return turn.T, -turn.T @ shift
    return turn, shift


def from_body(left: Entry, right: Entry) -> tuple[Array, Array]:
    """Return R and T, right_from_left, from the poses of both cameras to a body, or from it."""
    left_pose, right_pose = (_whole(each.value.reshape(-1, 4)) for each in (left, right))
    to_body, out_of_body = _inverse(right_pose) @ left_pose, right_pose @ _inverse(left_pose)
    frames = _frames(left.name)
    if frames is not None and _is_eye(frames[0]) != _is_eye(frames[1]):
        return _parts(out_of_body if _is_eye(frames[0]) else to_body)
    return _likelier(out_of_body, to_body)


def _likelier(first: Array, second: Array) -> tuple[Array, Array]:
    """Return R and T of the pose, of two (4, 4), that has the right camera more to the right."""

    def leftwards(pose: Array) -> float:
        length = np.linalg.norm(pose[:3, 3])
        return float(-pose[0, 3] / length) if length else 0.0

    return _parts(first if leftwards(first) >= leftwards(second) else second)


def _frames(name: Name) -> tuple[str, str] | None:
    """Return the frames that a pose leads to and from, as its name tells: ``T_cam_imu`` leads from imu to cam."""
    key = last_word(name)
    for pattern in _FRAMES:
        if found := pattern.fullmatch(key):
            return found[1], found[2]
    found = _BACKWARDS.fullmatch(key)
    return None if found is None else (found[2], found[1])


def _is_eye(frame: str) -> bool:
    return frame.isdigit() or bool(_EYES & set(words_of((frame,))))


def _whole(pose: Array) -> Array:
    whole: Array = np.vstack([pose[:3], [0, 0, 0, 1]])
    return whole


def _inverse(pose: Array) -> Array:
    return np.asarray(np.linalg.inv(_whole(pose)), np.float64)


def _parts(pose: Array) -> tuple[Array, Array]:
    return pose[:3, :3], pose[:3, 3]
