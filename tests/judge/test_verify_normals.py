"""Clean normals have no finding in any layout, and each planted fault has one."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from backends import backend_fault
from planted_faults import change_normals, findings
from scenes import noise_layers
from tiny_datasets import SCENES, cheap, lean

from semisynth_gl import Renderer, make_mesh, make_scene, oracle
from semisynth_gl.codecs import Encodings
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import read_index
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.channels import View
from semisynth_gl.judge.findings import Verdict
from semisynth_gl.judge.rays import RayJudge
from semisynth_gl.judge.single_view import check_normals
from semisynth_gl.judge.verify import verify_dataset
from semisynth_gl.layouts import layout_names

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
OUTPUTS = ("normals", "visibility", "instances", "depth")


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    out = tmp_path_factory.mktemp("normals") / "out"
    generate(lean().model_copy(update={"outputs": OUTPUTS}), out, 2, 0)
    return out


@pytest.fixture
def dataset(clean, tmp_path):
    return shutil.copytree(clean, tmp_path / "dataset", symlinks=True)


@pytest.mark.parametrize("layout", layout_names())
def test_clean_normals_have_no_finding_in_any_layout(tmp_path, layout):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    generate(cheap(outputs=list(OUTPUTS)), tmp_path / "out", 2, 0, layout=layout)
    first, *pairs = verify_dataset(read_index(tmp_path / "out"), 200)
    assert [str(finding) for verdict in (first, *pairs) for finding in verdict.findings] == []
    assert len(pairs) == 2
    for verdict in pairs:
        assert 0 < verdict.measures["oracle_normals_largest_deg"] < 0.01


def test_normals_of_complex_models_have_no_finding(clean):
    assert findings(clean, 400) == []


def plant(value):
    def change(normals):
        normals[30, 40] = value
        return normals

    return change


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        pytest.param(lambda n: n[..., [1, 0, 2]], "points away from the eye in", id="x and y swapped"),
        pytest.param(lambda n: n[..., [2, 1, 0]], "points away from the eye in", id="x and z swapped"),
        pytest.param(lambda n: -n, "points away from the eye in 23375 pixels", id="negated"),
        pytest.param(lambda n: 1.0001 * n, "is no unit vector in 23375 pixels", id="too long"),
        pytest.param(lambda n: n / np.abs(n).max(axis=2, keepdims=True), "is no unit vector", id="largest 1"),
        pytest.param(plant(0), "is 0 though something is seen in 1 pixel, the first at (40, 30)", id="zero"),
        pytest.param(plant(np.nan), "is no unit vector in 1 pixel, the first at (40, 30)", id="NaN"),
        pytest.param(plant(np.inf), "is no unit vector in 1 pixel, the first at (40, 30)", id="inf"),
    ],
)
@pytest.mark.parametrize("name", ["normals0.pfm", "normals1.pfm"])
def test_wrong_normals_are_found(dataset, change, fault, name):
    change_normals(dataset / SCENES / "middlebury-000001" / name, change)
    found = findings(dataset)
    assert {(finding.scene, finding.check) for finding in found} == {("middlebury-000001", "normals")}
    assert any(f"normals_{EYES[int(name[7])]} {fault}" in finding.message for finding in found)


def test_rays_find_normals_of_another_pair_and_small_turns(dataset):
    scenes = dataset / SCENES
    shutil.copy(scenes / "middlebury-000000" / "normals1.pfm", scenes / "middlebury-000001" / "normals1.pfm")
    turn = np.deg2rad(0.02)
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    change_normals(scenes / "middlebury-000000" / "normals0.pfm", lambda normals: normals @ rotation.T)
    found = [finding for finding in findings(dataset, 100) if finding.check == "oracle"]
    assert [(finding.scene, finding.message.split(":")[0]) for finding in found] == [
        ("middlebury-000000", "normals_left"),
        ("middlebury-000001", "normals_right"),
    ]
    assert "pixels are off by more than 0.01 degrees; at (" in found[0].message


def edge_on(seed, count, camera):
    """A wall, and triangles before it whose planes nearly go through the left eye, as one model each; their frame."""
    rng, middle = np.random.default_rng(seed), np.array([camera.cx_left_px, camera.cy_px])
    wall = make_mesh("wall", [[-9, -9, 9], [9, -9, 9], [9, 9, 9], [-9, 9, 9]], SQUARE, [[0, 1, 2], [0, 2, 3]])
    start, angle = rng.uniform(0, middle * 2, (count, 2)), rng.uniform(0, 2 * np.pi, count)
    along, across = (np.stack([np.cos(angle + turn), np.sin(angle + turn)], axis=1) for turn in (0, np.pi / 2))
    length, width = rng.uniform(5, 60, count)[:, None], 10 ** rng.uniform(-3, -1, count)[:, None]
    at = np.stack([start, start + length * along, start + length * along / 2 + width * across], axis=1)
    points = np.concatenate([(at - middle) / camera.focal_px, np.ones((count, 3, 1))], axis=2)
    points *= rng.uniform(2, 4, (count, 3, 1))
    slivers = make_mesh(
        "slivers", points.reshape(-1, 3), np.tile(SQUARE[:3], (count, 1)), np.arange(3 * count).reshape(-1, 3)
    )
    models = [wall, slivers]
    scene = make_scene(camera, model=[0, 1], world_from_model=[np.eye(4)] * 2, layer=[0, 0])
    with Renderer(models, noise_layers(1, 16), outputs=("normals",)) as renderer:
        return models, scene, renderer.render(scene)


def count_wrong(models, scene, frame, normals, pixels):
    """The number of wrong normals that rays through pixels find, of a frame's left view with these normals."""
    stored = StoredFrame(
        frame.camera, frame.left.with_channels({"normals": normals}), View({"image": frame.right.image})
    )
    check, verdict = object.__new__(RayJudge), Verdict("pair")
    check._scenes = SimpleNamespace(sampled=lambda _: SimpleNamespace(scene=scene), models=models, seed=0)
    check._pixels = pixels
    check.check(stored, verdict)
    found = [finding.message for finding in verdict.findings if finding.message.startswith("normals_left: ")]
    return sum(int(message.split()[1]) for message in found)


def test_rays_do_not_blame_the_normals_of_surfaces_that_they_miss(monkeypatch):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    seen = edge_on(5, 1000, StereoCamera.centred(80, 60, 75.0, 0.1))
    normals = seen[-1].left.normals
    # Those of other places, and those of other sides, are found as before.
    cases = (normals, 30_000), (np.roll(normals, 5, axis=1), 30_000), (-normals, 1000)
    right, *wrong = (count_wrong(*seen, *case) for case in cases)
    monkeypatch.setattr(oracle, "normals_beside", lambda *_: ())
    by_rays, *found_by_rays = (count_wrong(*seen, *case) for case in cases)
    assert right == 0 < by_rays
    for number, expected in zip(wrong, found_by_rays, strict=True):
        assert 400 < expected < 1.1 * number


INF = np.inf
NOT_ZERO, ZERO = "is not 0 where nothing is seen in 1 pixel", "is 0 though something is seen in 1 pixel"


@pytest.mark.parametrize(
    ("doffs_px", "limited", "values", "fault"),
    [
        # With a positive doffs a surface may have no disparity: inf tells nothing.
        (1.5, False, {"disparity": INF, "normals": 0}, None),
        (1.5, False, {"disparity": INF}, None),
        (0.0, False, {"disparity": INF, "normals": 0}, None),
        (0.0, False, {"disparity": INF}, NOT_ZERO),
        # The encoding made a large disparity inf.
        (0.0, True, {"disparity": INF}, None),
        (0.0, True, {"normals": 0}, ZERO),
        # Depth and ids know.
        (1.5, False, {"disparity": INF, "depth": INF}, NOT_ZERO),
        (1.5, False, {"disparity": INF, "instances": 0}, NOT_ZERO),
        (1.5, False, {"disparity": INF, "depth": INF, "instances": 0, "normals": 0}, None),
        (1.5, False, {"disparity": INF, "depth": 2.0, "normals": 0}, ZERO),
        (0.0, True, {"disparity": INF, "instances": 7, "normals": 0}, ZERO),
    ],
)
def test_normals_are_zero_where_nothing_is_seen(doffs_px, limited, values, fault):
    """A wall that faces the left eye, and pixel (2, 1) of it."""
    camera = StereoCamera.centred(6, 4, 60.0, 0.25, doffs_px)
    view = {"disparity": np.full((4, 6), 5, np.float32), "normals": np.full((4, 6, 3), (0, 0, -1), np.float32)}
    if "depth" in values:
        view["depth"] = np.full((4, 6), 1, np.float32)
    if "instances" in values:
        view["instances"] = np.ones((4, 6), np.uint16)
    for name, value in values.items():
        view[name][1, 2] = value
    encodings = Encodings(disparity=KITTI_DISPARITY) if limited else Encodings()
    provenance = {"disparity_beyond": {"left": 1}} if limited else {}
    frame = StoredFrame(camera, View(view), View({}), provenance=provenance, encodings=encodings)
    verdict = Verdict("pair")
    check_normals(frame, "left", verdict)
    wanted = [] if fault is None else [f"normals_left {fault}, the first at (2, 1)"]
    assert [finding.message for finding in verdict.findings] == wanted
