"""Calibrations of cameras before rectification, and photographs as these take them, beside OpenCV's rectification."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from semisynth_gl.calibration import calibrate as calibrating
from semisynth_gl.calibration.calibrate import calibrate
from semisynth_gl.calibration.rig import Size
from semisynth_gl.calibration.rig_files import read_rigs
from semisynth_gl.calibration.style import untried_style
from semisynth_gl.cli.calibrate import calibrate as command
from semisynth_gl.config.load import parse_config
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.raw_camera import RawCamera, rotation_of, vector_of
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.lens.chain import LensChain
from semisynth_gl.pairs.pipeline import render_pair
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.borders import black_border
from semisynth_gl.textures.images import read_image
from semisynth_gl.textures.prepare import prepare_atlas
from semisynth_gl.textures.view_names import is_right

cv2 = pytest.importorskip("cv2", reason="OpenCV, the extra opencv, is not installed")

SIZE = (640, 480)
K1 = np.array([[520.0, 0, 322], [0, 522, 236], [0, 0, 1]])
K2 = np.array([[525.0, 0, 315], [0, 524, 243], [0, 0, 1]])
D1 = np.array([-0.28, 0.09, 0.0005, -0.0003, 0.01])
D2 = np.array([-0.29, 0.1, -0.0004, 0.0002, 0.0])
R = cv2.Rodrigues(np.array([0.01, -0.02, 0.006]))[0]
T = np.array([[-0.12], [0.001], [0.0005]])
RAW = {"K1": K1, "D1": D1, "K2": K2, "D2": D2, "R": R, "T": T}
FISHEYE = np.array([-0.03, 0.01, -0.005, 0.001])


def rectified(alpha=-1.0, unit_m=1.0):
    r1, r2, p1, p2, *_ = cv2.stereoRectify(
        K1, D1, K2, D2, SIZE, R, T / unit_m, flags=cv2.CALIB_ZERO_DISPARITY, alpha=alpha
    )
    return {"R1": r1, "R2": r2, "P1": p1, "P2": p2}


def stored(path, values, *, size=True):
    """Write values by OpenCV's own writer."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    if size:
        storage.write("image_width", SIZE[0])
        storage.write("image_height", SIZE[1])
    storage.release()
    return path


def renamed(values, **names):
    return {names.get(name, name): value for name, value in values.items()}


def check(rig, alpha=-1.0):
    """A rig is the one that the matrices of this module describe."""
    wanted = rectified(alpha)
    camera = rig.camera
    np.testing.assert_allclose(camera.focal_px, wanted["P1"][0, 0], rtol=1e-6)
    np.testing.assert_allclose(camera.baseline_m, -wanted["P2"][0, 3] / wanted["P2"][0, 0], rtol=1e-6)
    for eye, matrix, distortion, turn in (("left", K1, D1, "R1"), ("right", K2, D2, "R2")):
        raw = rig.raw[eye]
        np.testing.assert_allclose(raw.matrix, matrix, rtol=1e-6)
        np.testing.assert_allclose(raw.distortion, distortion, atol=1e-9)
        np.testing.assert_allclose(raw.rotation, wanted[turn], atol=1e-6)
        assert (raw.width_px, raw.height_px, raw.model) == (*SIZE, "radial-tangential")


def pose_values(pose):
    """A pose as Basalt writes it."""
    vector = np.array(vector_of(pose[:3, :3]))
    angle = np.linalg.norm(vector)
    quaternion = [*(vector / angle * np.sin(angle / 2)), np.cos(angle / 2)]
    return dict(zip(("px", "py", "pz", "qx", "qy", "qz", "qw"), map(float, [*pose[:3, 3], *quaternion]), strict=True))


def pose(turn, shift):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, np.ravel(shift)
    return matrix


def basalt(kind="pinhole-radtan8", coefficients=None):
    """The cameras of this module as Basalt writes them, on an IMU that looks elsewhere."""
    imu_from_left = pose(cv2.Rodrigues(np.array([0.3, -1.2, 0.4]))[0], [0.02, -0.07, 0.01])
    imu_from_right = imu_from_left @ np.linalg.inv(pose(R, T))
    names = {"pinhole-radtan8": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), "kb4": ("k1", "k2", "k3", "k4")}
    cameras = []
    for k, own in ((K1, D1), (K2, D2)):
        d = [*map(float, own if coefficients is None else coefficients), 0, 0, 0]
        values = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
        cameras.append({"camera_type": kind, "intrinsics": values | dict(zip(names.get(kind, ()), d, strict=False))})
    poses = [pose_values(each) for each in (imu_from_left, imu_from_right)]
    return {"value0": {"T_imu_cam": poses, "intrinsics": cameras, "resolution": [list(SIZE)] * 2}}


# Devices write an empty rotation for the last camera of a chain, others zeros.
NOWHERE = -1, None
RIGHT_FROM_LEFT_CM = pose(R, 100 * T)
COLOUR_FROM_LEFT_CM = pose(cv2.Rodrigues(np.array([0.02, 0.01, -0.01]))[0], [-3.7, 0.1, 0.2])
LINKS = {
    "nowhere": {},
    "to the right": {1: (2, RIGHT_FROM_LEFT_CM)},
    "to the left": {2: (1, np.linalg.inv(RIGHT_FROM_LEFT_CM))},
    "to the third": {1: (0, COLOUR_FROM_LEFT_CM), 2: (0, COLOUR_FROM_LEFT_CM @ np.linalg.inv(RIGHT_FROM_LEFT_CM))},
}


def depthai(links="to the right", kind=0, coefficients=None):
    """The cameras of this module as DepthAI writes them, in cm."""

    def camera(socket, k, own):
        target, matrix = LINKS[links].get(socket, NOWHERE)
        d = [*map(float, own if coefficients is None else coefficients)]
        place = dict(zip("xyz", [0.0] * 3 if matrix is None else matrix[:3, 3].tolist(), strict=True))
        turn = [] if matrix is None else matrix[:3, :3].tolist()
        return {
            "cameraType": kind,
            "width": SIZE[0],
            "height": SIZE[1],
            "intrinsicMatrix": k.tolist(),
            "distortionCoeff": d + [0.0] * (14 - len(d)),
            "extrinsics": {"rotationMatrix": turn, "toCameraSocket": target, "translation": place},
        }

    cameras = [[0, camera(0, K1, D1)], [1, camera(1, K1, D1)], [2, camera(2, K2, D2)]]
    stereo = {"leftCameraSocket": 1, "rightCameraSocket": 2}
    return {"boardName": "OAK-D", "cameraData": cameras, "stereoRectificationData": stereo}


def json_file(folder, values):
    path = folder / "calibration.json"
    path.write_text(json.dumps(values, indent=2))
    return str(path)


@pytest.mark.parametrize("values", [basalt(), *map(depthai, [*LINKS][1:])], ids=["Basalt", *[*LINKS][1:]])
def test_json_is_read(tmp_path, values):
    (rig,) = read_rigs([json_file(tmp_path, values)])
    wanted = rectified()
    np.testing.assert_allclose(rig.camera.focal_px, wanted["P1"][0, 0], rtol=1e-6)
    np.testing.assert_allclose(rig.camera.baseline_m, -wanted["P2"][0, 3] / wanted["P2"][0, 0], rtol=1e-6)
    for eye, matrix, distortion, turn in (("left", K1, D1, "R1"), ("right", K2, D2, "R2")):
        raw = rig.raw[eye]
        np.testing.assert_allclose(raw.matrix, matrix)
        found = [*raw.distortion, *[0] * 14]
        np.testing.assert_allclose(found[: len(D1)], distortion, atol=1e-9)
        assert not any(found[len(D1) :])
        np.testing.assert_allclose(raw.rotation, wanted[turn], atol=1e-6)


@pytest.mark.parametrize("values", [basalt("kb4", FISHEYE), depthai(kind=1, coefficients=FISHEYE)])
def test_json_of_fisheyes_is_read(tmp_path, values):
    (rig,) = read_rigs([json_file(tmp_path, values)])
    assert {rig.raw[eye].model for eye in ("left", "right")} == {"fisheye"}
    np.testing.assert_allclose(rig.raw["left"].distortion, FISHEYE)
    assert rig.camera.baseline_m == pytest.approx(np.linalg.norm(T), rel=1e-4)


def changed(values, *path, to=None):
    """Values with another one, or without it."""
    copy = json.loads(json.dumps(values))
    node = copy
    for key in path[:-1]:
        node = node[key]
    if to is None:
        del node[path[-1]]
    else:
        node[path[-1]] = to
    return copy


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (basalt("ds"), r"intrinsics\[0\]\.camera_type: expected pinhole, pinhole-radtan8, kb4, got .?ds"),
        (changed(basalt(), "value0", "intrinsics", 1), "value0.intrinsics: expected a list of at least two"),
        (changed(basalt(), "value0", "intrinsics", 0, "intrinsics", "k3"), r"\[0\].intrinsics: expected k3 as well"),
        (changed(basalt(), "value0", "T_imu_cam", 1, "qw"), r"T_imu_cam\[1\]: expected 7 finite numbers"),
        (changed(basalt(), "value0", "T_imu_cam", 1, to=[0] * 7), r"T_imu_cam\[1\]: expected a quaternion, got zeros"),
        (changed(basalt(), "value0", "resolution"), "value0.resolution: expected a list of at least two"),
        (changed(basalt(), "value0", "resolution", 1, to=[2, 2]), "expected images of one size of both cameras"),
        (changed(basalt(), "value0", "resolution", to=[640, 480]), "expected a width and a height, got 640"),
        (changed(basalt(), "value0", "resolution", to=[[640], [480]]), "expected a width and a height"),
        (changed(basalt(), "value0", "resolution", to=[{"w": 1}, {}]), "expected a width and a height"),
        (
            changed(basalt(), "value0", "intrinsics", 0, "intrinsics", "fx", to="x"),
            r"intrinsics: expected 4 finite numbers",
        ),
        (changed(depthai(), "cameraData", 1, 1, "extrinsics", "toCameraSocket", to=[2]), "extrinsics that lead from"),
        (
            changed(depthai(), "cameraData", 1, 1, "extrinsics", "rotationMatrix", to=[1]),
            "rotationMatrix: expected a 3 x 3",
        ),
        (changed(depthai(), "cameraData", 1, 1, "distortionCoeff", to=[[1] * 4] * 14), "a tilted sensor's"),
        (depthai("nowhere"), "extrinsics that lead from socket 1 to socket 2"),
        (changed(basalt(), "value0", "T_imu_cam", 1, to=basalt()["value0"]["T_imu_cam"][0]), "a translation of 0"),
        (depthai(kind=2), "socket 1: cameraType: expected 0"),
        (depthai(coefficients=[0.1] * 14), "got 14: the last two, a tilted sensor's, must be 0"),
        (changed(depthai(), "cameraData", 2), r"the sockets \[1, 2\] of stereoRectificationData, got \[0, 1\]"),
        (changed(depthai(), "stereoRectificationData"), "stereoRectificationData: missing: it names the sockets"),
        (changed(depthai(), "cameraData", 2, 1, "distortionCoeff"), "socket 2: distortionCoeff: missing"),
        (changed(depthai(), "cameraData", to=3), r"of stereoRectificationData, got \[\]"),
        (changed(depthai(), "stereoRectificationData", "leftCameraSocket", to=[1]), "expected the sockets"),
        (
            changed(depthai(), "cameraData", 1, 1, "extrinsics"),
            "extrinsics that lead from socket 1 to socket 2",
        ),
        (changed(depthai(), "cameraData", 1, 1, "intrinsicMatrix"), "socket 1: intrinsicMatrix: missing"),
    ],
)
def test_json_that_breaks_its_format_is_refused(tmp_path, values, words):
    with pytest.raises(ReadError, match=words):
        read_rigs([json_file(tmp_path, values)])


@pytest.mark.parametrize("extension", ["yml", "yaml"])
@pytest.mark.parametrize(
    "values",
    [
        RAW,
        RAW | rectified(),
        renamed(RAW, K1="M1", K2="M2") | rectified(),
        renamed(RAW, K1="cameraMatrix1", K2="cameraMatrix2", D1="distCoeffs1", D2="distCoeffs2"),
        renamed(RAW, K1="camera_matrix_1", K2="camera_matrix_2", D1="dist_coeffs_1", D2="dist_coeffs_2") | rectified(),
        {name: value for name, value in (RAW | rectified()).items() if name not in "RT"},
        RAW | {"D1": D1[None], "D2": D2[:, None], "T": T.ravel()},
        RAW | {"D1": np.r_[D1, [0.0] * 9]} | {"D2": np.r_[D2, [0.0] * 9]},
    ],
    ids=["raw", "all", "samples", "python", "older", "rectified", "rows-and-columns", "fourteen"],
)
def test_opencvs_files_give_the_raw_cameras(tmp_path, values, extension):
    (rig,) = read_rigs([stored(tmp_path / f"stereo.{extension}", values)])
    if len(np.ravel(values[next(name for name in values if "1" in name and "D" in name.upper()[:4])])) == 14:
        assert len(rig.raw["left"].distortion) == 12
        return
    check(rig)


def test_intrinsics_and_extrinsics_in_two_files_are_one_rig(tmp_path):
    """As OpenCV's sample of stereo calibration writes them, without a size."""
    inner = stored(tmp_path / "intrinsics.yml", {"M1": K1, "D1": D1, "M2": K2, "D2": D2}, size=False)
    outer = stored(tmp_path / "extrinsics.yml", {"R": R, "T": T} | rectified(alpha=0), size=False)
    for order in ([inner, outer], [outer, inner]):
        (rig,) = read_rigs(order, size=Size(*SIZE))
        check(rig, alpha=0)
    (alone,) = read_rigs([outer], size=Size(*SIZE))
    assert alone.raw is None
    with pytest.raises(ReadError, match="not how they stand"):
        read_rigs([inner], size=Size(*SIZE))


def test_the_unit_counts_for_the_baseline_alone(tmp_path):
    path = stored(tmp_path / "mm.yml", RAW | {"T": T * 1000})
    with pytest.raises(ReadError, match="not in metres"):
        read_rigs([path])
    (rig,) = read_rigs([path], unit_m=1e-3)
    check(rig)


def opencv_text(**changes):
    return "".join(f"{name}: {np.array(value).tolist()}\n" for name, value in (RAW | changes).items())


def orb_slam(values):
    lines = ["%YAML:1.0", f"LEFT.width: {SIZE[0]}", f"LEFT.height: {SIZE[1]}"]
    names = {"LEFT": ("K1", "D1", "R1", "P1"), "RIGHT": ("K2", "D2", "R2", "P2")}
    for side, each in names.items():
        for short, name in zip("KDRP", each, strict=True):
            matrix = np.atleast_2d(values[name])
            data = ", ".join(map(repr, map(float, matrix.ravel())))
            lines += [f"{side}.{short}: !!opencv-matrix", f"   rows: {len(matrix)}", f"   cols: {matrix.shape[1]}"]
            lines += ["   dt: d", f"   data: [{data}]"]
    return "\n".join(lines)


def ros(values, model="plumb_bob"):
    files = []
    for number in "12":
        lines = [f"image_width: {SIZE[0]}", f"image_height: {SIZE[1]}", f"distortion_model: {model}"]
        keys = {"camera_matrix": "K", "distortion_coefficients": "D", "rectification_matrix": "R"}
        for key, name in (keys | {"projection_matrix": "P"}).items():
            matrix = np.atleast_2d(values[f"{name}{number}"])
            lines += [f"{key}:", f"  rows: {len(matrix)}", f"  cols: {matrix.shape[1]}"]
            lines += [f"  data: {matrix.ravel().tolist()}"]
        files.append("\n".join(lines) + "\n")
    return files


def echoed(values):
    """Both cameras' messages as `ros2 topic echo` prints them."""
    text = ""
    for number in "12":
        text += f"header:\n  frame_id: c{number}\nheight: {SIZE[1]}\nwidth: {SIZE[0]}\ndistortion_model: plumb_bob\n"
        text += "".join(f"{name.lower()}: {values[name + number].ravel().tolist()}\n" for name in "DKRP") + "---\n"
    return text


def kalibr(model="radtan", distortions=(D1[:4], D2[:4])):
    text = ""
    for number, (matrix, distortion) in enumerate(zip((K1, K2), distortions, strict=True)):
        (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
        text += f"cam{number}:\n  camera_model: pinhole\n  distortion_coeffs: {distortion.tolist()}\n"
        text += f"  distortion_model: {model}\n  intrinsics: {[fx, fy, cx, cy]}\n  resolution: {list(SIZE)}\n"
        text += f"  rostopic: /cam{number}/image_raw\n"
    placed = np.vstack([np.hstack([R, T]), [0, 0, 0, 1]])
    return text + f"  T_cn_cnm1: {placed.tolist()}\n"


def test_orb_slams_and_ross_files_give_the_raw_cameras(tmp_path):
    values = RAW | rectified()
    (tmp_path / "euroc.yaml").write_text(orb_slam(values))
    check(read_rigs([tmp_path / "euroc.yaml"])[0])
    for name, text in zip(("left.yaml", "right.yaml"), ros(values), strict=True):
        (tmp_path / name).write_text(text)
    check(read_rigs([tmp_path / "left.yaml", tmp_path / "right.yaml"])[0])
    assert read_rigs([tmp_path / "right.yaml"])[0].raw is None
    (tmp_path / "echo.yaml").write_text(echoed(values))
    check(read_rigs([tmp_path / "echo.yaml"])[0])


def test_a_translation_may_be_a_row_and_a_lens_may_bend_nothing(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(opencv_text(T=T.T.tolist(), D1=[], D2=[]))
    (rig,) = read_rigs([path], size=Size(*SIZE))
    assert rig.raw["left"].distortion == (0.0,) * 5
    assert rig.camera.baseline_m == pytest.approx(0.12, abs=1e-3)


def test_a_camchain_of_kalibr_is_rectified_as_opencv_does(tmp_path):
    path = tmp_path / "camchain.yaml"
    path.write_text(kalibr())
    (rig,) = read_rigs([path])
    r1, _, p1, *_ = cv2.stereoRectify(K1, D1[:4], K2, D2[:4], SIZE, R, T, flags=cv2.CALIB_ZERO_DISPARITY)
    np.testing.assert_allclose(rig.camera.focal_px, p1[0, 0], rtol=1e-9)
    np.testing.assert_allclose(rig.raw["left"].rotation, r1, atol=1e-12)
    path.write_text(kalibr("equidistant", (FISHEYE, FISHEYE)))
    (rig,) = read_rigs([path])
    r1, r2, p1, *_ = cv2.fisheye.stereoRectify(K1, FISHEYE, K2, FISHEYE, SIZE, R, T, flags=cv2.CALIB_ZERO_DISPARITY)
    np.testing.assert_allclose(rig.camera.focal_px, p1[0, 0], rtol=1e-9)
    np.testing.assert_allclose(rig.raw["right"].rotation, r2, atol=1e-12)
    assert rig.raw["right"].model == "fisheye"


@pytest.mark.parametrize("alpha", [0.0, 0.4, 1.0])
def test_alpha_rectifies_what_states_no_projections(tmp_path, alpha):
    (rig,) = read_rigs([stored(tmp_path / "rig.yml", RAW)], alpha=alpha)
    check(rig, alpha)
    assert rig.source.endswith(f"rig.yml, rectified by stereoRectify with alpha {alpha:g}")
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
    (tmp_path / "camchain.yaml").write_text(kalibr("equidistant", (FISHEYE, FISHEYE)))
    (rig,) = read_rigs([tmp_path / "camchain.yaml"], alpha=0.7)
    of_k = K1, FISHEYE, K2, FISHEYE, SIZE, R, T
    _, _, p1, *_ = cv2.fisheye.stereoRectify(*of_k, flags=cv2.CALIB_ZERO_DISPARITY, balance=0.7)
    np.testing.assert_allclose(rig.camera.focal_px, p1[0, 0], rtol=1e-9)


@pytest.mark.parametrize("lens", ["equidistant", "radtan"])
@pytest.mark.parametrize("fov_deg", [30, 90, 140])
def test_a_field_of_view_is_that_of_the_rectified_images(tmp_path, lens, fov_deg):
    (tmp_path / "camchain.yaml").write_text(kalibr(lens, (FISHEYE, FISHEYE)))
    (rig,) = read_rigs([tmp_path / "camchain.yaml"], fov_deg=fov_deg)
    camera = rig.camera
    left, right = (np.degrees(np.arctan((x - camera.cx_left_px) / camera.focal_px)) for x in (-0.5, SIZE[0] - 0.5))
    assert (-left, right) == (pytest.approx(fov_deg / 2), pytest.approx(fov_deg / 2))
    assert (camera.cx_right_px, camera.cy_px) == (camera.cx_left_px, (SIZE[1] - 1) / 2)
    assert camera.baseline_m == pytest.approx(np.linalg.norm(T))


@pytest.mark.parametrize("focal_px", [520, 150, 100])
def test_the_middle_of_a_wide_fisheye_stays_sharp(tmp_path, focal_px):
    """As OpenCV's default does not keep it."""
    text = kalibr("equidistant", (FISHEYE, FISHEYE)).replace("520.0, 522.0", f"{focal_px}, {focal_px}")
    (tmp_path / "camchain.yaml").write_text(text.replace("525.0, 524.0", f"{focal_px}, {focal_px}"))
    (rig,), (whole,) = (read_rigs([tmp_path / "camchain.yaml"], alpha=alpha) for alpha in (None, 0))
    assert (rig.view_deg < 99) == (focal_px == 520)
    assert rig.view_deg == pytest.approx(min(whole.view_deg, 100))


def test_a_narrowed_fisheye_is_noted_with_what_is_lost(place):
    wide = np.array([[160.0, 0, 322], [0, 160, 236], [0, 0, 1]])
    values = {"K1": wide, "K2": wide, "D1": FISHEYE, "D2": FISHEYE, "R": np.eye(3), "T": T}
    path = stored(place / "wide.yml", values)
    path.write_text(path.read_text() + "distortion_model: fisheye\n")
    told = calibrate(place / "photos", calib=path, range_px=(2, 40), trials=0).notes
    lost = [re.search(r"100 degrees across.*: (\d+)% of the fisheye's image is lost", note) for note in told]
    (found,) = filter(None, lost)
    (rig,) = read_rigs([path])
    x, y = np.meshgrid(np.arange(0.0, SIZE[0], 5), np.arange(0.0, SIZE[1], 5))
    chain = LensChain(rig.raw["left"], rig.camera, "left", "black")
    column, row = rig.raw["left"].rectified(chain.pinhole, x, y)
    seen = (column >= 0) & (column < SIZE[0]) & (row >= 0) & (row < SIZE[1])
    assert int(found[1]) == pytest.approx(100 * (1 - seen.mean()), abs=2)
    told = calibrate(place / "photos", calib=path, range_px=(2, 40), trials=0, fov_deg=100).notes
    assert not any("is lost" in note for note in told)


@pytest.mark.parametrize("lens", ["equidistant", "radtan"])
def test_cameras_above_each_other_and_turned_sizes_are_named(tmp_path, lens):
    path = tmp_path / "camchain.yaml"
    text = kalibr(lens, (FISHEYE, FISHEYE))
    path.write_text(text.replace("resolution: [640, 480]", "resolution: [480, 640]"))
    with pytest.raises(ReadError, match="near that of 640 x 480: the size is probably written as height, width"):
        read_rigs([path])
    below = pose(R, R @ [-0.001, -0.12, 0]).tolist()
    path.write_text(re.sub(r"T_cn_cnm1: .*", f"T_cn_cnm1: {below}", text))
    with pytest.raises(ReadError, match=r"vertical rig: the right camera stands 0\.12 m below the left one"):
        read_rigs([path])


def test_alpha_is_refused_where_it_decides_nothing(tmp_path):
    with pytest.raises(InputError, match=r"alpha: .*rig\.yml states how its images are rectified"):
        read_rigs([stored(tmp_path / "rig.yml", RAW | rectified())], alpha=0.5)
    left, right = ros(RAW | rectified())
    (tmp_path / "left.yaml").write_text(left)
    (tmp_path / "right.yaml").write_text(right)
    with pytest.raises(InputError, match=r"alpha: .*states how"):
        read_rigs([tmp_path / "left.yaml", tmp_path / "right.yaml"], alpha=1.0)
    others = {"range_px": (2, 40), "trials": 0}
    with pytest.raises(InputError, match="alpha: is for the lenses of a calibration"):
        calibrate("photos", focal_px=500, baseline_m=0.1, size=SIZE, alpha=1, **others)
    with pytest.raises(InputError, match=r"alpha: must be from 0 to 1, got 1\.5"):
        calibrate("photos", calib="rig.yml", alpha=1.5, **others)


def test_cameras_that_are_rectified_already_have_no_lens(tmp_path):
    values = rectified()
    for number in "12":
        values |= {f"R{number}": np.eye(3), f"D{number}": np.zeros(5), f"K{number}": values[f"P{number}"][:, :3]}
    left, right = ros(values)
    (tmp_path / "left.yaml").write_text(left)
    (tmp_path / "right.yaml").write_text(right)
    assert read_rigs([tmp_path / "left.yaml", tmp_path / "right.yaml"])[0].raw is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (kalibr("omni"), ["cam0.lens model 'omni'", "radtan"]),
        (kalibr().replace("camera_model: pinhole", "camera_model: ds", 1), ["cam0.camera_model", "pinhole", "'ds'"]),
        (kalibr().replace("resolution: [640, 480]", "resolution: [640, 200]", 1), ["one size", "640 x 200"]),
        (kalibr().replace("T_cn_cnm1", "T_cam_imu"), ["cam1.T_cn_cnm1: missing"]),
        (kalibr().replace("  intrinsics:", "  inner:", 1), ["cam0.intrinsics: missing"]),
        (kalibr(distortions=(D1, D2[:3])), ["cam1.distortion_coeffs", "4 or 5 or 8 or 12", "got 3"]),
        (kalibr("equidistant", (D1, D2)), ["cam0.distortion_coeffs", "expected 4 coefficients", "got 5"]),
        ("K1: [1]\nD1: [0, 0, 0, 0]\nK2: [1]\nD2: [0]\nR: [1]\nT: [1]\n", ["K1: expected a 3 x 3 matrix"]),
        ("R: [1]\nT: [1]\n", ["lacks the cameras", "K1, D1, K2 and D2"]),
        (opencv_text(D1=D1[:4]), ["D1: 4 coefficients", "distortion_model: radial-tangential"]),
        (opencv_text(T=[1, 2]), ["T: expected 3 numbers, got 2"]),
    ],
)
def test_what_is_no_lens_of_opencvs_is_refused_with_its_numbers(tmp_path, text, words):
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(ReadError) as error:
        read_rigs([path], size=Size(*SIZE))
    for word in (str(path), *words):
        assert word in str(error.value)


ALL = RAW | rectified()


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ([orb_slam(ALL | {"R2": 2 * np.eye(3)})], ["RIGHT.R: expected a rotation"]),
        ([orb_slam(ALL | {"K2": K2 + np.eye(3, k=1)})], ["RIGHT.K: expected [fx 0 cx"]),
        ([orb_slam(ALL | {"D1": np.arange(14.0)})], ["LEFT.D", "got 14", "tilted"]),
        ([orb_slam(ALL | {"D1": D1[:4], "D2": D2[:4]})], ["LEFT.D: 4 coefficients", "fisheye"]),
        (ros(ALL | {"R1": np.zeros((3, 3))}), ["rectification_matrix: expected a rotation"]),
        (ros(ALL, model="none"), ["lens model 'none'"]),
        (
            [ros(ALL | {"D1": FISHEYE}, model="equidistant")[0], ros(ALL | {"D2": D2[:4]})[1]],
            ["lenses of one model", "fisheye"],
        ),
    ],
)
def test_a_rectified_rig_does_without_a_lens_that_cannot_be_used(place, files, words):
    paths = []
    for number, text in enumerate(files):
        paths.append(place / f"{number}.yaml")
        paths[-1].write_text(text)
    (rig,) = read_rigs(paths)
    assert rig.raw is None
    calibration = calibrate(place / "photos", calib=paths, range_px=(2, 40), trials=0)
    assert calibration.config.lens is None
    with pytest.raises(InputError, match="its cameras before rectification") as error:
        made(place, calib=paths)
    for word in words:
        assert word in str(rig.lens_fault)
        assert any(word in note for note in calibration.notes)
        assert word in str(error.value)


@given(st.tuples(*[st.floats(-1.7, 1.7)] * 3))
def test_a_rotation_vector_comes_back(vector):
    np.testing.assert_allclose(vector_of(rotation_of(vector)), vector, atol=1e-9)


def test_a_reduced_rig_sees_the_same_directions():
    raw = RawCamera(320, 240, 260.0, 261.0, 161.0, 118.0, "radial-tangential", tuple(D1), rotation_of((0.01, 0.02, 0)))
    half, pinhole = raw.scaled(0.5), np.array([[250.0, 0, 160], [0, 250, 120], [0, 0, 1]])
    x, y = np.meshgrid(np.arange(0.0, 160), np.arange(0.0, 120))
    seen, whole = half.rectified(pinhole, x, y), raw.rectified(pinhole, (x + 0.5) * 2 - 0.5, (y + 0.5) * 2 - 0.5)
    np.testing.assert_allclose(seen, whole, atol=1e-9)
    assert (half.width_px, half.height_px) == (160, 120)


@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("a/left/0001.png", False),
        ("a/right/0001.png", True),
        ("mav0/cam1/data/14.png", True),
        ("mav0/cam0/data/14.png", False),
        ("right/left_3.png", False),
        ("scene_R.png", True),
        ("bright/moor.png", False),
        ("R0010123.JPG", False),
        ("image_3/000017_10.png", True),
        ("image_2/000017_10.png", False),
        ("Adirondack/im1.png", True),
        ("Adirondack/im0.png", False),
        ("cam1_0001.png", True),
    ],
)
def test_names_tell_right_views(name, right):
    assert is_right(Path(name)) == right


# --- photographs ---


@pytest.fixture
def place(tmp_path):
    """Twelve raw photographs of noise, none of it black, and a calibration whose rectified images keep all of them."""
    rng = np.random.default_rng(0)
    folder = tmp_path / "photos"
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        for number in range(6):
            noise = rng.integers(0, 256, (*SIZE[::-1], 3), dtype=np.uint8)
            image = np.clip(cv2.GaussianBlur(noise, (0, 0), 1.0).astype(int) * 3 - 250, 60, 255).astype(np.uint8)
            Image.fromarray(image).save(folder / side / f"{number:02}.png")
    stored(tmp_path / "stereo.yml", RAW | rectified(alpha=1))
    return tmp_path


def made(place, **arguments):
    settings = {"calib": place / "stereo.yml", "range_px": (2, 40), "trials": 0} | arguments
    return calibrate(place / "photos", **({"rectify_to": place / "rectified"} | settings))


def opencvs(place, side):
    """The rectified photographs of one eye as a user's program makes them."""
    values = rectified(alpha=1)
    matrix, distortion, number = (K1, D1, "1") if side == "left" else (K2, D2, "2")
    maps = cv2.initUndistortRectifyMap(
        matrix, distortion, values[f"R{number}"], values[f"P{number}"], SIZE, cv2.CV_32FC1
    )
    for path in sorted((place / "photos" / side).iterdir()):
        yield place / "rectified" / side / path.name, cv2.remap(read_image(path), *maps, cv2.INTER_LINEAR)


def test_raw_photographs_become_a_dataset_with_their_borders(place):
    calibration = made(place)
    config = parse_config(calibration.text, "rig.yaml")
    assert config == calibration.config
    frame = render_pair(config, 0)
    for side in ("left", "right"):
        valid = frame.view(side).valid == 255
        for path, image in opencvs(place, side):
            # OpenCV's maps of single precision, from a rotation that went through a vector of ten digits.
            assert np.abs(read_image(path).astype(int) - image).max() <= 1
            border = black_border(image)
            assert border.mean() > 0.05
            assert not (border & valid).any()
            # What is left is mixed from pixels inside and outside, in a ring up to two pixels wide.
            ring = cv2.dilate(border.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
            assert (~valid & ~border & ~ring).mean() < 1e-4
        drawn = frame.view(side).image
        assert drawn[border].max() < 20
    assert "photographs      12 of 6 subjects" in "\n".join(calibration.summary)
    assert any(line.startswith("lens ") and "borders" in line for line in calibration.summary)


def test_alpha_makes_the_borders_of_photographs_and_dataset(place):
    stored(place / "stereo.yml", RAW)
    for alpha, least, most in ((0, 0, 1e-3), (1, 0.05, 0.5)):
        config = made(place, alpha=alpha, rectify_to=place / f"at {alpha}").config
        border = (render_pair(config, 0).left.valid != 255).mean()
        photograph = black_border(read_image(place / f"at {alpha}" / "left" / "00.png")).mean()
        assert least <= border <= most
        assert abs(border - photograph) < 0.03


def test_photographs_that_are_not_rectified_are_noted(place, monkeypatch):
    """The rectification of `place` leaves borders, which photographs as the cameras take them have not."""
    # Trial pairs take seconds, and change nothing here.
    monkeypatch.setattr(calibrating, "_tried", lambda facts, *_: untried_style(facts.recipes))
    settings = {"calib": place / "stereo.yml", "range_px": (8, 60), "trials": 1}
    raw = calibrate(place / "photos", **settings)
    (note,) = (note for note in raw.notes if "probably not rectified" in note)
    assert re.search(r"the lens leaves \d+\.\d% border, and they have 0\.0%", note)
    assert "rectify_to" in note
    rectified = calibrate(place / "photos", rectify_to=place / "rectified", **settings)
    assert not any("probably" in note for note in rectified.notes)
    assert "12 photographs rectified: 6 of the left camera, 6 of the right one (right/00.png, right/01.png, " in str(
        rectified.notes
    )
    (line,) = (line for line in rectified.summary if line.startswith("lens"))
    assert "at least 100% of each raw image in view" in line


def test_a_file_is_no_folder_for_rectified_photographs(place):
    (place / "rectified").write_text("")
    with pytest.raises(InputError, match="rectified is a file: name a new folder"):
        made(place)


def test_patches_keep_clear_of_borders(place):
    config = made(place).config

    atlas = prepare_atlas(config.textures, Split(0))
    assert len(atlas.patches) > 10
    for layers in (atlas.layers, atlas.large_layers):
        assert len(layers)
        assert layers[..., :3].min() > 30


def test_the_command_rectifies_twice_alike(place):
    arguments = ["--images", place / "photos", "--calib", place / "stereo.yml", "--rectify-to", place / "rectified"]
    arguments += ["--range-px", 2, 40, "--trials", 0, "--overwrite", "--out", place / "rig.yaml"]
    texts = []
    for _ in range(2):
        result = CliRunner().invoke(command, list(map(str, arguments)), catch_exceptions=False)
        assert result.exit_code == 0, result.output
        assert f"compare data/rig --images {place / 'rectified'}" in result.output
        texts.append((place / "rig.yaml").read_text())
    assert texts[0] == texts[1]
    assert f'- "{place / "rectified"}"' in texts[0]


def test_pairs_show_how_well_the_calibration_fits(place):
    """Photographs of one scene through both lenses, whose right camera stands 3 px lower than calibrated."""
    flat = np.random.default_rng(1).integers(60, 256, (480, 640, 3), dtype=np.uint8)
    flat = cv2.GaussianBlur(flat, (0, 0), 1.5)
    flat = np.clip((flat.astype(int) - 157) * 4 + 157, 60, 255).astype(np.uint8)
    values = rectified(alpha=1)
    for side, matrix, distortion, number, down in (("left", K1, D1, "1", 0), ("right", K2, D2, "2", 3)):
        x, y = np.meshgrid(np.arange(640.0), np.arange(480.0))
        points = np.stack([x.ravel(), y.ravel() - down], axis=1)[:, None]
        seen = cv2.undistortPoints(points, matrix, distortion, R=values[f"R{number}"], P=values[f"P{number}"])
        maps = (seen[:, 0, i].reshape(480, 640).astype(np.float32) for i in (0, 1))
        raw = cv2.remap(flat, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        Image.fromarray(raw).save(place / f"pair-{side}.png")
    pair = (place / "pair-left.png", place / "pair-right.png")
    calibration = made(place, pairs=[pair])
    rig, focal_px = calibration.config.rig, calibration.config.camera.focal_px.middle
    down_px = rig.right_y_px.middle - np.tan(np.deg2rad(rig.right_pitch_deg.middle)) * focal_px
    assert down_px == pytest.approx(3 * focal_px / K2[1, 1], abs=0.2)


def test_wrong_photographs_are_refused_before_anything_is_written(place):
    with pytest.raises(InputError, match="lies among the photographs"):
        calibrate(place / "photos", calib=place / "stereo.yml", rectify_to=place / "photos" / "out", range_px=(2, 40))
    with pytest.raises(InputError, match="other_camera is set"):
        made(place, other_camera=True)
    stored(place / "only-p.yml", rectified())
    with pytest.raises(InputError, match="its cameras before rectification"):
        made(place, calib=place / "only-p.yml")
    with pytest.raises(InputError, match=r"raw images have 320 x 240, but of 12 photographs none.* 640 x 480"):
        made(place, scale=0.5)
    for sources in (str(place / "photos" / "*" / "0*.png"), sorted((place / "photos" / "left").iterdir())):
        top = place / "photos" if isinstance(sources, str) else place / "photos" / "left"
        with pytest.raises(InputError, match=r"would replace the photograph|lies among the photographs"):
            calibrate(sources, calib=place / "stereo.yml", rectify_to=top, range_px=(2, 40), trials=0)
    for pairs in ([("a",)], [("a", "b", "c")]):
        with pytest.raises(InputError, match="pairs"):
            made(place, pairs=pairs)
    Image.new("RGB", SIZE).save(place / "photos" / "left" / "00.jpg")
    with pytest.raises(InputError, match="differ in more than their endings"):
        made(place)
    (place / "photos" / "left" / "00.jpg").unlink()
    assert not (place / "rectified").exists()
    (place / "rectified").mkdir()
    Image.new("RGB", SIZE).save(place / "rectified" / "holiday.png")
    with pytest.raises(InputError, match=r"holds 1 other image, such as holiday\.png"):
        made(place)


def test_photographs_of_another_size_are_left_out_with_a_note(place):
    Image.new("RGB", (100, 80)).save(place / "photos" / "small.png")
    assert any("1 photograph left out" in note and "640 x 480" in note for note in made(place).notes)


def test_photographs_below_another_folder_and_turned_ones(place, monkeypatch):
    (place / "day").mkdir()
    monkeypatch.chdir(place / "day")
    made(Path(".."), calib="../stereo.yml", pairs=[("../photos/left", str(place / "photos" / "right"))])
    assert len(list((place / "rectified").rglob("*.png"))) == 12
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("RGB", SIZE, (200, 90, 90)).save(place / "photos" / "turned.jpg", exif=exif)
    with pytest.raises(InputError, match="turned by its EXIF"):
        made(place)


def test_a_lens_that_folds_is_left_out_with_a_note(place):
    far = {"K1": np.array([[380.0, 0, 320], [0, 380, 240], [0, 0, 1]]), "D1": np.array([-0.35, 0.12, 0, 0, -0.02])}
    far |= {"K2": far["K1"], "D2": far["D1"]}
    r1, r2, p1, p2, *_ = cv2.stereoRectify(far["K1"], far["D1"], far["K2"], far["D2"], SIZE, R, T, alpha=1)
    stored(place / "far.yml", RAW | far | {"R1": r1, "R2": r2, "P1": p1, "P2": p2})
    calibration = calibrate(place / "photos", calib=place / "far.yml", range_px=(2, 40), trials=0)
    assert calibration.config.lens is None
    assert any("bends two directions" in note for note in calibration.notes)
    with pytest.raises(InputError, match="bends two directions"):
        made(place, calib=place / "far.yml")


def test_rectified_photographs_of_another_calibration_are_not_replaced(place):
    made(place)
    files = {path: path.read_bytes() for path in (place / "rectified").rglob("*.png")}
    made(place)  # the same ones
    stored(place / "other.yml", RAW | {"K1": np.add(K1, [[0, 0, 3], [0, 0, 0], [0, 0, 0]])} | rectified())
    with pytest.raises(InputError, match="with other pixels: name a new folder"):
        made(place, calib=place / "other.yml")
    assert files == {path: path.read_bytes() for path in (place / "rectified").rglob("*.png")}


def test_lenses_of_several_rigs_are_left_out_with_a_note(place):
    stored(place / "other.yml", RAW | rectified())
    both = [place / "stereo.yml", place / "other.yml"]
    calibration = calibrate(place / "photos", calib=both, range_px=(2, 40), trials=0)
    assert calibration.config.lens is None
    assert any("lenses of 2 rigs were left out" in note for note in calibration.notes)


def test_without_opencv_lenses_are_left_out_with_a_note(place, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "cv2", None)
    calibration = calibrate(place / "photos", calib=place / "stereo.yml", range_px=(2, 40), trials=0)
    assert calibration.config.lens is None
    assert any("left out" in note and "OpenCV" in note for note in calibration.notes)
