"""Clean datasets have no finding, and each planted fault has one."""

import json
import re
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from planted_faults import at_pixel, change_file, change_json, checks, findings, swap
from processes import assert_refused
from scenes import noise_layers
from tiny_datasets import SCENES, lean, verified

from semisynth_gl import Renderer, make_mesh, make_scene
from semisynth_gl.codecs.png import GREY16
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import ViewArrays
from semisynth_gl.inputs.errors import SemisynthError
from semisynth_gl.judge.findings import CheckResults
from semisynth_gl.judge.matching import check_views
from semisynth_gl.judge.rays import check_rays

BENCHMARKS = ("middlebury", "kitti", "eth3d", "sceneflow")
OUTPUTS = ("visibility", "instances", "depth", "normals", "correspondence")
ONE = "middlebury-000001"


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    root = tmp_path_factory.mktemp("datasets")
    for name in BENCHMARKS:
        config = lean(name)
        outputs = OUTPUTS if name == "middlebury" else ("visibility",)
        generate(config.model_copy(update={"outputs": outputs}), root / name, 3, 0)
    return root


@pytest.fixture
def dataset(datasets, tmp_path):
    """Copy the dataset in Middlebury's layout, for planting faults."""
    return shutil.copytree(datasets / "middlebury", tmp_path / "dataset", symlinks=True)


def scene_of(dataset, number=1):
    return dataset / SCENES / f"middlebury-{number:06d}"


@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_clean_dataset_has_no_finding(datasets, name):
    found = verified(datasets / name, 200)
    assert found.findings == []
    _, *all_results = found.all_results
    assert len(all_results) == 3
    for measures in (results.measures for results in all_results):
        assert measures["oracle_disparity_largest_px"] < 1e-3
        assert measures["image_explained"] > 0.95
        assert abs(measures["best_shift_x_px"]) < 0.1
        assert measures["visibility_left_disagree_share"] < 0.01
        if name == "middlebury":  # the only one with normals
            assert 0 < measures["oracle_normals_largest_deg"] < 0.01


def changed(change, *names):
    def plant(scene):
        for name in names:
            change_file(scene / name, change)

    return plant


def normals(change):
    return changed(change, "normals1.pfm")


def copied(name):
    return lambda scene: shutil.copy(scene.with_name("middlebury-000000") / name, scene / name)


def text(pattern, new):
    def plant(scene):
        path = scene / "calib.txt"
        path.write_text(re.sub(pattern, new, path.read_text()))

    return plant


def turned(vectors):
    turn = np.deg2rad(0.02)
    return vectors @ np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])


def large_ids(scene):
    ids = np.asarray(Image.open(scene / "inst1.png")).astype(np.uint16)
    (scene / "inst1.png").write_bytes(GREY16.encode(np.where(ids == 1, 60000, ids).astype(np.uint16)))


IMAGES, DISPARITIES, MASKS = ("im0.png", "im1.png"), ("disp0GT.pfm", "disp1GT.pfm"), ("mask0nocc.png", "mask1nocc.png")
AT = "in 1 pixel, the first at (40, 30)"
FAULTS = {
    # The change, the check that finds it, and words of the message.
    **{
        f"{name} flipped, axis {axis}": (changed(lambda each, axis=axis: np.flip(each, axis), name), "images", "")
        for name in IMAGES
        for axis in (0, 1)
    },
    "a darker image": (changed(lambda each: each // 2, "im1.png"), "images", ""),
    "a black image": (changed(np.zeros_like, "im1.png"), "images", ""),
    "an image of another pair": (copied("im1.png"), "images", ""),
    **{
        f"{kind} {count}": (changed(change, *DISPARITIES[count[0] : count[1]]), check, "")
        for kind, change in {
            "half a pixel more": lambda d: d + 0.5,
            "half a pixel less": lambda d: d - 0.5,
            "times 1.01": lambda d: d * 1.01,
        }.items()
        # If both views have the same error they agree; then rays or another channel find it.
        for count, check in {(0, 1): "left-right", (1, 2): "left-right", (0, 2): "oracle"}.items()
    },
    "a disparity that calib.txt does not have": (changed(lambda d: d * 1.01, *DISPARITIES), "calib", "vmax"),
    **{
        f"one disparity of {value} in {name}": (changed(at_pixel(30, 40, value), name), "disparity", AT)
        for value in (-np.inf, np.inf, 0.0, -3.0, 1e6)
        for name in DISPARITIES
    },
    "images swapped": (lambda scene: swap(scene, IMAGES), "images", ""),
    "disparities swapped": (lambda scene: swap(scene, DISPARITIES), "left-right", ""),
    "views swapped": (lambda scene: swap(scene, IMAGES, DISPARITIES, MASKS), "left-right", ""),
    "masks swapped": (lambda scene: swap(scene, MASKS), "visibility", ""),
    "left mask of another pair": (copied(MASKS[0]), "visibility", ""),
    "right mask of another pair": (copied(MASKS[1]), "visibility", ""),
    "mask of other values": (changed(lambda mask: mask // 2, MASKS[0]), "visibility", "is not one of 0, 128, 255"),
    "all visible": (changed(lambda mask: np.full_like(mask, 255), MASKS[0]), "visibility", "outside the image"),
    "nothing hidden": (changed(lambda mask: mask | np.uint8(127) * (mask == 128), MASKS[1]), "visibility", ""),
    "depth": (changed(lambda depth: depth * 1.0001, "depth0.pfm"), "depth", ""),
    "large ids": (large_ids, "instances", "is above the"),
    "correspondence": (
        changed(at_pixel(30, 40, (-5, 0)), "correspondence0.flo"),
        "correspondence",
        "disagrees with the disparity",
    ),
    "normals with x and y swapped": (normals(lambda n: n[..., [1, 0, 2]]), "normals", "points away from the eye"),
    "normals negated": (normals(lambda n: -n), "normals", "normals_right points away from the eye in 23375 pixels"),
    "normals too long": (normals(lambda n: 1.0001 * n), "normals", "is not a unit vector in 23375 pixels"),
    **{
        f"one normal of {value}": (normals(at_pixel(30, 40, value)), "normals", f"is not a unit vector {AT}")
        for value in (0, np.nan, np.inf)
    },
    "normals of another pair": (copied("normals1.pfm"), "oracle", "normals_right"),
    "normals a little turned": (normals(turned), "oracle", "normals_right"),
    "doffs": (text("doffs=.*", "doffs=0"), "calib", "doffs"),
    "baseline": (text("baseline=.*", "baseline=193.0"), "calib", "baseline_m"),
    "ndisp": (text("ndisp=.*", "ndisp=5"), "calib", "ndisp 5"),
    "vmax": (text("vmax=.*", "vmax=5"), "calib", "vmax is 5"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_found_in_its_pair(dataset, fault):
    plant, check, words = FAULTS[fault]
    plant(scene_of(dataset))
    found = findings(dataset, 50 if check == "oracle" else 0)
    assert {finding.scene for finding in found} == {ONE}
    assert any(finding.check == check and words in finding.message for finding in found), found


@pytest.mark.parametrize("noise", [0, 5, 10])
@pytest.mark.parametrize("off_px", [0, 0.5, -0.5, 1])
@pytest.mark.parametrize("disparity_px", [4.0, 4.3, 4.5])
def test_images_that_fit_half_a_pixel_aside_are_found(noise, off_px, disparity_px):
    def waves(phase_px):
        y, x = np.indices((100, 200))
        levels = 128 + 60 * np.sin(0.45 * (x + phase_px) + 0.1 * y)
        return np.rint((levels + np.random.default_rng(0).normal(0, noise, x.shape)).clip(0, 255)).astype(np.uint8)

    views = (
        ViewArrays({"image": waves(shift_px), "disparity": np.full((100, 200), disparity_px, np.float32)})
        for shift_px in (0, disparity_px + off_px)
    )
    results = CheckResults("a")
    check_views(StoredFrame(StereoCamera.centred(200, 100, 75.0, 0.1), *views), results, imperfect=noise > 0)
    assert [finding.check for finding in results.findings] == ["images"] * bool(off_px)
    # If a shift makes the images match, it is opposite to the planted one.
    assert results.measures.get("best_shift_x_px", -off_px) * off_px <= 0


def test_imperfect_images_are_judged_after_their_levels_are_matched(dataset):
    imperfections = {"noise": [2.0, 4.0], "gamma": 1.0, "exposure_stops": [-1.0, 0.0]}
    change_json(dataset / "index.json", lambda index: index["config_values"].update(imperfections=imperfections))
    right = scene_of(dataset) / "im1.png"
    change_file(right, lambda image: (image // 2).astype(np.uint8))
    assert "images" not in checks(dataset)
    darker = right.read_bytes()
    for change in (lambda image: np.roll(image, 1, 1), lambda image: np.roll(image, -1, 1), lambda image: image[::-1]):
        right.write_bytes(darker)
        change_file(right, change)
        assert "images" in checks(dataset)


@pytest.mark.parametrize("name", ["im0.png", "disp1GT.pfm", "calib.txt", "pair.json"])
@pytest.mark.parametrize("left", [None, 0, 1, -1], ids=["missing", "empty", "half", "last byte"])
def test_a_missing_or_truncated_file_is_found(dataset, name, left):
    path = scene_of(dataset) / name
    data = path.read_bytes()
    # A text without its last newline is still complete.
    whole = len(data.rstrip(b"\n")) if path.suffix in (".json", ".txt") else len(data)
    if left is None:
        path.unlink()
    else:
        path.write_bytes(data[: {0: 0, 1: len(data) // 2, -1: whole - 1}[left]])
    (found,) = findings(dataset)
    assert (found.scene, found.check) == (ONE, "files")
    assert found.message.startswith(f"{SCENES}/{ONE}/{name} {'is missing' if left is None else ''}")


def test_files_and_lists_that_mislead_are_found(dataset):
    scene = scene_of(dataset)
    shutil.copy(scene / "disp0GT.pfm", scene / "disp0other.pfm")
    shutil.copytree(scene, dataset / SCENES / "middlebury-000009")
    (dataset / "MiddEval3" / "official_train.txt").write_text("middlebury-000000\nmiddlebury-000002\n")
    found = verified(dataset)
    (foreign, listed), remove = found.findings, found.remove
    assert remove == ["index.json"]
    number = 2 + len(list(scene.iterdir())) - 1
    assert foreign.message.startswith(f"{number} files that the index does not list")
    assert foreign.message.endswith(f"{ONE}/disp0other.pfm")
    assert listed.message.startswith("MiddEval3/official_train.txt differs from the layout's list")


def test_images_of_another_kind_or_size_are_found(dataset):
    Image.open(scene_of(dataset, 0) / "im0.png").convert("P").save(scene_of(dataset, 0) / "im0.png")
    change_file(scene_of(dataset, 1) / "im1.png", lambda image: image[:, :-1])
    change_file(scene_of(dataset, 2) / "mask0nocc.png", lambda mask: np.stack([mask] * 3, axis=2))
    found = [(finding.scene[-1], finding.check) for finding in findings(dataset)]
    assert found == [("0", "files"), ("1", "size"), ("2", "files")]


def test_an_index_of_another_config_or_seed_is_found(dataset, datasets):
    path = dataset / "index.json"
    stored = path.read_text()
    index, other = json.loads(stored), json.loads((datasets / "kitti" / "index.json").read_text())
    other |= {key: index[key] for key in ("layout", "pairs", "shard_pairs", "shards")} | {"config": "middlebury"}
    other["config_values"]["name"] = "middlebury"
    path.write_text(json.dumps(other))
    assert {"origin", "size"} <= checks(dataset)
    index["config_values"]["disparity"]["max_px"] += 1
    path.write_text(json.dumps(index))
    assert checks(dataset) == {"index"}
    path.write_text(stored.replace('"seed": 0', '"seed": 1'))
    assert {"origin", "oracle"} <= checks(dataset, 50)


@pytest.mark.parametrize(
    ("key", "value"), [("seed", -1), ("splits", {"train": {"patches": []}}), ("config_values", {"name": "x"})]
)
def test_the_oracle_refuses_what_it_cannot_make_again(dataset, key, value):
    change_json(dataset / "index.json", lambda index: index.update({key: value}))
    with pytest.raises(SemisynthError, match=rf"cannot be rebuilt|index\.json: {key}"):
        findings(dataset, 50)


def test_digests_and_records_are_compared(dataset):
    path = scene_of(dataset, 0) / "pair.json"
    path.write_text(path.read_text().replace("{", "{ ", 1))
    records = sorted((dataset / "shards").glob("semisynth-*.json"))
    change_json(records[0], lambda record: record.update(bytes=1))
    records[1].unlink()
    calib = f"{SCENES}/middlebury-000002/calib.txt"
    change_json(records[2], lambda record: record["samples"][0]["files"].pop(calib))
    expected = [
        ("0", "shard", f"{records[0].stem}: bytes is 1 in its record"),
        ("0", "sha256", f"{SCENES}/middlebury-000000/pair.json has"),
        ("1", "shard", f"shards/{records[1].name} is missing"),
        ("2", "files", f"{calib} is not in the shard's record"),
    ]
    result = verified(dataset)
    found = result.findings
    assert [(finding.scene[-1], finding.check) for finding in found] == [each[:2] for each in expected]
    assert all(finding.message.startswith(words) for finding, (*_, words) in zip(found, expected, strict=True))
    assert list(result.remove) == [f"shards/{record.name}" for record in records]


SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


def test_rays_find_normals_of_other_places_beside_triangles_that_they_miss():
    """A wall, and slivers in front of it whose planes nearly contain the left eye."""
    camera, rng, count = StereoCamera.centred(80, 60, 75.0, 0.1), np.random.default_rng(5), 1000
    middle = np.array([camera.cx_left_px, camera.cy_px])
    wall = make_mesh("wall", [[-9, -9, 9], [9, -9, 9], [9, 9, 9], [-9, 9, 9]], SQUARE, [[0, 1, 2], [0, 2, 3]])
    start, angle = rng.uniform(0, middle * 2, (count, 2)), rng.uniform(0, 2 * np.pi, count)
    along, across = (np.stack([np.cos(angle + turn), np.sin(angle + turn)], axis=1) for turn in (0, np.pi / 2))
    length, width = rng.uniform(5, 60, count)[:, None], 10 ** rng.uniform(-3, -1, count)[:, None]
    at = np.stack([start, start + length * along, start + length * along / 2 + width * across], axis=1)
    points = np.concatenate([(at - middle) / camera.focal_px, np.ones((count, 3, 1))], axis=2)
    points *= rng.uniform(2, 4, (count, 3, 1))
    triangles = np.arange(3 * count).reshape(-1, 3)
    models = [wall, make_mesh("slivers", points.reshape(-1, 3), np.tile(SQUARE[:3], (count, 1)), triangles)]
    scene = make_scene(camera, model=[0, 1], world_from_model=[np.eye(4)] * 2, layer=[0, 0])
    with Renderer(models, noise_layers(1, 16), outputs=("normals",)) as renderer:
        frame = renderer.render(scene)
    scenes = SimpleNamespace(sampled=lambda _: SimpleNamespace(scene=scene), models=models, seed=0)
    for wrong in (False, True):
        normals = np.roll(frame.left.normals, 5, axis=1) if wrong else frame.left.normals
        left, right = frame.left.with_channels({"normals": normals}), ViewArrays({"image": frame.right.image})
        results = CheckResults("pair")
        check_rays(StoredFrame(frame.camera, left, right), scenes, 20_000, results)
        assert any("normals_left" in finding.message for finding in results.findings) == wrong, results.findings


def test_the_command_tells_what_it_found(program, dataset, tmp_path):
    code, out, err = program("verify", dataset, "--oracle", "--pixels", 50, "--json", "report.json")
    assert code == 0, out
    assert out.startswith("3 pairs, nothing found; at worst: ")
    assert "3 of 3 pairs" in err
    (scene_of(dataset) / "im0.png").unlink()
    code, out, err = program("verify", dataset, "--json", "report.json")
    assert (code, out) == (1, f"{ONE}: files: {SCENES}/{ONE}/im0.png is missing\n")
    assert "1 finding in 3 pairs" in err
    report = json.loads((tmp_path / "report.json").read_text())
    assert f"remove {dataset}/{report['remove'][0]}; then run generate again" in err
    assert report["findings"] == [{"scene": ONE, "check": "files", "message": out.split(": ")[2].strip()}]
    assert report["measures"]["middlebury-000000"]["visibility_left_disagree_share"] < 0.01


def test_the_command_refuses_what_is_no_finished_dataset(program, dataset):
    assert_refused(program("verify", dataset, "--json", "no/x.json"))
    (dataset / "index.json").unlink()
    for arguments, words in ((("nowhere",), "not a dataset"), ((dataset,), "not finished"), ((), "DIR")):
        assert_refused(program("verify", *arguments), words)
