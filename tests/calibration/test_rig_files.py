"""Calibration files of many tools: each gives the rig that it describes, or is refused with what to do."""

import json
import re
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from calibration_files import CAMERA, KITTI, MIDDLEBURY, kitti, matrices, matrix, middlebury, opencv
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shared_material import SHARED, needs_shared

from semisynth_gl.calibration.arrays import EyeArrays, Size, StereoArrays
from semisynth_gl.calibration.rig import rectified, turned_size_fault
from semisynth_gl.calibration.rig_files import read_rigs
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.raw_camera import vector_of
from semisynth_gl.inputs.errors import InputError, ReadError, SemisynthError
from semisynth_gl.lens.chain import LensChain

cv2 = pytest.importorskip("cv2", reason="OpenCV, the extra opencv, is not installed")

SIZE = (640, 480)
K1 = np.array([[520.0, 0, 322], [0, 522, 236], [0, 0, 1]])
K2 = np.array([[525.0, 0, 315], [0, 524, 243], [0, 0, 1]])
D1 = np.array([-0.28, 0.09, 0.0005, -0.0003, 0.01])
D2 = np.array([-0.29, 0.1, -0.0004, 0.0002, 0.03])
FISHEYE = np.array([-0.03, 0.01, -0.005, 0.001])
R = cv2.Rodrigues(np.array([0.01, -0.02, 0.006]))[0]
T = np.array([-0.12, 0.001, 0.0005])
POSE = np.vstack([np.column_stack([R, T]), [0, 0, 0, 1]])
# The left camera on a body that looks elsewhere, and the right one where it then stands.
BODY_LEFT = np.eye(4)
BODY_LEFT[:3, :3], BODY_LEFT[:3, 3] = cv2.Rodrigues(np.array([0.3, -1.2, 0.4]))[0], (0.02, -0.07, 0.01)
BODY_RIGHT = BODY_LEFT @ np.linalg.inv(POSE)


def projections(alpha=-1.0, unit_m=1.0):
    turned = cv2.stereoRectify(
        K1, D1, K2, D2, SIZE, R, T[:, None] / unit_m, flags=cv2.CALIB_ZERO_DISPARITY, alpha=alpha
    )
    return dict(zip(("R1", "R2", "P1", "P2", "Q"), turned[:5], strict=True))


def check(rig, alpha=-1.0, lens=(D1, D2)):
    """A rig is the one of this module."""
    r1, r2, p1, p2, *_ = cv2.stereoRectify(
        K1, lens[0], K2, lens[1], SIZE, R, T[:, None], flags=cv2.CALIB_ZERO_DISPARITY, alpha=alpha
    )
    np.testing.assert_allclose(rig.camera.focal_px, p1[0, 0], rtol=1e-6)
    np.testing.assert_allclose(rig.camera.baseline_m, -p2[0, 3] / p2[0, 0], rtol=1e-6)
    for eye, k, distortion, turn in (("left", K1, lens[0], r1), ("right", K2, lens[1], r2)):
        raw = rig.raw[eye]
        np.testing.assert_allclose(raw.matrix, k, rtol=1e-6)
        np.testing.assert_allclose((*raw.distortion, *[0] * 9)[: len(distortion)], distortion, atol=1e-9)
        np.testing.assert_allclose(raw.rotation, turn, atol=1e-6)
        assert (raw.width_px, raw.height_px, raw.model) == (*SIZE, "radial-tangential")


# --- shapes in which tools and people keep a rig: the files of each, by name ---

SHAPES: dict[str, Callable[[Path], list[Path]]] = {}


def shape(make):
    SHAPES[make.__name__] = make
    return make


def write(folder, **files):
    paths = []
    for name, content in files.items():
        stem, _, extension = name.rpartition("_")
        path = folder / f"{stem.replace('__', '/')}.{extension}"
        path.parent.mkdir(exist_ok=True)
        path.write_text(content if isinstance(content, str) else json.dumps(content, default=np.ndarray.tolist))
        paths.append(path)
    return paths


def storage(path, values, *, size=True):
    """Write values by OpenCV's own writer."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        file.write(name, np.asarray(value))
    if size:
        file.write("image_width", SIZE[0])
        file.write("image_height", SIZE[1])
    file.release()
    return path


def scalars(k, d):
    names = dict(zip(("k1", "k2", "p1", "p2", "k3"), map(float, d), strict=True))
    return dict(zip(("fx", "fy", "cx", "cy"), vector(k), strict=True)) | names


def vector(k):
    return [k[0, 0].item(), k[1, 1].item(), k[0, 2].item(), k[1, 2].item()]


RAW = {"K1": K1, "D1": D1, "K2": K2, "D2": D2, "R": R, "T": T}
NAMES = {
    "samples": ("M1", "D1", "M2", "D2", "R", "T"),
    "python": ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T"),
    "tutorial": ("mtxL", "distL", "mtxR", "distR", "Rot", "Trns"),
    "snake": ("camera_matrix_left", "dist_coeffs_left", "camera_matrix_right", "dist_coeffs_right", "R", "T"),
    "words": ("Left_Camera_Matrix", "Left_Distortion", "Right_Camera_Matrix", "Right_Distortion", "rotation", "trans"),
    "letters": ("Kl", "Dl", "Kr", "Dr", "R", "t"),
    "first": ("intrinsics_left", "distortion_l", "intrinsics_right", "distortion_r", "rot_mat", "tvec"),
}
for _label, _names in NAMES.items():
    for _extension in ("yml", "xml", "json"):
        SHAPES[f"{_label}.{_extension}"] = lambda folder, names=_names, extension=_extension: [
            storage(folder / f"rig.{extension}", dict(zip(names, RAW.values(), strict=True)))
        ]


@shape
def npz_in_mm(folder):
    names = dict(zip(NAMES["tutorial"], RAW.values(), strict=True)) | {"Trns": T[:, None] * 1000}
    np.savez(folder / "rig.npz", **names, objpoints=np.array([{}], dtype=object), E=R, F=R * 7, imageSize=SIZE)
    return [folder / "rig.npz"]


@shape
def npy_for_each(folder):
    paths = []
    for name, value in {"K_left": K1, "K_right": K2, "dist_left": D1, "dist_right": D2, "R": R, "T": T}.items():
        np.save(folder / f"{name}.npy", value)
        paths.append(folder / f"{name}.npy")
    return [*paths, *write(folder, size_json={"image_size": SIZE})]


@shape
def everything_of_stereo_rectify(folder):
    return [storage(folder / "rig.yml", RAW | projections())]


@shape
def intrinsics_and_extrinsics(folder):
    inner = dict(zip(("M1", "D1", "M2", "D2"), (K1, D1, K2, D2), strict=True))
    return [storage(folder / "intrinsics.yml", inner), storage(folder / "extrinsics.yml", {"R": R, "T": T}, size=False)]


@shape
def one_file_a_camera(folder):
    each = [storage(folder / f"{eye}.yml", {"K": k, "D": d}) for eye, k, d in (("left", K1, D1), ("right", K2, D2))]
    return [*each, storage(folder / "stereo.yml", {"R": R, "T": T}, size=False)]


@shape
def nested(folder):
    values = {
        "left": {"K": K1, "D": D1},
        "right": {"K": K2, "D": D2},
        "stereo": {"R": R, "T": T},
        "resolution": {"width": SIZE[0], "height": SIZE[1]},
    }
    return write(folder, rig_json=values)


@shape
def listed_cameras(folder):
    def camera(name, k, d, turn, shift):
        return {"name": name, "camera_matrix": k, "dist": d, "R": turn, "t": shift, "imageSize": SIZE}

    return write(folder, rig_json={"cameras": [camera("a", K1, D1, np.eye(3), [0] * 3), camera("b", K2, D2, R, T)]})


@shape
def single_numbers_and_a_rotation_vector(folder):
    return write(
        folder,
        rig_json={
            "intrinsics": {"left": scalars(K1, D1), "right": scalars(K2, D2)},
            "extrinsics": {"rotation": vector_of(R.tolist()), "translation": T},
            "image_shape": [SIZE[1], SIZE[0], 3],
        },
    )


@shape
def numbers_with_the_eye_in_their_names(folder):
    lines = [f"width: {SIZE[0]}", f"height: {SIZE[1]}"]
    for eye, k, d in (("left", K1, D1), ("right", K2, D2)):
        lines += [f"{name}_{eye}: {value!r}" for name, value in scalars(k, d).items()]
    lines += [f"R: {' '.join(map(repr, R.ravel().tolist()))}", f"T = {T.tolist()}"]
    return write(folder, rig_txt="\n".join(lines))


@shape
def matlab(folder):
    def camera(k, d):
        return {"IntrinsicMatrix": k.T, "RadialDistortion": [d[0], d[1], d[4]], "TangentialDistortion": d[2:4]}

    values = {"CameraParameters1": camera(K1, D1), "CameraParameters2": camera(K2, D2), "ImageSize": [SIZE[0], SIZE[1]]}
    return write(folder, rig_json=values | {"RotationOfCamera2": R.T, "TranslationOfCamera2": T * 1000})


@shape
def bouguet(folder):
    values = {"om": vector_of(R.tolist()), "T": T * 1000, "imsize": SIZE}
    for eye, k, d in (("left", K1, D1), ("right", K2, D2)):
        values |= {f"fc_{eye}": [k[0, 0], k[1, 1]], f"cc_{eye}": k[:2, 2], f"kc_{eye}": d}
    return write(folder, Calib_Results_json=values)


@shape
def orb_slam(folder):
    values = RAW | projections()
    text = f"%YAML:1.0\n\nCamera.fx: {values['P1'][0, 0]}\nCamera.fy:435.2\nCamera.cx:367.4\nCamera.cy: 252.2\n"
    text += f"Camera.bf: 50.0\nLEFT.height: {SIZE[1]}\nLEFT.width: {SIZE[0]}\n"
    for side, number in (("LEFT", "1"), ("RIGHT", "2")):
        text += "".join(matrix(f"{side}.{name}", values[name + number], space="") for name in "DKRP")
    return write(folder, EuRoC_yaml=text)


@shape
def stella(folder):
    values = RAW | projections()
    (fx, _, cx, _), (_, fy, cy, _), _ = values["P1"].tolist()
    camera = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "k1": 0, "k2": 0, "p1": 0, "p2": 0, "k3": 0}
    camera |= {"cols": SIZE[0], "rows": SIZE[1], "focal_x_baseline": -values["P2"][0, 3]}
    pairs = {f"{name}_{eye}": values[f"{name}{n}"].ravel() for n, eye in ((1, "left"), (2, "right")) for name in "KDR"}
    return write(folder, rig_yaml={"Camera": camera, "StereoRectifier": pairs})


@shape
def orb_slam_3(folder):
    text = (
        f'%YAML:1.0\n\nFile.version: "1.0"\nCamera.type: "PinHole"\nCamera.width: {SIZE[0]}\nCamera.height: {SIZE[1]}\n'
    )
    for number, k, d in ((1, K1, D1), (2, K2, D2)):
        text += "".join(f"Camera{number}.{name}: {value}\n" for name, value in scalars(k, d).items())
    return write(folder, EuRoC_yaml=text + matrix("Stereo.T_c1_c2", np.linalg.inv(POSE)))


@shape
def ros(folder):
    return write(folder, **{f"{eye}_yaml": _ros(n) for eye, n in (("left", "1"), ("right", "2"))})


@shape
def ros_without_eyes_in_the_names(folder):
    return write(folder, a_yaml=_ros("1"), b_yaml=_ros("2"))


@shape
def ros_nested(folder):
    nested = {eye: _ros(n).replace("\n", "\n  ") for eye, n in (("left", "1"), ("right", "2"))}
    return write(folder, rig_yaml="".join(f"{eye}:\n  {text.rstrip()}\n" for eye, text in nested.items()))


def _ros(number, model="plumb_bob"):
    values = RAW | projections()
    keys = {"camera_matrix": "K", "distortion_coefficients": "D", "rectification_matrix": "R", "projection_matrix": "P"}
    text = f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: rig\ndistortion_model: {model}\n"
    return text + "".join(
        matrix(key, values[name + number]).replace(" !!opencv-matrix", "") for key, name in keys.items()
    )


@shape
def ros_messages(folder):
    return write(folder, rig_yaml="".join(message(n, sec) for n in "12" for sec in range(5)))


@shape
def ros_1_messages_in_text(folder):
    return write(folder, rig_txt=message("1", upper=True) + message("2", upper=True))


def message(number, sec=0, *, upper=False, **changed):
    """A message as `ros2 topic echo` prints it, with the line that divides it from the next."""
    values = RAW | projections() | changed
    text = f"header:\n  stamp:\n    sec: {sec}\n  frame_id: c{number}\nheight: {SIZE[1]}\nwidth: {SIZE[0]}\n"
    text += "distortion_model: plumb_bob\n"
    for name in "DKRP":
        text += f"{name if upper else name.lower()}: {np.ravel(values[name + number]).tolist()}\n"
    return f"{text}binning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n---\n"


@shape
def ros_ini(folder):
    def rows(value):
        return "\n".join(" ".join(map(repr, map(float, row))) for row in np.atleast_2d(value))

    values, files = RAW | projections(), {}
    for eye, n in (("left", "1"), ("right", "2")):
        files[f"{eye}_ini"] = (
            f"# oST version 5.0 parameters\n\n[image]\n\nwidth\n{SIZE[0]}\n\nheight\n{SIZE[1]}\n\n"
            f"[narrow_stereo/{eye}]\n\n"
            f"camera matrix\n{rows(values['K' + n])}\n\ndistortion\n{rows(values['D' + n])}\n\nrectification\n"
            f"{rows(values['R' + n])}\n\nprojection\n{rows(values['P' + n])}\n"
        )
    return write(folder, **files)


@shape
def report(folder):
    """As scripts print arrays for people, with angles beside the rotation."""

    def printed(value):
        with np.printoptions(precision=17):
            return str(value)

    text = "=== RESULTS ===\n\nChessboard size: 9 x 6\nIMAGE SIZE (width x height):\n640 480\n\n-----\n"
    text += "Rotation angles (Roll, Pitch, Yaw) [degrees]: 0.57, -1.15, 0.34\n\n"
    for eye, k, d in (("LEFT", K1, D1), ("RIGHT", K2, D2)):
        text += f"{eye} CAMERA MATRIX:\n{printed(k)}\n\n{eye} DISTORTION:\n{printed(d)}\n\n"
    text += f"ROTATION MATRIX (R):\n{printed(R)}\n\nTRANSLATION VECTOR (T) [mm]:\n{printed(T[:, None] * 1000)}\n"
    return write(folder, report_txt=text)


@shape
def numbered(folder):
    """As surgical robots keep a rig."""
    text = ""
    for eye, k, d in (("Left", K1, D1), ("Right", K2, D2)):
        values = dict(zip(("fc_x", "fc_y", "cc_x", "cc_y"), vector(k), strict=True)) | {"res_x": 640, "res_y": 480}
        values |= {f"kc_{n}": value for n, value in enumerate([*d, 0, 0, 0])}
        if eye == "Right":
            values |= {f"R_{n}": value for n, value in enumerate(R.ravel())}
            values |= {f"T_{n}": value * 1000 for n, value in enumerate(T)}
        text += f"[Stereo{eye}]\n" + "".join(f"{name}={float(value)!r}\n" for name, value in values.items())
    return write(folder, calibration_ini=text)


@shape
def from_right_to_left(folder):
    back = np.linalg.inv(POSE)
    values = {"K_left": K1, "D_left": D1, "K_right": K2, "D_right": D2, "size": SIZE}
    return write(folder, rig_json=values | {"R_right_to_left": back[:3, :3], "T_right_to_left": back[:3, 3]})


@shape
def tabs_and_a_board(folder):
    names = "left_K", "left_D", "right_K", "right_D", "stereo_R", "stereo_T"
    rows = [f"{name}:\t{value.tolist()}\t\t# measured" for name, value in zip(names, RAW.values(), strict=True)]
    board = "board:\n  cols: 9\n  rows: 6\n  size: [9, 6]\n"
    return write(folder, rig_yaml="\n".join([*rows, "img_shape:\t[640, 480]", board]))


def against_a_board(direction):
    """Each camera's pose against a board, in the direction that the names tell."""
    cameras = {}
    for number, k, d, body in ((0, K1, D1, BODY_LEFT), (1, K2, D2, BODY_RIGHT)):
        pose = body if direction == "cam_to_board" else np.linalg.inv(body)
        names = {f"R_{direction}": pose[:3, :3], f"t_{direction}": pose[:3, 3]}
        cameras[f"camera_{number}"] = {"camera_matrix": k, "dist": d, "width": 640, "height": 480, **names}
    return cameras


for _direction in ("board_to_cam", "cam_to_board"):
    SHAPES[_direction] = lambda folder, way=_direction: write(folder, rig_json=against_a_board(way))


def kalibr(lens="radtan", coefficients=(D1[:4], D2[:4]), pose=POSE, *, imu=False, size=SIZE):
    cameras = {}
    for number, (k, d) in enumerate(zip((K1, K2), coefficients, strict=True)):
        body = np.linalg.inv((BODY_LEFT, BODY_RIGHT)[number])
        cameras[f"cam{number}"] = {
            **({"T_cam_imu": body.tolist()} if imu else {}),
            **({"T_cn_cnm1": pose.tolist()} if number and pose is not None else {}),
            "cam_overlaps": [1 - number],
            "camera_model": "pinhole",
            "distortion_coeffs": list(d),
            "distortion_model": lens,
            "intrinsics": vector(k),
            "resolution": list(size),
            "rostopic": f"/cam{number}/image_raw",
        }
    return cameras


def camodocal(folder, model="PINHOLE"):
    files = {"rig_yaml": "%YAML:1.0\n" + matrix("body_T_cam0", BODY_LEFT) + matrix("body_T_cam1", BODY_RIGHT)}
    for number, k, d in ((0, K1, D1), (1, K2, D2)):
        values = scalars(k, [*d[:4], 0])
        text = f"%YAML:1.0\n---\nmodel_type: {model}\ncamera_name: c\nimage_width: {SIZE[0]}\nimage_height: {SIZE[1]}\n"
        for section, names in (("distortion", ("k1", "k2", "p1", "p2")), ("projection", ("fx", "fy", "cx", "cy"))):
            text += f"{section}_parameters:\n" + "".join(f"   {name}: {values[name]}\n" for name in names)
        files[f"cam{number}_yaml"] = text
    return write(folder, **files)


def euroc(folder):
    files = {}
    for number, k, d, body in ((0, K1, D1, BODY_LEFT), (1, K2, D2, BODY_RIGHT)):
        data = {"cols": 4, "rows": 4, "data": body.ravel().tolist()}
        files[f"cam{number}__sensor_yaml"] = json.dumps({
            "sensor_type": "camera", "T_BS": data, "rate_hz": 20, "resolution": SIZE, "camera_model": "pinhole",
            "intrinsics": vector(k), "distortion_model": "radial-tangential", "distortion_coefficients": list(d[:4])
        })  # fmt: skip
    return write(folder, **files)


FOUR = {
    "kalibr": lambda folder: write(folder, chain_yaml=kalibr()),
    "kalibr with an IMU": lambda folder: write(folder, chain_yaml=kalibr(pose=None, imu=True)),
    "kalibr with both": lambda folder: write(folder, chain_yaml=kalibr(imu=True)),
    "camodocal": camodocal,
    "euroc": euroc,
    "python": lambda folder: [storage(folder / "rig.yml", RAW | {"D1": D1[:4], "D2": D2[:4]})],
}


def pose_values(pose):
    """A pose as Basalt writes it."""
    turn = np.array(vector_of(pose[:3, :3].tolist()))
    angle = np.linalg.norm(turn)
    quaternion = [*(turn / angle * np.sin(angle / 2)), np.cos(angle / 2)]
    return dict(zip(("px", "py", "pz", "qx", "qy", "qz", "qw"), map(float, [*pose[:3, 3], *quaternion]), strict=True))


def basalt(kind="pinhole-radtan8", lens=(D1, D2)):
    names = {"pinhole-radtan8": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), "kb4": ("k1", "k2", "k3", "k4")}
    cameras = []
    for k, own in zip((K1, K2), lens, strict=True):
        values = {name: scalars(k, D1)[name] for name in ("fx", "fy", "cx", "cy")}
        values |= dict(zip(names.get(kind, ()), [*map(float, own), 0, 0, 0], strict=False))
        cameras.append({"camera_type": kind, "intrinsics": values})
    poses = [pose_values(each) for each in (BODY_LEFT, BODY_RIGHT)]
    return {"value0": {"T_imu_cam": poses, "intrinsics": cameras, "resolution": [list(SIZE)] * 2}}


# Poses in cm between the sockets of an OAK; devices write an empty rotation for the last camera of a chain.
RIGHT_FROM_LEFT, COLOUR_FROM_LEFT = POSE.copy(), np.eye(4)
RIGHT_FROM_LEFT[:3, 3] *= 100
COLOUR_FROM_LEFT[:3, 3] = -3.7, 0.1, 0.2
LINKS = {
    "nowhere": {},
    "to the right": {1: (2, RIGHT_FROM_LEFT)},
    "to the left": {2: (1, np.linalg.inv(RIGHT_FROM_LEFT))},
    "to the third": {1: (0, COLOUR_FROM_LEFT), 2: (0, COLOUR_FROM_LEFT @ np.linalg.inv(RIGHT_FROM_LEFT))},
}


def depthai(links="to the right", kind=0, lens=(D1, D2)):
    def camera(socket, k, own):
        target, pose = LINKS[links].get(socket, (-1, None))
        return {
            "cameraType": kind,
            "width": SIZE[0],
            "height": SIZE[1],
            "intrinsicMatrix": k.tolist(),
            "distortionCoeff": [*map(float, own), *[0.0] * (14 - len(own))],
            "extrinsics": {
                "rotationMatrix": [] if pose is None else pose[:3, :3].tolist(),
                "toCameraSocket": target,
                "translation": dict(zip("xyz", [0.0] * 3 if pose is None else pose[:3, 3].tolist(), strict=True)),
            },
        }

    cameras = [[0, camera(0, K1, lens[0])], [1, camera(1, K1, lens[0])], [2, camera(2, K2, lens[1])]]
    stereo = {"leftCameraSocket": 1, "rightCameraSocket": 2}
    return {"boardName": "OAK-D", "cameraData": cameras, "stereoRectificationData": stereo}


@shape
def mrcal(folder):
    files = {}
    for name, k, d, turn, shift in (("left", K1, D1, np.eye(3), [0] * 3), ("right", K2, D2, R, T)):
        values = {"lensmodel": "LENSMODEL_OPENCV5", "intrinsics": [*vector(k), *d.tolist()], "imagersize": list(SIZE)}
        pose = [*vector_of(turn.tolist()), *map(float, shift)]
        files[f"{name}_cameramodel"] = "# a model\n" + repr(values | {"extrinsics": pose}).replace("(", "[").replace(
            ")", "]"
        )
    return write(folder, **files)


SHAPES["basalt"] = lambda folder: write(folder, calibration_json=basalt())
for _link in [*LINKS][1:]:
    SHAPES[f"depthai {_link}"] = lambda folder, link=_link: write(folder, oak_json=depthai(link))


@pytest.mark.parametrize("make", SHAPES.values(), ids=SHAPES.keys())
def test_every_shape_gives_the_rig(tmp_path, make):
    (rig,) = read_rigs(make(tmp_path))
    check(rig)


@pytest.mark.parametrize("make", FOUR.values(), ids=FOUR.keys())
def test_every_shape_with_four_coefficients_gives_the_rig(tmp_path, make):
    (rig,) = read_rigs(make(tmp_path))
    check(rig, lens=(D1[:4], D2[:4]))


@pytest.mark.parametrize(
    "values",
    [basalt("kb4", (FISHEYE, FISHEYE)), depthai(kind=1, lens=(FISHEYE, FISHEYE)), kalibr("equidistant", [FISHEYE] * 2)],
)
def test_fisheyes_are_read(tmp_path, values):
    (rig,) = read_rigs(write(tmp_path, rig_json=values))
    r1, r2, p1, *_ = cv2.fisheye.stereoRectify(
        K1, FISHEYE, K2, FISHEYE, SIZE, R, T[:, None], flags=cv2.CALIB_ZERO_DISPARITY
    )
    assert rig.camera.focal_px == pytest.approx(p1[0, 0])
    for eye, turn in (("left", r1), ("right", r2)):
        assert rig.raw[eye].model == "fisheye"
        np.testing.assert_allclose(rig.raw[eye].distortion, FISHEYE)
        np.testing.assert_allclose(rig.raw[eye].rotation, turn, atol=1e-9)


@needs_shared
def test_calibrations_of_many_tools_give_one_rig():
    folder = SHARED / "calibrations"
    wanted = json.loads((folder / "expected.json").read_text())
    turn, shift = np.array(wanted["R"]), np.array(wanted["T_m"])

    def truth(lens, k=wanted):
        of = [np.array(k[name]) for name in ("K1", "K2")]
        d = [np.array(wanted[f"{lens}{n}"]) for n in "12"]
        rectify = cv2.fisheye.stereoRectify if lens == "equidistant" else cv2.stereoRectify
        size = tuple(k["size"])
        return of, d, rectify(of[0], d[0], of[1], d[1], size, turn, shift[:, None], flags=cv2.CALIB_ZERO_DISPARITY)

    raw = {
        ("arrays_mm.npz",), ("nested.json",), ("storage.json",), ("storage.xml",), ("storage.yml",), ("words.json",),
        ("chain_anchors.yaml",), ("body_pose/left.yaml", "body_pose/right.yaml"),
        ("camodocal/rig.yaml", "camodocal/cam0.yaml", "camodocal/cam1.yaml"),
        ("mrcal/cam0.cameramodel", "mrcal/cam1.cameramodel"), ("three/left.yml", "three/right.yml", "three/stereo.yml"),
        ("chain_imu.yaml",), ("zed.conf",),
    }  # fmt: skip
    for names in raw:
        zed = names[0] == "zed.conf"
        (rig,) = read_rigs([folder / name for name in names], photographed=Size(1280, 720) if zed else None)
        k, d, (r1, r2, p1, p2, *_) = truth(
            "equidistant" if "imu" in names[0] else "D", wanted["zed_hd"] if zed else wanted
        )
        for eye, own, lens, rotation in (("left", k[0], d[0], r1), ("right", k[1], d[1], r2)):
            np.testing.assert_allclose(rig.raw[eye].matrix, own, atol=1e-6, err_msg=str(names))
            np.testing.assert_allclose(rig.raw[eye].distortion[: len(lens)], lens, atol=1e-6, err_msg=str(names))
            np.testing.assert_allclose(rig.raw[eye].rotation, rotation, atol=1e-6, err_msg=str(names))
        assert rig.camera.baseline_m == pytest.approx(-p2[0, 3] / p2[0, 0], rel=1e-6)
        assert rig.camera.focal_px == pytest.approx(p1[0, 0], rel=1e-6)
    size = Size(*wanted["size"])
    for names in (("K.txt",), ("orb.yaml",), ("P_left.npy", "P_right.npy"), ("S_rect_101.txt",)):
        (rig,) = read_rigs([folder / name for name in names], photographed=size)
        camera, (left, right) = rig.camera, (wanted["P1"], wanted["P2"])
        assert rig.size == size
        got = camera.focal_px, camera.cx_left_px, camera.cy_px, camera.baseline_m
        np.testing.assert_allclose(got, (left[0][0], left[0][2], left[1][2], -right[0][3] / right[0][0]), rtol=1e-5)
    (rig,) = read_rigs([folder / "scalars.json"])
    assert (rig.camera.baseline_m, rig.camera.doffs_px) == (0.075, pytest.approx(2.2))
    (rig,) = read_rigs([folder / "cityscapes.json"], photographed=Size(2048, 1024))
    assert (rig.camera.focal_px, rig.camera.baseline_m) == (2262.52, 0.209313)
    assert rig.camera.focal_y_px == pytest.approx(2265.3)


# --- rectified rigs ---

RECTIFIED = {
    "m.txt": middlebury,
    "spaced.txt": lambda camera: middlebury(camera).replace("=", " = ").replace("\n", "\r\n"),
    "k.txt": kitti,
    "grey.txt": lambda camera: kitti(camera, ("_rect_00", "_rect_01")),
    "o.yaml": opencv,
    "k.json": lambda camera: json.dumps({
        "fx": camera.focal_px, "cx0": camera.cx_left_px, "cx1": camera.cx_right_px, "cy": camera.cy_px,
        "baseline_mm": camera.baseline_m * 1000, "width": camera.width_px, "height": camera.height_px,
    }),
    "q.json": lambda camera: json.dumps({"imageSize": [camera.width_px, camera.height_px], "Q": [
        [1, 0, 0, -camera.cx_left_px], [0, 1, 0, -camera.cy_px], [0, 0, 0, camera.focal_px],
        [0, 0, 1 / camera.baseline_m, (camera.cx_right_px - camera.cx_left_px) / camera.baseline_m]]}),
}  # fmt: skip
numbers = st.floats(1, 5000, allow_nan=False)


@settings(max_examples=30, deadline=None)
@given(
    size=st.tuples(st.integers(1, 9999), st.integers(1, 9999)),
    focal_px=st.floats(10, 9000),
    baseline_m=st.floats(0.001, 2.4),
    centre=st.tuples(numbers, numbers, numbers),
)
def test_a_rectified_rig_in_any_format_is_read_back(tmp_path_factory, size, focal_px, baseline_m, centre):
    folder = tmp_path_factory.mktemp("rig")
    camera = StereoCamera(*size, focal_px, baseline_m, *centre)
    assume(turned_size_fault(Size(*size), *matrices(camera)) is None)
    for name, text in RECTIFIED.items():
        (folder / name).write_text(text(camera))
        (rig,) = read_rigs([folder / name])
        assert rig.size == size
        assert rig.source == str(folder / name)
        for key in ("focal_px", "baseline_m", "cx_left_px", "cx_right_px", "cy_px"):
            assert getattr(rig.camera, key) == pytest.approx(getattr(camera, key), rel=1e-9, abs=1e-9), name


def test_kittis_own_calibration_counts_as_rectified(tmp_path):
    (tmp_path / "calib_cam_to_cam.txt").write_text(KITTI)
    (rig,) = read_rigs([tmp_path / "calib_cam_to_cam.txt"])
    assert (rig.size, rig.camera.focal_px, rig.camera.doffs_px, rig.layout) == ((1242, 375), 721.5377, 0, "kitti")
    assert rig.camera.baseline_m == pytest.approx(0.5327, abs=1e-4)
    short = "".join(f"{line.replace('_rect_0', '')}\n" for line in KITTI.splitlines() if line.startswith("P_rect"))
    (tmp_path / "000000.txt").write_text(short)
    (again,) = read_rigs([tmp_path / "000000.txt"], size=Size(1242, 375))
    assert again.camera == rig.camera


def test_lenses_of_raw_images_of_another_size_are_not_used(tmp_path):
    """As in KITTI's recordings, whose rectified images are a part of the raw ones."""
    text = kitti()
    for number, k, d in (("02", K1, D1), ("03", K2, D2)):
        arrays = {"S": (1392, 512), "K": k, "D": d, "R": np.eye(3), "T": np.zeros(3), "R_rect": np.eye(3)}
        text += "".join(f"{name}_{number}: {' '.join(map(str, np.ravel(each)))}\n" for name, each in arrays.items())
    (tmp_path / "calib_cam_to_cam.txt").write_text(text)
    (rig,) = read_rigs([tmp_path / "calib_cam_to_cam.txt"])
    assert (rig.size, rig.raw) == ((741, 500), None)
    assert "raw images of 741 x 500, as rectified ones, got 1392 x 512" in str(rig.lens_fault)


def test_eth3d_has_no_doffs(tmp_path):
    text = middlebury(StereoCamera(942, 489, 541.764, 0.0599079, 553.869, 553.869, 232.396))
    path = tmp_path / "two_view_training" / "calib.txt"
    path.parent.mkdir()
    path.write_text(text + "ndisp=64\n")
    (rig,) = read_rigs([path])
    assert (rig.camera.doffs_px, rig.camera.baseline_m, rig.bounds.ndisp) == (0, pytest.approx(0.0599079), 64)
    assert rig.layout == "eth3d"


def test_the_right_camera_alone_holds_the_baseline(tmp_path):
    left, right = ros(tmp_path)
    check(read_rigs([left, right])[0])
    check(read_rigs([tmp_path / "*.yaml"])[0])
    (alone,) = read_rigs([right])
    assert alone.camera.baseline_m == pytest.approx(np.linalg.norm(T))
    assert alone.raw is None
    with pytest.raises(ReadError, match="describes no pair"):
        read_rigs([left])
    a, b = ros_without_eyes_in_the_names(tmp_path)
    with pytest.raises(InputError, match="swap left and right"):
        read_rigs([b, a])


def test_bare_numbers_are_a_matrix_and_a_baseline(tmp_path):
    for text in ("700 0 320 0 700 240 0 0 1\n0.12\n", "700 0 320\n0 700 240\n0 0 1\n\n0.12\n"):
        (tmp_path / "K.txt").write_text(text)
        (rig,) = read_rigs([tmp_path / "K.txt"], size=Size(640, 480))
        assert rig.camera == StereoCamera(640, 480, 700.0, 0.12, 320.0, 320.0, 240.0)


def test_modes_are_chosen_by_the_size(tmp_path):
    values = {"baseline": "-50.2"}
    for number, width, height in ((0, 1280, 720), (1, 640, 360), (9, 0, 0)):
        numbers = {
            "fx": width / 2,
            "fy": width / 2,
            "ppx": width / 2,
            "ppy": height / 2,
            "width": width,
            "height": height,
        }
        values |= {f"rectified.{number}.{key}": str(value) for key, value in numbers.items()}
    (path,) = write(tmp_path, realsense_json=values)
    for size in (Size(1280, 720), Size(640, 360)):
        (rig,) = read_rigs([path], photographed=size)
        assert (rig.size, rig.camera.focal_px, rig.camera.baseline_m) == (size, size.width_px / 2, 0.0502)
    with pytest.raises(ReadError, match="1280 x 720, 640 x 360: give the size"):
        read_rigs([path])
    with pytest.raises(ReadError, match="got 320 x 240"):
        read_rigs([path], size=Size(320, 240))


def test_zeds_modes_have_the_right_camera_on_the_right(tmp_path):
    lines = []
    for mode, scale in (("HD", 1.0), ("VGA", 0.525)):
        for eye, k, d in (("LEFT", K1, D1), ("RIGHT", K2, D2)):
            values = {name: value * (scale if name[0] in "fc" else 1) for name, value in scalars(k, d).items()}
            lines += [f"[{eye}_CAM_{mode}]", *(f"{name}={value}" for name, value in values.items()), ""]
    x, y, z = vector_of(R.tolist())
    lines += ["[STEREO]", f"Baseline={-1000 * T[0]}", f"TY={1000 * T[1]}", f"TZ={1000 * T[2]}"]
    lines += [f"{name}_{mode}={value}" for mode in ("HD", "VGA") for name, value in (("RX", x), ("CV", y), ("RZ", z))]
    (path,) = write(tmp_path, SN1_conf="\n".join(lines))
    for size, scale in ((Size(1280, 720), 1.0), (Size(672, 376), 0.525)):
        (rig,) = read_rigs([path], photographed=size)
        k = [np.diag([scale, scale, 1]) @ each for each in (K1, K2)]
        whole = k[0], D1, k[1], D2, tuple(size), R, T[:, None]
        r1, r2, p1, p2, *_ = cv2.stereoRectify(*whole, flags=cv2.CALIB_ZERO_DISPARITY)
        assert rig.camera.focal_px == pytest.approx(p1[0, 0])
        assert rig.camera.baseline_m == pytest.approx(-p2[0, 3] / p2[0, 0])
        np.testing.assert_allclose(rig.raw["left"].rotation, r1, atol=1e-9)
        np.testing.assert_allclose(rig.raw["right"].rotation, r2, atol=1e-9)
    with pytest.raises(ReadError, match="1280 x 720, 672 x 376: give the size"):
        read_rigs([path])


# --- what a user says of a file ---


def test_units_are_concluded_or_given(tmp_path):
    for unit, unit_m in {"mm": 0.001, "cm": 0.01, "m": 1.0}.items():
        (tmp_path / "rig.yml").write_text(opencv(unit_m=unit_m))
        (rig,) = read_rigs([tmp_path / "rig.yml"])
        assert rig.camera.baseline_m == pytest.approx(CAMERA.baseline_m)
        assert len(rig.notes) == (unit != "m")
        (rig,) = read_rigs([tmp_path / "rig.yml"], unit="cm")
        assert rig.camera.baseline_m == pytest.approx(CAMERA.baseline_m / unit_m * 0.01)
        assert not rig.notes
    (tmp_path / "calib.txt").write_text(MIDDLEBURY)
    with pytest.raises(ReadError, match="states the unit: leave the unit out"):
        read_rigs([tmp_path / "calib.txt"], unit="mm")


def test_the_unit_counts_for_the_baseline_alone(tmp_path):
    path = storage(tmp_path / "rig.yml", RAW | {"T": T * 1000})
    check(read_rigs([path], unit="mm")[0])


def test_the_size_comes_from_the_file_the_user_or_the_photographs(tmp_path):
    (tmp_path / "stereo.yml").write_text(opencv(size=False))
    with pytest.raises(InputError, match=r"does not say how large the images are: give the size"):
        read_rigs([tmp_path / "stereo.yml"])
    assert read_rigs([tmp_path / "stereo.yml"], size=Size(640, 480))[0].size == (640, 480)
    (rig,) = read_rigs([tmp_path / "stereo.yml"], photographed=Size(700, 500))
    assert rig.size == (700, 500)
    assert any("700 x 500" in note for note in rig.notes)
    (tmp_path / "calib.txt").write_text(MIDDLEBURY)
    assert read_rigs([tmp_path / "calib.txt"], photographed=Size(70, 50))[0].size == (741, 500)
    with pytest.raises(InputError, match="is for images of 741 x 500, not 640 x 480"):
        read_rigs([tmp_path / "calib.txt"], size=Size(640, 480))


def test_two_of_several_cameras_are_chosen(tmp_path):
    pose = np.eye(4)
    pose[0, 3] = -0.3
    chain = kalibr()
    third = {
        **chain["cam1"],
        "T_cn_cnm1": pose.tolist(),
        "intrinsics": [500, 500, 320, 240],
        "distortion_coeffs": [0] * 4,
    }
    (path,) = write(tmp_path, chain_yaml=chain | {"cam2": third})
    with pytest.raises(ReadError, match=r"3 cameras \(cam0.*choose two, --pair"):
        read_rigs([path])
    check(read_rigs([path], cameras=("cam0", "cam1"))[0], lens=(D1[:4], D2[:4]))
    (rig,) = read_rigs([path], cameras=("cam1", "cam2"))
    assert rig.camera.baseline_m == pytest.approx(0.3)
    np.testing.assert_allclose(rig.raw["left"].matrix, K2)
    (rig,) = read_rigs([path], cameras=("cam0", "cam2"))
    assert rig.camera.baseline_m == pytest.approx(np.linalg.norm((pose @ POSE)[:3, 3]))
    with pytest.raises(ReadError, match="no pair of cameras cam0 and cam3"):
        read_rigs([path], cameras=("cam0", "cam3"))


def test_the_pose_between_the_chosen_cameras_counts(tmp_path):
    other = np.eye(4)
    other[0, 3] = -0.7
    values = {
        f"cam{n}": {"camera_matrix": vector(k), "distortion_coeffs": d, "resolution": SIZE}
        for n, k, d in ((0, K2, D2), (1, K1, D1), (2, K2, D2))
    }
    (path,) = write(tmp_path, rig_yaml=values | {"T_10": other, "T_21": POSE})
    check(read_rigs([path], cameras=("cam1", "cam2"))[0])
    small = changed(values, "cam1", "resolution", to=[320, 240]) | {"rect1": {"resolution": SIZE}, "T_21": POSE}
    with pytest.raises(ReadError, match="images of 320 x 240 and of 640 x 480"):
        read_rigs(write(tmp_path, rig_yaml=small), cameras=("cam1", "cam2"))
    with pytest.raises(ReadError, match=r"no pair"):
        read_rigs([path], cameras=("cam0", "cam2"))


def test_photographs_tell_which_side_of_a_size_is_the_width(tmp_path):
    path = storage(tmp_path / "rig.json", RAW | {"imageSize": np.array([SIZE[1], SIZE[0]])}, size=False)
    with pytest.raises(ReadError, match="near that of 640 x 480"):
        read_rigs([path])
    for chosen in ({"size": Size(*SIZE)}, {"photographed": Size(*SIZE)}):
        (rig,) = read_rigs([path], **chosen)
        check(rig)
        assert any("taken for height and width" in note for note in rig.notes)


def test_projections_of_another_unit_or_baseline_than_the_translation(tmp_path):
    for unit_m in (1, 0.001):
        values = RAW | projections() | {"T": T / unit_m}
        check(read_rigs([storage(tmp_path / "rig.yml", values)])[0])
    values = RAW | projections()
    values["P2"] = values["P2"] * [1, 1, 1, 2]
    (rig,) = read_rigs([storage(tmp_path / "rig.yml", values)])
    check(rig)
    assert any(re.match("the cameras are 0.24.* apart by P, and 0.12.* by T", note) for note in rig.notes)
    check(read_rigs([storage(tmp_path / "rig.yml", RAW | projections() | {"T": T * 1e-9})])[0])


def test_names_that_tell_nothing_are_given(tmp_path):
    names = dict(zip(("K1", "D1", "K2", "D2", "R", "T"), ("alpha", "beta", "gamma", "delta", "x", "y"), strict=True))
    values = {f"{name}y": RAW[key] for key, name in names.items()} | {"ours": [*SIZE]}
    (path,) = write(tmp_path, rig_json={"v": values})
    with pytest.raises(ReadError, match=r"no pair.*v\.alphay \(3 x 3\), v\.betay \(5\).*K1=left"):
        read_rigs([path])
    keys = {key: f"v.{name}y" for key, name in names.items()}
    check(read_rigs([path], keys=keys | {"size": "v.ours"})[0])
    with pytest.raises(ReadError, match=r"has no v\.omega, which K1 was to be: it has v\.alphay"):
        read_rigs([path], keys=keys | {"K1": "v.omega"})
    with pytest.raises(InputError, match="K9: expected one of K1, D1"):
        read_rigs([path], keys={"K9": "v.alphay"})


def test_one_matrix_is_of_both_cameras_with_a_note(tmp_path):
    (path,) = write(tmp_path, rig_json={"K": K1, "D": D1, "R": R, "T": T, "imageSize": SIZE})
    (rig,) = read_rigs([path])
    np.testing.assert_allclose(rig.raw["right"].matrix, K1)
    assert any("K was taken for both cameras" in note for note in rig.notes)


@pytest.mark.parametrize("extension", ["json", "yml", "xml", "npz"])
def test_a_file_names_its_lens(tmp_path, extension):
    path, wide = tmp_path / f"rig.{extension}", np.diag([0.3, 0.3, 1]) @ K1
    values = {"K1": wide, "D1": FISHEYE, "K2": wide, "D2": FISHEYE, "R": R, "T": T}

    def stored(**more):
        if extension == "npz":
            np.savez(path, **values, **more)
            return path
        file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        for name, value in (values | more).items():
            file.write(name, value)
        file.release()
        return path

    with pytest.raises(ReadError, match="a wide lens with 4 coefficients may be"):
        read_rigs([stored()], size=Size(*SIZE))
    for name, model in (("fisheye", "fisheye"), ("radtan", "radial-tangential")):
        (rig,) = read_rigs([stored(distortion_model=name)], size=Size(*SIZE), alpha=0)
        assert rig.raw["left"].model == model


def test_a_lens_beside_a_baseline_is_left_out_with_a_note(tmp_path):
    (path,) = write(
        tmp_path, rig_json={"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "D": D1, "baseline": 0.2, "imageSize": SIZE}
    )
    (rig,) = read_rigs([path])
    assert (rig.camera.baseline_m, rig.raw) == (0.2, None)
    assert any(note.startswith("D was left out") for note in rig.notes)


def test_files_of_whole_rigs_are_several_rigs(tmp_path):
    for number, focal_px in enumerate((700.0, 800.0)):
        path = tmp_path / f"scene{number}" / "calib.txt"
        path.parent.mkdir()
        path.write_text(middlebury(StereoCamera.centred(640, 480, focal_px, 0.2)))
    assert [rig.camera.focal_px for rig in read_rigs([tmp_path / "*/calib.txt"])] == [700, 800]


# --- rectification ---


@pytest.mark.parametrize("alpha", [0.0, 0.4, 1.0])
def test_alpha_rectifies_what_states_no_projections(tmp_path, alpha):
    (rig,) = read_rigs([storage(tmp_path / "rig.yml", RAW)], alpha=alpha)
    check(rig, alpha)
    chains = [LensChain(rig.raw[eye], rig.camera, eye, "black") for eye in EYES]
    # OpenCV looks for the border at a few points of it, and leaves single pixels.
    border = max(1 - chain.valid.mean() for chain in chains)
    assert border < 1e-3 if alpha == 0 else border > 0.02
    x, y = (each.ravel().astype(float) for each in np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])))
    for chain in chains:
        column, row = chain.raw.rectified(chain.pinhole, x, y)
        seen = (column > -1) & (column < SIZE[0]) & (row > -1) & (row < SIZE[1])
        assert seen.all() == (alpha == 1)


def test_a_fisheyes_alpha_is_opencvs_balance(tmp_path):
    (rig,) = read_rigs(write(tmp_path, chain_yaml=kalibr("equidistant", [FISHEYE] * 2)), alpha=0.7)
    of_k = K1, FISHEYE, K2, FISHEYE, SIZE, R, T[:, None]
    _, _, p1, *_ = cv2.fisheye.stereoRectify(*of_k, flags=cv2.CALIB_ZERO_DISPARITY, balance=0.7)
    np.testing.assert_allclose(rig.camera.focal_px, p1[0, 0], rtol=1e-9)


@pytest.mark.parametrize("lens", ["equidistant", "radtan"])
@pytest.mark.parametrize("fov_deg", [30, 90, 140])
def test_a_field_of_view_is_that_of_the_rectified_images(tmp_path, lens, fov_deg):
    (rig,) = read_rigs(write(tmp_path, chain_yaml=kalibr(lens, [FISHEYE] * 2)), fov_deg=fov_deg)
    camera = rig.camera
    left, right = (np.degrees(np.arctan((x - camera.cx_left_px) / camera.focal_px)) for x in (-0.5, SIZE[0] - 0.5))
    assert (-left, right) == (pytest.approx(fov_deg / 2), pytest.approx(fov_deg / 2))
    assert (camera.cx_right_px, camera.cy_px) == (camera.cx_left_px, (SIZE[1] - 1) / 2)
    assert camera.baseline_m == pytest.approx(np.linalg.norm(T))


@pytest.mark.parametrize("focal_px", [520, 150, 100])
def test_the_middle_of_a_wide_fisheye_stays_sharp(tmp_path, focal_px):
    """As OpenCV's default does not keep it."""
    chain = kalibr("equidistant", [FISHEYE] * 2)
    for camera in chain.values():
        camera["intrinsics"][:2] = focal_px, focal_px
    path = write(tmp_path, chain_yaml=chain)
    (rig,), (whole,) = (read_rigs(path, alpha=alpha) for alpha in (None, 0))
    assert (rig.view_deg < 99) == (focal_px == 520)
    assert rig.view_deg == pytest.approx(min(whole.view_deg, 100))


def test_cameras_that_are_rectified_already_have_no_lens(tmp_path):
    values = projections()
    p1, p2 = (values[f"P{n}"] for n in "12")
    values |= {"R1": np.eye(3), "R2": np.eye(3), "K1": p1[:, :3], "K2": p2[:, :3], "D1": np.zeros(5), "D2": np.zeros(5)}
    assert read_rigs([storage(tmp_path / "rig.yml", values)])[0].raw is None


# --- refusals ---


def changed(values, *path, to=None):
    """Values with another one, or without it."""
    copy = json.loads(json.dumps(values, default=np.ndarray.tolist))
    node = copy
    for key in path[:-1]:
        node = node[key]
    if to is None:
        del node[path[-1]]
    else:
        node[path[-1]] = to
    return copy


def m(old, new):
    assert old in MIDDLEBURY
    return MIDDLEBURY.replace(old, new)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (m("cam1=[994.978 0", "cam1=[990 0"), ["not rectified", "994.978 px left, 990 right"]),
        (m("279; 0 994.978 254.877", "279; 0 994.978 255.9"), ["cy differs", "254.877", "255.9"]),
        (m("994.978 0 311.193", "994.978 3 311.193"), ["not rectified", "has rotation or skew"]),
        (m("279; 0 994.978", "279; 0 990.1"), ["not rectified", "fy is 994.978 px left, 990.1 right"]),
        (m("0 994.978 254.877", "0 2500 254.877"), ["fy / fx is 2.51262: expected 0.5 to 2"]),
        (m("0 994.978 254.877", "3 994.978 254.877"), ["describes no pair", "cam0 (3 x 3)"]),
        (m("baseline=193.001", "baseline=0"), ["baseline is 0 m"]),
        (m("baseline=193.001", "baseline=wide"), ["baseline: expected a number, got 'wide'"]),
        (m("doffs=31.086", "doffs=0"), ["doffs is 0", "is 31.086"]),
        (m("width=741", "width=-3"), ["-3 x 500"]),
        (m("width=741", "width=inf"), ["how large the images are"]),
        (m("994.978", "nan"), ["describes no pair"]),
        (KITTI.replace("P_rect_03: 7.215377e+02", "P_rect_03: 7.0e+02"), ["not rectified"]),
        (KITTI.replace("2.199936e+00", "2.2e+01"), ["not rectified", "below"]),
        (KITTI.replace(" 2.729905e-03", ""), ["describes no pair", "P_rect_03 (11)"]),
        (KITTI.replace("S_rect_03: 1.242", "S_rect_03: 1.250"), ["one size of both cameras", "1250"]),
        (message("1") + message("1").replace("c1", "x"), ["baseline is 0 m"]),
        (message("2") + message("1"), ["the baseline is -0.12", "swap"]),
        (message("2", P2=np.zeros((3, 4))), ["describes no pair"]),
        (message("2").replace("binning_x: 0", "binning_x: 2"), ["binning", "the scale"]),
        (message("2").replace("x_offset: 0", "x_offset: 8"), ["roi", "window"]),
        (message("2").replace("width: 640", "width: -1"), ["-1 x 480"]),
        (json.dumps(kalibr("omni")), ["omni", "pinhole-radtan"]),
        (json.dumps(kalibr()).replace('"pinhole"', '"ds"'), ["ds", "pinhole-equi"]),
        (json.dumps(changed(kalibr(), "cam0", "resolution", to=[640, 200])), ["one size", "640 x 200"]),
        (json.dumps(kalibr(coefficients=(D1, D2[:3]))), ["cam1.distortion_coeffs", "of both lenses", "3 in cam1"]),
        (json.dumps(RAW | {"K2": K2 + np.eye(3, k=1), "imageSize": SIZE}, default=np.ndarray.tolist), ["a skew of 1"]),
        (json.dumps(kalibr("equidistant", (D1, D2))), ["expected 4 coefficients of a fisheye lens, got 5"]),
        (json.dumps(kalibr(size=(480, 640))), ["near that of 640 x 480: the size is probably"]),
        (json.dumps(basalt("ds")), ["ds", "kb4"]),
        (json.dumps(changed(basalt(), "value0", "T_imu_cam", 1, to=basalt()["value0"]["T_imu_cam"][0])), ["of 0"]),
        (json.dumps(depthai("nowhere")), ["describes no pair"]),
        (json.dumps(depthai(kind=2)), ["describes no pair"]),
        (json.dumps(depthai(lens=(np.full(14, 0.1),) * 2)), ["got 14: the last two, a tilted sensor's, must be 0"]),
        (json.dumps(changed(depthai(), "cameraData", 2)), ["describes no pair of cameras"]),
        (json.dumps(changed(depthai(), "stereoRectificationData")), ["leftCameraSocket: expected a number"]),
        ("fx: 3\n", ["describes no pair", "fx (a number)"]),
        (json.dumps({"K": K1.tolist(), "size": {"cols": 640, "rows": 480}}), ["describes no pair", "size.rows"]),
        ("=== RESULTS ===\n.: 3\n", ["describes no pair"]),
        ("[[1, 2], [3, 4]]", ["describes no pair", "values (2 x 2)"]),
        ("<x>3</x>", ["describes no pair"]),
        ("", ["no numbers"]),
        ("[1, 2", ["describes no pair"]),
        ("a: !!python/object:os.system b\n", ["no numbers"]),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><x>&a;</x>", ["without a document type"]),
        ("[" * 100_000, ["nested too deeply"]),
        ("\x00\x01", ["no numbers"]),
    ],
)  # fmt: skip
def test_what_is_no_calibration_is_refused_with_its_numbers(tmp_path, text, words):
    path = tmp_path / "rig.txt"
    path.write_text(text)
    with pytest.raises(SemisynthError) as error:
        read_rigs([path])
    for word in (str(path), *words):
        assert word in str(error.value), str(error.value)


@pytest.mark.parametrize("lens", ["equidistant", "radtan"])
def test_a_vertical_rig_is_named(tmp_path, lens):
    below = np.eye(4)
    below[:3, :3], below[:3, 3] = R, R @ [-0.001, -0.12, 0]
    with pytest.raises(ReadError, match=r"vertical rig: the right camera stands 0\.12 m below the left one"):
        read_rigs(write(tmp_path, chain_yaml=kalibr(lens, [FISHEYE] * 2, below)))
    left, right = matrices()
    right[0, 3], right[1, 3] = 0, -100
    with pytest.raises(InputError, match=r"vertical rig: the right camera stands 0\.100505 m below"):
        rectified(StereoArrays(EyeArrays(p=left), EyeArrays(p=right), Size(741, 500)), None)


def test_alpha_is_refused_where_it_decides_nothing(tmp_path):
    for paths in ([storage(tmp_path / "rig.yml", RAW | projections())], ros(tmp_path)):
        with pytest.raises(InputError, match=r"alpha: .*states how its images are rectified"):
            read_rigs(paths, alpha=0.5)


@settings(max_examples=60, deadline=None)
@given(data=st.one_of(st.binary(max_size=300), st.text(max_size=300).map(lambda text: f"cam0=[{text}".encode())))
@pytest.mark.parametrize("extension", ["yaml", "txt", "json", "xml", "npz", "npy"])
def test_any_bytes_are_read_or_refused(tmp_path_factory, data, extension):
    path = tmp_path_factory.mktemp("any") / f"x.{extension}"
    path.write_bytes(data)
    with pytest.raises(SemisynthError):
        read_rigs([path])


@pytest.mark.parametrize("line", ["key{}: {{a: [1, 2], b: word}}", "- {}.5", "1.5 {}", "a = [{}, 2"])
@pytest.mark.parametrize("extension", ["yaml", "json", "txt"])
def test_large_files_of_other_things_are_refused_soon(tmp_path, line, extension):
    path = tmp_path / f"x.{extension}"
    path.write_text("\n".join(map(line.format, range(1_000_000 // (len(line) + 6)))))
    start = time.monotonic()
    with pytest.raises(ReadError):
        read_rigs([path])
    assert time.monotonic() - start < 10


def test_pickled_arrays_are_not_opened(tmp_path):
    np.savez(tmp_path / "rig.npz", K=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ReadError, match="no numbers"):
        read_rigs([tmp_path / "rig.npz"])


def test_files_that_are_not_there_are_refused(tmp_path):
    for source, words in (("no.txt", "no such file"), ("*.txt", "as a glob it matches"), (".", "is a folder")):
        with pytest.raises(InputError, match=words):
            read_rigs([tmp_path / source])


@given(
    size=st.tuples(st.integers(100, 4000), st.integers(100, 4000)).filter(lambda size: max(size) > 1.25 * min(size)),
    off=st.tuples(*[st.floats(-0.03, 0.03)] * 3),
)
def test_a_size_whose_sides_changed_places_is_noticed(size, off):
    size = Size(*size)
    left_x, right_x = (size.width_px * (0.5 + each) for each in off[:2])
    camera = StereoCamera(*size, 500, 0.1, left_x, right_x, size.height_px * (0.5 + off[2]))
    left, right = (EyeArrays(p=p) for p in matrices(camera))
    assert rectified(StereoArrays(left, right, size), None).size == size
    turned = Size(*reversed(size))
    for stated, users in ((turned, None), (None, turned)):
        with pytest.raises(InputError, match=f"near that of {size}: the size is probably written as height, width"):
            rectified(StereoArrays(left, right, stated), users)


# --- rectified rigs whose lens cannot be used ---

ALL = RAW | projections()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (ALL | {"D1": np.arange(14.0)}, ["got 14", "tilted"]),
        (ALL | {"distortion_model": "omni"}, ["omni"]),
        (ALL | {"distortion_model": "equidistant"}, ["expected 4 coefficients of a fisheye"]),
    ],
)
def test_a_rectified_rig_does_without_a_lens_that_cannot_be_used(tmp_path, values, words):
    (rig,) = read_rigs(write(tmp_path, rig_json=values | {"imageSize": SIZE}))
    assert rig.raw is None
    for word in words:
        assert word in str(rig.lens_fault)


def test_lenses_of_two_models_are_not_used(tmp_path):
    left, right = _ros("1", "equidistant"), _ros("2")
    left = re.sub(r"cols: 5\n   dt: d\n   data: \[[^]]*", f"cols: 4\n   data: [{', '.join(map(str, FISHEYE))}", left)
    (rig,) = read_rigs(write(tmp_path, left_yaml=left, right_yaml=right))
    assert rig.raw is None
    assert "lenses of one model" in str(rig.lens_fault)


# What damages a number or a name: other values, other names, and nothing.
DAMAGES = (b"nan", b".inf", b"-1", b"0", b"1e400", b'"x"', b"null", b"[]", b"true", b"-12", b"[[1],[2,3]]", b"~", b"")


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_damaged_calibrations_are_read_or_refused(tmp_path_factory, data):
    make = data.draw(st.sampled_from([*SHAPES.values(), *FOUR.values()]))
    paths = make(tmp_path_factory.mktemp("damaged"))
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(paths))
        content = path.read_bytes()
        parts = [each.span() for each in re.finditer(rb"-?\d+\.?\d*(?:e-?\d+)?|[A-Za-z_]\w+|\n", content)]
        begin, end = data.draw(st.sampled_from(parts))
        other = data.draw(st.sampled_from(parts))
        by = data.draw(st.sampled_from([*DAMAGES, content[other[0] : other[1]]]))
        path.write_bytes(content[:begin] + by + content[end:])
    cameras = data.draw(st.sampled_from([None, ("cam0", "cam1"), ("left", "right"), ("a", "b")]))
    with suppress(SemisynthError):
        read_rigs(paths, photographed=Size(*SIZE), cameras=cameras)
