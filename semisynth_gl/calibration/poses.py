"""The relative pose of two cameras, computed from the poses that a calibration states."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from semisynth_gl.calibration.named_arrays import LEFT, RIGHT, label_of, last_part, words_of
from semisynth_gl.calibration.tree import Array, Name

# Words that mean a camera in the name of a pose. Any other frame is a body, an IMU or the world.
_EYES = {"cam", "camera", "c", "s", "sensor", "left", "right", "l", "r"}
# Forms of names that state two frames. The target frame is first, except in the last form, such as cam_to_board.
_FRAME = r"([A-Za-z]+\d*)"
_FORMS = (
    rf"{_FRAME}_T_{_FRAME}|(.+)_from_(.+)",
    rf"[A-Za-z]*?_?T_?{_FRAME}_{_FRAME}|T_?([A-Z])([A-Z]\d?)|T_?([a-z]\d?)([a-z]\d?)|T_?(\d)_?(\d)",
    r"(?P<start>.+?)(?:_to_|To|2(?=[A-Za-z]))(?P<to>.+)",
)


class RelativePose(NamedTuple):
    """The pose (4, 4) to_from_start of two frames; if it is not ``sure``, the pose may be the inverse."""

    to: str
    start: str
    pose: Array
    sure: bool = True


def pose_of(turn: Array, shift: Array) -> Array:
    """Return the pose (4, 4) of a rotation (3, 3) and a translation of three numbers."""
    pose: Array = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift.ravel()
    return pose


def relative_pose(name: Name, pose: Array, cameras: tuple[str, str] | None) -> RelativePose:
    """Return the relative pose of the frames in the name of a pose (4, 4), else of its camera and a common frame."""
    if frames := frames_of(name, cameras):
        return RelativePose(*frames, pose)
    # Poses that differ only in the camera's name start at a common frame, or lead to it.
    stem = " ".join(word for word in words_of((last_part(name),)) if not (word.isdigit() or word in LEFT | RIGHT))
    return RelativePose(label_of(name, cameras), f"against {stem}", pose, sure=False)


def right_from_left(poses: Sequence[RelativePose], cameras: tuple[str, str] | None) -> Array | None:
    """Return the pose right_from_left, (4, 4), of the two cameras; None if the poses do not connect them.

    Where poses are not sure, the direction is chosen that puts the right camera more to the right.
    ``cameras`` are the labels of the left and the right camera; None for left and right, or the two lowest numbers.
    """
    frames = {frame for each in poses for frame in each[:2]}
    numbers = sorted((frame for frame in frames if frame.isdigit()), key=int)
    if cameras is None:
        cameras = ("left", "right") if len(numbers) < 2 or {"left", "right"} <= frames else (numbers[0], numbers[1])
    found = list[Array]()
    for inverted in (False, True):
        # Poses frame_from_left. Each round over ``poses`` adds at least one more frame of a chain.
        known: dict[str, Array] = {cameras[0]: np.eye(4)}
        for to, start, pose, sure in [*poses] * min(len(poses), 9):
            to_from_start = np.linalg.inv(pose) if inverted and not sure else pose
            if start in known:
                known.setdefault(to, to_from_start @ known[start])
            elif to in known:
                known[start] = np.linalg.inv(to_from_start) @ known[to]
        found += [known[cameras[1]]] if cameras[1] in known else []
    return min(found, key=lambda pose: pose[0, 3] / (np.linalg.norm(pose[:3, 3]) or 1), default=None)


def frames_of(name: Name, cameras: tuple[str, str] | None = None) -> tuple[str, str] | None:
    """Return the labels of a pose's target frame and source frame; None if its name does not state both.

    ``T_cam_imu`` in the section of cam1 leads from imu to 1.
    """
    key = last_part(name)
    if key == "T_cn_cnm1":
        number = label_of(name[: name.index(key)])
        return (number, str(int(number) - 1)) if number.isdigit() else None
    found = next((found for form in _FORMS if (found := re.fullmatch(form, key))), None)
    if found is None:
        return None
    frames = [found["to"], found["start"]] if "to" in found.groupdict() else [each for each in found.groups() if each]
    eyes = [frame for frame in frames if frame.isdigit() or _EYES & {*words_of((frame,))}]
    labels = {frame: label_of((frame,), cameras) for frame in eyes}
    if not all(labels.values()):  # the number in T_cam_imu0 means the camera
        labels = {frame: label_of(name, cameras) for frame in eyes}
        frames = [frame if frame in eyes else frame.rstrip("0123456789") for frame in frames]
    to, start = (labels.get(frame, frame.lower()) for frame in frames)
    return None if to == start or not eyes else (to, start)
