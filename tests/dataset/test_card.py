"""The dataset card, as the Hugging Face Hub and `datasets` read it."""

import json
from fnmatch import fnmatch

import numpy as np
import pytest
from hand_made_datasets import config_of, write_dataset
from PIL import Image
from ruamel.yaml import YAML

from semisynth_gl.dataset.index import encode_card, file_patterns
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import read_index
from semisynth_gl.frame.channels import RENDERED_OUTPUTS
from semisynth_gl.layouts import find_layout, layout_names

FOLDERS = [name for name in layout_names() if not find_layout(name).packed]
# The config's name contains the name of a split.
NAME = "tiny-train-x"


def write(folder, layout, config=None):
    """Write five training pairs and a test pair; return the plan and the index in JSON's types."""
    write_dataset(folder, layout, {"train": 5, "test": 1}, 2, config or config_of(name=NAME))
    return read_index(folder).plan, json.loads((folder / "index.json").read_text())


def front_of(card):
    begin, front, body = card.decode().split("---\n", 2)
    assert not begin
    return YAML(typ="safe", pure=True).load(front), body


@pytest.mark.parametrize("layout", FOLDERS)
def test_load_dataset_reads_every_image_and_nothing_else(layout, tmp_path, monkeypatch):
    datasets = pytest.importorskip("datasets")
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    outputs = ["visibility", "instances", "flow"]
    plan, _ = write(tmp_path / "o", layout, config_of(name=NAME, outputs=outputs, sequence={"length": 2}))
    front, _ = front_of((tmp_path / "o/README.md").read_bytes())
    names = [config["config_name"] for config in front["configs"]]
    # `datasets` would read KITTI's flow, 16-bit RGB, with 8 bits.
    images = {role for role, path in plan.files("train", 0).items() if path.endswith((".png", ".jpg"))}
    assert set(names) == {role for role in images if not (layout == "kitti" and role.startswith("flow"))}
    for name in [None, *names]:
        loaded = datasets.load_dataset(str(tmp_path / "o"), name, cache_dir=str(tmp_path / "cache"))
        for split, pairs in plan.pairs.items():
            assert loaded[split].column_names == ["image"]
            # Row i is the same pair in each config.
            files = sorted((plan.files(split, pair) for pair in range(pairs)), key=lambda each: each["left"])
            for row, own in zip(loaded[split], files, strict=True):
                expected = Image.open(tmp_path / "o" / own[name or "left"])
                assert row["image"].mode == expected.mode
                assert np.array_equal(np.asarray(row["image"]), np.asarray(expected))


@pytest.mark.parametrize(("length", "views"), [(None, 1), (1, 1), (50, 1), (2, 4), (3000, 1)])
@pytest.mark.parametrize("layout", layout_names())
def test_a_pattern_matches_the_files_of_its_role_and_no_others(layout, length, views):
    lacks = find_layout(layout).lacks | ({"flow", "flow_backward", "disparity_change"} if length == 3000 else set())
    values = {} if length is None else {"outputs": [output for output in RENDERED_OUTPUTS if output not in lacks]}
    camera = {"width_px": 48, "height_px": 32, "focal_px": 60, "baselines": [0.1, 0.2, 0.3, 0.4][:views]}
    config = config_of(name=NAME, camera=camera, sequence={"length": length or 1}, **values)
    assert config.views == views
    plan = make_plan(config, 0, layout, {"train": 3, "validation": 1, "test": 2})
    patterns = {(split, role): path for split in plan.splits for role, path in file_patterns(plan, split).items()}
    for pair in (0, 1, 7, 10, 999, 3001, 123_457, 999_999):
        files = {(split, role): path for split in plan.splits for role, path in plan.files(split, pair).items()}
        assert patterns.keys() == files.keys()
        for (split, role), path in files.items():
            matching = {each for each, pattern in patterns.items() if fnmatch(path, pattern)}
            # Each split has its own tars.
            assert matching == {(each, role) for each in (plan.splits if plan.layout.packed else [split])}


@pytest.mark.parametrize(
    ("licence", "known", "name"),
    [
        ("cc-by-nc-sa-4.0", "cc-by-nc-sa-4.0", None),
        ('my: "own" #1', "other", "my-own-1"),
        ("---\nlicense: mit <b>", "other", "license-mit-b"),
        ("§", "other", None),
    ],
)
def test_the_front_matter_is_what_a_hub_wants(tmp_path, licence, known, name):
    rights = {"dataset": licence, "images": licence, "models": "unknown"}
    plan, index = write(tmp_path, "webdataset", config_of(name=NAME, licences=rights))
    front, body = front_of(encode_card(plan, index))
    assert (front["license"], front.get("license_name")) == (known, name)
    assert front["task_categories"] == ["depth-estimation"]
    assert front["tags"] == ["stereo", "disparity", "synthetic", "webdataset"]
    assert "\nlicense" not in body
    assert "<b>" not in body
    tars = {shard.tar: shard.split for shard in plan.shards}
    for files in front["configs"][0]["data_files"]:
        assert {split for tar, split in tars.items() if fnmatch(tar, files["path"])} == {files["split"]}
    sizes = {1: "n<1K", 999: "n<1K", 1000: "1K<n<10K", 10_000: "10K<n<100K", 10**6: "1M<n<10M", 10**8: "100M<n<1B"}
    for pairs, size in sizes.items():
        front, _ = front_of(encode_card(plan.model_copy(update={"pairs": {"train": pairs}}), index))
        assert front["size_categories"] == [size]
