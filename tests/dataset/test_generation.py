"""Datasets as `generate` makes them: layouts, seeds, splits, shards."""

import json

import numpy as np
import pytest
from backends import backend_fault
from tiny_datasets import SEED, findings, tiny

from semisynth_gl.config import load_config
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.layouts import layout_names
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.scene.sources import prepare_sources


@pytest.fixture(scope="module")
def config():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})


def test_without_a_layout_the_number_of_pairs_decides(config, tmp_path):
    kitti = config.model_copy(update={"layout": "kitti"})
    first = {"shard_pairs": 1, "shards": range(1)}
    for name, chosen, pairs in (("few", config, 9_999), ("many", config, 10_000), ("own", kitti, 10_000)):
        result = generate(chosen, tmp_path / name, pairs, SEED, **first)
        assert result.plan.layout_name == {"few": "middlebury", "many": "webdataset", "own": "kitti"}[name]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["files.disparity=png16"], "sets the encodings itself"),
        (["outputs=[correspondence]"], "no files for the output correspondence"),
        (["disparity.signed=true"], "no signed ones"),
        (["outputs=[flow]", "sequence.length=91"], r"sequence\.length"),
    ],
)
def test_what_a_layout_cannot_hold_is_refused(tmp_path, settings, said):
    with pytest.raises(InputError, match=f"the layout kitti .*{said}.*another layout"):
        generate(load_config("kitti", settings), tmp_path / "out", 1)


@pytest.mark.parametrize("layout", layout_names())
def test_every_layout_reads_back_and_verifies_clean(config, tmp_path, layout):
    out = tmp_path / "o"
    generate(config, out, 2, SEED, layout=layout, shard_pairs=1)
    assert findings(out, 40) == []
    with PairRenderer(config, SEED) as pairs:
        frame = pairs.render(1).frame
    dataset = open_dataset(out)
    assert len(dataset) == 2
    read = dataset[1]
    if read.encodings.image.lossless:
        np.testing.assert_array_equal(read.left.image, frame.left.image)
        np.testing.assert_array_equal(read.right.image, frame.right.image)
    for side in ("left", "right"):
        came, made = read.view(side).disparity, frame.view(side).disparity
        np.testing.assert_allclose(came, made, rtol=0, atol=read.encodings.disparity.error_px)
        # Whether a hidden point is outside follows from its disparity, which codecs may round.
        share = 0 if read.encodings.disparity.lossless else 1e-3
        assert (read.view(side).visibility != frame.view(side).visibility).mean() <= share
    assert read.camera == frame.camera or layout.startswith(("middlebury", "eth3d"))
    assert read.camera.focal_px == frame.camera.focal_px
    with pytest.raises(IndexError):
        dataset[2]


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
    with pytest.raises(InputError, match="pairs"):
        generate(config, tmp_path / "o", 3, SEED, layout="webdataset")
    models = config.model_copy(update={"splits": config.splits.model_copy(update={"models": True})})
    plan = make_plan(models, 0, "middlebury", {"train": 1, "test": 1})
    names = [{mesh.name for mesh in prepare_sources(models, plan.split(split)).models} for split in plan.splits]
    assert all(names)
    assert not names[0] & names[1]
