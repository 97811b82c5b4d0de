"""Reading files back: what is right comes out, what is wrong is named."""

import json
import struct

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from semisynth_gl.camera import StereoCamera
from semisynth_gl.codecs.calib import MIDDLEBURY_CALIB
from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import RGB8
from semisynth_gl.dataset.reader import read_index
from semisynth_gl.errors import InputError, ReadError, SemisynthError

CAMERA = StereoCamera(37, 21, 1164.25, 0.193001, 17.5, 48.586, 10.25)
sides = st.integers(1, 20)


@pytest.fixture
def scene(tmp_path):
    rng = np.random.default_rng(0)
    disparity = rng.uniform(1, 90, (2, 21, 37)).astype(np.float32)
    disparity[0, 0, 0] = np.inf
    del disparity


@settings(deadline=None)
@given(hnp.arrays(np.float32, st.tuples(sides, sides), elements=st.floats(0, 1e4, width=32) | st.just(np.inf)))
def test_pfm_is_the_inverse_of_writing(image):
    np.testing.assert_array_equal(PFM.decode(PFM.encode(image), "x"), image)


def test_pfm_of_opencv_is_read(tmp_path):
    image = np.random.default_rng(0).random((5, 7), np.float32)
    cv2.imwrite(str(tmp_path / "x.pfm"), image)
    np.testing.assert_array_equal(PFM.read(tmp_path / "x.pfm", any_scale=True), image)


def test_pfm_of_others_is_read_when_asked(tmp_path):
    path = tmp_path / "x.pfm"
    path.write_bytes(b"Pf 2 1\r\n0.003922\r\n" + struct.pack(">2f", 1.5, 2.5))
    assert PFM.read(path, any_scale=True).tolist() == [[1.5, 2.5]]
    with pytest.raises(ReadError, match="header"):
        PFM.read(path)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "header"),
        (b"PF\n1 1\n-1.0\n" + bytes(12), "header"),
        (b"Pf\n1 1\n1.0\n" + bytes(4), "header"),
        (b"Pf\r\n1 1\r\n-1.0\r\n" + bytes(4), "header"),
        (b"Pf\n2 2\n-1.0\n" + bytes(15), "ends after 15 of 16 bytes"),
        (b"Pf\n2 2\n-1.0\n" + bytes(17), "1 bytes after"),
        (b"Pf\n0 2\n-1.0\n", "no pixel"),
        (b"Pf\n999999999 999999999\n-1.0\n", "ends after 0"),
    ],
)
def test_wrong_pfm_is_named(tmp_path, data, words):
    (tmp_path / "d.pfm").write_bytes(data)
    with pytest.raises(SemisynthError, match=f"d.pfm: .*{words}"):
        PFM.read(tmp_path / "d.pfm")


def test_png_of_each_kind(tmp_path):
    rng = np.random.default_rng(0)
    for name, reader, image in (
        ("rgb", read_rgb, rng.integers(0, 256, (5, 7, 3), dtype=np.uint8)),
        ("grey", read_grey, rng.integers(0, 256, (5, 7), dtype=np.uint8)),
        ("grey16", read_grey16, rng.integers(0, 65536, (5, 7), dtype=np.uint16)),
    ):
        cv2.imwrite(str(tmp_path / name) + ".png", image[..., ::-1] if image.ndim == 3 else image)
        came = reader(tmp_path / f"{name}.png")
        assert came.dtype == image.dtype
        np.testing.assert_array_equal(came, image)
        for other in {read_rgb, read_grey, read_grey16} - {reader}:
            with pytest.raises(ReadError, match="expected"):
                other(tmp_path / f"{name}.png")


def test_wrong_png_is_named(tmp_path):
    path = tmp_path / "i.png"
    good = encode_png(np.random.default_rng(0).integers(0, 256, (40, 40, 3), dtype=np.uint8))
    lying = good[:16] + struct.pack(">II", 1 << 20, 1 << 20) + good[24:]
    flipped = good[:200] + bytes([good[200] ^ 1]) + good[201:]
    for data, words in (
        (good[:-1], "does not end"),
        (good[:-12], "does not end"),
        (good + b"x", "does not end"),
        (good[:300] + good[-12:], "cannot be decoded"),
        (flipped, "cannot be decoded"),
        (lying, "claims 1048576 x 1048576"),
        (b"\xff\xd8\xff\xe0" + bytes(60), "expected a PNG"),
        (b"", "expected a PNG"),
    ):
        path.write_bytes(data)
        with pytest.raises(ReadError, match=words):
            RGB8.read(path)
    Image.fromarray(np.arange(256, dtype=np.uint8)[None]).convert("P").save(path)
    with pytest.raises(ReadError, match="got 8-bit palette"):
        RGB8.read(path)
    with pytest.raises(ReadError, match="is missing"):
        RGB8.read(tmp_path / "none.png")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("doffs=", "dofs=", "in this order"),
        ("isint=0\n", "", "in this order"),
        ("dymax=0\n", "dymax=0", "no end"),
        ("ndisp=100", "ndisp=1e2", "invalid literal"),
        ("width=37", "width=0", "at least 1 x 1"),
        ("; 0 0 1]", "]", "expected a matrix"),
        ("cam1=[1164.25", "cam1=[1164.5", "cam1 is not"),
        ("baseline=", "baseline=x", "could not convert"),
    ],
)
def test_wrong_calibration_is_named(scene, old, new, words):
    path = scene[0] / "calib.txt"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(ReadError, match=words):
        MIDDLEBURY_CALIB.read(path)


def test_what_is_no_dataset_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for path, words in (
        (tmp_path / "none", "no such folder"),
        (tmp_path / "file", "got a file"),
        (tmp_path, "not a dataset"),
    ):
        with pytest.raises(InputError, match=words):
            read_index(path)
    (tmp_path / "index.json").write_text(json.dumps({"program": "semisynth-gl", "layout": "nuscenes"}))
    with pytest.raises(InputError, match="'nuscenes'"):
        read_index(tmp_path)


def test_json_must_hold_an_object(tmp_path):
    (tmp_path / "a.json").write_text("{")
    (tmp_path / "b.json").write_text("3")
    with pytest.raises(ReadError, match="not JSON"):
        JSON_OBJECT.read(tmp_path / "a.json")
    with pytest.raises(ReadError, match="got int"):
        JSON_OBJECT.read(tmp_path / "b.json")
