"""Calibration files of many tools: each gives the rig that it describes, or is refused with what to do."""

import json
import re
import time
from contextlib import suppress

import numpy as np
import pytest
from calibration_files import (
    CAMERA,
    D1,
    D2,
    FISHEYE,
    IMAGE,
    K1,
    K2,
    KITTI,
    MIDDLEBURY,
    RAW,
    SIZE,
    R,
    T,
    kitti,
    matrices,
    matrix,
    middlebury,
    opencv,
    projections,
    write_storage,
)  # fmt: skip
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shared_material import SHARED, needs_shared

from semisynth_gl.calibration.arrays import StereoArrays
from semisynth_gl.calibration.kinds import Size, turned_size_fault
from semisynth_gl.calibration.rig import rectified
from semisynth_gl.calibration.rig_files import read_rigs
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.raw_camera import vector_of
from semisynth_gl.inputs.errors import InputError, ReadError, SemisynthError

cv2 = pytest.importorskip("cv2", reason="OpenCV, the extra opencv, is not installed")

POSE = np.vstack([np.column_stack([R, T]), [0, 0, 0, 1]])
# The left camera on a body that looks elsewhere, and the right one where it then stands.
BODY_LEFT = np.eye(4)
BODY_LEFT[:3, :3], BODY_LEFT[:3, 3] = cv2.Rodrigues(np.array([0.3, -1.2, 0.4]))[0], (0.02, -0.07, 0.01)
BODY_RIGHT = BODY_LEFT @ np.linalg.inv(POSE)


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


# --- shapes in which tools and people keep a rig: the content of each file, by name ---


def write(folder, files):
    """Write text, values as JSON, or values by OpenCV's own writer; return the paths."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        if isinstance(content, Storage):
            write_storage(path, content)
        elif path.suffix == ".npy":
            np.save(path, content)
        elif path.suffix == ".npz":
            np.savez(path, **content)
        else:
            path.write_text(content if isinstance(content, str) else json.dumps(content, default=np.ndarray.tolist))
    return [folder / name for name in files]


def read(folder, files, **options):
    return read_rigs(write(folder, files), **options)


class Storage(dict):
    """Values that OpenCV's own writer writes."""


def scalars(k, d):
    names = dict(zip(("k1", "k2", "p1", "p2", "k3"), map(float, d), strict=True))
    return dict(zip(("fx", "fy", "cx", "cy"), vector(k), strict=True)) | names


def vector(k):
    return [k[0, 0].item(), k[1, 1].item(), k[0, 2].item(), k[1, 2].item()]


ALL = RAW | projections()
EYES_OF_RAW = (("left", K1, D1), ("right", K2, D2))
NAMES = {
    "samples": ("M1", "D1", "M2", "D2", "R", "T"),
    "python": ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T"),
    "tutorial": ("mtxL", "distL", "mtxR", "distR", "Rot", "Trns"),
    "snake": ("camera_matrix_left", "dist_coeffs_left", "camera_matrix_right", "dist_coeffs_right", "R", "T"),
    "words": ("Left_Camera_Matrix", "Left_Distortion", "Right_Camera_Matrix", "Right_Distortion", "rotation", "trans"),
    "letters": ("Kl", "Dl", "Kr", "Dr", "R", "t"),
    "first": ("intrinsics_left", "distortion_l", "intrinsics_right", "distortion_r", "rot_mat", "tvec"),
}


def named(names, values=RAW):
    return dict(zip(names, values.values(), strict=True))


def lines(values, form="{}: {}\n"):
    return "".join(form.format(*pair) for pair in values.items())


def scalars_of_eyes():
    named = {f"{name}_{eye}": value for eye, k, d in EYES_OF_RAW for name, value in scalars(k, d).items()}
    return {"width": SIZE[0], "height": SIZE[1]} | named


def listed_camera(name, k, d, turn, shift):
    return {"name": name, "camera_matrix": k, "dist": d, "R": turn, "t": shift, "imageSize": SIZE}


def matlab_camera(k, d):
    return {"IntrinsicMatrix": k.T, "RadialDistortion": [d[0], d[1], d[4]], "TangentialDistortion": d[2:4]}


def bouguet():
    eyes = {f"{name}_{eye}": value for eye, k, d in EYES_OF_RAW
            for name, value in (("fc", [k[0, 0], k[1, 1]]), ("cc", k[:2, 2]), ("kc", d))}  # fmt: skip
    return {"om": vector_of(R.tolist()), "T": T * 1000, "imsize": SIZE} | eyes


def orb_slam():
    text = f"%YAML:1.0\n\nCamera.fx: {ALL['P1'][0, 0]}\nCamera.fy:435.2\nCamera.cx:367.4\nCamera.cy: 252.2\n"
    text += f"Camera.bf: 50.0\nLEFT.height: {SIZE[1]}\nLEFT.width: {SIZE[0]}\n"
    eyes = (("LEFT", "1"), ("RIGHT", "2"))
    return text + "".join(matrix(f"{eye}.{name}", ALL[name + n], space="") for eye, n in eyes for name in "DKRP")


def orb_slam_3():
    cameras = (("Camera1", K1, D1), ("Camera2", K2, D2))
    values = {f"{eye}.{name}": value for eye, k, d in cameras for name, value in scalars(k, d).items()}
    values = {"File.version": '"1.0"', "Camera.type": '"PinHole"', "Camera.width": 640, "Camera.height": 480} | values
    return "%YAML:1.0\n\n" + lines(values) + matrix("Stereo.T_c1_c2", np.linalg.inv(POSE))


def stella():
    (fx, _, cx, _), (_, fy, cy, _), _ = ALL["P1"].tolist()
    camera = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "k1": 0, "k2": 0, "p1": 0, "p2": 0, "k3": 0}
    camera |= {"cols": SIZE[0], "rows": SIZE[1], "focal_x_baseline": -ALL["P2"][0, 3]}
    pairs = {f"{name}_{eye}": ALL[f"{name}{n}"].ravel() for n, eye in ((1, "left"), (2, "right")) for name in "KDR"}
    return {"Camera": camera, "StereoRectifier": pairs}


def ros(number, model="plumb_bob"):
    keys = {"camera_matrix": "K", "distortion_coefficients": "D", "rectification_matrix": "R", "projection_matrix": "P"}
    values = "".join(matrix(key, ALL[name + number]).replace(" !!opencv-matrix", "") for key, name in keys.items())
    return lines(IMAGE) + f"camera_name: rig\ndistortion_model: {model}\n{values}"


def message(number, sec=0, *, upper=False, **changed):
    """A message as `ros2 topic echo` prints it, with the line that divides it from the next."""
    text = f"header:\n  stamp:\n    sec: {sec}\n  frame_id: c{number}\nheight: {SIZE[1]}\nwidth: {SIZE[0]}\n"
    text += "distortion_model: plumb_bob\n"
    values = {name: np.ravel((ALL | changed)[name + number]).tolist() for name in "DKRP"}
    text += lines(values if upper else {name.lower(): value for name, value in values.items()})
    return f"{text}binning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n---\n"


def ros_ini(eye, n):
    sections = {"camera matrix": "K", "distortion": "D", "rectification": "R", "projection": "P"}
    rows = {key: "\n".join(" ".join(map(repr, map(float, row))) for row in np.atleast_2d(ALL[name + n]))
            for key, name in sections.items()}  # fmt: skip
    head = f"# oST version 5.0 parameters\n\n[image]\n\nwidth\n{SIZE[0]}\n\nheight\n{SIZE[1]}\n\n"
    return f"{head}[narrow_stereo/{eye}]\n\n" + lines(rows, "{}\n{}\n\n")


def report():
    """As scripts print arrays for people, with angles beside the rotation."""
    text = "=== RESULTS ===\n\nChessboard size: 9 x 6\nIMAGE SIZE (width x height):\n640 480\n\n-----\n"
    text += "Rotation angles (Roll, Pitch, Yaw) [degrees]: 0.57, -1.15, 0.34\n\n"
    with np.printoptions(precision=17):
        text += "".join(f"{eye} CAMERA MATRIX:\n{k}\n\n{eye} DISTORTION:\n{d}\n\n" for eye, k, d in
                        (("LEFT", K1, D1), ("RIGHT", K2, D2)))  # fmt: skip
        return text + f"ROTATION MATRIX (R):\n{R}\n\nTRANSLATION VECTOR (T) [mm]:\n{T[:, None] * 1000}\n"


def from_right_to_left():
    back = np.linalg.inv(POSE)
    values = {"K_left": K1, "D_left": D1, "K_right": K2, "D_right": D2, "size": SIZE}
    return values | {"R_right_to_left": back[:3, :3], "T_right_to_left": back[:3, 3]}


def against_a_board(direction):
    """Each camera's pose against a board, in the direction that the names tell."""
    cameras = {}
    for number, k, d, body in ((0, K1, D1, BODY_LEFT), (1, K2, D2, BODY_RIGHT)):
        pose = body if direction == "cam_to_board" else np.linalg.inv(body)
        names = {f"R_{direction}": pose[:3, :3], f"t_{direction}": pose[:3, 3]}
        cameras[f"camera_{number}"] = {"camera_matrix": k, "dist": d, "width": 640, "height": 480, **names}
    return cameras


def mrcal(k, d, turn, shift):
    values = {"lensmodel": "LENSMODEL_OPENCV5", "intrinsics": [*vector(k), *d.tolist()], "imagersize": [*SIZE]}
    pose = [*vector_of(turn.tolist()), *map(float, shift)]
    return "# a model\n" + repr(values | {"extrinsics": pose})


def kalibr(lens="radtan", coefficients=(D1[:4], D2[:4]), pose=POSE, *, imu=False):
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
            "resolution": list(SIZE),
            "rostopic": f"/cam{number}/image_raw",
        }
    return cameras


def camodocal(k, d):
    values = scalars(k, [*d[:4], 0])
    text = "%YAML:1.0\n---\nmodel_type: PINHOLE\ncamera_name: c\n" + lines(IMAGE)
    for section, names in (("distortion", ("k1", "k2", "p1", "p2")), ("projection", ("fx", "fy", "cx", "cy"))):
        text += f"{section}_parameters:\n" + lines({name: values[name] for name in names}, "   {}: {}\n")
    return text


def euroc(k, d, body):
    return json.dumps({
        "sensor_type": "camera", "T_BS": {"cols": 4, "rows": 4, "data": body.ravel().tolist()}, "rate_hz": 20,
        "resolution": SIZE, "camera_model": "pinhole", "intrinsics": vector(k),
        "distortion_model": "radial-tangential", "distortion_coefficients": list(d[:4]),
    })  # fmt: skip


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


SHAPES = {
    **{f"{label}.{extension}": {f"rig.{extension}": Storage(named(names) | IMAGE)}
       for label, names in NAMES.items() for extension in ("yml", "xml", "json")},
    "npz in mm": {"rig.npz": named(NAMES["tutorial"]) | {
        "Trns": T[:, None] * 1000, "objpoints": np.array([{}], dtype=object), "E": R, "F": R * 7, "imageSize": SIZE}},
    "npy for each": {
        "K_left.npy": K1, "K_right.npy": K2, "dist_left.npy": D1, "dist_right.npy": D2, "R.npy": R, "T.npy": T,
        "size.json": {"image_size": SIZE}},
    "everything of stereoRectify": {"rig.yml": Storage(ALL | IMAGE)},
    "intrinsics and extrinsics": {
        "intrinsics.yml": Storage({"M1": K1, "D1": D1, "M2": K2, "D2": D2} | IMAGE),
        "extrinsics.yml": Storage({"R": R, "T": T})},
    "one file a camera": {
        **{f"{eye}.yml": Storage({"K": k, "D": d} | IMAGE) for eye, k, d in EYES_OF_RAW},
        "stereo.yml": Storage({"R": R, "T": T})},
    "nested": {"rig.json": {
        "left": {"K": K1, "D": D1}, "right": {"K": K2, "D": D2}, "stereo": {"R": R, "T": T},
        "resolution": {"width": SIZE[0], "height": SIZE[1]}}},
    "listed cameras": {"rig.json": {"cameras": [
        listed_camera("a", K1, D1, np.eye(3), [0] * 3), listed_camera("b", K2, D2, R, T)]}},
    "single numbers and a rotation vector": {"rig.json": {
        "intrinsics": {"left": scalars(K1, D1), "right": scalars(K2, D2)},
        "extrinsics": {"rotation": vector_of(R.tolist()), "translation": T}, "image_shape": [SIZE[1], SIZE[0], 3]}},
    "numbers with the eye in their names": {
        "rig.txt": lines(scalars_of_eyes()) + f"R: {' '.join(map(repr, R.ravel().tolist()))}\nT = {T.tolist()}"},
    "matlab": {"rig.json": {
        "CameraParameters1": matlab_camera(K1, D1), "CameraParameters2": matlab_camera(K2, D2), "ImageSize": [*SIZE],
        "RotationOfCamera2": R.T, "TranslationOfCamera2": T * 1000}},
    "bouguet": {"Calib_Results.json": bouguet()},
    "orb slam": {"EuRoC.yaml": orb_slam()},
    "orb slam 3": {"EuRoC.yaml": orb_slam_3()},
    "stella": {"rig.yaml": stella()},
    "ros": {"left.yaml": ros("1"), "right.yaml": ros("2")},
    "ros without eyes in the names": {"a.yaml": ros("1"), "b.yaml": ros("2")},
    "ros nested": {"rig.yaml": "".join(
        "\n  ".join([f"{eye}:", *ros(n).splitlines()]) + "\n" for eye, n in (("left", "1"), ("right", "2")))},
    "ros messages": {"rig.yaml": "".join(message(n, sec) for n in "12" for sec in range(5))},
    "ros 1 messages in text": {"rig.txt": message("1", upper=True) + message("2", upper=True)},
    "ros ini": {"left.ini": ros_ini("left", "1"), "right.ini": ros_ini("right", "2")},
    "report": {"report.txt": report()},
    "from right to left": {"rig.json": from_right_to_left()},
    "tabs and a board": {"rig.yaml": lines(
        named(("left_K", "left_D", "right_K", "right_D", "stereo_R", "stereo_T"),
              {key: value.tolist() for key, value in RAW.items()}), "{}:\t{}\t\t# measured\n",
    ) + "img_shape:\t[640, 480]\nboard:\n  cols: 9\n  rows: 6\n  size: [9, 6]\n"},
    "board to cam": {"rig.json": against_a_board("board_to_cam")},
    "cam to board": {"rig.json": against_a_board("cam_to_board")},
    "mrcal": {"left.cameramodel": mrcal(K1, D1, np.eye(3), [0] * 3), "right.cameramodel": mrcal(K2, D2, R, T)},
    "basalt": {"calibration.json": basalt()},
    **{f"depthai {link}": {"oak.json": depthai(link)} for link in [*LINKS][1:]},
}  # fmt: skip
FOUR = {
    "kalibr": {"chain.yaml": kalibr()},
    "kalibr with an IMU": {"chain.yaml": kalibr(pose=None, imu=True)},
    "kalibr with both": {"chain.yaml": kalibr(imu=True)},
    "camodocal": {
        "rig.yaml": "%YAML:1.0\n" + matrix("body_T_cam0", BODY_LEFT) + matrix("body_T_cam1", BODY_RIGHT),
        "cam0.yaml": camodocal(K1, D1), "cam1.yaml": camodocal(K2, D2)},
    "euroc": {"cam0/sensor.yaml": euroc(K1, D1, BODY_LEFT), "cam1/sensor.yaml": euroc(K2, D2, BODY_RIGHT)},
    "python": {"rig.yml": Storage(RAW | IMAGE | {"D1": D1[:4], "D2": D2[:4]})},
}  # fmt: skip


@pytest.mark.parametrize("files", SHAPES.values(), ids=SHAPES.keys())
def test_every_shape_gives_the_rig(tmp_path, files):
    (rig,) = read(tmp_path, files)
    check(rig)


@pytest.mark.parametrize("files", FOUR.values(), ids=FOUR.keys())
def test_every_shape_with_four_coefficients_gives_the_rig(tmp_path, files):
    (rig,) = read(tmp_path, files)
    check(rig, lens=(D1[:4], D2[:4]))


@pytest.mark.parametrize(
    "values",
    [basalt("kb4", (FISHEYE, FISHEYE)), depthai(kind=1, lens=(FISHEYE, FISHEYE)), kalibr("equidistant", [FISHEYE] * 2)],
)
def test_fisheyes_are_read(tmp_path, values):
    (rig,) = read(tmp_path, {"rig.json": values})
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


def test_the_right_camera_alone_holds_the_baseline(tmp_path):
    left, right = write(tmp_path, SHAPES["ros"])
    check(read_rigs([left, right])[0])
    check(read_rigs([tmp_path / "*.yaml"])[0])
    (alone,) = read_rigs([right])
    assert alone.camera.baseline_m == pytest.approx(np.linalg.norm(T))
    assert alone.raw is None
    with pytest.raises(ReadError, match="describes no pair"):
        read_rigs([left])
    a, b = write(tmp_path / "unnamed", SHAPES["ros without eyes in the names"])
    with pytest.raises(InputError, match="swap left and right"):
        read_rigs([b, a])


SHORT_KITTI = "".join(f"{line.replace('_rect_0', '')}\n" for line in KITTI.splitlines() if line.startswith("P_rect"))
KITTIS = StereoCamera(1242, 375, 721.5377, 0.5327, 609.5593, 609.5593, 172.854)
BARE = StereoCamera(640, 480, 700.0, 0.12, 320.0, 320.0, 240.0)


@pytest.mark.parametrize(
    ("text", "camera"),
    [
        (KITTI, KITTIS),
        (SHORT_KITTI, KITTIS),
        ("700 0 320 0 700 240 0 0 1\n0.12\n", BARE),
        ("700 0 320\n0 700 240\n0 0 1\n\n0.12\n", BARE),
    ],
)
def test_rectified_rigs_of_benchmarks(tmp_path, text, camera):
    (rig,) = read(tmp_path, {"calib.txt": text}, size=Size(camera.width_px, camera.height_px))
    assert rig.raw is None
    for key, value in camera.values().items():
        assert getattr(rig.camera, key) == pytest.approx(value, abs=1e-4), key


def realsense():
    values = {"baseline": "-50.2"}
    for number, width, height in ((0, 1280, 720), (1, 672, 376), (9, 0, 0)):
        numbers = {"fx": width / 2, "fy": width / 2, "ppx": width / 2, "ppy": height / 2}
        numbers |= {"width": width, "height": height}
        values |= {f"rectified.{number}.{key}": str(value) for key, value in numbers.items()}
    return values


def zed():
    modes, (x, y, z) = {"HD": 1.0, "VGA": 0.525}, vector_of(R.tolist())
    text = ""
    for mode, scale in modes.items():
        for eye, k, d in EYES_OF_RAW:
            values = {name: value * (scale if name[0] in "fc" else 1) for name, value in scalars(k, d).items()}
            text += f"[{eye.upper()}_CAM_{mode}]\n{lines(values, '{}={}' + chr(10))}\n"
    stereo = {"Baseline": -1000 * T[0], "TY": 1000 * T[1], "TZ": 1000 * T[2]}
    stereo |= {f"{name}_{mode}": value for mode in modes for name, value in (("RX", x), ("CV", y), ("RZ", z))}
    return f"{text}[STEREO]\n" + lines(stereo, "{}={}\n")


@pytest.mark.parametrize("files", [{"realsense.json": realsense()}, {"SN1.conf": zed()}])
def test_modes_are_chosen_by_the_size(tmp_path, files):
    for size, scale in ((Size(1280, 720), 1.0), (Size(672, 376), 0.525)):
        (rig,) = read(tmp_path, files, photographed=size)
        assert rig.size == size
        if "SN1.conf" in files:
            k = [np.diag([scale, scale, 1]) @ each for each in (K1, K2)]
            whole = k[0], D1, k[1], D2, tuple(size), R, T[:, None]
            r1, r2, p1, p2, *_ = cv2.stereoRectify(*whole, flags=cv2.CALIB_ZERO_DISPARITY)
            assert rig.camera.focal_px == pytest.approx(p1[0, 0])
            assert rig.camera.baseline_m == pytest.approx(-p2[0, 3] / p2[0, 0])
            np.testing.assert_allclose(rig.raw["left"].rotation, r1, atol=1e-9)
            np.testing.assert_allclose(rig.raw["right"].rotation, r2, atol=1e-9)
        else:
            assert (rig.camera.focal_px, rig.camera.baseline_m) == (size.width_px / 2, 0.0502)
    with pytest.raises(ReadError, match="1280 x 720, 672 x 376: give the size"):
        read(tmp_path, files)
    with pytest.raises(ReadError, match="got 320 x 240"):
        read(tmp_path, files, size=Size(320, 240))


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


def test_the_size_comes_from_the_file_the_user_or_the_photographs(tmp_path):
    (tmp_path / "stereo.yml").write_text(opencv(size=False))
    with pytest.raises(InputError, match="does not say how large the images are"):
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
    (path,) = write(tmp_path, {"chain.yaml": chain | {"cam2": third}})
    with pytest.raises(ReadError, match=r"3 cameras \(0, 1, 2.*choose two, --pair"):
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
    (path,) = write(tmp_path, {"rig.yaml": values | {"T_10": other, "T_21": POSE}})
    check(read_rigs([path], cameras=("cam1", "cam2"))[0])


def test_principal_points_tell_which_side_of_a_size_is_the_width(tmp_path):
    check(read(tmp_path, {"rig.json": RAW | {"imageSize": [SIZE[1], SIZE[0]]}})[0])


def test_projections_of_another_unit_or_baseline_than_the_translation(tmp_path):
    for unit_m in (1, 0.001):
        values = RAW | projections() | {"T": T / unit_m}
        check(read(tmp_path, {"rig.yml": Storage(IMAGE | values)})[0])
    values = RAW | projections()
    values["P2"] = values["P2"] * [1, 1, 1, 2]
    (rig,) = read(tmp_path, {"rig.yml": Storage(IMAGE | values)})
    check(rig)
    assert any(re.match("the cameras are 0.24.* apart by P, and 0.12.* by T", note) for note in rig.notes)
    check(read(tmp_path, {"rig.yml": Storage(IMAGE | RAW | projections() | {"T": T * 1e-9})})[0])


def test_names_that_tell_nothing_are_given(tmp_path):
    names = dict(zip(("K1", "D1", "K2", "D2", "R", "T"), ("alpha", "beta", "gamma", "delta", "x", "y"), strict=True))
    values = {f"{name}y": RAW[key] for key, name in names.items()} | {"ours": [*SIZE]}
    (path,) = write(tmp_path, {"rig.json": {"v": values}})
    with pytest.raises(ReadError, match=r"no pair.*v\.alphay \(3 x 3\), v\.betay \(5\).*K1=left"):
        read_rigs([path])
    keys = {key: f"v.{name}y" for key, name in names.items()}
    check(read_rigs([path], keys=keys | {"size": "v.ours"})[0])
    with pytest.raises(ReadError, match=r"has no v\.omega, which K1 was to be: it has v\.alphay"):
        read_rigs([path], keys=keys | {"K1": "v.omega"})
    with pytest.raises(InputError, match="K9: expected one of K1, D1"):
        read_rigs([path], keys={"K9": "v.alphay"})


@pytest.mark.parametrize("extension", ["json", "yml", "xml", "npz"])
def test_a_file_names_its_lens(tmp_path, extension):
    wide = np.diag([0.3, 0.3, 1]) @ K1
    values = Storage({"K1": wide, "D1": FISHEYE, "K2": wide, "D2": FISHEYE, "R": R, "T": T})
    values = dict(values) if extension == "npz" else values
    with pytest.raises(ReadError, match="a wide lens with 4 coefficients may be"):
        read(tmp_path, {f"rig.{extension}": values}, size=Size(*SIZE))
    for name, model in (("fisheye", "fisheye"), ("radtan", "radial-tangential")):
        values["distortion_model"] = name
        (rig,) = read(tmp_path, {f"rig.{extension}": values}, size=Size(*SIZE), alpha=0)
        assert rig.raw["left"].model == model


@pytest.mark.parametrize("flag", ["fisheye: 0", "fisheye: false", "is_fisheye: no", "fisheye: 1", "fisheye: true"])
def test_a_flag_tells_a_fisheye_by_its_value(tmp_path, flag):
    matrix, numbers = [700, 0, 320, 0, 700, 240, 0, 0, 1], [-0.1, 0.01, 0, 0]
    arrays = {"K1": matrix, "D1": numbers, "K2": matrix, "D2": numbers, "R": np.eye(3).ravel().tolist()}
    path = tmp_path / "rig.yaml"
    path.write_text("\n".join([flag, "T: [-0.1, 0, 0]", *(f"{name}: {values}" for name, values in arrays.items())]))
    (rig,) = read_rigs([path], size=Size(*SIZE))
    expected = "fisheye" if flag.endswith(("1", "true")) else "radial-tangential"
    assert {rig.raw[eye].model for eye in ("left", "right")} == {expected}


def test_a_flag_of_json_tells_a_fisheye(tmp_path):
    for flag, expected in ((True, "fisheye"), (False, "radial-tangential")):
        values = {"fisheye": flag, "K1": K1, "D1": D1[:4], "K2": K1, "D2": D1[:4], "R": R, "T": T}
        (rig,) = read(tmp_path, {"rig.json": values}, size=Size(*SIZE))
        assert rig.raw["left"].model == expected


def test_what_is_concluded_is_noted(tmp_path):
    (rig,) = read(tmp_path, {"rig.json": {"K": K1, "D": D1, "R": R, "T": T} | IMAGE})
    assert rig.notes[0].startswith("one K was taken for both cameras")
    np.testing.assert_allclose(rig.raw["right"].matrix, K1)
    camera = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]
    (rig,) = read(tmp_path, {"rig.json": {"K": camera, "D": D1, "baseline": 0.2} | IMAGE})
    assert rig.notes[0].startswith("D was left out")
    assert (rig.camera.baseline_m, rig.raw) == (0.2, None)


def test_files_of_whole_rigs_are_several_rigs(tmp_path):
    for number, focal_px in enumerate((700.0, 800.0)):
        path = tmp_path / f"scene{number}" / "calib.txt"
        path.parent.mkdir()
        path.write_text(middlebury(StereoCamera.centred(640, 480, focal_px, 0.2)))
    assert [rig.camera.focal_px for rig in read_rigs([tmp_path / "*/calib.txt"])] == [700, 800]


# --- rectification ---


@pytest.mark.parametrize("alpha", [0.0, 0.4, 1.0])
def test_alpha_rectifies_what_states_no_projections(tmp_path, alpha):
    (rig,) = read(tmp_path, {"rig.yml": Storage(RAW | IMAGE)}, alpha=alpha)
    check(rig, alpha)


def test_a_fisheyes_alpha_is_opencvs_balance(tmp_path):
    (rig,) = read(tmp_path, {"chain.yaml": kalibr("equidistant", [FISHEYE] * 2)}, alpha=0.7)
    of_k = K1, FISHEYE, K2, FISHEYE, SIZE, R, T[:, None]
    _, _, p1, *_ = cv2.fisheye.stereoRectify(*of_k, flags=cv2.CALIB_ZERO_DISPARITY, balance=0.7)
    np.testing.assert_allclose(rig.camera.focal_px, p1[0, 0], rtol=1e-9)


@pytest.mark.parametrize("focal_px", [520, 150, 100])
def test_the_middle_of_a_wide_fisheye_stays_sharp(tmp_path, focal_px):
    """As OpenCV's default does not keep it."""
    chain = kalibr("equidistant", [FISHEYE] * 2)
    for camera in chain.values():
        camera["intrinsics"][:2] = focal_px, focal_px
    path = write(tmp_path, {"chain.yaml": chain})
    cameras = [read_rigs(path, alpha=alpha)[0].camera for alpha in (None, 0)]
    view_deg, whole_deg = (np.degrees(2 * np.arctan(each.width_px / 2 / each.focal_px)) for each in cameras)
    assert (view_deg < 99) == (focal_px == 520)
    assert view_deg == pytest.approx(min(whole_deg, 100))


def test_cameras_that_are_rectified_already_have_no_lens(tmp_path):
    values = projections()
    p1, p2 = (values[f"P{n}"] for n in "12")
    values |= {"R1": np.eye(3), "R2": np.eye(3), "K1": p1[:, :3], "K2": p2[:, :3], "D1": np.zeros(5), "D2": np.zeros(5)}
    assert read(tmp_path, {"rig.yml": Storage(IMAGE | values)})[0].raw is None


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
        (m("cam1=[994.978 0", "cam1=[990 0"), ["not rectified", "[[990.0, 0"]),
        (m("994.978 0 311.193", "994.978 3 311.193"), ["not rectified", "[[994.978, 3"]),
        (m("279; 0 994.978", "279; 0 990.1"), ["not rectified", "[0.0, 990.1"]),
        (m("baseline=193.001", "baseline=0"), ["baseline is 0 m"]),
        (m("baseline=193.001", "baseline=wide"), ["baseline: expected a number, got 'wide'"]),
        (m("width=741", "width=-3"), ["-3 x 500"]),
        (KITTI.replace("2.199936e+00", "2.2e+01"), ["not rectified", "below"]),
        (KITTI.replace("S_rect_03: 1.242", "S_rect_03: 1.250"), ["one size of both cameras", "1250"]),
        (message("2") + message("1"), ["the baseline is -0.12", "swap"]),
        (json.dumps(kalibr(coefficients=(D1, D2[:3]))), ["of both lenses", "3 in cam1.distortion_coeffs"]),
        (json.dumps(RAW | {"K2": K2 + np.eye(3, k=1), "imageSize": SIZE}, default=np.ndarray.tolist), ["a skew of 1"]),
        (json.dumps(basalt("ds")), ["its lens is ds"]),
        (json.dumps(changed(basalt(), "value0", "T_imu_cam", 1, to=basalt()["value0"]["T_imu_cam"][0])), ["apart"]),
        (json.dumps(depthai("nowhere")), ["describes no pair"]),
        (json.dumps(depthai(lens=(np.full(14, 0.1),) * 2)), ["got 14: the last two, a tilted sensor's, must be 0"]),
        (json.dumps(changed(depthai(), "stereoRectificationData")), ["leftCameraSocket: expected a number"]),
        ("fx: 3\n", ["describes no pair", "fx (1)"]),
        ("a: !!python/object:os.system b\n", ["no numbers"]),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><x>&a;</x>", ["no numbers"]),
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
    with pytest.raises(ReadError, match=r"0\.12 m below it: turn the images of a vertical rig"):
        read(tmp_path, {"chain.yaml": kalibr(lens, [FISHEYE] * 2, below)})
    left, right = matrices()
    right[0, 3], right[1, 3] = 0, -100
    with pytest.raises(InputError, match=r"not rectified.*0\.100505 m below"):
        rectified(StereoArrays(p=(left, right)), Size(741, 500))


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
    with pytest.raises(ReadError, match="no numbers"):
        read(tmp_path, {"rig.npz": {"K": np.array([{"a": 1}], dtype=object)}})


def test_files_that_are_not_there_are_refused(tmp_path):
    for source in ("no.txt", "*.txt", "."):
        with pytest.raises(InputError, match="no such file, nor a file with"):
            read_rigs([tmp_path / source])


@given(
    size=st.tuples(st.integers(100, 4000), st.integers(100, 4000)).filter(lambda size: max(size) > 1.25 * min(size)),
    off=st.tuples(*[st.floats(-0.03, 0.03)] * 3),
)
def test_a_size_whose_sides_changed_places_is_noticed(size, off):
    size = Size(*size)
    left_x, right_x = (size.width_px * (0.5 + each) for each in off[:2])
    camera = StereoCamera(*size, 500, 0.1, left_x, right_x, size.height_px * (0.5 + off[2]))
    arrays = StereoArrays(p=matrices(camera))
    assert rectified(arrays, size).size == size
    with pytest.raises(InputError, match=f"near that of {size}: the size is probably written as height, width"):
        rectified(arrays, Size(*reversed(size)))


# --- rectified rigs whose lens cannot be used ---

RAW_KITTI = "".join(
    lines({f"{name}_{n}": " ".join(map(str, np.ravel(each))) for name, each in arrays.items()})
    for n, k, d in (("02", K1, D1), ("03", K2, D2))
    for arrays in [{"S": (1392, 512), "K": k, "D": d, "R": np.eye(3), "T": np.zeros(3), "R_rect": np.eye(3)}]
)
FOUR_OF_FISHEYE = f"cols: 4\n   data: [{', '.join(map(str, FISHEYE))}"
TWO_MODELS = re.sub(r"cols: 5\n   dt: d\n   data: \[[^]]*", FOUR_OF_FISHEYE, ros("1", "equidistant"))


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"rig.json": ALL | IMAGE | {"D1": np.arange(14.0)}}, "got 14.*tilted"),
        ({"rig.json": ALL | IMAGE | {"distortion_model": "omni"}}, "omni"),
        ({"rig.json": ALL | IMAGE | {"distortion_model": "equidistant"}}, "expected 4 coefficients of a fisheye"),
        ({"left.yaml": TWO_MODELS, "right.yaml": ros("2")}, "lenses of one model"),
        # As in KITTI's recordings, whose rectified images are a part of the raw ones.
        ({"calib.txt": kitti() + RAW_KITTI}, "raw images of 741 x 500, as rectified ones, got 1392 x 512"),
    ],
)
def test_a_rectified_rig_does_without_a_lens_that_cannot_be_used(tmp_path, files, words):
    (rig,) = read(tmp_path, files)
    assert rig.raw is None
    assert re.search(words, str(rig.lens_fault))


# What damages a number or a name: other values, other names, and nothing.
DAMAGES = (b"nan", b".inf", b"-1", b"0", b"1e400", b'"x"', b"null", b"[]", b"true", b"-12", b"[[1],[2,3]]", b"~", b"")


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_damaged_calibrations_are_read_or_refused(tmp_path_factory, data):
    files = data.draw(st.sampled_from([*SHAPES.values(), *FOUR.values()]))
    paths = write(tmp_path_factory.mktemp("damaged"), files)
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
