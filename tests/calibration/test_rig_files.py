"""Calibration files of many tools: the rig that each gives, or the message that refuses it."""

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
    matrix,
    middlebury,
    opencv,
    projections,
    write_storage,
)  # fmt: skip
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shared_material import SHARED, needs_shared

from semisynth_gl.calibration.rig_files import read_rig
from semisynth_gl.calibration.sizes import ImageSize
from semisynth_gl.calibration.tree import read_tree
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import InputError, ReadError, SemisynthError

cv2 = pytest.importorskip("cv2", reason="OpenCV, the extra opencv, is not installed")

POSE = np.vstack([np.column_stack([R, T]), [0, 0, 0, 1]])
BACK = np.linalg.inv(POSE)
# Poses of both cameras on a body whose frame differs from the left camera's.
BODY_LEFT = np.eye(4)
BODY_LEFT[:3, :3], BODY_LEFT[:3, 3] = cv2.Rodrigues(np.array([0.3, -1.2, 0.4]))[0], (0.02, -0.07, 0.01)
BODIES = BODY_LEFT, BODY_LEFT @ BACK
ALL = RAW | projections()
EYES = (("left", K1, D1, BODIES[0]), ("right", K2, D2, BODIES[1]))
FIVE, FOUR, FISH = (D1, D2), (D1[:4], D2[:4]), (FISHEYE, FISHEYE)


class Storage(dict):
    """Values for a cv2.FileStorage."""


def write(folder, files):
    """Write files of text, JSON or cv2.FileStorage; return the paths. Names without a dot are keys of one JSON file."""
    files = files if all("." in name for name in files) else {"rig.json": files}
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
    return read_rig(write(folder, files), **options)


def check(rig, alpha=None, lens=FIVE, k=(K1, K2), turn=R, shift=T, size=SIZE, fisheye=None):
    """Check that a rig equals OpenCV's rectification of these arrays."""
    fisheye = lens is FISH if fisheye is None else fisheye
    rectify = cv2.fisheye.stereoRectify if fisheye else cv2.stereoRectify
    chosen = {} if alpha is None else {"balance" if fisheye else "alpha": alpha}
    arrays = (k[0], lens[0], k[1], lens[1], size, turn, shift[:, None])
    r1, r2, p1, p2, *_ = rectify(*arrays, flags=cv2.CALIB_ZERO_DISPARITY, **chosen)
    np.testing.assert_allclose(rig.camera.focal_px, p1[0, 0], rtol=1e-6)
    np.testing.assert_allclose(rig.camera.baseline_m, -p2[0, 3] / p2[0, 0], rtol=1e-6)
    for eye, own, distortion, rotation in (("left", k[0], lens[0], r1), ("right", k[1], lens[1], r2)):
        raw = rig.raw[eye]
        np.testing.assert_allclose(raw.matrix, own, rtol=1e-6)
        np.testing.assert_allclose((*raw.distortion, *[0] * 9)[: len(distortion)], distortion, atol=1e-9)
        np.testing.assert_allclose(raw.rotation, rotation, atol=1e-6)
        assert (raw.width_px, raw.height_px, raw.model) == (*size, "fisheye" if fisheye else "radial-tangential")


# --- formats of tools and users: the content of each file, by name ---


def vector(k):
    return [k[0, 0].item(), k[1, 1].item(), k[0, 2].item(), k[1, 2].item()]


def scalars(k, d):
    return dict(zip(("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"), [*vector(k), *map(float, d)], strict=False))


def lines(values, form="{}: {}\n"):
    return "".join(form.format(*pair) for pair in values.items())


def named(text, values=RAW):
    return dict(zip(text.split(), values.values(), strict=True))


def eyes(make):
    """Merge the mappings that ``make`` returns for each eye's name, K and D."""
    return {name: value for eye, k, d, _ in EYES for name, value in make(eye, k, d).items()}


def orb_slam():
    text = f"%YAML:1.0\n\nCamera.fx: {ALL['P1'][0, 0]}\nCamera.fy:435.2\nCamera.cx:367.4\nCamera.cy: 252.2\n"
    text += f"Camera.bf: 50.0\nLEFT.height: {SIZE[1]}\nLEFT.width: {SIZE[0]}\n"
    return text + "".join(
        matrix(f"{eye}.{name}", ALL[name + n], space="")
        for eye, n in (("LEFT", "1"), ("RIGHT", "2"))
        for name in "DKRP"
    )


def orb_slam_3(lens=FIVE, kind="PinHole", names=("k1", "k2", "p1", "p2", "k3")):
    text = f'%YAML:1.0\n\nFile.version: "1.0"\nCamera.type: "{kind}"\nCamera.width: 640\nCamera.height: 480\n'
    for n, k, d in ((1, K1, lens[0]), (2, K2, lens[1])):
        text += lines({f"Camera{n}.{name}": value for name, value in scalars(k, ()).items()})
        text += lines({f"Camera{n}.{name}": value for name, value in zip(names, d, strict=True)})
    return text + matrix("Stereo.T_c1_c2", BACK)


def stella():
    camera = scalars(ALL["P1"][:, :3], np.zeros(5)) | {"cols": SIZE[0], "rows": SIZE[1]}
    pairs = {f"{name}_{eye}": ALL[f"{name}{n}"].ravel() for n, eye in ((1, "left"), (2, "right")) for name in "KDR"}
    return {"Camera": camera | {"focal_x_baseline": -ALL["P2"][0, 3]}, "StereoRectifier": pairs}


def ros(number, model="plumb_bob"):
    keys = {"camera_matrix": "K", "distortion_coefficients": "D", "rectification_matrix": "R", "projection_matrix": "P"}
    values = "".join(matrix(key, ALL[name + number]).replace(" !!opencv-matrix", "") for key, name in keys.items())
    return lines(IMAGE) + f"camera_name: rig\ndistortion_model: {model}\n{values}"


def message(number, sec=0):
    """Return a message as `ros2 topic echo` prints it, with the line "---" after it."""
    text = f"header:\n  stamp:\n    sec: {sec}\n  frame_id: c{number}\nheight: {SIZE[1]}\nwidth: {SIZE[0]}\n"
    text += "distortion_model: plumb_bob\n" + lines({n.lower(): np.ravel(ALL[n + number]).tolist() for n in "DKRP"})
    return f"{text}binning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n---\n"


def ros_ini(eye, n):
    sections = {"camera matrix": "K", "distortion": "D", "rectification": "R", "projection": "P"}
    rows = {key: "\n".join(" ".join(map(repr, map(float, row))) for row in np.atleast_2d(ALL[name + n]))
            for key, name in sections.items()}  # fmt: skip
    head = f"# oST version 5.0 parameters\n\n[image]\n\nwidth\n{SIZE[0]}\n\nheight\n{SIZE[1]}\n\n"
    return f"{head}[narrow_stereo/{eye}]\n\n" + lines(rows, "{}\n{}\n\n")


def vector_of(turn):
    return cv2.Rodrigues(turn)[0].ravel().tolist()


def matlab(k, d):
    radial = [d[0], d[1], d[4]]
    return {"IntrinsicMatrix": k.T, "RadialDistortion": radial, "TangentialDistortion": d[2:4], "ImageSize": SIZE[::-1]}


def drivingstereo():
    values = {}
    for n, number, turn, shift in (("1", 101, np.eye(3), np.zeros(3)), ("2", 103, R, T)):
        raw = {"S": SIZE, "K": ALL["K" + n], "D": ALL["D" + n], "R": turn, "T": shift}
        rectified = {"S_rect": SIZE, "R_rect": ALL["R" + n], "P_rect": ALL["P" + n]}
        values |= {f"{key}_{number}": " ".join(map(str, np.ravel(each))) for key, each in (raw | rectified).items()}
    return lines(values)


def mrcal(k, d, turn, shift, pose="extrinsics"):
    values = {"lensmodel": "LENSMODEL_OPENCV5", "intrinsics": [*vector(k), *d.tolist()], "imagersize": [*SIZE]}
    return "# a model\n" + repr(values | {pose: [*vector_of(turn), *map(float, shift)], "blob": b"{[#"})


def kalibr(lens="radtan", coefficients=FOUR, *, imu="", chain=POSE):
    cameras = {}
    for number, (_, k, _, body) in enumerate(EYES):
        own = {imu: (np.linalg.inv(body) if imu == "T_cam_imu" else body).tolist()} if imu else {}
        cameras[f"cam{number}"] = own | {
            **({"T_cn_cnm1": chain.tolist()} if number and chain is not None else {}),
            "cam_overlaps": [1 - number],
            "camera_model": "pinhole",
            "distortion_coeffs": list(coefficients[number]),
            "distortion_model": lens,
            "intrinsics": vector(k),
            "resolution": list(SIZE),
            "rostopic": f"/cam{number}/image_raw",
        }
    return cameras


def camodocal(distortion, projection, kind="PINHOLE"):
    text = f"%YAML:1.0\n---\nmodel_type: {kind}\ncamera_name: c\n" + lines(IMAGE)
    for section, values in (("distortion", distortion), ("projection", projection)):
        text += f"{section}_parameters:\n" + lines(values, "   {}: {}\n")
    return text


def camodocal_rig(*cameras):
    poses = "".join(matrix(f"body_T_cam{number}", body) for number, body in enumerate(BODIES))
    return {"rig.yaml": "%YAML:1.0\n" + poses} | {f"cam{number}.yaml": text for number, text in enumerate(cameras)}


def euroc(k, d, body):
    return json.dumps({
        "sensor_type": "camera", "T_BS": {"cols": 4, "rows": 4, "data": body.ravel().tolist()}, "rate_hz": 20,
        "resolution": SIZE, "camera_model": "pinhole", "intrinsics": vector(k),
        "distortion_model": "radial-tangential", "distortion_coefficients": list(d[:4]),
    })  # fmt: skip


def quaternion(turn):
    axis = np.array(vector_of(turn))
    angle = np.linalg.norm(axis)
    return [*(axis / angle * np.sin(angle / 2)), np.cos(angle / 2)]


def basalt(kind="pinhole-radtan8", lens=FIVE):
    names = {"pinhole-radtan8": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), "kb4": ("k1", "k2", "k3", "k4")}
    cameras = []
    for k, own in zip((K1, K2), lens, strict=True):
        values = scalars(k, ()) | dict(zip(names.get(kind, ()), [*map(float, own), 0, 0, 0], strict=False))
        cameras.append({"camera_type": kind, "intrinsics": values})
    axes = "px", "py", "pz", "qx", "qy", "qz", "qw"
    numbers = ([*map(float, body[:3, 3]), *quaternion(body[:3, :3])] for body in BODIES)
    poses = [dict(zip(axes, each, strict=True)) for each in numbers]
    return {"value0": {"T_imu_cam": poses, "intrinsics": cameras, "resolution": [list(SIZE)] * 2}}


# Poses in cm between an OAK's sockets. Devices write an empty rotation for the last camera of a chain.
RIGHT_FROM_LEFT, COLOUR_FROM_LEFT = POSE.copy(), np.eye(4)
RIGHT_FROM_LEFT[:3, 3] *= 100
COLOUR_FROM_LEFT[:3, 3] = -3.7, 0.1, 0.2
LINKS = {
    "nowhere": {},
    "to the right": {1: (2, RIGHT_FROM_LEFT)},
    "to the left": {2: (1, np.linalg.inv(RIGHT_FROM_LEFT))},
    "to the third": {1: (0, COLOUR_FROM_LEFT), 2: (0, COLOUR_FROM_LEFT @ np.linalg.inv(RIGHT_FROM_LEFT))},
}


def depthai(links="to the right", kind=0, lens=FIVE):
    cameras = []
    for socket, (k, own) in enumerate(((K1, lens[0]), (K1, lens[0]), (K2, lens[1]))):
        target, pose = LINKS[links].get(socket, (-1, None))
        link = {"rotationMatrix": [] if pose is None else pose[:3, :3].tolist(), "toCameraSocket": target}
        link["translation"] = dict(zip("xyz", [0.0] * 3 if pose is None else pose[:3, 3].tolist(), strict=True))
        values = {"cameraType": kind, "width": SIZE[0], "height": SIZE[1], "intrinsicMatrix": k.tolist()}
        values["distortionCoeff"] = [*map(float, own), *[0.0] * (14 - len(own))]
        cameras.append([socket, values | {"extrinsics": link}])
    stereo = {"leftCameraSocket": 1, "rightCameraSocket": 2}
    return {"boardName": "OAK-D", "cameraData": cameras, "stereoRectificationData": stereo}


SHORT = scalars(K1, D1[:4]), scalars(K2, D2[:4])
KB = [
    dict(zip(("k2", "k3", "k4", "k5", "mu", "mv", "u0", "v0"), [*FISHEYE, *vector(k)], strict=True)) for k in (K1, K2)
]
PLAIN = {f"{eye}.yml": Storage({"K": k, "D": d} | IMAGE) for eye, k, d, _ in EYES}
WITH_FIVE = {
    "storage.yml": {"storage.yml": Storage(RAW | IMAGE)},
    "storage.xml": {"storage.xml": Storage(RAW | IMAGE)},
    "npz in mm": {"rig.npz": {"newMtxL": K1 * [[2], [2], [1]], "newMtxR": K2 * [[2], [2], [1]]}
                  | named("mtxL distL mtxR distR R T") | {
        "T": T[:, None] * 1000, "objpoints": np.array([{}], dtype=object), "F": R * 7, "imageSize": SIZE,
        "rectL": ALL["R1"], "rectR": ALL["R2"]}},
    "npy for each": {
        "K_left.npy": K1, "K_right.npy": K2, "dist_left.npy": D1, "dist_right.npy": D2, "R.npy": R, "T.npy": T,
        "size.json": {"image_size": SIZE}},
    "intrinsics and extrinsics": {
        "intrinsics.yml": Storage({"M1": K1, "D1": D1, "M2": K2, "D2": D2} | IMAGE),
        "extrinsics.yml": Storage({"R": R, "T": T} | projections())},
    "one file a camera": PLAIN | {"stereo.yml": Storage({"R": R, "T": T})},
    "a rig beside single cameras": (
        {name: Storage(values | {"K": values["K"] * [[2], [2], [1]]}) for name, values in PLAIN.items()}
        | {"stereo.yml": Storage(RAW | IMAGE)}),
    "listed cameras against the first": {"cameras": [
        {"K": K1, "dist": D1, "R": np.eye(3), "t": [0] * 3, "imageSize": SIZE},
        {"K": K2, "dist": D2, "R": R, "t": T, "imageSize": SIZE}]},
    "single numbers and a rotation vector": {
        "intrinsics": {"left": scalars(K1, D1), "right": scalars(K2, D2)}, "image_shape": [SIZE[1], SIZE[0], 3],
        "extrinsics": {"rotation": vector_of(R), "translation": T}},
    "matlab": {
        "CameraParameters1": matlab(K1, D1), "CameraParameters2": matlab(K2, D2),
        "RotationOfCamera2": R.T, "TranslationOfCamera2": T * 1000},
    "matlab's fields": {
        **{f"{name}{n}": value for n, k, d in ((1, K1, D1), (2, K2, D2)) for name, value in matlab(k, d).items()},
        "ImageSize": SIZE[::-1], "RotationOfCamera2": R.T, "TranslationOfCamera2": T * 1000},
    "bouguet": eyes(lambda eye, k, d: {f"fc_{eye}": [k[0, 0], k[1, 1]], f"cc_{eye}": k[:2, 2], f"kc_{eye}": d})
                | {"om": vector_of(R), "R": R, "T": T * 1000, "nx": SIZE[0], "ny": SIZE[1]},
    "orb slam": {"EuRoC.yaml": orb_slam()},
    "orb slam 3": {"EuRoC.yaml": orb_slam_3()},
    "stella": stella(),
    "ros": {"left.yaml": ros("1"), "right.yaml": ros("2")},
    "ros without eyes in the names": {"a.yaml": ros("1"), "b.yaml": ros("2")},
    "ros nested": {"rig.yaml": "".join(
        "\n  ".join([f"{eye}:", *ros(n).splitlines()]) + "\n" for eye, n in (("left", "1"), ("right", "2")))},
    "ros messages": {"rig.yaml": "".join(message(n, sec) for n in "12" for sec in range(3))},
    "ros ini": {"left.ini": ros_ini("left", "1"), "right.ini": ros_ini("right", "2")},
    "tabs and a board": {"rig.yaml": lines(
        {name: value.tolist() for name, value in named("left_K left_D right_K right_D stereo_R stereo_T").items()},
        "{}:\t{}\t\t# measured\n",
    ) + "img_shape:\t[480, 640]\nboard:\n  cols: 9\n  rows: 6\n  size: [9, 6]\n"},
    **{f"mrcal {name}": {
        "left.cameramodel": mrcal(K1, D1, np.eye(3), [0] * 3, name), "right.cameramodel": mrcal(K2, D2, R, T, name)}
       for name in ("extrinsics", "rt_cam_ref")},
    "drivingstereo": {"2018-10-10.txt": "calib_time: 10-Nov-2018 10:00:00\n" + drivingstereo()},
    "basalt": basalt(),
    **{f"depthai {link}": depthai(link) for link in [*LINKS][1:]},
}  # fmt: skip
WITH_FOUR = {
    "kalibr": {"chain.yaml": kalibr()},
    "kalibr with an IMU": {"chain.yaml": kalibr(chain=None, imu="T_cam_imu")},
    "kalibr with both": {"chain.yaml": kalibr(imu="T_cam_imu")},
    "openvins": {"chain.yaml": kalibr(chain=None, imu="T_imu_cam")},
    "camodocal": camodocal_rig(*(
        camodocal({n: each[n] for n in ("k1", "k2", "p1", "p2")}, {n: each[n] for n in ("fx", "fy", "cx", "cy")})
        for each in SHORT)),
    "euroc": {f"cam{n}/sensor.yaml": euroc(*each[1:]) for n, each in enumerate(EYES)},
    "kimera": {f"{eye}CameraParams.yaml": euroc(*each[1:]) for eye, each in zip(("Left", "Right"), EYES, strict=True)},
}  # fmt: skip
FISHEYES = {
    "basalt kb4": basalt("kb4", FISH),
    "depthai fisheye": depthai(kind=1, lens=FISH),
    "kalibr equidistant": kalibr("equidistant", FISH),
    "camodocal kb": camodocal_rig(*(camodocal({}, each, "KANNALA_BRANDT") for each in KB)),
    "orb slam 3 kb8": {"rig.yaml": orb_slam_3(FISH, "KannalaBrandt8", ("k1", "k2", "k3", "k4"))},
}  # fmt: skip
SHAPES = [
    pytest.param(files, lens, id=name)
    for lens, shapes in ((FIVE, WITH_FIVE), (FOUR, WITH_FOUR), (FISH, FISHEYES))
    for name, files in shapes.items()
]


@pytest.mark.parametrize(("files", "lens"), SHAPES)
def test_every_shape_gives_the_rig(tmp_path, files, lens):
    check(read(tmp_path, files), lens=lens)


LABELS = "left right|L R|1 2|0 1|cam0 cam1|cam_1 cam_2|LEFT RIGHT|left_camera right_camera|stereo_left stereo_right"
NAMES = {
    "K": "K|cameraMatrix|camera_matrix|mtx|M|intrinsic_matrix|camera_mat",
    "D": "D|dist|distCoeffs|distortion_coefficients|kc|distortion|coeffs",
    "R": "R|rotation|rot_mat|stereo_R|RotationMatrix|om",
    "T": "T|translation|Trns|tvec|t|stereo_T|translation_vector",
    "size": "imageSize|image_size|size|resolution|img_shape",
}
JOINS = {
    "last": lambda eye, name, value: {f"{name}_{eye}": value},
    "camel": lambda eye, name, value: {f"{name}{eye[0].upper()}{eye[1:]}": value},
    "section": lambda eye, name, value: {eye: {name: value}},
}


@settings(max_examples=100)
@given(
    labels=st.sampled_from(LABELS.split("|")).map(str.split),
    names=st.fixed_dictionaries({key: st.sampled_from(names.split("|")) for key, names in NAMES.items()}),
    join=st.sampled_from([*JOINS]),
    form=st.sampled_from(["matrices", "vectors", "numbers"]),
)
def test_eyes_and_arrays_are_told_by_any_of_their_names(tmp_path_factory, labels, names, join, form):
    assume(join == "section" or (form == "matrices" and labels[0] in {"left", "L", "1", "0", "stereo_left"}))
    assume(join != "section" or names["R"] != labels[1])  # the section and R would have the same name
    rig = {}
    for label, (_, k, d, _) in zip(labels, EYES, strict=True):
        matrices, vectors = {names["K"]: k, names["D"]: d}, {"intrinsics": vector(k), names["D"]: d}
        for name, value in {"matrices": matrices, "vectors": vectors, "numbers": scalars(k, d)}[form].items():
            for key, own in JOINS[join](label, name, value).items():
                rig[key] = rig[key] | own if isinstance(own, dict) and key in rig else own
    rig |= {names["R"]: vector_of(R) if names["R"] == "om" else R, names["T"]: T}
    rig[names["size"]] = SIZE[::-1] if "shape" in names["size"] else SIZE
    check(read(tmp_path_factory.mktemp("names"), {"rig.json": rig}))


@needs_shared
def test_calibrations_of_many_tools_give_one_rig():
    folder = SHARED / "calibrations"
    wanted = json.loads((folder / "expected.json").read_text())
    turn, shift, size = np.array(wanted["R"]), np.array(wanted["T_m"]), ImageSize(*wanted["size"])
    for names in (
        *("arrays_mm.npz", "nested.json", "storage.json", "storage.xml", "storage.yml", "words.json"),
        *("chain_anchors.yaml", "chain_imu.yaml", "zed.conf", "body_pose/*", "camodocal/*", "mrcal/*", "three/*"),
    ):
        of = wanted["zed_hd"] if names == "zed.conf" else wanted
        d = [np.array(wanted[("equidistant" if "imu" in names else "D") + n]) for n in "12"]
        rig = read_rig([folder / names], photographed=ImageSize(*of["size"]))
        k = np.array(of["K1"]), np.array(of["K2"])
        check(rig, lens=d, k=k, turn=turn, shift=shift, size=tuple(of["size"]), fisheye="imu" in names)
    for names in (("K.txt",), ("orb.yaml",), ("P_left.npy", "P_right.npy"), ("S_rect_101.txt",)):
        rig = read_rig([folder / name for name in names], photographed=size)
        camera, (left, right) = rig.camera, (wanted["P1"], wanted["P2"])
        assert rig.size == size
        got = camera.focal_px, camera.cx_left_px, camera.cy_px, camera.baseline_m
        np.testing.assert_allclose(got, (left[0][0], left[0][2], left[1][2], -right[0][3] / right[0][0]), rtol=1e-5)
    rig = read_rig([folder / "scalars.json"])
    assert (rig.camera.baseline_m, rig.camera.doffs_px) == (0.075, pytest.approx(2.2))
    rig = read_rig([folder / "cityscapes.json"], photographed=ImageSize(2048, 1024))
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
        "baseline_meters": camera.baseline_m, "width": camera.width_px, "height": camera.height_px,
    }),
    "q.json": lambda camera: json.dumps({"imageSize": [camera.width_px, camera.height_px], "Q": [
        [1, 0, 0, -camera.cx_left_px], [0, 1, 0, -camera.cy_px], [0, 0, 0, camera.focal_px],
        [0, 0, 1 / camera.baseline_m, (camera.cx_right_px - camera.cx_left_px) / camera.baseline_m]]}),
}  # fmt: skip
numbers = st.floats(1, 5000, allow_nan=False)


@settings(max_examples=30)
@given(
    size=st.tuples(st.integers(1, 9999), st.integers(1, 9999)),
    focal_px=st.floats(10, 9000),
    baseline_m=st.floats(0.001, 2.4),
    centre=st.tuples(numbers, numbers, numbers),
)
def test_a_rectified_rig_in_any_format_is_read_back(tmp_path_factory, size, focal_px, baseline_m, centre):
    assume(max(size) > 32)  # smaller sizes may be those of calibration boards
    folder = tmp_path_factory.mktemp("rig")
    camera = StereoCamera(*size, focal_px, baseline_m, *centre)
    for name, text in RECTIFIED.items():
        (folder / name).write_text(text(camera))
        rig = read_rig([folder / name])
        assert rig.size == size
        assert rig.source == str(folder / name)
        for key in ("focal_px", "baseline_m", "cx_left_px", "cx_right_px", "cy_px"):
            assert getattr(rig.camera, key) == pytest.approx(getattr(camera, key), rel=1e-9, abs=1e-9), name


def test_the_right_camera_alone_holds_the_baseline(tmp_path):
    left, right = write(tmp_path, WITH_FIVE["ros"])
    alone = read_rig([right])
    assert alone.camera.baseline_m == pytest.approx(np.linalg.norm(T))
    assert alone.raw is None
    with pytest.raises(ReadError, match="describes no pair"):
        read_rig([left])
    with pytest.raises(ReadError, match="describes no pair"):
        read(tmp_path / "left", {"P_left": ALL["P2"]} | IMAGE)
    a, b = write(tmp_path / "unnamed", WITH_FIVE["ros without eyes in the names"])
    with pytest.raises(InputError, match="swap left and right"):
        read_rig([b, a])


SHORT_KITTI = "".join(f"{line.replace('_rect_0', '')}\n" for line in KITTI.splitlines() if line.startswith("P_rect"))
KITTIS = StereoCamera(1242, 375, 721.5377, 0.5327, 609.5593, 609.5593, 172.854)
BARE = StereoCamera(640, 480, 700.0, 0.12, 320.0, 320.0, 240.0)


@pytest.mark.parametrize(
    ("text", "camera"),
    [
        (KITTI, KITTIS),
        (SHORT_KITTI + "Tr: 0 -1 0 -0.02 0 0 -1 -0.05 1 0 0 -0.29\n", KITTIS),
        ("700 0 320 0 700 240 0 0 1\n0.12\n", BARE),
        ("700 0 320\n0 700 240\n0 0 1\n\n0.12\n", BARE),
        ("Camera.type: Rectified\nCamera1.fx: 700\nCamera1.cx: 320\nCamera1.cy: 240\nStereo.b: 0.12\n", BARE),
    ],
)
def test_rectified_rigs_of_benchmarks(tmp_path, text, camera):
    rig = read(tmp_path, {"calib.txt": text}, size=ImageSize(camera.width_px, camera.height_px))
    assert rig.raw is None
    for key, value in camera.values().items():
        assert getattr(rig.camera, key) == pytest.approx(value, abs=1e-4), key


def realsense():
    values = {"baseline": "-50.2"}
    for number, width, height in ((0, 1280, 720), (1, 672, 376), (9, 0, 0)):
        own = {"fx": width / 2, "fy": width / 2, "ppx": width / 2, "ppy": height / 2, "width": width, "height": height}
        values |= {f"rectified.{number}.{key}": str(value) for key, value in own.items()}
    return values


def zed():
    modes, (x, y, z) = {"HD": 1.0, "VGA": 0.525}, vector_of(R)
    text = ""
    for mode, scale in modes.items():
        for eye, k, d, _ in EYES:
            values = {name: value * (scale if name[0] in "fc" else 1) for name, value in scalars(k, d).items()}
            text += f"[{eye.upper()}_CAM_{mode}]\n{lines(values, '{}={}' + chr(10))}\n"
    stereo = {"Baseline": -1000 * T[0], "TY": 1000 * T[1], "TZ": 1000 * T[2]}
    stereo |= {f"{name}_{mode}": value for mode in modes for name, value in (("RX", x), ("CV", y), ("RZ", z))}
    return f"{text}[STEREO]\n" + lines(stereo, "{}={}\n")


@pytest.mark.parametrize("files", [{"realsense.json": realsense()}, {"SN1.conf": zed()}])
def test_modes_are_chosen_by_the_size(tmp_path, files):
    for size, scale in ((ImageSize(1280, 720), 1.0), (ImageSize(672, 376), 0.525)):
        rig = read(tmp_path, files, photographed=size)
        if "SN1.conf" in files:
            check(rig, k=[np.diag([scale, scale, 1]) @ each for each in (K1, K2)], size=tuple(size))
        else:
            assert (rig.size, rig.camera.focal_px, rig.camera.baseline_m) == (size, size.width_px / 2, 0.0502)
    with pytest.raises(ReadError, match="1280 x 720, 672 x 376: give one of these, --size"):
        read(tmp_path, files)
    with pytest.raises(ReadError, match="not for 320 x 240"):
        read(tmp_path, files, size=ImageSize(320, 240))


def test_cameras_that_are_rectified_already_have_no_lens(tmp_path):
    values = projections()
    p1, p2 = (values[f"P{n}"] for n in "12")
    values |= {"R1": np.eye(3), "R2": np.eye(3), "K1": p1[:, :3], "K2": p2[:, :3], "D1": np.zeros(5), "D2": np.zeros(5)}
    assert read(tmp_path, values | IMAGE).raw is None
    # K of undistorted images beside K of the camera
    rig = read(tmp_path, eyes_of(K1, {"D": FIVE[0], "K_rect": K1 * [[0.9], [0.9], [1]]}) | IMAGE)
    np.testing.assert_array_equal(rig.raw["left"].matrix, K1)
    # R and T of both cameras are their poses, not R1 and R2.
    eyes = {
        eye: {"P": values[f"P{n}"], "K": k, "D": FIVE[0], "R": turn, "T": shift}
        for n, eye, k, turn, shift in ((1, "left", K1, np.eye(3), np.zeros(3)), (2, "right", K2, R, T))
    }
    assert read(tmp_path, eyes | IMAGE).raw is None


def eyes_of(k, d, **others):
    return {eye: {"K": k, **d} for eye in ("left", "right")} | {"R": np.eye(3), "T": [-0.12, 0, 0]} | others


@pytest.mark.parametrize(
    "values",
    [
        eyes_of(K1, {"D": FISH[0]}, fisheye=True),
        eyes_of(K1, {"D": FISH[0]}, fisheye_model=1),
        eyes_of(K1, {"D": FISH[0]}, distortion="fisheye"),
        eyes_of(K1, {"D": [*FISH[0], 0]}, model="distortion.kannala_brandt4"),
        eyes_of(K1, dict(zip(("k1", "k2", "k3", "k4"), FISH[0], strict=True))),
    ],
)
def test_a_fisheye_is_known_by_a_flag_a_model_or_its_numbers(tmp_path, values):
    raw = read(tmp_path, values | IMAGE).raw["left"]
    assert (raw.model, [*raw.distortion]) == ("fisheye", pytest.approx([*FISH[0]]))


@pytest.mark.parametrize(
    "values",
    [
        eyes_of(K1, {}, left={"K": K1, "D": FIVE[0]}),
        eyes_of(K1, {}, D=FIVE[0]),
        eyes_of(K1, {}, D_left=FIVE[0]),
        eyes_of(K1, {"radial_distortion": [-0.1, 0.01]}),
        eyes_of(K1, {}, k1_left=-0.1, k1_right=-0.1),
    ],
)
def test_coefficients_that_are_not_understood_are_refused(tmp_path, values):
    with pytest.raises(ReadError, match="expected coefficients of both lenses, got "):
        read(tmp_path, values | IMAGE)


def test_sizes_of_boards_and_exchanged_sides_are_not_those_of_images(tmp_path):
    for other in ({"checkerboard": {"rows": 6, "cols": 9}}, {"nx": 9, "ny": 6}, {"calibBoard": {"size": [9, 6]}}):
        assert read(tmp_path, eyes_of(K1, {"D": FIVE[0]}) | other, photographed=ImageSize(*SIZE)).size == SIZE
    assert read(tmp_path, eyes_of(K1, {"D": FIVE[0]}, image_size=SIZE[::-1])).size == SIZE
    assert read(tmp_path, eyes_of(K1, {"D": FIVE[0]}, onboard={"image_size": SIZE})).size == SIZE


def test_r_and_t_may_be_printed_with_six_digits_or_be_in_a_file_of_the_right_camera(tmp_path):
    printed = [[0.999998, -0.001234, 0.001567], [0.001236, 0.999998, -0.000789], [-0.001566, 0.000791, 0.999998]]
    assert read(tmp_path, eyes_of(K1, {"D": FIVE[0]}, R=printed, om=[0.00079, 0.001567, 0.001235]) | IMAGE).raw
    values = {"K1": K1, "D1": FIVE[0], "K2": K2, "D2": FIVE[1]}
    check(read(tmp_path, {"intrinsics.json": values | IMAGE, "extrinsics2.json": {"R": R, "T": T}}))


def test_no_value_of_a_text_or_xml_file_hides_another(tmp_path):
    for name, text, expected in (
        ("a.txt", "K\n1 2\n# rows\n3 4\n", {("K",): [1, 2, 3, 4]}),
        ("b.txt", "[left]\n1 2\n1 2 3\n", {("left", "numbers"): [1, 2], ("left", "numbers'"): [1, 2, 3]}),
        ("c.xml", "<a><b><_>1</_><_>2</_></b></a>", {("b",): [1, 2]}),
        ("d.xml", "<a><b>1 2</b><b>3</b><c>4</c></a>", {("b", "0"): [1, 2], ("b", "1"): [3], ("c",): [4]}),
    ):
        (path,) = write(tmp_path, {name: text})
        assert {key: value.tolist() for key, value in read_tree(path).items()} == expected


# --- options of the user, and values derived without them ---


def test_units_are_concluded_or_given(tmp_path):
    for unit, unit_m in {"mm": 0.001, "cm": 0.01, "m": 1.0}.items():
        rig = read(tmp_path, {"rig.yml": opencv(unit_m=unit_m)})
        assert rig.camera.baseline_m == pytest.approx(CAMERA.baseline_m)
        assert len(rig.notes) == (unit != "m")
        rig = read(tmp_path, {"rig.yml": opencv(unit_m=unit_m)}, unit="cm")
        assert rig.camera.baseline_m == pytest.approx(CAMERA.baseline_m / unit_m * 0.01)
        assert not rig.notes
        rig = read(tmp_path, IMAGE | {"fx": 500, "cx": 320, "cy": 240, f"baseline_{unit}": 3})
        assert (rig.camera.baseline_m, rig.notes) == (pytest.approx(3 * unit_m), ())
    # A translation of zero states no unit.
    values = {f"P{n}": projections()[f"P{n}"] * (1, 1, 1, 1000) for n in "12"} | {"R": np.eye(3), "T": np.zeros(3)}
    rig = read(tmp_path, values | IMAGE)
    assert rig.camera.baseline_m == pytest.approx(np.linalg.norm(T), rel=1e-4)
    with pytest.raises(InputError, match=r"unit: .*calib\.txt states the unit: do not give one"):
        read(tmp_path, {"calib.txt": MIDDLEBURY}, unit="mm")


def test_the_size_comes_from_the_file_the_user_or_the_photographs(tmp_path):
    files = {"stereo.yml": opencv(size=False)}
    with pytest.raises(InputError, match=r"size: missing in .*stereo.yml"):
        read(tmp_path, files)
    assert read(tmp_path, files, size=ImageSize(640, 480), photographed=ImageSize(700, 500)).size == (640, 480)
    assert read(tmp_path, files, photographed=ImageSize(700, 500)).size == (700, 500)
    assert read(tmp_path, {"calib.txt": MIDDLEBURY}, photographed=ImageSize(70, 50)).size == (741, 500)
    with pytest.raises(InputError, match="is for images of 741 x 500, not 640 x 480"):
        read(tmp_path, {"calib.txt": MIDDLEBURY}, size=ImageSize(640, 480))
    square = {"fx": 500, "cx": 255, "cy": 245, "baseline": 0.1, "image_shape": [490, 510, 3]}
    assert read(tmp_path, square).size == (510, 490)


def test_two_of_several_cameras_are_chosen(tmp_path):
    pose = np.eye(4)
    pose[0, 3] = -0.3
    chain = kalibr()
    chain["cam2"] = chain["cam1"] | {"T_cn_cnm1": pose.tolist(), "intrinsics": [500, 500, 320, 240]}
    (path,) = write(tmp_path, {"chain.yaml": chain})
    with pytest.raises(ReadError, match=r"3 cameras .*choose two with --pair"):
        read_rig([path])
    check(read_rig([path], cameras=("cam0", "cam1")), lens=FOUR)
    rig = read_rig([path], cameras=("cam1", "cam2"))
    assert rig.camera.baseline_m == pytest.approx(0.3)
    np.testing.assert_allclose(rig.raw["left"].matrix, K2)
    rig = read_rig([path], cameras=("cam0", "cam2"))
    assert rig.camera.baseline_m == pytest.approx(np.linalg.norm((pose @ POSE)[:3, 3]))
    with pytest.raises(InputError, match="swap left and right"):
        read_rig([path], cameras=("cam2", "cam0"))
    rig = read(tmp_path, depthai("to the third"), cameras=("1", "0"))  # the device names another pair
    assert rig.camera.baseline_m == pytest.approx(np.linalg.norm(COLOUR_FROM_LEFT[:3, 3]) / 100)
    with pytest.raises(ReadError, match="describes no pair of cameras"):
        read_rig([path], cameras=("cam0", "cam3"))
    with pytest.raises(InputError, match=r"cameras: expected two cameras by number or eye, .*got front,rear"):
        read_rig([path], cameras=("front", "rear"))


def test_the_translation_corrects_projections_of_a_different_baseline(tmp_path):
    rig = read(tmp_path, ALL | IMAGE | {"P2": ALL["P2"] * [1, 1, 1, 2]})
    check(rig)
    assert any(re.match("P gives a baseline of 0.24.*, and T gives 0.12", note) for note in rig.notes)


@pytest.mark.parametrize(
    ("line", "model"),
    [
        ("distortion_model: radtan", "radial-tangential"),
        ("distortion_model: fisheye", "fisheye"),
        ("distortion_model: unknown", None),
    ],
)
@pytest.mark.parametrize("d", [FISHEYE, np.append(FISHEYE, 0)])
def test_a_file_names_its_lens(tmp_path, line, model, d):
    wide = np.diag([0.3, 0.3, 1]) @ K1
    values = RAW | {"K1": wide, "D1": d, "K2": wide, "D2": d}
    files = {"rig.yaml": f"{line}\nrig: {json.dumps(values, default=np.ndarray.tolist)}"}
    if model is None:
        with pytest.raises(ReadError, match="a wide lens with 4 coefficients may be"):
            read(tmp_path, files, size=ImageSize(*SIZE))
    else:
        assert read(tmp_path, files, size=ImageSize(*SIZE), alpha=0).raw["left"].model == model


def test_an_npz_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("semisynth_gl.calibration.tree._LARGEST_NUMPY", 2000)
    np.savez_compressed(tmp_path / "rig.npz", K1=np.zeros(1000))
    with pytest.raises(ReadError, match="has arrays of 0 MiB"):
        read_rig([tmp_path / "rig.npz"])


def test_what_is_concluded_is_noted(tmp_path):
    camera = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]
    rig = read(tmp_path, {"K": camera, "D": D1, "baseline": 0.2} | IMAGE)
    assert rig.notes[0].startswith("D was ignored")
    assert (rig.camera.baseline_m, rig.raw) == (0.2, None)


def test_names_that_tell_nothing_are_given(tmp_path):
    names = dict(zip(RAW, ("alphay", "betay", "gammay", "deltay", "xy", "yy"), strict=True))
    others = {"left_K": np.eye(3), "right_K": np.eye(3), "image_size": [7, 7]}
    files = {"v": {name: RAW[key] for key, name in names.items()} | {"ours": [*SIZE]} | others}
    with pytest.raises(ReadError, match=r"no pair.*v\.alphay \(3 x 3\), v\.betay \(5\).*--calib-keys.*K1=left"):
        read(tmp_path, files)
    keys = {key: f"v.{name}" for key, name in names.items()} | {"size": "v.ours"}
    check(read(tmp_path, files, calib_keys=keys))
    stated = dict(list(keys.items())[:6])  # the size has a usual name
    values = {name: files["v"][name] for name in names.values()}
    check(read(tmp_path, {"v": values, "image_size": SIZE}, calib_keys=stated, cameras=("cam0", "cam1")))
    with pytest.raises(ReadError, match=r"no pair of cameras.*v\.alphay \(3 x 3\)"):
        read(tmp_path, files, calib_keys={"K1": keys["K1"]})
    with pytest.raises(InputError, match=r"K1: no value v\.omega; there are v\.alphay"):
        read(tmp_path, files, calib_keys=keys | {"K1": "v.omega"})
    with pytest.raises(InputError, match="K9: expected one of K1, D1"):
        read(tmp_path, files, calib_keys={"K9": "v.alphay"})


def test_files_of_whole_rigs_are_refused(tmp_path):
    for number in range(2):
        write(tmp_path, {f"scene{number}/calib.txt": MIDDLEBURY})
    with pytest.raises(InputError, match="describe a rig each: give the files of one"):
        read_rig([tmp_path / "*/calib.txt"])


@pytest.mark.parametrize(("alpha", "lens"), [(0.0, FIVE), (0.4, FIVE), (1.0, FIVE), (0.7, FISH)])
def test_alpha_rectifies_what_states_no_projections(tmp_path, alpha, lens):
    files = {"chain.yaml": kalibr("equidistant", FISH)} if lens is FISH else RAW | IMAGE
    check(read(tmp_path, files, alpha=alpha), alpha, lens)


def test_a_wide_fisheye_shows_100_degrees_unless_alpha_says_otherwise(tmp_path):
    k = np.array([[150.0, 0, 320], [0, 150, 240], [0, 0, 1]])
    eyes_of_k = {"K1": k, "D1": FISHEYE, "K2": k, "D2": FISHEYE}
    files = RAW | eyes_of_k | IMAGE | {"distortion_model": "fisheye"}
    camera = read(tmp_path, files).camera
    assert camera.focal_px == pytest.approx(320 / np.tan(np.radians(50)))
    assert (camera.cx_left_px, camera.cx_right_px, camera.cy_px) == (319.5, 319.5, 239.5)
    assert camera.baseline_m == pytest.approx(np.linalg.norm(T))
    assert read(tmp_path, files, alpha=1).camera.focal_px < 0.9 * camera.focal_px


# --- refusals ---


def m(old, new):
    assert old in MIDDLEBURY
    return MIDDLEBURY.replace(old, new)


SAME_POSES = basalt()
SAME_POSES["value0"]["T_imu_cam"] = SAME_POSES["value0"]["T_imu_cam"][:1] * 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (m("cam1=[994.978 0", "cam1=[990 0"), "not rectified"),
        (m("994.978 0 311.193", "994.978 3 311.193"), "not rectified"),
        (m("342.279; 0 994.978 254.877", "342.279; 0 994.978 254.977"), "not rectified"),
        (m("baseline=193.001", "baseline=wide"), "baseline: expected a number, got 'wide'"),
        (m("width=741", "width=-3"), "-3 x 500"),
        (m("width=741", f"width={'9' * 5000}"), "missing in .*rig.txt"),
        (m("baseline=193.001", "baseline=1e300"), r"baseline: expected a number, got '\[1\.e\+300\]'"),
        (KITTI.replace("2.199936e+00", "2.2e+01"), "not rectified"),
        (KITTI.replace("S_rect_03: 1.242", "S_rect_03: 1.250"), "the same size for both cameras"),
        (message("2") + message("1"), "swap"),
        (
            kalibr(coefficients=(D1, D2[:3])),
            "expected 4 or 5 or 8 or 12 coefficients .* got 3",
        ),
        (m("baseline=193.001", "baseline=0"), "the baseline is 0 m: expected one above 0"),
        (RAW | {"K2": K2 + np.eye(3, k=1), "imageSize": SIZE}, "a skew of 1"),
        ({"front_K": K1, "rear_K": K2, "R": R, "T": T} | IMAGE, "describes no pair"),
        (basalt("ds"), "its lens is ds"),
        (kalibr() | {"camera_model": "omni"}, "its lens is omni"),
        ("model_type: MEI\ngamma1: 700\n", "its lens is MEI"),
        (RAW | {"R": -R} | IMAGE, "describes no pair"),
        (kalibr(chain=BACK), "swap left and right"),
        (SAME_POSES, "cameras apart"),
        (depthai(lens=(np.full(14, 0.1),) * 2), "coefficients .* got 14"),
        (depthai() | {"stereoRectificationData": {}}, "leftCameraSocket: expected a number"),
        ("fx: 3\n", r"describes no pair.*fx \(1\)"),
        ("a: !!python/object:os.system b\n", "no numbers"),
        ("[" * 100_000, "nested too deeply"),
        ("\x00\x01", "is binary"),
    ],
)
def test_what_is_no_calibration_is_refused_with_what_is_wrong(tmp_path, text, words):
    with pytest.raises(SemisynthError, match=words) as error:
        read(tmp_path, {"rig.txt": text})
    assert str(tmp_path / "rig.txt") in str(error.value)


@pytest.mark.parametrize(
    "text",
    [
        "".join(f"key{number}: {{a: [1, 2], b: word}}\n" for number in range(30_000)),
        "".join(f"- {number}.5\n" for number in range(80_000)),
        "P2: " + "11 " * 200 + "x\nP_rect_02: " + "1." * 50_000 + "x\n",
        "cam0=" + " " * 200_000 + "x\n",
        "P2" + "\n" * 100_000 + "x\nP2:" + " " * 100_000 + "x\n",
        "%YAML:1.0\n" + "\n" * 100_000 + "x\n",
    ],
    ids=["mapping", "list", "numbers", "spaces", "lines", "opencv"],
)
@pytest.mark.parametrize("extension", ["yaml", "txt"])
def test_large_files_of_other_things_are_refused_soon(tmp_path, text, extension):
    start = time.monotonic()
    with pytest.raises(ReadError):
        read(tmp_path, {f"x.{extension}": text})
    assert time.monotonic() - start < 10


def test_aliases_and_pickles_are_not_expanded(tmp_path):
    bomb = "a0: &a0 [1, 2]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12))
    pickled = {"K": np.array([{"a": 1}], dtype=object)}
    for files, words in (({"rig.yaml": bomb}, "more than 200000 values"), ({"rig.npz": pickled}, "no numbers")):
        with pytest.raises(ReadError, match=words):
            read(tmp_path, files)


def test_files_that_are_not_there_are_refused(tmp_path):
    for source in ("no.txt", "*.txt", "."):
        with pytest.raises(InputError, match="no such file, nor a file with"):
            read_rig([tmp_path / source])


# --- rectified rigs whose lens cannot be used ---

FOUR_OF_FISHEYE = f"cols: 4\n   data: [{', '.join(map(str, FISHEYE))}"
TWO_MODELS = re.sub(r"cols: 5\n   dt: d\n   data: \[[^]]*", FOUR_OF_FISHEYE, ros("1", "equidistant"))


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (ALL | IMAGE | {"D1": np.arange(14.0)}, "got 14"),
        (ALL | IMAGE | {"distortion_model": "omni"}, "omni"),
        (ALL | IMAGE | {"distortion_model": "equidistant"}, "expected 4 coefficients of a fisheye"),
        ({"left.yaml": TWO_MODELS, "right.yaml": ros("2")}, "lenses of one model"),
    ],
)
def test_a_rectified_rig_does_without_a_lens_that_cannot_be_used(tmp_path, files, words):
    rig = read(tmp_path, files)
    assert rig.raw is None
    assert any(re.search(f"the lenses were ignored: .*{words}", note) for note in rig.notes)


# Texts that replace a number or a name.
DAMAGES = (b"nan", b".inf", b"-1", b"0", b"1e400", b'"x"', b"null", b"[]", b"true", b"-12", b"[[1],[2,3]]", b"~", b"")
DAMAGES += (b"1e300", b"9" * 5000, b"\xff")


@settings(max_examples=150)
@given(data=st.data())
def test_damaged_calibrations_are_read_or_refused(tmp_path_factory, data):
    files = data.draw(st.sampled_from([*WITH_FIVE.values(), *WITH_FOUR.values()]))
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
        read_rig(paths, photographed=ImageSize(*SIZE), cameras=cameras)
