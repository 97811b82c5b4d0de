"""Clean datasets have no finding, and each planted fault has one."""

import json
import re
import shutil
import sys

import numpy as np
import pytest
from backends import backend_fault
from PIL import Image
from planted_faults import all_findings, change_disparity, change_image, checks, findings, swap
from recorder import Recorder
from tiny_datasets import SCENES, cheap, lean, tiny

from semisynth_gl.cli import main
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import GREY16
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import read_index
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.verify import verify_dataset

BENCHMARKS = ("middlebury", "kitti", "eth3d", "sceneflow")
ALL_OUTPUTS = ("visibility", "instances", "depth")


def config_of(name, outputs=("visibility",)):
    # Faults are planted in Middlebury's, which rays are cast at for each.
    config = lean(name) if name == "middlebury" else tiny(name)
    return config.model_copy(update={"outputs": outputs})


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    root = tmp_path_factory.mktemp("datasets")
    for name in BENCHMARKS:
        generate(config_of(name), root / name, 3, 0)
    generate(config_of("middlebury", ALL_OUTPUTS), root / "all", 2, 0)
    return root


@pytest.fixture
def dataset(datasets, tmp_path):
    """Middlebury's, to plant a fault in."""
    return shutil.copytree(datasets / "middlebury", tmp_path / "dataset", symlinks=True)


@pytest.fixture
def dataset_of_all(datasets, tmp_path):
    """With every output."""
    return shutil.copytree(datasets / "all", tmp_path / "dataset", symlinks=True)


def scene_of(dataset, number=1):
    return dataset / SCENES / f"middlebury-{number:06d}"


def fit_calibration(scene):
    """Make vmin and vmax those of the disparity, so that they do not give a fault away."""
    disparity = PFM.read(scene / "disp0GT.pfm")
    path = scene / "calib.txt"
    text = re.sub("vmin=.*", f"vmin={disparity.min():g}", path.read_text())
    path.write_text(re.sub("vmax=.*", f"vmax={disparity.max():g}", text))


IMAGES, DISPARITIES, MASKS = ("im0.png", "im1.png"), ("disp0GT.pfm", "disp1GT.pfm"), ("mask0nocc.png", "mask1nocc.png")


@pytest.mark.parametrize("name", [*BENCHMARKS, "all"])
def test_a_clean_dataset_has_no_finding(datasets, name):
    verdicts = list(verify_dataset(read_index(datasets / name), 200))
    assert [str(finding) for verdict in verdicts for finding in verdict.findings] == []
    assert len(verdicts) == 1 + (2 if name == "all" else 3)
    for verdict in verdicts[1:]:
        assert verdict.measures["oracle_largest_px"] < 1e-3
        assert verdict.measures["residual_explained_share"] > 0.95
        assert abs(verdict.measures["best_shift_x_px"]) < 0.1
        assert verdict.measures["invalid_share"] == 0


@pytest.mark.parametrize("name", IMAGES)
@pytest.mark.parametrize("axis", [0, 1], ids=["upside-down", "mirrored"])
def test_a_flipped_image_is_found(dataset, name, axis):
    change_image(scene_of(dataset) / name, lambda image: np.flip(image, axis))
    assert checks(dataset) == {"images"}
    assert {finding.scene for finding in findings(dataset)} == {"middlebury-000001"}


def test_imperfect_images_are_judged_after_their_levels_are_matched(dataset):
    index = json.loads((dataset / "index.json").read_text())
    index["config_values"]["imperfections"] = {"noise": [2.0, 4.0], "gamma": 1.0, "exposure_stops": [-1.0, 0.0]}
    (dataset / "index.json").write_text(json.dumps(index))
    for number in range(3):
        change_image(scene_of(dataset, number) / "im1.png", lambda image: (image // 2).astype(np.uint8))
    assert "images" not in checks(dataset)
    verdict = next(each for each in verify_dataset(read_index(dataset)) if "image_correlation" in each.measures)
    assert abs(verdict.measures["best_shift_x_px"]) < 0.1
    right = scene_of(dataset, 1) / "im1.png"
    for change in (lambda image: np.roll(image, 1, 1), lambda image: np.roll(image, -1, 1)):
        before = right.read_bytes()
        change_image(right, change)
        found = [each.message for each in findings(dataset) if each.check == "images"]
        assert found
        right.write_bytes(before)
    change_image(scene_of(dataset, 0) / "im0.png", lambda image: image[::-1, ::-1])
    (finding,) = (each for each in findings(dataset) if each.check == "images")
    assert "correlate" in finding.message


def test_an_image_of_another_pair_is_found(dataset):
    shutil.copy(scene_of(dataset, 0) / "im1.png", scene_of(dataset) / "im1.png")
    assert checks(dataset) == {"images"}


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda d: d + 0.5, id="half a pixel more"),
        pytest.param(lambda d: d - 0.5, id="half a pixel less"),
        pytest.param(lambda d: d * 1.01, id="times 1.01"),
        pytest.param(lambda d: d / 1.01, id="times 0.99"),
    ],
)
@pytest.mark.parametrize("names", [DISPARITIES[:1], DISPARITIES[1:], DISPARITIES], ids=["left", "right", "both"])
def test_a_wrong_disparity_is_found(dataset, change, names):
    for number in range(3):
        scene = scene_of(dataset, number)
        for name in names:
            change_disparity(scene / name, change)
        fit_calibration(scene)
    # The two views agree where both are wrong alike: then only the rays tell.
    both = names == DISPARITIES
    found, check = findings(dataset, 50 if both else 0), "oracle" if both else "left-right"
    assert {finding.scene for finding in found if finding.check == check} == {
        f"middlebury-{number:06d}" for number in range(3)
    }


def test_a_wrong_disparity_gives_calib_away(dataset):
    for name in DISPARITIES:
        change_disparity(scene_of(dataset) / name, lambda d: d * 1.01)
    assert "calib" in checks(dataset)


@pytest.mark.parametrize(
    ("pairs", "check"),
    [
        ([IMAGES], "images"),
        ([DISPARITIES], "left-right"),
        ([IMAGES, DISPARITIES], "left-right"),
        ([IMAGES, DISPARITIES, MASKS], "left-right"),
        ([MASKS], "mask"),
    ],
)
def test_swapped_views_are_found(dataset, pairs, check):
    swap(scene_of(dataset), *pairs)
    fit_calibration(scene_of(dataset))
    assert check in checks(dataset)


@pytest.mark.parametrize("name", [*IMAGES, *DISPARITIES, *MASKS, "calib.txt", "pair.json"])
@pytest.mark.parametrize("left", [None, 0, 1, -1], ids=["missing", "empty", "half", "last byte"])
def test_a_missing_or_truncated_file_is_found(dataset, name, left):
    path = scene_of(dataset) / name
    data = path.read_bytes()
    # The last byte of a JSON file is a line's end after the object, which nobody misses.
    whole = len(data.rstrip(b"\n")) if path.suffix == ".json" else len(data)
    if left is None:
        path.unlink()
    else:
        path.write_bytes(data[: {0: 0, 1: len(data) // 2, -1: whole - 1}[left]])
    (found,) = findings(dataset)
    assert (found.scene, found.check) == ("middlebury-000001", "files")
    assert found.message.startswith(f"{SCENES}/middlebury-000001/{name} {'is missing' if left is None else ''}")


@pytest.mark.parametrize("value", [np.nan, -np.inf, np.inf, 0.0, -3.0, 1e6])
@pytest.mark.parametrize("name", DISPARITIES)
def test_one_bad_disparity_is_found(dataset, name, value):
    def plant(disparity):
        disparity[30, 40] = value
        return disparity

    change_disparity(scene_of(dataset) / name, plant)
    found = findings(dataset)
    assert "disparity" in {finding.check for finding in found}
    if value != 1e6:
        assert any("(40, 30)" in finding.message for finding in found)


@pytest.mark.parametrize("name", MASKS)
def test_a_mask_of_another_pair_is_found(datasets, tmp_path, name):
    for benchmark in BENCHMARKS:
        dataset = shutil.copytree(datasets / benchmark, tmp_path / benchmark)
        scenes = dataset / SCENES
        shutil.copy(scenes / f"{benchmark}-000000" / name, scenes / f"{benchmark}-000001" / name)
        assert "mask" in checks(dataset)


def test_a_mask_with_other_values_is_found(dataset):
    change_image(scene_of(dataset) / "mask0nocc.png", lambda mask: mask // 2)
    assert any("got 64, 127" in finding.message for finding in findings(dataset))


def test_files_that_mislead_are_found(dataset):
    scene = scene_of(dataset)
    shutil.copy(scene / "disp0GT.pfm", scene / "disp0other.pfm")
    shutil.copytree(scene, dataset / SCENES / "middlebury-000009")
    messages = [str(finding) for finding in findings(dataset)]
    assert messages == [
        f"dataset: files: {SCENES}/middlebury-{name} does not belong here: the index lists no such file"
        for name in ("000001/disp0other.pfm", *(f"000009/{file.name}" for file in sorted(scene.iterdir())))
    ]


def test_images_of_another_kind_or_size_are_found(dataset):
    Image.open(scene_of(dataset, 0) / "im0.png").convert("P").save(scene_of(dataset, 0) / "im0.png")
    change_image(scene_of(dataset, 1) / "im1.png", lambda image: image[:, :-1])
    change_image(scene_of(dataset, 2) / "mask0nocc.png", lambda mask: np.stack([mask] * 3, axis=2))
    assert [(finding.scene[-1], finding.check) for finding in findings(dataset)] == [
        ("0", "files"),
        ("1", "size"),
        ("2", "files"),
    ]


def test_an_index_of_another_config_is_found(dataset, datasets):
    index = json.loads((dataset / "index.json").read_text())
    other = json.loads((datasets / "kitti" / "index.json").read_text())
    other |= {key: index[key] for key in ("layout", "pairs", "shard_pairs", "shards")} | {"config": "middlebury"}
    (dataset / "index.json").write_text(json.dumps(other))
    assert {"origin", "size"} <= checks(dataset)
    other["config_values"]["name"] = "middlebury"
    (dataset / "index.json").write_text(json.dumps(other))
    assert {"origin", "size"} <= checks(dataset)
    index["config_values"]["disparity"]["max_px"] += 1
    (dataset / "index.json").write_text(json.dumps(index))
    assert checks(dataset) == {"index"}


def test_another_seed_is_found_by_the_oracle(dataset):
    path = dataset / "index.json"
    path.write_text(path.read_text().replace('"seed": 0', '"seed": 1'))
    assert {"origin", "oracle"} <= checks(dataset, 50)


@pytest.mark.parametrize(
    ("key", "value"), [("seed", -1), ("splits", {"train": {"patches": []}}), ("config_values", {"name": "x"})]
)
def test_the_oracle_refuses_what_it_cannot_make_again(dataset, key, value):
    index = json.loads((dataset / "index.json").read_text()) | {key: value}
    (dataset / "index.json").write_text(json.dumps(index))
    with pytest.raises(InputError, match="cannot be rebuilt"):
        findings(dataset, 50)


def test_an_unfinished_dataset_is_found(dataset):
    (dataset / "index.json").unlink()
    found = findings(dataset)
    assert [finding.check for finding in found] == ["index"]
    assert "not finished" in found[0].message


@pytest.mark.parametrize("layout", ["middlebury", "webdataset"])
def test_of_an_unfinished_dataset_what_is_there_is_checked(tmp_path, layout):
    listener = Recorder(stops_at=lambda pair: pair.index == 3)
    generate(cheap(name="middlebury"), tmp_path / "set", 7, layout=layout, shard_pairs=3, listener=listener)
    said = [str(finding) for finding in findings(tmp_path / "set")]
    assert "not finished" in said[0]
    if layout == "webdataset":
        assert said[1] == "dataset: index: 1 of 7 pairs not made yet"
        return
    assert said[1] == "dataset: index: 3 of 7 pairs not made yet"
    assert all("shard is not finished" in line for line in said[2:])
    shutil.rmtree(scene_of(tmp_path / "set", 1))
    assert any(line.startswith("middlebury-000001: files: ") for line in map(str, findings(tmp_path / "set")))


def test_lists_are_compared(dataset):
    listed = dataset / "MiddEval3" / "official_train.txt"
    listed.write_text("middlebury-000000\nmiddlebury-000002\n")
    assert any("lacks middlebury-000001" in finding.message for finding in findings(dataset))
    listed.unlink()
    shutil.rmtree(scene_of(dataset, 2))
    assert [(finding.scene, finding.check) for finding in findings(dataset)] == [
        ("dataset", "files"),
        *[("middlebury-000002", "files")] * 8,
    ]


def test_calibration_is_compared(dataset):
    path = scene_of(dataset) / "calib.txt"
    original = path.read_text()
    for pattern, new, words in (
        ("doffs=.*", "doffs=0", "doffs"),
        ("baseline=.*", "baseline=193.0", "baseline_m"),
        ("ndisp=.*", "ndisp=5", "ndisp 5"),
        ("vmax=.*", "vmax=5", "vmax is 5"),
    ):
        path.write_text(re.sub(pattern, new, original))
        assert any(finding.check == "calib" and words in finding.message for finding in findings(dataset))


def test_depth_and_instances_are_compared(dataset_of_all):
    change_disparity(scene_of(dataset_of_all, 0) / "depth0.pfm", lambda depth: depth * 1.0001)
    scene = scene_of(dataset_of_all, 1)
    ids = np.asarray(Image.open(scene / "inst1.png")).astype(np.uint16)
    (scene / "inst1.png").write_bytes(GREY16.encode(np.where(ids == 1, 60000, ids).astype(np.uint16)))
    assert [(finding.scene[-1], finding.check) for finding in findings(dataset_of_all)] == [
        ("0", "depth"),
        ("1", "instances"),
    ]
    (scene / "inst0.png").unlink()
    assert any(finding.message.endswith("inst0.png is missing") for finding in findings(dataset_of_all))


def test_a_changed_byte_is_found_by_its_digest(dataset):
    path = scene_of(dataset) / "pair.json"
    path.write_text(path.read_text().replace("{", "{ ", 1))
    found = all_findings(dataset)
    assert [(finding.scene, finding.check) for finding in found] == [("middlebury-000001", "sha256")]
    assert "pair.json has" in found[0].message


def test_records_are_compared_with_the_index(dataset):
    records = sorted((dataset / "shards").glob("semisynth-*.json"))
    assert len(records) == 3
    record = json.loads(records[0].read_text())
    records[0].write_text(json.dumps(record | {"bytes": 1}))
    records[1].unlink()
    record = json.loads(records[2].read_text())
    record["samples"][0]["files"].pop(f"{SCENES}/middlebury-000002/calib.txt")
    records[2].write_text(json.dumps(record))
    asked = "but layout and outputs ask for it"
    assert [(finding.scene[-1], finding.check, finding.message.split(":")[0]) for finding in all_findings(dataset)] == [
        ("0", "shard", records[0].stem),
        ("1", "shard", f"shards/{records[1].name} is missing"),
        ("2", "files", f"{SCENES}/middlebury-000002/calib.txt is not in the shard's record, {asked}"),
    ]


@pytest.fixture
def call(monkeypatch, capsys):
    def caller(*arguments):
        monkeypatch.setattr(sys, "argv", ["semisynth-gl", "verify", *map(str, arguments)])
        with pytest.raises(SystemExit) as stopped:
            main()
        return stopped.value.code, *capsys.readouterr()

    return caller


def test_the_command_tells_what_it_found(call, dataset, tmp_path):
    code, out, err = call(dataset, "--oracle", "--pixels", 50, "--json", tmp_path / "report.json")
    assert code == 0, out
    assert out.startswith("3 pairs, nothing found; at worst: ")
    assert "3 of 3 pairs" in err
    (scene_of(dataset) / "im0.png").unlink()
    code, out, err = call(dataset, "--json", tmp_path / "report.json")
    assert code == 1
    assert out == f"middlebury-000001: files: {SCENES}/middlebury-000001/im0.png is missing\n"
    assert "1 finding in 1 of 3 pairs" in err
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["findings"] == [
        {"scene": "middlebury-000001", "check": "files", "message": out.split(": ")[2].strip()}
    ]
    assert report["measures"]["middlebury-000000"]["visibility_left_disagree_share"] < 0.01


def test_the_command_refuses_what_is_no_dataset(call, tmp_path, dataset):
    for arguments in (("nowhere",), (tmp_path / "none",), (dataset, "--json", tmp_path / "no" / "x.json"), ()):
        code, out, err = call(*arguments)
        assert code == 2
        assert out == ""
        assert err
        assert "Traceback" not in err
