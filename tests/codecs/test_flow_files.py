"""Flow from arrays to files and back: encodings, names, and what loaders of flow find."""

# ruff: noqa: PTH207 - loaders are written down with the calls that they make

import struct
from glob import glob
from pathlib import Path

import cv2
import numpy as np
import pytest
from hand_made_pairs import decode, encode, make_frame, write_tree
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from tiny_datasets import tiny

from semisynth_gl.codecs import FLOW_CODECS, Encodings
from semisynth_gl.codecs.png import GREY16
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.layouts import find_layout

INF = np.float32(np.inf)
PATH = Path("the-file")
FLOW_OUTPUTS = ("visibility", "flow", "flow_backward", "disparity_change")
sides = st.integers(1, 12)


@st.composite
def flows(draw, largest=511.0):
    """Flow of any size, both components inf where there is none."""
    height, width = draw(sides), draw(sides)
    numbers = st.floats(-largest, largest, width=32)
    flow = draw(hnp.arrays(np.float32, (height, width, 2), elements=numbers))
    flow[draw(hnp.arrays(np.bool_, (height, width)))] = np.inf
    return flow


def flow_of(shape, seed=0):
    rng = np.random.default_rng(seed)
    flow = rng.normal(0, 60, (*shape, 2)).astype(np.float32)
    flow[rng.random(shape) < 0.2] = np.inf
    return flow


def config(length=1, **values):
    made = tiny(sequence={"length": length}, **values)
    return made.model_copy(update={"outputs": FLOW_OUTPUTS})


# Encodings


@pytest.mark.parametrize("encoding", ["flo", "pfm"])
@settings(max_examples=40, deadline=None)
@given(flow=flows(1e6))
def test_flow_comes_back_bit_for_bit(encoding, flow):
    came = FLOW_CODECS[encoding].decode(FLOW_CODECS[encoding].encode(flow), PATH)
    assert came.dtype == np.float32
    np.testing.assert_array_equal(came, flow)


@settings(max_examples=40, deadline=None)
@given(flow=flows(600.0))
def test_a_png16_is_rounded_or_beyond_and_never_wrapped(flow):
    codec = FLOW_CODECS["png16"]
    came = codec.decode(codec.encode(flow), PATH)
    assert came.dtype == np.float32
    valid = np.isfinite(flow).all(axis=2)
    beyond = codec.exceeds_limit(flow)
    assert not (beyond & ~valid).any()
    np.testing.assert_array_equal(np.isfinite(came).all(axis=2), valid & ~beyond)
    np.testing.assert_array_equal(np.isinf(came[..., 0]), np.isinf(came[..., 1]))
    kept = valid & ~beyond
    assert np.abs(came[kept] - flow[kept]).max(initial=0) <= codec.error_px
    within = valid & (np.abs(flow).max(axis=2) <= codec.limit_px)
    assert not (beyond & within).any()


def test_a_png16_ends_where_16_bits_do():
    rows = (-512.01, -512.0078125, -512.0, 0.0, 1 / 64, 511.984375, 511.9921, 511.9922, 512.0, 1e30, np.inf, np.nan)
    flow = np.array([[(value, 1.0) for value in rows], [(1.0, value) for value in rows]], np.float32)
    stored = by_opencv(FLOW_CODECS["png16"].encode(flow))
    first = [0, 0, 0, 32768, 32769, 65535, 65535, 0, 0, 0, 0, 0]
    valid = [0, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0]
    assert stored[0, :, 0].tolist() == stored[1, :, 1].tolist() == first
    assert stored[0, :, 2].tolist() == stored[1, :, 2].tolist() == valid
    assert stored[0, :, 1].tolist() == stored[1, :, 0].tolist() == [32832 * each for each in valid]
    beyond = [*(value == 0 for value in valid[:10]), False, False]
    assert FLOW_CODECS["png16"].exceeds_limit(flow).tolist() == [beyond, beyond]


def by_opencv(data, flags=cv2.IMREAD_UNCHANGED):
    return cv2.imdecode(np.frombuffer(data, np.uint8), flags)[..., ::-1]


def test_opencv_reads_what_is_written(tmp_path):
    flow = flow_of((13, 17))
    there = np.isfinite(flow).all(axis=2)
    (tmp_path / "flow.flo").write_bytes(FLOW_CODECS["flo"].encode(flow))
    by_flo = cv2.readOpticalFlow(str(tmp_path / "flow.flo"))
    np.testing.assert_array_equal(by_flo[there], flow[there])
    assert (by_flo[~there] == np.float32(1e10)).all()
    by_pfm = by_opencv(FLOW_CODECS["pfm"].encode(flow))
    np.testing.assert_array_equal(by_pfm, np.concatenate([flow, np.zeros((13, 17, 1))], axis=2))
    by_png = by_opencv(FLOW_CODECS["png16"].encode(flow), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(by_png[..., 2], there)
    assert not by_png[~there].any()
    assert np.abs((by_png[there][:, :2] / 64 - 512) - flow[there]).max() <= 1 / 128


@pytest.mark.parametrize(
    ("encoding", "data"),
    [
        ("flo", b"PIEH"),
        ("flo", b"PIEH" + struct.pack("<ii4f", 2**31 - 1, 2**31 - 1, 0, 0, 0, 0)),
        ("flo", b"PIEH" + struct.pack("<iif", 1, 1, 0)),
        ("flo", b"PIEH" + struct.pack("<ii2f", 1, 1, 0, np.nan)),
        ("pfm", b"Pf\n1 1\n-1.0\n" + struct.pack("<f", 0)),
        ("pfm", b"PF\n1 1\n-1.0\n" + struct.pack("<3f", 0, 0, 1)),
        ("png16", GREY16.encode(np.zeros((3, 4), np.uint16))),
    ],
)
def test_wrong_files_are_refused_by_name(encoding, data):
    with pytest.raises(ReadError, match="the-file: "):
        FLOW_CODECS[encoding].decode(data, PATH)


# What the encodings cannot say


def test_what_png16_cannot_say_is_invalid_everywhere():
    frame = make_frame(1, FLOW_OUTPUTS)
    flow = frame.left.flow.copy()
    flow[0, :3], flow[5, 5] = (600, 0), (0, -513)
    mask = frame.left.flow_visibility.copy()
    mask[5, 5] = OCCLUDED
    disparity = frame.left.disparity.copy()
    disparity[7, 7] = 300
    left = frame.left.with_channels({"flow": flow, "flow_visibility": mask, "disparity": disparity})
    frame = Frame(frame.camera, left, frame.right)
    beyond = FLOW_CODECS["png16"].exceeds_limit(flow)
    assert beyond.sum() == 4
    for name, encodings in (("kitti", None), ("middlebury", Encodings.from_names(disparity="png16", flow="png16"))):
        stored = decode(find_layout(name), 1, encode(find_layout(name), 1, frame=frame, encodings=encodings),
                        encodings=encodings)  # fmt: skip
        assert stored.provenance["flow_beyond"] == {"left": 4, "right": 0}
        assert stored.provenance["flow_backward_beyond"] == {"left": 0, "right": 0}
        assert stored.provenance["disparity_beyond"] == {"left": 1, "right": 0}
        assert np.isinf(stored.left.flow[beyond]).all()
        assert (stored.left.flow_visibility[beyond] == OUTSIDE).all()
        np.testing.assert_array_equal(stored.left.flow_visibility[~beyond], mask[~beyond])
        assert np.isinf(stored.left.disparity[7, 7])
        assert stored.left.visibility[7, 7] == OUTSIDE
        assert name == "kitti" or stored.calibration.vmax_px < 256
        assert np.isinf(stored.left.disparity_change[7, 7])
        assert np.isfinite(frame.left.disparity_change[7, 7])
        assert (stored.encodings.flow.error_px, stored.encodings.flow.limit_px) == (1 / 128, 511.984375)
    # Without flow there is nothing to count.
    bare = decode(find_layout("kitti"), 1, encode(find_layout("kitti"), 1, frame=make_frame(1, ("visibility",))))
    assert "flow_beyond" not in bare.provenance


# Names


def test_sequences_that_names_cannot_count_are_refused():
    assert make_plan(config(90), 0, "kitti", {"train": 1}).layout.most_frames == 90
    with pytest.raises(InputError, match=r"sequence\.length"):
        make_plan(config(91), 0, "kitti", {"train": 1})
    still = config(91).model_copy(update={"outputs": ("visibility",)})
    assert make_plan(still, 0, "kitti", {"train": 1}).config.sequence.length == 91
    assert make_plan(config(91), 0, "middlebury", {"train": 1}).config.sequence.length == 91


# Loaders of flow: what each finds, as lists of image 1, image 2 and flow


def raft_things(root, direction="into_future"):
    """As RAFT's FlyingThings3D, of the left camera."""
    folder = root / "SceneFlow" / "FlyingThings3D"
    image_dirs = [f"{each}/left" for each in sorted(glob(str(folder / "frames_cleanpass" / "TRAIN/*/*")))]
    flow_dirs = [f"{each}/{direction}/left" for each in sorted(glob(str(folder / "optical_flow" / "TRAIN/*/*")))]
    assert len(image_dirs) == len(flow_dirs)
    for image_dir, flow_dir in zip(image_dirs, flow_dirs, strict=True):
        images, found = sorted(glob(f"{image_dir}/*.png")), sorted(glob(f"{flow_dir}/*.pfm"))
        assert len(images) == len(found)
        for i in range(len(found) - 1):
            future = direction == "into_future"
            yield (images[i], images[i + 1], found[i]) if future else (images[i + 1], images[i], found[i + 1])


def kitti_flow(folder):
    """As RAFT's KITTI and torchvision's KittiFlow."""
    first, second = (sorted(glob(str(folder / "image_2" / f"*_{number}.png"))) for number in (10, 11))
    return list(zip(first, second, sorted(glob(str(folder / "flow_occ" / "*_10.png"))), strict=True))


def pair_of(path):
    """Number of the pair that an image is of."""
    return round(int(cv2.imread(str(path))[4, 4, 2]) / 8)


def flow_in(path):
    """By OpenCV: (H, W, 2) px, inf where there is none."""
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]
    if stored.dtype == np.float32:
        return stored[..., :2]
    return np.where(stored[..., 2:] > 0, stored[..., :2] / 64.0 - 512, np.inf)


@pytest.mark.parametrize(
    ("direction", "array", "step"), [("into_future", "flow_left", 1), ("into_past", "flow_backward_left", -1)]
)
def test_loaders_of_things_pair_flow_with_its_frames(tmp_path, direction, array, step):
    # The last sequence is cut short.
    root = write_tree("sceneflow", tmp_path, pairs=14, length=3)
    found = list(raft_things(root, direction))
    firsts = [pair_of(one) for one, _, _ in found]
    wanted = [pair for pair in range(14) if 0 <= pair + step < 14 and (pair + step) // 3 == pair // 3]
    assert sorted(firsts) == wanted
    for (_, two, flow), pair in zip(found, firsts, strict=True):
        assert pair_of(two) == pair + step
        np.testing.assert_array_equal(flow_in(flow), make_frame(pair).arrays()[array])


@pytest.mark.parametrize("folder", ["training", "KittiFlow/training"])
def test_loaders_of_kitti_pair_flow_with_its_frames(tmp_path, folder):
    root = write_tree("kitti", tmp_path, pairs=9, length=3)
    found = kitti_flow(root / folder)
    assert [(pair_of(one), pair_of(two)) for one, two, _ in found] == [(0, 1), (3, 4), (6, 7)]
    for one, _, flow in found:
        made = make_frame(pair_of(one)).left.flow
        valid = np.isfinite(made)
        np.testing.assert_array_equal(np.isfinite(flow_in(flow)), valid)
        assert np.abs(flow_in(flow)[valid] - made[valid]).max() <= 1 / 128
