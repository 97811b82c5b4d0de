"""Datasets on disk, opened again: what is no dataset, and datasets of each encoding, which verify finds clean."""

import json
import sys

import numpy as np
import pytest
from backends import backend_fault
from hand_made_datasets import config_of
from recorder import Recorder
from tiny_datasets import SCENES, lean, tiny

from semisynth_gl.cli import main
from semisynth_gl.codecs import DISPARITY_CODECS, Encodings
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import DamagedIndexError, open_dataset, read_index
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.verify import verify_dataset
from semisynth_gl.pairs.pipeline import render_pair


@pytest.fixture(scope="module")
def drawn():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return render_pair(lean(), 0, 5)


def findings(folder, rays=100):
    """Findings of verify, less those of the digest, which gives every change of a file away."""
    return [
        str(finding)
        for verdict in verify_dataset(read_index(folder), rays)
        for finding in verdict.findings
        if finding.check != "sha256"
    ]


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
    with pytest.raises(DamagedIndexError, match="field required"):
        read_index(tmp_path)


def test_a_dataset_without_the_section_has_the_default_encodings(tmp_path):
    """As another version may have written it: with less, or more, in its config."""
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
    with pytest.raises(InputError, match=r"files\.image: expected one of .*'webp'"):
        read_index(tmp_path)


@pytest.mark.parametrize("names", [("png", "pfm"), ("png", "png16")], ids="-".join)
def test_a_dataset_reads_back_and_verifies_clean(drawn, tmp_path, names):
    encodings = Encodings.from_names(*names)
    config = lean(files={"image": names[0], "disparity": names[1]})
    config = config.model_copy(update={"outputs": ("visibility", "instances", "depth")})
    recorder = Recorder()
    generate(config, tmp_path, 1, 5, listener=recorder)
    assert [pair.share_beyond for pair in recorder.pairs] == [0]
    scene = tmp_path / SCENES / "middlebury-000000"
    files = {file.name for file in scene.iterdir()}
    image, disparity = encodings.image.suffix, encodings.disparity.suffix
    assert {f"im0{image}", f"im1{image}", f"disp0GT{disparity}", f"disp1GT{disparity}"} <= files
    assert len(files) == 12
    assert read_index(tmp_path).plan.encodings == encodings
    stored = open_dataset(tmp_path)[0]
    np.testing.assert_array_equal(stored.left.image, drawn.left.image)
    np.testing.assert_array_equal(stored.right.image, drawn.right.image)
    np.testing.assert_allclose(
        stored.right.disparity, drawn.right.disparity, rtol=0, atol=1 / 512 if names[1] == "png16" else 0
    )
    assert findings(tmp_path) == []
    # Ten times the rounding.
    wrong = stored.left.disparity + np.float32(0.02)
    (scene / f"disp0GT{disparity}").write_bytes(DISPARITY_CODECS[names[1]].encode(wrong))
    assert any(": depth: depth_left" in finding for finding in findings(tmp_path, 0))


def test_a_dataset_beyond_256_px_is_reported_and_verifies_clean(drawn, tmp_path, monkeypatch, capsys):
    del drawn
    # 16 times as many pixels to a radian: disparities go to 430 px.
    config = tiny(files={"disparity": "png16"}).model_dump(mode="json")
    for section, keys in (
        ("camera", ("focal_px", "cx_left_px", "cx_right_px", "cy_px", "doffs_px")),
        ("disparity", ("min_px", "max_px")),
        ("background", ("wall_disparity_px", "plane_disparity_px")),
    ):
        for key in keys:
            value = config[section][key]
            config[section][key] = [each * 16 for each in value] if isinstance(value, list) else value and value * 16
    config["disparity"]["target"]["bin_px"] *= 16
    config["camera"] |= {"width_px": 900, "height_px": 60}
    config["particles"] |= {"size_px": [60.0, 200.0]}
    (tmp_path / "config.yaml").write_text(json.dumps(config))
    out = tmp_path / "out"
    arguments = ["--config", str(tmp_path / "config.yaml"), "--out", str(out), "--pairs", "1", "--seed", "1"]
    monkeypatch.setattr(sys, "argv", ["semisynth-gl", "generate", *arguments])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 0
    assert "in 1 pair more than 1% of the pixels have a disparity that png16 cannot hold" in capsys.readouterr().err
    assert findings(out) == []
    path = out / SCENES / "middlebury-000000" / "pair.json"
    pair = json.loads(path.read_text())
    pair["disparity_beyond"]["left"] += 1000_000
    path.write_text(json.dumps(pair))
    assert any("beyond the encoding" in finding for finding in findings(out, 0))
