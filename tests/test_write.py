"""What lands on disk, read back by other people's readers."""

import io
import json
from pathlib import PurePosixPath

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from semisynth_gl.camera import StereoCamera
from semisynth_gl.errors import InputError
from semisynth_gl.frame import Frame
from semisynth_gl.write.dataset import DatasetFolder
from semisynth_gl.write.middlebury import encode_scene, encode_scene_list, scene_name
from semisynth_gl.write.pfm import encode_pfm
from semisynth_gl.write.png import encode_png

sides = st.integers(1, 40)


def frame(width=37, height=21, seed=0):
    rng = np.random.default_rng(seed)
    disparity = rng.uniform(1, 90, (2, height, width)).astype(np.float32)
    disparity[0, 0, 0] = np.inf
    return Frame(
        StereoCamera(width, height, 1164.25, 0.193001, 17.5, 48.586, 10.25),
        *rng.integers(0, 256, (2, height, width, 3), dtype=np.uint8),
        *disparity,
        *rng.choice(np.array([0, 128, 255], np.uint8), (2, height, width)),
    )


@settings(deadline=None)
@given(hnp.arrays(np.uint8, st.one_of(st.tuples(sides, sides), st.tuples(sides, sides, st.just(3)))))
def test_png_is_read_back_by_pillow_and_opencv(image):
    data = encode_png(image)
    opened = Image.open(io.BytesIO(data))
    assert opened.mode == ("L" if image.ndim == 2 else "RGB")
    np.testing.assert_array_equal(np.asarray(opened), image)
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(decoded if image.ndim == 2 else decoded[..., ::-1], image)


@settings(deadline=None)
@given(hnp.arrays(np.float32, st.tuples(sides, sides), elements=st.floats(0, 1e4, width=32) | st.just(np.inf)))
def test_pfm_is_read_back_by_opencv(tmp_path_factory, image):
    path = tmp_path_factory.mktemp("pfm") / "disparity.pfm"
    path.write_bytes(encode_pfm(image))
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), image)


def test_pfm_has_the_header_that_loaders_expect():
    assert encode_pfm(np.zeros((3, 5), np.float32)) == b"Pf\n5 3\n-1.0\n" + bytes(60)
    upper = np.array([[1.0], [2.0]], np.float32)
    assert np.frombuffer(encode_pfm(upper)[-8:], "<f4").tolist() == [2.0, 1.0]


def test_sixteen_bit_png_is_read_back_by_opencv():
    ids = np.random.default_rng(0).integers(0, 65536, (9, 31)).astype(np.uint16)
    decoded = cv2.imdecode(np.frombuffer(encode_png(ids), np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, ids)


def test_calibration_reads_back_to_the_same_depth():
    written = encode_scene(frame(), {}, ndisp=100)["calib.txt"].decode().splitlines()
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
    files = encode_scene(shot, {"pair": 3}, ndisp=100)
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
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(files["im1.png"]))), shot.right)
    mask = Image.open(io.BytesIO(files["mask0nocc.png"]))
    assert mask.mode == "L"
    assert set(np.unique(mask)) == {0, 128, 255}
    assert json.loads(files["pair.json"]) == {"pair": 3}


def test_names_sort_as_numbers():
    names = [scene_name("kitti", index) for index in (2, 10, 999_999)]
    assert names == sorted(names) == ["kitti-000002", "kitti-000010", "kitti-999999"]
    assert encode_scene_list(names) == b"kitti-000002\nkitti-000010\nkitti-999999\n"


def test_nothing_changes_on_disk_before_open(tmp_path):
    out = tmp_path / "new" / "deep"
    folder = DatasetFolder(out, overwrite=False)
    assert not out.parent.exists()
    folder.open()
    folder.add_folder(PurePosixPath("MiddEval3/trainingF/a"), {"x": b"1", "y": b"2"})
    folder.finish({"pairs": 1})
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()) == [
        *("MiddEval3/trainingF/a/x", "MiddEval3/trainingF/a/y", "dataset.json"),
    ]


def test_a_full_folder_is_refused_and_untouched(tmp_path):
    (tmp_path / "precious.txt").write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(InputError, match=r"precious\.txt"):
            DatasetFolder(tmp_path, overwrite=overwrite)
    assert (tmp_path / "precious.txt").read_text() == "mine"


def test_somebody_elses_middeval3_is_never_overwritten(tmp_path):
    (tmp_path / "MiddEval3" / "trainingF").mkdir(parents=True)
    (tmp_path / "MiddEval3" / "trainingF" / "real.png").write_text("real data")
    with pytest.raises(InputError, match="MiddEval3"):
        DatasetFolder(tmp_path, overwrite=True)


def test_a_file_called_dataset_json_proves_nothing(tmp_path):
    scene = tmp_path / "MiddEval3" / "trainingF" / "Adirondack"
    scene.mkdir(parents=True)
    (scene / "im0.png").write_text("real data")
    for text in ('{"my": 1}', "not json", "[]"):
        (tmp_path / "dataset.json").write_text(text)
        with pytest.raises(InputError, match="Choose another folder"):
            DatasetFolder(tmp_path, overwrite=True)
    (tmp_path / "dataset.json").write_text('{"program": "semisynth-gl"}')
    with pytest.raises(InputError, match="trainingF/Adirondack"):
        DatasetFolder(tmp_path, overwrite=True)
    assert (scene / "im0.png").read_text() == "real data"


def test_overwrite_replaces_an_own_dataset_only(tmp_path):
    out = tmp_path / "out"
    for content in (b"old", b"new"):
        folder = DatasetFolder(out, overwrite=True)
        folder.open()
        folder.add_folder(PurePosixPath("MiddEval3/trainingF") / content.decode(), {"pair.json": content})
        folder.finish({"program": "semisynth-gl"})
    assert [p.name for p in (out / "MiddEval3" / "trainingF").iterdir()] == ["new"]
    (out / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        DatasetFolder(out, overwrite=True)
    (out / "notes.txt").unlink()
    with pytest.raises(InputError, match="not empty"):
        DatasetFolder(out, overwrite=False)


def test_a_failure_leaves_no_half_scene(tmp_path):
    out = tmp_path / "out"
    folder = DatasetFolder(out, overwrite=False)
    folder.open()
    folder.add_folder(PurePosixPath("MiddEval3/trainingF/whole"), {"pair.json": b"1"})
    with pytest.raises(TypeError):
        folder.add_folder(PurePosixPath("MiddEval3/trainingF/half"), {"x": b"1", "y": None})
    folder.abandon()
    assert [p.name for p in (out / "MiddEval3").rglob("*") if p.is_file()] == ["pair.json"]
    assert not (out / "dataset.json").exists()
    # What a stopped run left behind counts as ours.
    DatasetFolder(out, overwrite=True).open()
    assert not (out / "MiddEval3").exists()


def test_an_abandoned_empty_run_leaves_nothing(tmp_path):
    folder = DatasetFolder(tmp_path / "out", overwrite=False)
    folder.open()
    folder.abandon()
    assert not (tmp_path / "out").exists()
    (tmp_path / "mine").mkdir()
    folder = DatasetFolder(tmp_path / "mine", overwrite=False)
    folder.open()
    folder.abandon()
    assert (tmp_path / "mine").is_dir()


def test_a_file_in_the_way_is_refused(tmp_path):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(InputError, match="it is a file"):
        DatasetFolder(tmp_path / "out", overwrite=True)
    with pytest.raises(InputError, match="cannot be written"):
        DatasetFolder(tmp_path / "out" / "below", overwrite=False).open()
