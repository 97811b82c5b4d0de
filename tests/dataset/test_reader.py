"""The dataset reader: many processes, files of another size, and folders that are no dataset."""

import json
import multiprocessing
import re
from multiprocessing.pool import ThreadPool

import numpy as np
import pytest
from hand_made_datasets import config_of, write_dataset
from hand_made_pairs import CAMERA, make_frame
from planted_faults import change_json, findings
from tiny_datasets import SCENES

from semisynth_gl.codecs import Encodings
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.frame.channels import OUTPUTS
from semisynth_gl.inputs.errors import InputError, ReadError, SemisynthError
from semisynth_gl.layouts import find_layout, layout_names

PAIRS, READS = 8, 100


def test_what_is_no_dataset_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    write_dataset(tmp_path / "set", "eth3d", {"train": 1}, 1)
    for path, said in (("none", "no such folder"), ("file", "neither"), ("", "neither"), ("set/shards", "set$")):
        with pytest.raises(InputError, match=f"not a dataset: .*{said}"):
            read_index(tmp_path / path)
    (tmp_path / "set/index.json").write_text("{")
    with pytest.raises(ReadError, match=r"index\.json: is not JSON.*remove it"):
        read_index(tmp_path / "set")
    (tmp_path / "index.json").write_text(json.dumps({"program": "another"}))
    with pytest.raises(ReadError, match=r"index\.json: program: .*'another'"):
        read_index(tmp_path)


def test_a_dataset_without_the_section_has_the_default_encodings(tmp_path):
    """Another version of the program may have written a config with missing or additional sections."""
    plan = make_plan(config_of(), 0, "middlebury", {"train": 1}).values()
    values = plan["config_values"]
    del values["files"], values["imperfections"]
    values["of_the_future"] = {"x": 1}
    (tmp_path / "shards").mkdir()
    path = tmp_path / "shards/plan.json"
    path.write_text(json.dumps(plan))
    assert read_index(tmp_path).plan.encodings == Encodings()
    values["files"] = {"image": "webp"}
    path.write_text(json.dumps(plan))
    with pytest.raises(SemisynthError, match=r"files\.image: expected one of .*'webp'"):
        read_index(tmp_path)


def test_16_bit_disparities_beyond_256_px_are_counted(tmp_path, program):
    keys = ["files.disparity=png16", "disparity={min_px: 20, max_px: 430, target: {form: uniform}}", "scenes=[]"]
    keys += ["camera.width_px=900", "camera.height_px=60", "textures={source: procedural}", "models.complex=0"]
    options = [word for key in keys for word in ("--set", key)]
    out = tmp_path / "out"
    code, _, err = program("generate", "--config", "middlebury", "--out", out, "--pairs", 1, "--seed", 1, *options)
    assert code == 0, err
    assert "disparities above 256 px, of up to 430 px, become invalid: 16-bit PNG" in err
    signed = ["--set", "camera.doffs_px=450", "--set", "disparity={signed: true, min_px: -400}"]
    _, _, err_signed = program(
        "generate", "--config", "middlebury", "--out", tmp_path / "b", "--pairs", 1, *options, *signed
    )
    assert "disparities below -128 px, of up to -400 px, become invalid" in err_signed
    assert findings(out, 100) == []
    path = out / SCENES / "middlebury-000000" / "pair.json"
    (record,) = (out / "shards").glob("semisynth-*.json")
    (sample,) = json.loads(record.read_text())["samples"]
    assert 0 < sample["share_beyond"] == max(json.loads(path.read_text())["disparity_beyond"].values()) / (900 * 60)
    change_json(path, lambda pair: pair["disparity_beyond"].update(left=1_000_000))
    assert any("beyond the encoding" in finding.message for finding in findings(out))


def check(opened, seed):
    """Read pairs in a random order."""
    for number in np.random.default_rng(seed).integers(0, PAIRS, READS).tolist():
        truth = make_frame(number, ()).arrays()
        arrays = opened[number].arrays()
        assert arrays.keys() == truth.keys()
        assert all(np.array_equal(array, truth[role]) for role, array in arrays.items())


@pytest.mark.parametrize("method", ["fork", "spawn", "threads"])
def test_many_readers_share_an_open_dataset(tmp_path, method):
    write_dataset(tmp_path, "webdataset", {"train": PAIRS}, 3, config_of(outputs=[]))
    opened = open_dataset(tmp_path)
    # Read first, so that the reader has its files open when processes or threads share it.
    check(opened, 0)
    pool = ThreadPool(4) if method == "threads" else multiprocessing.get_context(method).Pool(2)
    with pool:
        pool.starmap(check, [(opened, seed) for seed in range(4)], chunksize=1)


# Files of another size than the dataset's images


@pytest.mark.parametrize("name", [name for name in layout_names() if not find_layout(name).packed])
def test_a_file_of_another_size_is_refused(tmp_path, name):
    layout = find_layout(name)
    lossless = (layout.encodings or Encodings()).image.lossless
    outputs = [output for output in OUTPUTS if output not in layout.lacks and (lossless or output != "raw")]
    eye = {"fx_px": 50, "distortion": [0, 0, 0, 0]}
    lens = {"raw_width_px": 64, "raw_height_px": 48, "left": eye, "right": eye}
    write_dataset(tmp_path, name, {"train": 1}, 1, config_of(outputs=outputs, lens=lens))
    dataset = open_dataset(tmp_path)
    assert dataset[0].left.image.shape == (CAMERA.height_px, CAMERA.width_px, 3)
    for number, (role, path) in enumerate(dataset.index.plan.files("train", 0).items()):
        data, codec = (tmp_path / path).read_bytes(), layout.role(role).codec(dataset.index.plan.encodings)
        value = codec.decode(data, path)
        if not isinstance(value, np.ndarray):
            continue
        changed = np.ascontiguousarray(
            (value[:-1], value[:, :-1], value.repeat(2, axis=0).repeat(2, axis=1))[number % 3]
        )
        (tmp_path / path).write_bytes(codec.encode(changed))
        said = f"^{re.escape(f'{tmp_path}/{path}')}: expected a height.*got {re.escape(str(changed.shape[:2]))}"
        with pytest.raises(ReadError, match=said):
            dataset[0]
        assert [path in finding.message for finding in findings(tmp_path) if finding.check == "size"] == [True], role
        (tmp_path / path).write_bytes(data)


def test_a_pair_of_another_dataset_or_camera_is_refused(tmp_path):
    """All files of the pair have the same size, but not the dataset's."""
    write_dataset(tmp_path / "set", "eth3d", {"train": 1}, 1)
    calib = tmp_path / "set" / open_dataset(tmp_path / "set").index.plan.files("train", 0)["calibration"]
    text = calib.read_text()
    calib.write_text(text.replace("width=48", "width=50"))
    with pytest.raises(ReadError, match=r"calib\.txt: expected a height and width of \(32, 48\) px.*got \(32, 50\)"):
        open_dataset(tmp_path / "set")[0]
    calib.write_text(text)
    change_json(tmp_path / "set/index.json", lambda index: index["config_values"]["camera"].update(height_px=64))
    with pytest.raises(ReadError, match=r"im0\.png: expected a height and width of \(64, 48\) px"):
        open_dataset(tmp_path / "set")[0]
