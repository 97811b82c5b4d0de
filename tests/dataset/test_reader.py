"""Datasets on disk, opened again: what is no dataset, and datasets of each encoding, which verify finds clean."""

import json

import numpy as np
import pytest
from backends import backend_fault
from hand_made_datasets import config_of
from tiny_datasets import CLUTTER_ALONE, SCENES, lean

from semisynth_gl.codecs import DISPARITY_CODECS, Encodings
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import DamagedIndexError, open_dataset, read_index
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.verify import verify_dataset


@pytest.fixture
def _opengl():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")


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


@pytest.mark.usefixtures("_opengl")
def test_a_dataset_of_16_bit_disparities_verifies_clean_until_they_are_changed(tmp_path):
    config = lean(files={"disparity": "png16"})
    config = config.model_copy(update={"outputs": ("visibility", "instances", "depth")})
    generate(config, tmp_path, 1, 5)
    assert read_index(tmp_path).plan.encodings == Encodings.from_names("png", "png16")
    assert findings(tmp_path) == []
    # Ten times the rounding.
    wrong = open_dataset(tmp_path)[0].left.disparity + np.float32(0.02)
    path = tmp_path / SCENES / "middlebury-000000/disp0GT.png"
    path.write_bytes(DISPARITY_CODECS["png16"].encode(wrong))
    assert any(": depth: depth_left" in finding for finding in findings(tmp_path, 0))


@pytest.mark.usefixtures("_opengl")
def test_a_dataset_beyond_256_px_is_reported_and_verifies_clean(tmp_path, program):
    keys = ["files.disparity=png16", "disparity={min_px: 20, max_px: 430, target: {form: uniform}}"]
    keys += ["camera.width_px=900", "camera.height_px=60", "textures.source=procedural", "models.complex=0"]
    options = [word for key in (*CLUTTER_ALONE, *keys) for word in ("--set", key)]
    out = tmp_path / "out"
    code, _, err = program("generate", "--config", "middlebury", "--out", out, "--pairs", 1, "--seed", 1, *options)
    assert code == 0, err
    assert "in 1 pair more than 1% of the pixels have a disparity that png16 cannot hold" in err
    assert findings(out) == []
    path = out / SCENES / "middlebury-000000" / "pair.json"
    pair = json.loads(path.read_text())
    pair["disparity_beyond"]["left"] += 1000_000
    path.write_text(json.dumps(pair))
    assert any("beyond the encoding" in finding for finding in findings(out, 0))
