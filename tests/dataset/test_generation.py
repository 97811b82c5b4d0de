"""Datasets of `generate`: layouts, seeds, splits, shards."""

import json

import pytest
from recorder import Recorder
from tiny_datasets import SEED, findings, tiny

from semisynth_gl.config import load_config
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs import pipeline
from semisynth_gl.scene.sources import prepare_sources


@pytest.fixture(scope="module")
def config():
    return tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})


def test_without_a_layout_the_number_of_pairs_decides(config, tmp_path):
    kitti = config.model_copy(update={"layout": "kitti"})
    first = {"shard_pairs": 1, "shards": range(1)}
    for name, chosen, pairs in (("few", config, 9_999), ("many", config, 10_000), ("own", kitti, 10_000)):
        result = generate(chosen, tmp_path / name, pairs, SEED, **first)
        assert result.plan.layout_name == {"few": "middlebury", "many": "webdataset", "own": "kitti"}[name]


_EYE = "{fx_px: 800, distortion: [0, 0, 0, 0]}"
LENS = f"{{raw_width_px: 1242, raw_height_px: 375, left: {_EYE}, right: {_EYE}}}"


@pytest.mark.parametrize(
    ("layout", "settings", "said"),
    [
        ("kitti", ["files.disparity=png16"], "sets the encodings itself.*another layout"),
        ("kitti", ["outputs=[correspondence]"], "no files for the output correspondence.*another layout"),
        ("kitti", ["disparity.signed=true"], "stores .*cannot be signed.*another layout"),
        ("crestereo", ["disparity.signed=true"], "stores .*another layout"),
        ("sceneflow", ["outputs=[correspondence]"], "correspondence.*such as middlebury"),
        ("kitti", ["outputs=[flow]", "sequence.length=91"], r"sequence\.length.*another layout"),
        (
            "kitti",
            [f"lens={LENS}", "outputs=[]"],
            "needs the output instances, visibility; then .*add valid",
        ),
    ],
)
def test_what_a_layout_cannot_hold_is_refused(tmp_path, layout, settings, said):
    with pytest.raises(InputError, match=f"{layout} .*{said}"):
        generate(load_config("kitti", settings), tmp_path / "out", 1, layout=layout)


def test_a_run_tells_how_many_attempts_failed_the_checks(config, tmp_path, monkeypatch):
    monkeypatch.setattr(
        pipeline, "faults", lambda _, __, scene=None: ["too dark"] * (scene is not None and scene.sequence.attempt < 2)
    )
    recorder = Recorder()
    generate(config, tmp_path / "o", 1, SEED, listener=recorder)
    assert "2 attempts failed the checks and were rendered anew" in recorder.messages[-1]


def test_splits_share_neither_photographs_nor_scenes(config, tmp_path):
    made = generate(config, tmp_path / "o", {"train": 3, "validation": 2, "test": 1}, SEED, layout="webdataset")
    assert findings(tmp_path / "o", 20) == []
    index = json.loads((tmp_path / "o/index.json").read_text())
    digests_of = [{photograph["sha256"] for photograph in split["photographs"]} for split in index["splits"].values()]
    assert all(digests_of)
    assert len(set.union(*digests_of)) == sum(map(len, digests_of))
    assert all(photograph["licence"] for split in index["splits"].values() for photograph in split["photographs"])
    assert [len(open_dataset(tmp_path / "o", split)) for split in made.plan.splits] == [3, 2, 1]
    one, other = open_dataset(tmp_path / "o", "train")[0], open_dataset(tmp_path / "o", "test")[0]
    assert one.camera != other.camera
    for number in (1, -2):
        with pytest.raises(IndexError, match=f"1 pair, got number {number}"):
            open_dataset(tmp_path / "o", "test")[number]
    with pytest.raises(InputError, match="pairs"):
        generate(config, tmp_path / "o", 3, SEED, layout="webdataset")
    models = config.model_copy(update={"splits": config.splits.model_copy(update={"models": True})})
    plan = make_plan(models, 0, "middlebury", {"train": 1, "test": 1})
    names = [{mesh.name for mesh in prepare_sources(models, plan.split(split)).models} for split in plan.splits]
    assert all(names)
    assert not names[0] & names[1]
