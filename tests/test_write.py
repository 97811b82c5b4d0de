"""What lands on disk, read back by other people's readers."""

import io
import json

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image
from semisynth_gl.encodings import Encodings

from semisynth_gl.camera import StereoCamera
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import GREY8, GREY16, RGB8
from semisynth_gl.frame import Frame
from semisynth_gl.layouts import Key, find_layout

sides = st.integers(1, 40)


def frame(width=37, height=21, seed=0):
    rng = np.random.default_rng(seed)
    disparity = rng.uniform(1, 90, (2, height, width)).astype(np.float32)
    disparity[0, 0, 0] = np.inf
    return Frame(
        StereoCamera(width, height, 1164.25, 0.193001, 17.5, 48.586, 10.25),
        *(
            View({"image": image, "disparity": disparity, "visibility": mask})
            for image, disparity, mask in zip(
                rng.integers(0, 256, (2, height, width, 3), dtype=np.uint8),
                disparity,
                rng.choice(np.array([0, 128, 255], np.uint8), (2, height, width)),
                strict=True,
            )
        ),
    )


def encoded(shot):
    """Files of a pair in Middlebury's layout, by name."""
    key = Key("middlebury", "train", 0)
    files = encode_pair(find_layout("middlebury"), key, shot, {"pair": 3}, 100, Encodings())
    assert {path.rpartition("/")[0] for path in files} == {"MiddEval3/trainingF/middlebury-000000"}
    return {path.rpartition("/")[2]: data for path, data in files.items()}


@settings(deadline=None)
@given(hnp.arrays(np.uint8, st.one_of(st.tuples(sides, sides), st.tuples(sides, sides, st.just(3)))))
def test_png_is_read_back_by_pillow_and_opencv(image):
    data = (GREY8 if image.ndim == 2 else RGB8).encode(image)
    opened = Image.open(io.BytesIO(data))
    assert opened.mode == ("L" if image.ndim == 2 else "RGB")
    np.testing.assert_array_equal(np.asarray(opened), image)
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(decoded if image.ndim == 2 else decoded[..., ::-1], image)


@settings(deadline=None)
@given(hnp.arrays(np.float32, st.tuples(sides, sides), elements=st.floats(0, 1e4, width=32) | st.just(np.inf)))
def test_pfm_is_read_back_by_opencv(tmp_path_factory, image):
    path = tmp_path_factory.mktemp("pfm") / "disparity.pfm"
    path.write_bytes(PFM.encode(image))
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), image)


def test_pfm_has_the_header_that_loaders_expect():
    assert PFM.encode(np.zeros((3, 5), np.float32)) == b"Pf\n5 3\n-1.0\n" + bytes(60)
    upper = np.array([[1.0], [2.0]], np.float32)
    assert np.frombuffer(PFM.encode(upper)[-8:], "<f4").tolist() == [2.0, 1.0]


def test_sixteen_bit_png_is_read_back_by_opencv():
    ids = np.random.default_rng(0).integers(0, 65536, (9, 31)).astype(np.uint16)
    decoded = cv2.imdecode(np.frombuffer(GREY16.encode(ids), np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, ids)


def test_calibration_reads_back_to_the_same_depth():
    written = encoded(frame())["calib.txt"].decode().splitlines()
    keys = [line.split("=")[0] for line in written]
    expected = "cam0 cam1 doffs baseline width height ndisp isint vmin vmax dyavg dymax"
    assert " ".join(keys) == expected
    values = dict(line.split("=") for line in written)
    rows = [[float(x) for x in row.split()] for row in values["cam0"].strip("[]").split(";")]
    assert rows == [[1164.25, 0, 17.5], [0, 1164.25, 10.25], [0, 0, 1]]
    camera = frame().camera
    disparity = camera.disparity_px(2.5)
    depth_mm = float(values["baseline"]) * rows[0][0] / (disparity + float(values["doffs"]))
    assert depth_mm == pytest.approx(2500, rel=1e-12)
    assert values["ndisp"] == "100"
    assert written[6] == "ndisp=100"  # HSM reads line 7
    assert float(values["vmin"]) >= 1
    assert float(values["vmax"]) <= 90.0


def test_a_scene_has_middleburys_files():
    shot = frame()
    files = encoded(shot)
    assert set(files) == {
        *(
            "im0.png",
            "im1.png",
            "disp0GT.pfm",
            "disp1GT.pfm",
            "mask0nocc.png",
            "mask1nocc.png",
            "calib.txt",
            "pair.json",
        ),
    }
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(files["im1.png"]))), shot.right.image)
    mask = Image.open(io.BytesIO(files["mask0nocc.png"]))
    assert mask.mode == "L"
    assert set(np.unique(mask)) == {0, 128, 255}
    assert json.loads(files["pair.json"]) == {"pair": 3}


def test_names_sort_as_numbers():
    keys = [Key("kitti", "train", index) for index in (2, 10, 999_999)]
    names = [key.name for key in keys]
    assert names == sorted(names) == ["kitti-000002", "kitti-000010", "kitti-999999"]
    lists = find_layout("middlebury").lists(keys, Encodings())
    assert lists == {"MiddEval3/official_train.txt": b"kitti-000002\nkitti-000010\nkitti-999999\n"}
