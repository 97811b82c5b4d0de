"""The dataset card: what hubs and their readers make of it."""

import hashlib
import io
from collections.abc import Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_made_datasets import sources_of
from PIL import Image
from ruamel.yaml import YAML

from semisynth_gl.config import Config
from semisynth_gl.dataset.card import encode_card
from semisynth_gl.dataset.documents import IndexDocument, RecordDocument
from semisynth_gl.dataset.file_sets import list_file_sets
from semisynth_gl.dataset.index import describe_dataset
from semisynth_gl.dataset.plan import Plan, make_plan
from semisynth_gl.dataset.sample import encode_pair
from semisynth_gl.dataset.tar import tar_end, tar_member
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.channels import DRAWN_OUTPUTS, View
from semisynth_gl.frame.frame import Frame
from semisynth_gl.layouts import find_layout, layout_names
from semisynth_gl.seeds.splits import SplitName

FOLDERS = [name for name in layout_names() if not find_layout(name).packed]
ODD = 'my: "own" #1'
CAMERA = StereoCamera(8, 6, 10.0, 0.1, 3.5, 3.5, 2.5)


FLOW = {
    "outputs": [output for output in DRAWN_OUTPUTS if output != "correspondence"],
    "sequence": {"length": 2},
}
"""Keys of a config with all outputs."""


PROVENANCE = {
    "pair": 0, "config": "tiny-train-x", "config_sha256": "", "version": "1", "renderer": "none",
    "backend": "egl", "seed": 3, "sequence": 0, "frame": 0, "near_m": 0.1,
    "instances": [{"model": "background", "still": True}] * 9,
}  # fmt: skip


def plan_for(layout: str, pairs: Mapping[str, int], licence: str = "unknown", **values: Any) -> Plan:
    config = Config.model_validate(
        {
            "name": "tiny-train-x",
            "camera": {"width_px": 8, "height_px": 6, "focal_px": 10, "baseline_m": [0.1, 0.2]},
            "disparity": {"min_px": 1, "max_px": 5},
            "licences": {"dataset": licence, "images": "CC|0 <b>", "models": "unknown"},
            "outputs": ["visibility", "instances", "depth"],
            **values,
        }
    )
    return make_plan(config, 3, layout, pairs, 2)


def frame(index: int) -> Frame:
    grey, ids = np.full((6, 8), 255, np.uint8), np.full((6, 8), index, np.uint16)
    truth = np.full((6, 8), index + 0.5, np.float32)
    image = np.full((6, 8, 3), index, np.uint8)
    normals = np.full((6, 8, 3), (0, 0, -1), np.float32)
    flow = np.full((6, 8, 2), index + 0.5, np.float32)
    left, right = (
        View(
            {
                "image": image + np.uint8(100 * number),
                "disparity": truth + np.float32(number),
                "visibility": grey,
                "correspondence": flow,
                "instances": ids,
                "depth": truth,
                "sky": grey,
                "normals": normals,
                "flow": flow,
                "flow_visibility": grey,
                "flow_backward": flow,
                "flow_backward_visibility": grey,
                "disparity_change": truth,
            }
        )
        for number in range(len(EYES))
    )
    return Frame(CAMERA, left, right)


def write(plan: Plan, folder: Path | None = None) -> IndexDocument:
    """Return a dataset's index, and write its shards if there is a folder to write to."""
    records = []
    for shard in plan.shards:
        content = b""
        for pair in range(shard.first, shard.end):
            files = encoded(plan, shard.split, pair)
            files = {path: files[path] for path in paths(plan, shard.split, pair).values()}
            for name, data in files.items():
                if plan.layout.packed:
                    content += tar_member(name, data)[0]
                elif folder:
                    path = folder / f"{plan.folder(shard.split)}{name}"
                    path.parent.mkdir(parents=True, exist_ok=True)
                    path.write_bytes(data)
        content += tar_end(len(content))
        tar = f"shards/{shard.name}.tar"
        record = {
            "shard": shard.name, "split": shard.split, "first": shard.first, "end": shard.end, "redraws": 1,
            "renderers": ["llvmpipe (LLVM 15.0.7, 256 bits)"], "bytes": len(content),
            "sha256": hashlib.sha256(content).hexdigest(), **({"tar": tar} if plan.layout.packed else {}),
        }  # fmt: skip
        records.append(RecordDocument.model_validate(record | {"samples": []}))
        if folder and plan.layout.packed:
            (folder / "shards").mkdir(exist_ok=True)
            (folder / tar).write_bytes(content)
    index = describe_dataset(plan, sources_of(plan), records)
    if folder:
        (folder / "README.md").write_bytes(encode_card(index))
    return index


def encoded(plan: Plan, split: SplitName, pair: int) -> dict[str, bytes]:
    """Return the bytes of a pair's files by path, as `write` writes them."""
    encodings = plan.layout.encodings_for(plan.config)
    return encode_pair(plan.layout, plan.key(split, pair), frame(pair), PROVENANCE | {"pair": pair}, 5, encodings).files


def paths(plan: Plan, split: SplitName, pair: int) -> dict[str, str]:
    """Return the files that a pair has, by role, below the split's folder or inside the tar."""
    layout = plan.layout
    encodings = layout.encodings_for(plan.config)
    return layout.files(plan.key(split, pair), encodings, plan.config.outputs, plan.config.truth)


def front_of(card: bytes) -> tuple[Any, str]:
    begin, front, body = card.decode().split("---\n", 2)
    assert not begin
    return YAML(typ="safe", pure=True).load(front), body


@pytest.mark.parametrize("layout", FOLDERS)
def test_load_dataset_reads_images_and_no_records(layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    datasets = pytest.importorskip("datasets")
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    # KITTI's flow is 16-bit RGB, of which 8 bits would arrive.
    plan = plan_for(layout, {"train": 3, "test": 1}, **(FLOW if layout == "kitti" else {}))
    write(plan, tmp_path)
    (tmp_path / "shards").mkdir()
    (tmp_path / "shards" / "semisynth-tiny-train-x-train-000000.json").write_text('{"shard": 1}\n')
    cache = str(tmp_path / "cache")
    front, body = front_of((tmp_path / "README.md").read_bytes())
    names = [config["config_name"] for config in front["configs"]]
    encodings = plan.layout.encodings_for(plan.config)
    for name in [None, *names]:
        loaded = datasets.load_dataset(str(tmp_path), name, cache_dir=cache)
        role = name or "left"
        for split, pairs in plan.pairs.items():
            assert loaded[split].column_names == ["image"]
            # Row i of each config is of the same pair.
            files = sorted((paths(plan, split, pair) for pair in range(pairs)), key=lambda each: each["left"])
            for row, own in zip(loaded[split], files, strict=True):
                data = (tmp_path / plan.folder(split) / own[role]).read_bytes()
                expected = Image.open(io.BytesIO(data))
                assert row["image"].mode == expected.mode
                assert np.array_equal(np.asarray(row["image"]), np.asarray(expected))
    assert names[:2] == ["left", "right"]
    assert all(plan.layout.role(name).codec(encodings).is_image for name in names)
    told = body.partition("It cannot load: ")[2].partition(".\n")[0]
    roles = set(paths(plan, "train", 0))
    assert {role for role in roles if role in told.replace(",", " ").replace(";", " ").split()} == roles - set(names)


def test_a_rig_that_deviates_is_not_called_rectified() -> None:
    deviating = {"rig": {"right_y_px": 2, "twin": True}, "disparity": {"min_px": 1, "max_px": 5, "signed": True}}
    for values, rectified in (({}, True), (deviating, False)):
        index = write(plan_for("middlebury", {"train": 4}, **values))
        card = encode_card(index).decode()
        assert ("4 rectified stereo pairs" in card) == rectified
        assert ("Rectification: imperfect" in card) == ("rectified twin" in card) == (not rectified)


@pytest.mark.parametrize("length", [None, 1, 2, 50])
@pytest.mark.parametrize("layout", layout_names())
def test_a_pattern_matches_the_files_of_its_role_and_no_others(layout: str, length: int | None) -> None:
    outputs = [output for output in DRAWN_OUTPUTS if output not in find_layout(layout).lacks]
    values = {} if length is None else {"outputs": outputs, "sequence": {"length": length}}
    plan = plan_for(layout, {"train": 3, "validation": 1, "test": 2}, **values)
    patterns = {f"{split}-{each.role}": each.pattern for split in plan.splits for each in list_file_sets(plan, split)}
    for index in (0, 1, 7, 10, 999, 3001, 123_457, 999_999):
        files = {
            f"{split}-{role}": ("" if plan.layout.packed else plan.folder(split)) + path
            for split in plan.splits
            for role, path in paths(plan, split, index).items()
        }
        assert patterns.keys() == files.keys()
        for name, path in files.items():
            own_tars = plan.layout.packed
            matching = {name for name, pattern in patterns.items() if fnmatch(path, pattern)}
            assert matching == ({f"{split}-{name.partition('-')[2]}" for split in plan.splits} if own_tars else {name})


def test_truth_of_the_left_view_alone_has_no_files_of_the_right_one() -> None:
    plan = plan_for("middlebury", {"train": 1}, truth="left", outputs=["visibility"])
    index = write(plan)
    roles = {each.role for each in list_file_sets(plan, "train")}
    assert "visibility_left" in roles
    assert not {"disparity_right", "depth_left"} & roles
    assert "disp1GT" not in encode_card(index).decode()


@pytest.mark.parametrize(
    ("licence", "hub", "name"),
    [
        ("unknown", "unknown", None),
        ("MIT", "mit", None),
        ("cc-by-4.0", "cc-by-4.0", None),
        (ODD, "other", "my-own-1"),
        ("no", "other", "no"),
        ("---\nlicense: mit", "other", "license-mit"),
        ("§", "other", None),
    ],
)
def test_licences_arrive_whatever_they_say(licence: str, hub: str, name: str | None) -> None:
    index = write(plan_for("webdataset", {"train": 1}, licence))
    front, _ = front_of(encode_card(index))
    assert (front["license"], front.get("license_name")) == (hub, name)


@pytest.mark.parametrize(
    ("pairs", "category"),
    [(1, "n<1K"), (999, "n<1K"), (1000, "1K<n<10K"), (10_000, "10K<n<100K"), (10**6, "1M<n<10M"), (10**12, "n>1T")],
)
def test_sizes_are_the_hubs(pairs: int, category: str) -> None:
    index = write(plan_for("webdataset", {"train": 1})).model_copy(update={"pairs": {"train": pairs}})
    assert front_of(encode_card(index))[0]["size_categories"] == [category]


def test_the_front_matter_is_what_a_hub_wants() -> None:
    plan = plan_for("webdataset", {"train": 5, "validation": 1})
    card = encode_card(write(plan))
    front, body = front_of(card)
    assert front["task_categories"] == ["depth-estimation"]
    assert front["tags"] == ["stereo", "disparity", "synthetic", "webdataset"]
    (config,) = front["configs"]
    for files in config["data_files"]:
        # The config's name has a split's in it.
        own = {f"shards/{shard.name}.tar" for shard in plan.shards if shard.split == files["split"]}
        assert {f"shards/{shard.name}.tar" for shard in plan.shards
                if fnmatch(f"shards/{shard.name}.tar", files["path"])} == own  # fmt: skip
    assert "shards/semisynth-tiny-train-x-train-{000000..000002}.tar" in body
    assert '"shards/semisynth-tiny-train-x-validation-000000.tar"' in body
    hub = pytest.importorskip("huggingface_hub")
    data = hub.DatasetCard(card.decode()).data
    assert (data.license, data.size_categories) == ("unknown", ["n<1K"])
    assert data.pretty_name == front["pretty_name"]
    assert data.to_dict()["configs"] == front["configs"]


def test_the_card_says_what_a_reader_needs() -> None:
    plan = plan_for("kitti", {"train": 3, "validation": 1}, textures={"source": "photographs"})
    index = write(plan)
    _, body = front_of(encode_card(index))
    for text in (
        "4 rectified stereo pairs", "8 x 6 pixels", "1 to 5 px", "0.1 to 0.2 m",
        "| train | 3 | 2 |", "open_dataset(", "train/training/disp_occ_0/000000_10.png",
        "x_left - x_right", "16-bit PNG that counts 1/256 px; 0 says", "255.996",
        index.version, index.config_sha256, "| seed | 3 |", "llvmpipe",
        "| 2 photographs | CC\\|0 \\<b\\> |", "next frame's disparity",
    ):  # fmt: skip
        assert text in body, text


def test_the_card_knows_the_encoding() -> None:
    _, body = front_of(encode_card(write(plan_for("webdataset", {"train": 1}, files={"disparity": "pfm"}))))
    assert "PFM, float32; inf says" in body
    assert "Rounding" not in body


def test_the_card_knows_the_flow() -> None:
    front, body = front_of(encode_card(write(plan_for("kitti", {"train": 4}, **FLOW))))
    assert "optical-flow" in front["tags"]
    for text in (
        "Pairs 2 i to 2 i + 1", "0.04 s apart", "64 u + 32768", "0 in the third channel says that there is none",
        "0.0078125 px", "511.984", "training/flow_noc/000000_10.png", "flow of the left view's pixels to the next",
    ):  # fmt: skip
        assert text in body, text
    _, body = front_of(encode_card(write(plan_for("webdataset", {"train": 4}, **FLOW))))
    assert "1e10 says that there is none" in body
    assert "Beyond" not in body
    assert "## Flow" not in encode_card(write(plan_for("webdataset", {"train": 4}))).decode()


@pytest.mark.parametrize("layout", layout_names())
def test_equal_indices_give_equal_bytes(layout: str) -> None:
    one, other = (write(plan_for(layout, {"train": 2, "test": 1}, ODD)) for _ in range(2))
    assert encode_card(one) == encode_card(other)
