"""Every layout, encoded and decoded, and read by public loaders and packages."""

# ruff: noqa: PTH207, PTH208 - the tests copy the loaders' own calls

import json
import os
import re
from dataclasses import fields
from functools import partial
from glob import glob
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
import pytest
from hand_made_datasets import config_of, write_dataset
from hand_made_pairs import CAMERA, PAIRS, decode, encode, encoded, make_frame, make_provenance
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from semisynth_gl.codecs import Encodings
from semisynth_gl.codecs.calib import KITTI_CALIB
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import GREY8, RGB8
from semisynth_gl.dataset.pair_files import decode_file
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, OUTPUTS, OUTSIDE, ROLES, VISIBLE, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.layouts import PairKey, find_layout, layout_names
from semisynth_gl.layouts.roles import number_objects, restore_outside
from semisynth_gl.seeds.splits import SPLITS


def matched(left, right, disparity, disparity_right=None):
    """Check that all files of a loader's sample belong to one pair; return its number."""
    images = [np.asarray(Image.open(path).convert("RGB"))[4, 4] for path in (left, right)]
    assert [image[1] > 128 for image in images] == [False, True], (left, right)
    found = {round(int(image[0]) / 8) for image in images} | {int(disparity_by_opencv(disparity)[4, 4] - 1)}
    if disparity_right is not None:
        found.add(int(disparity_by_opencv(disparity_right)[4, 4] - 101))
    assert len(found) == 1, (left, right, disparity, disparity_right)
    return found.pop()


def disparity_by_opencv(path):
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if stored.dtype == np.uint16:
        return stored / (32 if path.endswith(".disp.png") else 256)
    return stored


# Encoding and decoding


@pytest.mark.parametrize(("outputs", "truth"), [(OUTPUTS, "both"), (OUTPUTS, "left"), ((), "both")])
@pytest.mark.parametrize(
    ("name", "encodings"),
    [
        *((name, None) for name in layout_names()),
        ("middlebury", Encodings.from_names("png", "png16", "png16")),
        ("webdataset", Encodings.from_names("png", "png16", "pfm")),
    ],
)
def test_what_is_written_comes_back(name, encodings, outputs, truth):
    layout = find_layout(name)
    outputs = [output for output in outputs if output not in layout.lacks]
    frame = make_frame(6, outputs, truth)
    files = encode(layout, 6, frame=frame, encodings=encodings)
    encoded = encodings or layout.encodings or Encodings()
    assert set(files) == set(layout.files(PairKey("lab", "train", 6), encoded, outputs, truth).values())
    stored = decode(layout, 6, files, encodings=encodings)
    none = {"left": 0} if truth == "left" else {"left": 0, "right": 0}
    counted = {"disparity_beyond": none} if stored.encodings.disparity.limit_px < np.inf else {}
    if stored.encodings.flow.limit_px < np.inf and outputs:
        counted |= {"flow_beyond": none, "flow_backward_beyond": none}
    assert stored.provenance == make_provenance(6) | counted
    assert (stored.split, stored.index, stored.name) == ("train", 6, "lab-000006")
    for each in fields(CAMERA):
        assert getattr(stored.camera, each.name) == pytest.approx(getattr(CAMERA, each.name), abs=1e-12)
    assert set(stored.arrays()) == set(frame.arrays())
    flow_px, disparity_px = stored.encodings.flow.error_px, stored.encodings.disparity.error_px
    level = 0 if stored.encodings.image.lossless else 4
    errors = {"flow": flow_px, "flow_backward": flow_px, "disparity": disparity_px, "image": level, "raw": level}
    for role, was in frame.arrays().items():
        is_ = stored.arrays()[role]
        assert is_.dtype == was.dtype, role
        error = errors.get(ROLES[role][1].name, 0)
        np.testing.assert_allclose(is_.astype(float), was.astype(float), rtol=0, atol=error, err_msg=role)


LENGTHS = st.one_of(
    st.sampled_from([np.inf, 255.99, 255.998, 256.0, 2047.98, 2048.0, 1e-6, 1 / 512, 1 / 64, 1e30]),
    st.floats(2.0**-20, 3000, width=32),
)


@settings(max_examples=40)
@given(st.lists(LENGTHS, min_size=1, max_size=12))
def test_a_disparity_is_rounded_or_counted_and_never_wrapped(lengths):
    disparity = np.array([lengths], np.float32)
    height, width = disparity.shape
    image, mask = np.zeros((height, width, 3), np.uint8), np.full((height, width), OUTSIDE, np.uint8)
    camera = StereoCamera.centred(width, height, 60.0, 0.25)
    view = ViewArrays({"image": image, "disparity": disparity, "visibility": mask})
    frame = Frame(camera, view, view)
    for name in layout_names():
        layout = find_layout(name)
        pair = encoded(layout, 0, frame=frame)
        stored = decode(layout, 0, pair.files)
        is_ = stored.left.disparity
        limit = stored.encodings.disparity.limit_px + stored.encodings.disparity.error_px
        beyond = np.isfinite(disparity) & (disparity >= limit)
        if np.isfinite(limit):
            assert stored.provenance["disparity_beyond"] == {"left": beyond.sum(), "right": beyond.sum()}
        np.testing.assert_array_equal(np.isinf(is_), np.isinf(disparity) | beyond)
        valid = np.isfinite(is_)
        assert (is_[valid] > 0).all()
        assert (np.abs(is_[valid] - disparity[valid]) <= stored.rounding_px(disparity[valid])).all()
        np.testing.assert_array_equal(stored.right.disparity, is_)


def test_what_png16_cannot_say_is_invalid_everywhere():
    frame = make_frame(1)
    flow, mask = frame.left.flow.copy(), frame.left.flow_visibility.copy()
    flow[0, :3], flow[5, 5], mask[5, 5] = (600, 0), (0, -513), OCCLUDED
    disparity = frame.left.disparity.copy()
    disparity[7, 7] = 300
    left = frame.left.with_channels({"flow": flow, "flow_visibility": mask, "disparity": disparity})
    frame = Frame(frame.camera, left, frame.right)
    beyond = np.isfinite(flow).all(axis=2) & (np.abs(flow).max(axis=2) > 512)
    for name, encodings in (("kitti", None), ("middlebury", Encodings.from_names(disparity="png16", flow="png16"))):
        layout = find_layout(name)
        stored = decode(layout, 1, encode(layout, 1, frame=frame, encodings=encodings), encodings=encodings)
        counts = {key: value for key, value in stored.provenance.items() if key.endswith("_beyond")}
        assert counts == {
            "disparity_beyond": {"left": 1, "right": 0},
            "flow_beyond": {"left": beyond.sum(), "right": 0},
            "flow_backward_beyond": {"left": 0, "right": 0},
        }
        assert np.isinf(stored.left.flow[beyond]).all()
        assert (stored.left.flow_visibility[beyond] == OUTSIDE).all()
        np.testing.assert_array_equal(stored.left.flow_visibility[~beyond], mask[~beyond])
        assert np.isinf([stored.left.disparity[7, 7], stored.left.disparity_change[7, 7]]).all()
        assert stored.left.visibility[7, 7] == OUTSIDE
        assert name == "kitti" or stored.calibration.vmax_px < 256


@pytest.mark.parametrize("name", layout_names())
def test_broken_files_are_named(name):
    layout = find_layout(name)
    encodings = layout.encodings or Encodings()
    names = {path: role for role, path in layout.files(PairKey("lab", "train", 0), encodings).items()}
    for path, data in encode(layout, 0).items():
        if names[path] == "calib_cam_to_cam":
            continue  # no reader uses it
        for broken in (b"", data[: len(data) // 2], data[:-2], b"\x80abc" * 50):
            with pytest.raises(ReadError):
                decode_file(layout, names[path], broken, Path(path), encodings)


# Names


@pytest.mark.parametrize("name", layout_names())
def test_names_never_collide_and_stay_inside(name):
    layout = find_layout(name)
    encodings = layout.encodings or Encodings()
    for splits, length in ((SPLITS, None), (("train",), 3), (("train", "test"), 1)):
        seen = set()
        for split in splits:
            # A shard contains one split.
            folder = f"{split}:" if layout.packed else layout.folder(split, splits)
            keys = [PairKey("lab", split, index, length) for index in (*range(8), 2999, 3000, 3001, 999_999)]
            paths = [path for key in keys for path in layout.files(key, encodings).values()]
            paths += layout.lists_of(keys, encodings)
            assert len(set(paths)) == len(paths)
            assert seen.isdisjoint(f"{folder}{path}" for path in paths)
            seen.update(f"{folder}{path}" for path in paths)
            links = layout.links_of(keys)
            for path in (*paths, *links, *layout.folders):
                assert re.fullmatch(r"[\w./-]+", path, re.ASCII)
                assert not path.startswith("/")
                assert ".." not in path.split("/")
            for link, target in links.items():
                assert not os.path.normpath(f"{PurePosixPath(link).parent}/{target}").startswith(".."), link
                assert not any(path.startswith(f"{link}/") for path in paths), link


# Conversions of a frame


def test_kittis_objects_leave_out_what_stands_still():
    rows = [{"still": True}] * 6 + [{"still": False}] * 600
    ids = np.array([[0, 1, 6, 7, 8, 255, 256, 257, 511, 606]], np.uint16)
    assert number_objects(ids, rows).tolist() == [[0, 0, 0, 7, 8, 255, 1, 2, 1, 96]]
    layout, ids = find_layout("kitti"), make_frame(3).left.instances
    stored = encode(layout, 3)[layout.files(PairKey("lab", "train", 3), layout.encodings)["objects"]]
    np.testing.assert_array_equal(GREY8.decode(stored, Path("x")), number_objects(ids, make_provenance(3)["instances"]))


@settings(max_examples=60)
@given(
    st.sampled_from(EYES),
    st.lists(st.floats(0.015625, 70, width=32) | st.sampled_from([0.5, 1.5, 2.5, 6.5, np.inf]), min_size=7, max_size=7),
    st.lists(st.sampled_from([VISIBLE, OCCLUDED, OUTSIDE, 64]), min_size=7, max_size=7),
)
def test_a_hidden_point_is_outside_where_its_position_is(eye, disparity, mask):
    disparity, mask = np.array([disparity], np.float32), np.array([mask], np.uint8)
    restored = restore_outside(mask, disparity, eye)
    for x in range(7):
        # visibility.comp computes the same in float32.
        position = np.float32(x) + (-disparity[0, x] if eye == "left" else disparity[0, x])
        inside = np.isinf(disparity[0, x]) or -0.5 <= position < 6.5
        assert restored[0, x] == (OUTSIDE if mask[0, x] == OCCLUDED and not inside else mask[0, x])


def test_middleburys_calibration_gives_the_same_depth():
    camera = StereoCamera(48, 32, 1164.25, 0.193001, 17.5, 48.586, 10.25)
    frame = make_frame(3)
    frame = Frame(camera, frame.left, frame.right)
    files = encode(find_layout("middlebury"), 3, frame=frame)
    written = files["MiddEval3/trainingF/lab-000003/calib.txt"].decode().splitlines()
    values = dict(line.split("=") for line in written)
    rows = [[float(x) for x in row.split()] for row in values["cam0"].strip("[]").split(";")]
    assert rows == [[1164.25, 0, 17.5], [0, 1164.25, 10.25], [0, 0, 1]]
    disparity = camera.disparity_px(2.5)
    depth_mm = float(values["baseline"]) * rows[0][0] / (disparity + float(values["doffs"]))
    assert depth_mm == pytest.approx(2500, rel=1e-12)
    valid = frame.left.disparity[np.isfinite(frame.left.disparity)]
    assert float(values["vmin"]) == pytest.approx(valid.min(), rel=1e-5)
    assert float(values["vmax"]) == pytest.approx(valid.max(), rel=1e-5)


def test_kittis_calibration_is_the_camera():
    lines = dict(line.split(": ") for line in KITTI_CALIB.encode(CAMERA).decode().splitlines())
    left, right = (np.array(lines[f"P_rect_{eye}"].split(), float).reshape(3, 4) for eye in ("02", "03"))
    assert lines["S_rect_02"] == lines["S_rect_03"] == "48 32"
    np.testing.assert_array_equal(left[:, :3], [[60, 0, CAMERA.cx_left_px], [0, 60, CAMERA.cy_px], [0, 0, 1]])
    assert right[0, 2] == CAMERA.cx_right_px
    np.testing.assert_allclose(right[:, 3], [-60 * CAMERA.baseline_m, 0, 0])


def test_the_json_of_a_webdataset_never_changes_its_types():
    def shape(value):
        return {key: shape(each) for key, each in value.items()} if isinstance(value, dict) else type(value)

    layout = find_layout("webdataset")
    values = [json.loads(encode(layout, index)[f"{index:08d}.json"]) for index in (0, 1, 6)]
    assert shape(values[0]) == shape(values[1]) == shape(values[2])
    assert [value["redrawn"] for value in values] == [0, 0, 1]
    assert values[0]["near_m"] == 1.0
    assert values[0]["seed"] == 2**62 + 1
    for data in (b"{}", b'{"provenance": 3}', b'{"provenance": "["}'):
        with pytest.raises(ReadError):
            decode_file(layout, "provenance", data, Path("0.json"), Encodings())


# The loaders that docs/output.md lists must find all pairs, each with its own files


def globs(*patterns):
    """Zip the sorted files of several globs, as torchvision, RAFT-Stereo and others do."""

    def found(root):
        files = [sorted(glob(str(root / pattern))) for pattern in patterns]
        assert files[0]
        return list(zip(*files, strict=True))

    return found


def psmnet_sceneflow(root, parts=("TRAIN",), flying="frames_disparity"):
    """Walk one root as PSMNet does. HSM does the same with another folder of disparities."""
    folder = root / "SceneFlow" / "FlyingThings3D"
    trees = [each for each in os.listdir(folder) if (folder / each).is_dir()]
    assert not os.listdir(folder / next(each for each in trees if "monkaa_frames_cleanpass" in each))
    assert {"monkaa_disparity", "driving_disparity", "frames_cleanpass", flying} <= {*trees}
    for length in ("35mm_focallength", "15mm_focallength"):
        for scene in ("scene_backwards", "scene_forwards"):
            for speed in ("fast", "slow"):
                assert not os.listdir(folder / "driving_frames_cleanpass" / length / scene / speed / "left")
    for part in ("TRAIN", "TEST"):
        for letter in "ABC":
            for number in os.listdir(folder / "frames_cleanpass" / part / letter):
                place = f"{part}/{letter}/{number}"
                for image in os.listdir(folder / "frames_cleanpass" / place / "left"):
                    pfm = image.replace(".png", ".pfm")
                    if part in parts:
                        files = (("frames_cleanpass", "left", image), ("frames_cleanpass", "right", image))
                        files += ((flying, "left", pfm), (flying, "right", pfm))
                        yield tuple(f"{folder}/{tree}/{place}/{eye}/{name}" for tree, eye, name in files)


def from_list(name):
    """Read a list as GwcNet does."""

    def found(root):
        lines = (root / "filenames" / name).read_text().splitlines()
        return [tuple(str(root / path) for path in line.split(" ")) for line in lines]

    return found


def raft_middlebury(root):
    """Find scenes as RAFT-Stereo does, and check the line of calib.txt that HSM reads."""
    for name in (root / "MiddEval3" / "official_train.txt").read_text().splitlines():
        scene = root / "MiddEval3" / "trainingF" / name
        assert GREY8.read(scene / "mask0nocc.png").shape == (CAMERA.height_px, CAMERA.width_px)
        assert (scene / "calib.txt").read_text().splitlines()[6] == "ndisp=200"
        yield tuple(str(scene / file) for file in ("im0.png", "im1.png", "disp0GT.pfm", "disp1GT.pfm"))


def raft_middlebury_2014(root):
    for scene in (root / "2014").glob("*"):
        assert {RGB8.read(scene / f"im1{ending}.png").shape for ending in ("E", "L")} == {(32, 48, 3)}
        yield tuple(str(scene / name) for name in ("im0.png", "im1.png", "disp0.pfm"))


def of_kinds(folder, *names):
    """Find the files of CREStereo's four kinds of scenes."""
    kinds = [
        globs(*(f"{folder.format(kind)}/{name}" for name in names))
        for kind in ("shapenet", "reflective", "tree", "hole")
    ]
    return lambda root: [found for each in kinds for found in each(root)]


THINGS, BOTH = "SceneFlow/FlyingThings3D", ("*_left.jpg", "*_right.jpg", "*_left.disp.png")
LOADERS = {
    "kitti": (
        *(
            globs(*(f"{root}/{each}/*_10.png" for each in ("image_2", "image_3", "disp_occ_0", "disp_occ_1")))
            for root in ("training", "Kitti2015/training")
        ),
        from_list("KITTI_2015_train.txt"),
    ),
    "eth3d": [
        globs(*(f"{root}two_view_training{each}" for each in ("/*/im0.png", "/*/im1.png", "_gt/*/disp0GT.pfm")))
        for root in ("", "ETH3D/")
    ],
    "sceneflow": (
        *(
            globs(
                *(f"{THINGS}/{images}/TRAIN/*/*/{eye}/*.png" for eye in EYES),
                *(f"{THINGS}/disparity/TRAIN/*/*/{eye}/*.pfm" for eye in EYES),
            )
            for images in ("frames_cleanpass", "frames_finalpass")
        ),
        psmnet_sceneflow,
        partial(psmnet_sceneflow, flying="disparity"),
        *(from_list("sceneflow_train.txt"), from_list("SceneFlow_finalpass_train.txt")),
    ),
    "crestereo": (
        of_kinds("CREStereo/{}", *BOTH, "*_right.disp.png"),
        of_kinds("WAFT-Stereo/CREStereo/{}/*", *BOTH),
        globs(*(f"CREStereo/**/{name}" for name in BOTH)),
    ),
    "middlebury": (
        raft_middlebury,
        *(
            globs(*(f"{folder}/*/{each}" for each in ("im0.png", "im1.png", "disp0GT.pfm", "disp1GT.pfm")))
            for folder in ("carla-highres/trainingF", "MiddEval3/trainingH", "MiddEval3/trainingQ")
        ),
    ),
    "middlebury-2014": (
        raft_middlebury_2014,
        globs(*(f"Middlebury2014/train/*-perfect/{each}" for each in ("im0.png", "im1.png", "disp0.pfm", "disp1.pfm"))),
    ),
}


@pytest.mark.parametrize("name", [name for name in layout_names() if not find_layout(name).packed])
def test_loaders_find_every_pair_and_match_its_files(name, tmp_path):
    write_dataset(tmp_path, name, {"train": PAIRS}, PAIRS)
    if name == "middlebury-2014":  # torchvision requires the name of one of Middlebury's scenes
        assert any(entry.startswith("Adirondack") for entry in os.listdir(tmp_path / "Middlebury2014/train"))
    for loader in LOADERS[name]:
        assert sorted(matched(*found) for found in loader(tmp_path)) == list(range(PAIRS)), loader


def test_sceneflow_keeps_train_and_test_in_one_tree(tmp_path):
    write_dataset(tmp_path, "sceneflow", dict.fromkeys(SPLITS, 4), 4)
    for part in ("TRAIN", "TEST"):
        assert sorted(matched(*found) for found in psmnet_sceneflow(tmp_path, (part,))) == [0, 1, 2, 3]
    assert "/TEST/" in from_list("SceneFlow_finalpass_test.txt")(tmp_path)[0][0]
    assert len(list((tmp_path / "validation" / THINGS / "frames_cleanpass").glob("TEST/*/*/left/*.png"))) == 4


def raft_things(root, direction):
    """Yield image 1, image 2 and flow of the left camera as RAFT's FlyingThings3D does."""
    folder = root / "SceneFlow" / "FlyingThings3D"
    image_dirs = [f"{each}/left" for each in sorted(glob(str(folder / "frames_cleanpass" / "TRAIN/*/*")))]
    flow_dirs = [f"{each}/{direction}/left" for each in sorted(glob(str(folder / "optical_flow" / "TRAIN/*/*")))]
    for image_dir, flow_dir in zip(image_dirs, flow_dirs, strict=True):
        images, found = sorted(glob(f"{image_dir}/*.png")), sorted(glob(f"{flow_dir}/*.pfm"))
        assert len(images) == len(found)
        for i in range(len(found) - 1):
            future = direction == "into_future"
            yield (images[i], images[i + 1], found[i]) if future else (images[i + 1], images[i], found[i + 1])


def kitti_flow(root, folder):
    """Find images and flow as RAFT's KITTI and torchvision's KittiFlow do."""
    first, second = (sorted(glob(str(root / folder / "image_2" / f"*_{number}.png"))) for number in (10, 11))
    return list(zip(first, second, sorted(glob(str(root / folder / "flow_occ" / "*_10.png"))), strict=True))


def pair_of(path):
    """Read the pair's number from an image."""
    return round(int(cv2.imread(str(path))[4, 4, 2]) / 8)


@pytest.mark.parametrize(
    ("name", "loader", "array", "step"),
    [
        ("sceneflow", partial(raft_things, direction="into_future"), "flow_left", 1),
        ("sceneflow", partial(raft_things, direction="into_past"), "flow_backward_left", -1),
        ("kitti", partial(kitti_flow, folder="training"), "flow_left", 1),
        ("kitti", partial(kitti_flow, folder="KittiFlow/training"), "flow_left", 1),
    ],
)
def test_loaders_of_flow_pair_it_with_its_frames(tmp_path, name, loader, array, step):
    # SceneFlow's last sequence is incomplete.
    pairs = 14 if name == "sceneflow" else 9
    outputs = ["visibility", "instances", "flow", "flow_backward"]
    write_dataset(tmp_path, name, {"train": pairs}, 3, config_of(outputs=outputs, sequence={"length": 3}))
    found = list(loader(tmp_path))
    firsts = [pair_of(one) for one, _, _ in found]
    wanted = [pair for pair in range(pairs) if 0 <= pair + step < pairs and (pair + step) // 3 == pair // 3]
    assert sorted(firsts) == (wanted if name == "sceneflow" else [0, 3, 6])  # KITTI's loaders use the first two frames
    for (_, two, path), pair in zip(found, firsts, strict=True):
        assert pair_of(two) == pair + step
        stored, made = cv2.imread(path, cv2.IMREAD_UNCHANGED)[..., ::-1], make_frame(pair).arrays()[array]
        if name == "sceneflow":
            np.testing.assert_array_equal(stored[..., :2], made)
        else:
            np.testing.assert_array_equal(stored[..., 2], np.isfinite(made).all(axis=2))
            assert np.abs((stored[..., :2] / 64.0 - 512 - made)[np.isfinite(made)]).max() <= 1 / 128


# Packages


def test_webdataset_and_hugging_face_iterate_the_tars(tmp_path, monkeypatch):
    webdataset = pytest.importorskip("webdataset")
    for name, value in (("HF_HUB_OFFLINE", "1"), ("HF_HOME", str(tmp_path / "home"))):
        monkeypatch.setenv(name, value)
    datasets = pytest.importorskip("datasets")
    write_dataset(tmp_path / "set", "webdataset", {"train": 8}, 4)
    tars, dataset = sorted(glob(f"{tmp_path}/set/shards/*.tar")), open_dataset(tmp_path / "set")
    samples = list(webdataset.WebDataset(tars, shardshuffle=False))
    assert [sample["__key__"] for sample in samples] == [f"{index:08d}" for index in range(8)]
    for index, sample in enumerate(samples):
        assert PFM.decode(sample["disp1.pfm"], Path("x")).tobytes() == make_frame(index).right.disparity.tobytes()
        assert json.loads(json.loads(sample["json"])["provenance"]) == dataset[index].provenance
    cache = str(tmp_path / "cache")
    loaded = datasets.load_dataset("webdataset", data_files={"train": tars}, split="train", cache_dir=cache)
    assert loaded.features["json"]["camera"]["width_px"].dtype == "int64"
    assert loaded.features["json"]["near_m"].dtype == "float64"
    for index, row in enumerate(loaded):
        assert (row["__key__"], row["json"]["pair"]) == (f"{index:08d}", index)
        assert json.loads(row["json"]["provenance"]) == dataset[index].provenance
        np.testing.assert_array_equal(np.asarray(row["right.png"]), make_frame(index).right.image)
        disparity = cv2.imdecode(np.frombuffer(row["disp0.pfm"], np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(disparity, make_frame(index).left.disparity)
