"""Two cameras before rectification, and how they stand to each other, as Kalibr, Basalt and DepthAI write them.

No file says how to rectify the rig.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from semisynth_gl.calibration.file_values import FormatError, Matrix, checked_size, numbers, rotation, stated_size
from semisynth_gl.calibration.raw_rig import Intrinsics, Unrectified, intrinsics
from semisynth_gl.calibration.rig import Size
from semisynth_gl.inputs.errors import shown
from semisynth_gl.scene.rig import rotation_from_quaternion

# Basalt's lenses: the names of their coefficients in OpenCV's order, and what `intrinsics` calls them.
_BASALT_LENSES = {
    "pinhole": ((), "radial-tangential"),
    "pinhole-radtan8": (("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), "radial-tangential"),
    "kb4": (("k1", "k2", "k3", "k4"), "fisheye"),
}
# DepthAI's types of a camera, and the number of coefficients that count.
_DEPTHAI_LENSES = {0: ("radial-tangential", 14), 1: ("fisheye", 4)}
_CM = 0.01


def is_basalt(values: Mapping[str, Any]) -> bool:
    """Return whether a file is Basalt's calibration.json."""
    inner = values.get("value0")
    return isinstance(inner, Mapping) and {"T_imu_cam", "intrinsics"} <= inner.keys()


def is_depthai(values: Mapping[str, Any]) -> bool:
    """Return whether a file is what DepthAI's eepromToJsonFile writes of an OAK."""
    return "cameraData" in values


def kalibr_rig(values: Mapping[str, Any], source: str) -> Unrectified:
    """Return the rig of a Kalibr camchain.

    Raises:
        FormatError: where the file breaks its format, or has another lens.
    """
    cameras, sizes = [], []
    for name in ("cam0", "cam1"):
        camera, prefix = values[name], f"{name}."
        if camera.get("camera_model", "pinhole") != "pinhole":
            raise FormatError(
                f"{prefix}camera_model: expected pinhole, got {shown(camera['camera_model'])}: calibrate with "
                "kalibr_calibrate_cameras --models pinhole-radtan or pinhole-equi"
            )
        for key in ("intrinsics", "distortion_coeffs", "resolution"):
            if key not in camera:
                raise FormatError(f"{prefix}{key}: missing: expected a camchain that Kalibr wrote")
        fx, fy, cx, cy = numbers(prefix + "intrinsics", camera["intrinsics"], (4,)).tolist()
        with_matrix = {**camera, "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]}
        made = intrinsics(with_matrix, ("K", "distortion_coeffs"), prefix, camera.get("distortion_model"))
        if made is None:
            raise FormatError(f"{prefix}distortion_coeffs: expected four coefficients, got none")
        cameras.append(made)
        sizes.append(stated_size(camera))
    if sizes[0] is None or sizes[0] != sizes[1]:
        raise FormatError(f"resolution: expected one size for both cameras, got {sizes[0]} and {sizes[1]}")
    if "T_cn_cnm1" not in values["cam1"]:
        raise FormatError("cam1.T_cn_cnm1: missing: expected how cam1 stands to cam0; calibrate both together")
    # From the frame of cam0 to that of cam1, as OpenCV's R and T.
    placed = numbers("cam1.T_cn_cnm1", values["cam1"]["T_cn_cnm1"], (4, 4))
    turn = rotation("cam1.T_cn_cnm1", placed[:3, :3].tolist())
    return Unrectified((cameras[0], cameras[1]), turn, placed[:3, 3], sizes[0], source)


def basalt_rig(values: Mapping[str, Any], source: str) -> Unrectified:
    """Return the rig of Basalt's first two cameras, the left one first.

    Raises:
        FormatError: where the file breaks its format, or has another lens.
    """
    inner = values["value0"]
    lenses, poses, sizes = (_two(f"value0.{key}", inner.get(key)) for key in ("intrinsics", "T_imu_cam", "resolution"))
    cameras = tuple(_basalt_camera(f"value0.intrinsics[{number}].", each) for number, each in enumerate(lenses))
    size = _one_size(checked_size(sizes[0]), checked_size(sizes[1]))
    imu_from_cameras = [_pose(f"value0.T_imu_cam[{number}]", each) for number, each in enumerate(poses)]
    right_from_left = np.linalg.inv(imu_from_cameras[1]) @ imu_from_cameras[0]
    return Unrectified((cameras[0], cameras[1]), right_from_left[:3, :3], right_from_left[:3, 3], size, source)


def depthai_rig(values: Mapping[str, Any], source: str) -> Unrectified:
    """Return the rig of an OAK's two stereo cameras, in the size that they were calibrated in.

    Raises:
        FormatError: where the file breaks its format, or has another lens.
    """
    stereo, listed = values.get("stereoRectificationData"), values["cameraData"]
    if not isinstance(stereo, Mapping):
        raise FormatError("stereoRectificationData: missing: it names the sockets of the left and the right camera")
    sockets = [stereo.get(key) for key in ("leftCameraSocket", "rightCameraSocket")]
    known: dict[object, Mapping[str, Any]] = {}
    for each in listed if isinstance(listed, list) else ():
        match each:
            case [int() as socket, Mapping() as camera]:
                known[socket] = camera
    if not all(isinstance(socket, int) and socket in known for socket in sockets):
        raise FormatError(
            f"cameraData: expected the sockets {shown(sockets)} of stereoRectificationData, got {shown(list(known))}"
        )
    cameras = tuple(_depthai_camera(f"cameraData, socket {socket}: ", known[socket]) for socket in sockets)
    size = _one_size(*(stated_size(known[socket]) for socket in sockets))
    right_from_left = _depthai_way(known, sockets[0], sockets[1])
    shift_m = right_from_left[:3, 3] * _CM
    return Unrectified((cameras[0], cameras[1]), right_from_left[:3, :3], shift_m, size, source)


def _two(key: str, node: object) -> tuple[Any, Any]:
    if not isinstance(node, list) or len(node) < 2:
        raise FormatError(f"{key}: expected a list of at least two cameras, got {shown(node)}")
    return node[0], node[1]


def _one_size(left: Size | None, right: Size | None) -> Size:
    if left is None or left != right:
        raise FormatError(f"expected images of one size of both cameras, got {left} and {right}")
    return left


def _basalt_camera(prefix: str, node: object) -> Intrinsics:
    kind = node.get("camera_type") if isinstance(node, Mapping) else None
    if not isinstance(node, Mapping) or not isinstance(kind, str) or kind not in _BASALT_LENSES:
        raise FormatError(
            f"{prefix}camera_type: expected {', '.join(_BASALT_LENSES)}, got {shown(kind)}: calibrate with one of these"
        )
    names, model = _BASALT_LENSES[kind]
    values = node.get("intrinsics")
    values = values if isinstance(values, Mapping) else {}
    lacking = [name for name in ("fx", "fy", "cx", "cy", *names) if name not in values]
    if lacking:
        raise FormatError(f"{prefix}intrinsics: expected {', '.join(lacking)} as well")
    fx, fy, cx, cy = numbers(prefix + "intrinsics", [values[name] for name in ("fx", "fy", "cx", "cy")], (4,)).tolist()
    made = {"intrinsics": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], ", ".join(names): [values[name] for name in names]}
    return _made(made, ("intrinsics", ", ".join(names)), prefix, model)


def _depthai_camera(prefix: str, node: Mapping[str, Any]) -> Intrinsics:
    kind = node.get("cameraType", 0)
    if not isinstance(kind, int) or kind not in _DEPTHAI_LENSES:
        raise FormatError(f"{prefix}cameraType: expected 0 (perspective) or 1 (fisheye), got {shown(kind)}")
    model, count = _DEPTHAI_LENSES[kind]
    keys = "intrinsicMatrix", "distortionCoeff"
    for key in keys:
        if node.get(key) is None:
            raise FormatError(f"{prefix}{key}: missing")
    values = {keys[0]: node[keys[0]], keys[1]: numbers(prefix + keys[1], node[keys[1]], None)[:count].tolist()}
    return _made(values, keys, prefix, model)


def _made(values: Mapping[str, Any], keys: tuple[str, str], prefix: str, model: str) -> Intrinsics:
    camera = intrinsics(values, keys, prefix, model)
    if camera is None:
        raise FormatError(f"{prefix}expected a calibrated camera, got none")
    return camera


def _pose(key: str, node: object) -> Matrix:
    """Return a pose (4, 4) from a place and a quaternion."""
    names = ("px", "py", "pz", "qx", "qy", "qz", "qw")
    stated = [node.get(name) for name in names] if isinstance(node, Mapping) else node
    x, y, z, *quaternion = numbers(key, stated, (7,)).tolist()
    length = float(np.linalg.norm(quaternion))
    if length == 0:
        raise FormatError(f"{key}: expected a quaternion, got zeros")
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_quaternion(np.array([quaternion]) / length)[0]
    pose[:3, 3] = x, y, z
    return pose


def _depthai_way(known: Mapping[object, Mapping[str, Any]], start: object, end: object) -> Matrix:
    """Return the pose (4, 4), cm, from one camera's frame to another's, along the links of the file."""
    ways: dict[object, Matrix] = {start: np.eye(4)}
    links = [link for socket, camera in known.items() if (link := _link(socket, camera, known)) is not None]
    for _ in links:
        for here, there, pose in links:
            if here in ways and there not in ways:
                ways[there] = pose @ ways[here]
            elif there in ways and here not in ways:
                ways[here] = np.linalg.inv(pose) @ ways[there]
    if end not in ways:
        raise FormatError(f"cameraData: expected extrinsics that lead from socket {start} to socket {end}, got none")
    return ways[end]


def _link(
    socket: object, camera: Mapping[str, Any], known: Mapping[object, object]
) -> tuple[object, object, Matrix] | None:
    """Read where a camera's extrinsics lead.

    Returns:
        The camera's socket, the other camera's socket, and the pose (4, 4) in cm from the first frame to the second;
        None if the extrinsics lead to no known camera.
    """
    extrinsics = camera.get("extrinsics")
    extrinsics = extrinsics if isinstance(extrinsics, Mapping) else {}
    # The last camera of a chain leads to -1, with an empty rotation or one of zeros.
    there = extrinsics.get("toCameraSocket")
    if not isinstance(there, int) or there not in known:
        return None
    key, place = f"cameraData, socket {socket}: extrinsics.", extrinsics.get("translation")
    pose = np.eye(4)
    pose[:3, :3] = rotation(key + "rotationMatrix", extrinsics.get("rotationMatrix"))
    stated = [place.get(axis) for axis in "xyz"] if isinstance(place, Mapping) else place
    pose[:3, 3] = numbers(key + "translation", stated, (3,))
    return socket, there, pose
