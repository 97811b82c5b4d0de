"""Codecs in both directions, compared with other readers and writers."""

import io
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from isal import isal_zlib
from PIL import Image

from semisynth_gl.codecs import FLOW_CODECS
from semisynth_gl.codecs.calib import MIDDLEBURY_CALIB, CalibContent
from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.pfm import PFM, PFM3
from semisynth_gl.codecs.png import GREY8, GREY16, RGB8, RGB16, deflate
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import ReadError

CAMERA = StereoCamera(37, 21, 1164.25, 0.193001, 17.5, 48.586, 10.25)
CALIB = MIDDLEBURY_CALIB.encode(CalibContent(CAMERA, CAMERA.doffs_px, 100, 1.0, 90.0))
PATH = Path("the-file")
sides = st.integers(1, 40)
disparities = hnp.arrays(np.float32, st.tuples(sides, sides), elements=st.floats(0, 1e4, width=32) | st.just(np.inf))


def by_opencv(data):
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return decoded if decoded.ndim == 2 else decoded[..., ::-1]


# PNG


PNGS = {(np.uint8, 2): GREY8, (np.uint8, 3): RGB8, (np.uint16, 2): GREY16, (np.uint16, 3): RGB16}


@given(
    st.sampled_from([np.uint8, np.uint16]).flatmap(
        lambda dtype: hnp.arrays(dtype, st.one_of(st.tuples(sides, sides), st.tuples(sides, sides, st.just(3))))
    )
)
def test_png_of_each_kind_comes_back_here_and_by_opencv(image):
    png = PNGS[image.dtype.type, image.ndim]
    data, by_others = png.encode(image), cv2.imencode(".png", image[..., ::-1] if image.ndim == 3 else image)[1]
    for came in (png.decode(data, PATH), by_opencv(data), png.decode(by_others.tobytes(), PATH)):
        assert came.dtype == image.dtype
        np.testing.assert_array_equal(came, image)
    for other in {*PNGS.values()} - {png}:
        with pytest.raises(ReadError, match="expected"):
            other.decode(data, PATH)


@pytest.mark.parametrize("length", [100, 288, 289, 310, 4000])
def test_where_a_stream_is_in_memory_does_not_matter(monkeypatch, length):
    """The third to sixth bytes equal part of the stream's address, with which ISA-L 2.32 confuses them."""
    rng = np.random.default_rng(0)
    streams = [isal_zlib.compressobj(1) for _ in range(8)]
    assert len({id(stream) >> 16 for stream in streams}) > 1
    for stream in streams:
        content = rng.integers(0, 5, length, np.uint8)
        content[2:6] = np.array([(id(stream) >> 16) & 0xFFFFFFFF], "<u4").view(np.uint8)
        content[50:80] = content[2:32]
        deflated = set()
        for each in (stream, isal_zlib.compressobj(1), isal_zlib.compressobj(1)):
            monkeypatch.setattr(isal_zlib, "compressobj", lambda _, each=each: each)
            deflated.add(deflate(content))
            monkeypatch.undo()
        assert len(deflated) == 1


def test_wrong_png_is_refused_by_name(tmp_path):
    path = tmp_path / "i.png"
    good = RGB8.encode(np.random.default_rng(0).integers(0, 256, (40, 40, 3), dtype=np.uint8))
    lying = good[:16] + struct.pack(">II", 1 << 20, 1 << 20) + good[24:]
    flipped = good[:200] + bytes([good[200] ^ 1]) + good[201:]
    palette = io.BytesIO()
    Image.fromarray(np.arange(256, dtype=np.uint8)[None]).convert("P").save(palette, "PNG")
    short = good[:300] + good[-12:]
    for data in (good[:-1], good[:-12], good + b"x", short, flipped, lying, b"\xff\xd8", b"", palette.getvalue()):
        path.write_bytes(data)
        with pytest.raises(ReadError, match=r"i\.png"):
            RGB8.read(path)
    with pytest.raises(ReadError, match="is missing"):
        RGB8.read(tmp_path / "none.png")


# PFM


@given(disparities, st.sampled_from([PFM, PFM3, FLOW_CODECS["pfm"], FLOW_CODECS["flo"]]))
def test_floats_come_back_bit_for_bit_here_and_pfm_by_opencv(image, codec):
    if codec is not PFM:  # in flow, either both components are inf or none
        image = np.stack([image, image / 2, -image], axis=2)[..., : 3 if codec is PFM3 else 2]
    data = codec.encode(image)
    came = codec.decode(data, PATH)
    assert came.dtype == np.float32
    np.testing.assert_array_equal(came, image)
    if codec in (PFM, PFM3):
        np.testing.assert_array_equal(by_opencv(data), image)


def test_other_peoples_pfm_is_read():
    data = b"Pf 2 1\r\n0.003922\r\n" + struct.pack(">2f", 1.5, 2.5)
    assert PFM.decode(data, PATH).tolist() == [[1.5, 2.5]]


# Disparity and flow


def test_opencv_reads_flow(tmp_path):
    flow = np.random.default_rng(0).normal(0, 60, (13, 17, 2)).astype(np.float32)
    flow[::3, ::2] = np.inf
    there = np.isfinite(flow).all(axis=2)
    (tmp_path / "flow.flo").write_bytes(FLOW_CODECS["flo"].encode(flow))
    by_flo = cv2.readOpticalFlow(str(tmp_path / "flow.flo"))
    np.testing.assert_array_equal(by_flo[there], flow[there])
    assert (by_flo[~there] == np.float32(1e10)).all()
    by_pfm = by_opencv(FLOW_CODECS["pfm"].encode(flow))
    np.testing.assert_array_equal(by_pfm, np.concatenate([flow, np.zeros((13, 17, 1))], axis=2))


def test_a_flow_png16_ends_where_16_bits_do():
    rows = (-512.01, -512.0078125, -512.0, 0.0, 1 / 64, 511.984375, 511.9921, 511.9922, 512.0, 1e30, np.inf, np.nan)
    flow = np.array([[(value, 1.0) for value in rows], [(1.0, value) for value in rows]], np.float32)
    codec = FLOW_CODECS["png16"]
    stored, came = by_opencv(codec.encode(flow)), codec.decode(codec.encode(flow), PATH)
    first = [0, 0, 0, 32768, 32769, 65535, 65535, 0, 0, 0, 0, 0]
    valid = [0, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0]
    assert stored[0, :, 0].tolist() == stored[1, :, 1].tolist() == first
    assert stored[0, :, 2].tolist() == stored[1, :, 2].tolist() == valid
    assert stored[0, :, 1].tolist() == stored[1, :, 0].tolist() == [32832 * each for each in valid]
    beyond = [*(value == 0 for value in valid[:10]), False, False]
    assert codec.exceeds_limit(flow).tolist() == [beyond, beyond]
    assert np.isfinite(came).all(axis=2).tolist() == [[value == 1 for value in valid]] * 2
    assert np.abs(came[0, 1:7] - flow[0, 1:7]).max() <= codec.error_px == 1 / 128


@pytest.mark.parametrize(
    ("codec", "data"),
    [
        (PFM, b"PF\n1 1\n-1.0\n" + bytes(12)),
        (PFM, b"Pf\n2 2\n-1.0\n" + bytes(17)),
        (PFM, b"Pf\n0 2\n-1.0\n"),
        (PFM, b"Pf\n999999999 999999999\n-1.0\n"),
        (FLOW_CODECS["flo"], b"PIEH"),
        (FLOW_CODECS["flo"], b"PIEH" + struct.pack("<ii4f", 2**31 - 1, 2**31 - 1, 0, 0, 0, 0)),
        (FLOW_CODECS["flo"], b"PIEH" + struct.pack("<iif", 1, 1, 0)),
        (FLOW_CODECS["flo"], b"PIEH" + struct.pack("<ii2f", 1, 1, 0, np.nan)),
        (FLOW_CODECS["pfm"], b"Pf\n1 1\n-1.0\n" + struct.pack("<f", 0)),
        (FLOW_CODECS["pfm"], b"PF\n1 1\n-1.0\n" + struct.pack("<3f", 0, 0, 1)),
        (FLOW_CODECS["png16"], GREY16.encode(np.zeros((3, 4), np.uint16))),
        (MIDDLEBURY_CALIB, CALIB.replace(b"doffs=", b"dofs=")),
        (MIDDLEBURY_CALIB, CALIB.replace(b"ndisp=100", b"ndisp=1.5")),
        (MIDDLEBURY_CALIB, CALIB.replace(b"; 0 0 1]", b"]")),
        (MIDDLEBURY_CALIB, CALIB.replace(b"cam1=[1164.25", b"cam1=[1164.5")),
    ],
)
def test_wrong_files_are_refused_by_name(codec, data):
    with pytest.raises(ReadError, match="the-file: "):
        codec.decode(data, PATH)


def test_a_png16_ends_at_256_px_and_keeps_0_for_no_truth():
    last = np.float32(65535.5 / 256)
    values = [np.inf, np.nan, 0, -1, 1e-6, 1 / 256, 255.996, np.nextafter(last, 0), last, 256, 1e30]
    disparity = np.array([values], np.float32)
    assert by_opencv(KITTI_DISPARITY.encode(disparity))[0].tolist() == [0, 0, 0, 0, 1, 1, 65535, 65535, 0, 0, 0]
    assert KITTI_DISPARITY.exceeds_limit(disparity)[0].tolist() == [False] * 8 + [True] * 3


@pytest.mark.parametrize("steps", [256, 7.3])
def test_a_map_counts_in_any_steps(tmp_path, steps):
    counts = np.arange(2**16, dtype=np.uint16).reshape(256, 256)
    (tmp_path / "a.png").write_bytes(GREY16.encode(counts))
    disparity = read_disparity_map(tmp_path / "a.png", steps)
    assert disparity.dtype == np.float32
    assert np.isposinf(disparity[0, 0])
    np.testing.assert_array_equal(disparity.ravel()[1:], counts.ravel()[1:].astype(np.float32) / np.float32(steps))
