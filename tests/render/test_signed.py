"""Signed disparity and sky: what is at or beyond 0, and what is infinitely far away, against the oracle and on disk."""

import numpy as np
import pytest
from heavy import heavy
from hypothesis import given
from hypothesis import strategies as st
from planted_faults import all_findings
from scenes import assert_equal, board, facing, noise_layers, one_model, posed

from semisynth_gl import InputError, open_dataset, oracle
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import GREY8
from semisynth_gl.codecs.png16 import SIGNED_DISPARITY
from semisynth_gl.config import load_config
from semisynth_gl.config.scene_sections import ParticlesSection
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import read_index
from semisynth_gl.frame.camera import EYES, Crop, StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, SKY, VISIBLE
from semisynth_gl.judge.evaluate import evaluate
from semisynth_gl.judge.protocol import PROTOCOLS
from semisynth_gl.layouts import LAYOUTS
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.particles import Slots, sample_release
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.rig import rotation_about_axis
from semisynth_gl.scene.scene import make_scene, move
from semisynth_gl.scene.view_volume import height_of_view

# One for all: models are made once.
SEED = 3
OUTPUTS = ("visibility", "instances", "depth", "sky", "normals", "flow", "flow_backward", "disparity_change")
SMALL = (
    *("scenes=[]", "camera.cx_left_px=null", "camera.cx_right_px=null", "camera.cy_px=null"),
    *("camera.width_px=120", "camera.height_px=80", "camera.focal_px=110", "camera.baseline_m=0.4"),
    *(
        "textures.max_patches=16",
        "textures.source=procedural",
        "textures.large_px=0",
        "models.variants=1",
        "models.complex=0",
    ),
    *("background.cuboid=0", "background.room=0", "checks.min_valid=0", "disparity.target={form: uniform}"),
)
MOVING = {"sequence.length": 2, "camera.sway_m": 0.04, "camera.sway_deg": 1.5}


def open_scenes(doffs_px=0.0, sky=0.0, kind="plane", *, signed=True, outputs=OUTPUTS, more=None):
    """A config of open scenes with few models; what is infinitely far away has the disparity -doffs."""
    lowest = 3 - doffs_px if signed else max(2.0, 3 - doffs_px)
    keys = {
        "camera.doffs_px": doffs_px,
        "disparity.signed": signed,
        "disparity.min_px": lowest,
        "disparity.max_px": lowest + 37,
        "background.plane": float(kind == "plane"),
        "background.street": float(kind == "street"),
        "background.plane_disparity_px": lowest - 1.5,
        "background.sky": sky,
        "particles.size_px": [8, 24],
        "particles.layers": [{"count": 16, "disparity_px": [lowest, lowest + 20]}],
    }
    return load_config("kitti", [*SMALL, *(keys | (more or {})).items()]).model_copy(update={"outputs": outputs})


# Exactness


@pytest.mark.one_backend
@pytest.mark.parametrize(
    ("doffs_px", "sky", "kind", "signed"),
    [(20.0, 0.0, "plane", True), (7.0, 1.0, "plane", True), (-5.0, 1.0, "street", False), (0.0, 1.0, "street", False)],
)
def test_truth_is_the_oracles(backend, doffs_px, sky, kind, signed):
    config = open_scenes(doffs_px, sky, kind, signed=signed, more=MOVING)
    with PairRenderer(config, SEED, backend) as renderer:
        pair, sampled = renderer.render(0), renderer.sampler.sample(0)
        scene, models, motion = sampled.scene, renderer.sampler.models, sampled.motion(+1)
    assert scene.sky.any() == (sky > 0)
    least, has_disparity = [], signed or doffs_px < 0
    for eye in EYES:
        view = pair.frame.view(eye)
        row, column = (side.ravel() for side in np.mgrid[: view.disparity.shape[0], : view.disparity.shape[1]])
        row, column = row[::2], column[::2]
        x, y = column.astype(float), row.astype(float)
        hits = cast_rays(scene, models, eye, x, y)
        # Where an edge passes the pixel's centre, either surface may be seen.
        same = view.instances[row, column].astype(int) - 1 == hits.instance
        assert same.mean() > 0.995
        is_sky = np.isin(hits.instance, np.flatnonzero(scene.sky))
        assert is_sky.any() == (sky > 0)
        assert np.array_equal((view.sky[row, column] == SKY)[same], is_sky[same])
        assert set(np.unique(view.sky)) <= {0, SKY}
        disparity, rendered = oracle.disparity_px(scene.camera, hits, signed=signed), view.disparity[row, column]
        valid = np.isfinite(disparity) & same
        assert np.array_equal(np.isfinite(rendered)[same], valid[same])
        assert np.percentile(np.abs(rendered[valid] - disparity[valid]), 99.9) < 1e-4
        assert set(view.disparity[view.sky == SKY]) <= {np.float32(-doffs_px if has_disparity else np.inf)}
        assert np.isposinf(view.depth[view.sky == SKY]).all()
        least.append(disparity[valid].min())
        alike = view.visibility[row, column] == oracle.visibility(scene, models, eye, x, y, hits, signed=signed)
        assert alike[same].mean() > 0.99
        assert alike[same & is_sky].sum() >= 0.99 * (same & is_sky).sum()
        flows = oracle.flow(scene, models, motion, eye, x, y, hits, signed=signed)
        flow, moves = view.flow[row, column], np.isfinite(flows.flow_px).all(axis=1) & same
        assert np.array_equal(np.isfinite(flow).all(axis=1)[same], moves[same])
        assert np.percentile(np.abs(flow[moves] - flows.flow_px[moves]).max(axis=1), 99.9) < 1e-4
        alike = view.flow_visibility[row, column] == flows.visibility
        assert alike[same].mean() > 0.99
        assert alike[same & is_sky].sum() >= 0.99 * (same & is_sky).sum()
        change, changes = view.disparity_change[row, column], np.isfinite(flows.disparity_change_px) & same
        assert np.array_equal(np.isfinite(change)[same], changes[same])
        assert np.percentile(np.abs(change[changes] - flows.disparity_change_px[changes]), 99.9) < 1e-4
        assert (change[is_sky & changes] == 0).all()
        points = pair.frame.points(eye)
        assert np.isnan(points[view.sky == SKY]).all()
        with_point = np.isfinite(view.disparity) & (view.sky != SKY)
        np.testing.assert_allclose(points[with_point][:, 2], view.depth[with_point], rtol=2e-3)
    assert min(least) < 0 if signed else min(least) > 0


@pytest.mark.one_backend
@pytest.mark.parametrize("signed", [True, False])
def test_correspondences_of_a_right_camera_that_deviates_are_the_oracles(backend, signed):
    deviating = {"rig.right_roll_deg": 1.0, "rig.right_pitch_deg": 0.4, "rig.focal_ratio": 1.02}
    outputs = ("visibility", "instances", "sky", "correspondence")
    with PairRenderer(
        open_scenes(12.0, 1.0, signed=signed, outputs=outputs, more=deviating), SEED, backend
    ) as renderer:
        frame, scene = renderer.render(0).frame, renderer.sampler.sample(0).scene
        models = renderer.sampler.models
    for eye in EYES:
        view = frame.view(eye)
        row, column = (side.ravel()[::2] for side in np.mgrid[: view.disparity.shape[0], : view.disparity.shape[1]])
        x, y = column.astype(float), row.astype(float)
        hits = cast_rays(scene, models, eye, x, y)
        same = view.instances[row, column].astype(int) - 1 == hits.instance
        assert same.mean() > 0.995
        expected = oracle.correspondence_px(scene.camera, eye, x, y, hits, signed=signed)
        way, known = view.correspondence[row, column], np.isfinite(expected[:, 0]) & same
        assert known.mean() > 0.9 or not signed
        assert np.array_equal(np.isfinite(way).all(axis=1)[same], known[same])
        assert np.percentile(np.abs(way[known] - expected[known]).max(axis=1), 99.9) < 1e-4
        is_sky = np.isin(hits.instance, np.flatnonzero(scene.sky)) & same
        assert is_sky.any()
        assert np.isfinite(way[is_sky]).all() == signed
        visibility = oracle.visibility(scene, models, eye, x, y, hits, signed=signed)
        assert (view.visibility[row, column] == visibility)[same].mean() > 0.99
        points = frame.points(eye)
        assert np.isnan(points[view.sky == SKY]).all()


# On paper: f B = 10 px m.
CAMERA = StereoCamera.centred(200, 24, 100.0, 0.1, doffs_px=20.0)


def test_negative_disparities_are_hidden_and_leave_the_image_where_paper_says(open_renderer):
    """The wall is at -12, the board at -5 and from 60 to 80 on the right: the wall's 48 to 68 is hidden there."""
    scene = one_model(CAMERA, [board(CAMERA, -100, 400, -12.0), board(CAMERA, 60.25, 80.25, -5.0)])
    frame = open_renderer([FACE], noise_layers(1, 16), signed=True).render(scene)
    row, x = 12, np.arange(200)
    np.testing.assert_allclose(frame.left.disparity[row], np.where((x > 55.25) & (x < 75.25), -5, -12), atol=1e-4)
    expected = np.where((x + 12 > 60.25) & (x + 12 < 80.25), OCCLUDED, VISIBLE)
    expected[(x > 55.25) & (x < 75.25)] = VISIBLE
    expected[x + 12 >= 199.5] = OUTSIDE
    assert frame.left.visibility[row].tolist() == expected.tolist()
    # And the other way round: the left view's board spans 55.25 to 75.25.
    right = np.where((x - 12 > 55.25) & (x - 12 < 75.25), OCCLUDED, VISIBLE)
    right[(x > 60.25) & (x < 80.25)] = VISIBLE
    right[x - 12 < -0.5] = OUTSIDE
    assert frame.right.visibility[row].tolist() == right.tolist()


@pytest.mark.parametrize("signed", [True, False])
def test_crops_are_those_of_the_whole_image(open_renderer, signed):
    boards = [board(CAMERA, -100, 400, -12.0), board(CAMERA, 60.25, 80.25, -5.0), board(CAMERA, 110.0, 130.0, 6.0)]
    scene = one_model(CAMERA, boards, sky=[True, False, False])
    renderer = open_renderer([FACE], noise_layers(1, 16), signed=signed, outputs=("visibility", "sky", "depth"))
    whole = renderer.render(scene)
    assert np.isfinite(whole.left.disparity).all() == signed
    for crop in (Crop(48, 3, 9, 9), Crop(0, 0, 30, 24), Crop(100, 5, 100, 4)):
        assert_equal(renderer.render(scene, crop), whole, crop)


def test_the_sky_has_no_parallax_and_turns_with_the_camera(open_renderer):
    """Neither the baseline nor a shift of the rig moves it; it is behind what stands farther away than its face."""
    camera = StereoCamera.centred(96, 64, 100.0, 0.5)
    sky, far = facing(camera, -300, -300, 700, 700, 2.0), facing(camera, 40, 20, 16, 16, 50.0)
    turn = rotation_about_axis(np.array([[0.0, 1.0, 0]]), np.array([0.05]))[0]
    shifted, turned = (posed(linear, (0.7, -0.2, 0.4)) for linear in (np.eye(3), turn))

    def scene(pose):
        return make_scene(
            camera, model=[0, 0], world_from_model=[sky, far], layer=[0, 1], sky=[True, False], camera_from_world=pose
        )

    renderer = open_renderer([FACE], noise_layers(2, 64), signed=True, outputs=(*OUTPUTS[:4], "flow"))
    still = scene(np.eye(4))
    frame = renderer.render(still, future=move(still, camera_from_world=turned))
    both = (frame.left.sky == SKY) & (frame.right.sky == SKY)
    assert (frame.left.instances[20:36, 40:56] == 2).all()
    assert (frame.left.sky == SKY).sum() == 96 * 64 - 16 * 16
    np.testing.assert_array_equal(frame.left.image[both], frame.right.image[both])
    assert (frame.left.disparity[frame.left.sky == SKY] == 0).all()
    seen = frame.left.visibility[frame.left.sky == SKY]
    assert set(seen) == {VISIBLE, OCCLUDED}
    moved = renderer.render(scene(shifted), future=move(still))
    both = (frame.left.sky == SKY) & (moved.left.sky == SKY)
    np.testing.assert_array_equal(frame.left.image[both], moved.left.image[both])
    y, x = (side.ravel() for side in np.mgrid[:64, :96])
    then = camera.rays("left", x, y) @ turn.T
    u = 100 * then[:, 0] / then[:, 2] + camera.cx_left_px - x
    in_sky = (frame.left.sky == SKY).ravel()
    np.testing.assert_allclose(frame.left.flow[..., 0].ravel()[in_sky], u[in_sky], atol=1e-4)


def test_a_sky_of_another_shape_is_refused():
    with pytest.raises(InputError, match=r"sky must be \(1,\) bool"):
        one_model(CAMERA, [np.eye(4)], sky=[True, False])


# Configs


BAD = [
    ({"disparity.min_px": 0}, "disparity.min_px goes down to 0 px: .*signed is false"),
    ({"background.plane_disparity_px": 0}, "plane_disparity_px goes down to 0 px"),
    ({"particles.clutter": [{"count": 3, "disparity_px": -2}]}, "clutter.0.disparity_px goes down to -2 px"),
    ({"disparity.target": {"form": "uniform", "high_px": 0}}, "target: expected low_px < high_px"),
    ({"scenes": [{"recipe": "a", "disparity": {"signed": True}}]}, "a recipe cannot change this key"),
]
BAD_SIGNED = [
    ({"disparity.min_px": -10}, "disparity.min_px goes down to -10 px: .* doffs = 10 px"),
    ({"camera.doffs_px": [3, 10]}, "disparity.min_px goes down to -7 px: .* doffs = 3 px"),
    ({"background.plane_disparity_px": [-12, -5]}, "background.plane_disparity_px goes down to -12 px"),
    ({"disparity.target": {"form": "uniform", "low_px": -30}}, "of the pixels below and 0.0% above"),
]


@pytest.mark.parametrize(
    ("signed", "keys", "message"), [*((False, *case) for case in BAD), *((True, *case) for case in BAD_SIGNED)]
)
def test_what_has_no_place_is_refused_by_its_key(signed, keys, message):
    good = open_scenes(10.0 if signed else 0.0, signed=signed)
    values = list(good.model_dump(mode="json").items())
    with pytest.raises(InputError, match=message):
        load_config("kitti", [*values, *keys.items()])


TARGETS = [
    {"form": "uniform"},
    {"form": "uniform-depth"},
    {"form": "gamma", "origin_px": -16, "mean_px": -8, "spread_px": 5},
    {"form": "gamma", "origin_px": 0, "mean_px": 6, "spread_px": 3},
    {"form": "histogram", "first_px": -15, "bin_px": 5, "shares": [1, 2, 3, 2, 1]},
]


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target["form"])
def test_targets_reach_below_0(target):
    config = open_scenes(20.0, more={"disparity.min_px": -15, "disparity.max_px": 18, "disparity.target": target})
    wanted = config.wanted_histogram()
    assert wanted.edges_px[0] == -15
    assert wanted.shares.sum() == pytest.approx(1)
    assert (wanted.shares >= 0).all()
    assert (wanted.cumulative(0.0) > 1e-4) == (target.get("origin_px") != 0)


def test_scenes_are_as_many_below_0_as_above():
    """A rig of a large doffs shows what one without shows, all disparities less by that."""
    expected = []
    for doffs_px in (0.0, 20.0):
        solved = {"particles.layers": None, "particles.size_px": [20, 80]}
        with PairRenderer(open_scenes(doffs_px, outputs=(), more=solved), SEED) as renderer:
            expected.append(renderer.sampler.expected())
    np.testing.assert_allclose(expected[1].edges_px + 20, expected[0].edges_px, atol=1e-9)
    np.testing.assert_allclose(expected[1].shares, expected[0].shares, atol=0.02)


def test_particles_come_into_both_views_at_any_disparity():
    """What the right view shows at its left border is left of the left view where its disparity is negative."""
    camera = StereoCamera.centred(100, 60, 50.0, 0.1, doffs_px=40.0)
    slots = Slots(
        *(np.full(4000, value) for value in (1.0, -30.0, 5.0, 1.0, 1.0, 0.5, 1.0, 1.0)), height_of_view(camera)
    )
    start = sample_release(camera, ParticlesSection(), slots, np.random.default_rng(0)).start_px
    assert start.min() == pytest.approx(-30 - 5 - 0.5, abs=0.3)
    assert start.max() == pytest.approx(100 + 5 - 0.5, abs=0.3)


def test_panels_stand_in_the_farther_half_of_signed_disparities():
    config = open_scenes(20.0, outputs=(), more={"structures.panels": 6, "structures.panel_slant_deg": 0})
    with PairRenderer(config, SEED) as renderer:
        scene = renderer.sampler.sample(0).scene
    disparity_px = scene.camera.disparity_px(scene.world_from_model[1:7, 2, 3])
    assert (disparity_px > -17.5).all()
    assert (disparity_px < np.sqrt(3 * 40) - 20 + 0.5).all()


def test_a_share_of_the_open_scenes_has_a_sky_and_nothing_else_changes():
    scenes = []
    for sky in (0.5, 0.0):
        config = open_scenes(0.0, sky, outputs=("instances",), more={"structures.panels": 2})
        with PairRenderer(config, SEED) as renderer:
            sampled = [renderer.sampler.sample(index) for index in range(20)]
            tables = [one.instance_table() for one in sampled]
            facts = [one.provenance().get("sky") for one in sampled]
            scenes.append([one.scene for one in sampled])
        assert facts == [True if scene.sky.any() else None for scene in scenes[-1]]
        assert [[row.get("sky", False) for row in rows] for rows in tables] == [s.sky.tolist() for s in scenes[-1]]
    some, none = scenes
    assert 4 < sum(scene.sky.any() for scene in some) < 16
    assert all(scene.sky.sum() in (0, 1) and not scene.sky[1:].any() for scene in some)
    assert not any(scene.sky.any() for scene in none)
    for scene, plain in zip(some, none, strict=True):
        np.testing.assert_array_equal(scene.world_from_model[1:], plain.world_from_model[1:])


# Files


@given(st.lists(st.floats(width=32), min_size=1, max_size=40))
def test_signed_png16_keeps_all_but_what_is_too_large(values):
    disparity = np.array([values], np.float32)
    exceeding = SIGNED_DISPARITY.exceeds_limit(disparity)
    decoded = SIGNED_DISPARITY.decode(SIGNED_DISPARITY.encode(disparity), "d.png")
    known = np.isfinite(disparity) & ~exceeding
    assert np.array_equal(np.isfinite(decoded), known)
    assert np.isposinf(decoded[~known]).all()
    assert (np.abs(decoded[known] - disparity[known]) <= SIGNED_DISPARITY.error_px * (1 + 1e-6)).all()
    assert (np.abs(decoded[known]) <= SIGNED_DISPARITY.limit_px).all()
    assert (np.abs(disparity[exceeding]) > SIGNED_DISPARITY.limit_px).all()
    again = SIGNED_DISPARITY.decode(SIGNED_DISPARITY.encode(decoded), "d.png")
    np.testing.assert_array_equal(again, decoded)


@pytest.mark.one_backend
def test_datasets_are_read_back_verified_and_evaluated(tmp_path, backend):
    config = open_scenes(6.5, 1.0, more=MOVING)
    with PairRenderer(config, SEED, backend) as renderer:
        made = [renderer.render(number) for number in range(2)]
    encoded = config.model_copy(update={"files": config.files.model_copy(update={"disparity": "png16"})})
    data, results, least = tmp_path / "data", tmp_path / "results", []
    generate(encoded, data, 2, SEED, layout="webdataset", backend=backend)
    index = read_index(data)
    assert (index.signed, index.plan.format) == (True, 1)
    assert all_findings(data, 50) == []
    results.mkdir()
    for pair, expected in zip(open_dataset(data), made, strict=True):
        arrays, drawn_arrays = pair.arrays(), expected.frame.arrays()
        assert arrays.keys() == drawn_arrays.keys()
        for role, array in arrays.items():
            if role.startswith(("disparity_left", "disparity_right")):
                np.testing.assert_allclose(array, drawn_arrays[role], atol=SIGNED_DISPARITY.error_px, rtol=0)
                least.append(array.min())
            elif role.startswith(("sky", "left", "right", "instances")):
                np.testing.assert_array_equal(array, drawn_arrays[role])
        for eye in EYES:
            np.testing.assert_array_equal(pair.sky_of_instances(eye), pair.view(eye).sky == SKY)
        (results / f"{pair.name}.png").write_bytes(SIGNED_DISPARITY.encode(pair.left.disparity))
    assert min(least) < 0
    for protocol in ("middlebury", "kitti", "eth3d", "paper"):
        mean = evaluate(results, data, protocol)["mean"]["all"]
        assert mean["epe"] < 0.003, protocol
        assert mean["coverage"] == PROTOCOLS[protocol].full_share, protocol


def test_verify_finds_what_no_sky_has(tmp_path):
    config = open_scenes(6.5, 1.0, outputs=("sky", "instances", "depth"))
    generate(config, tmp_path / "data", 1, SEED, layout="middlebury")
    folder = next((tmp_path / "data/MiddEval3/trainingF").glob("*"))

    def found(rays=0):
        every = all_findings(tmp_path / "data", rays)
        said.extend(finding.message for finding in every if finding.check == "oracle")
        return {finding.check for finding in every} - {"sha256"}

    said = []
    assert found(200) == set()
    path, mask = folder / "disp0GT.pfm", folder / "sky0.png"
    whole, sky = path.read_bytes(), mask.read_bytes()
    disparity = PFM.decode(whole, path)
    for wrong, checks in ((-6.0, {"depth"}), (-9.0, {"disparity"}), (np.inf, {"disparity"})):
        path.write_bytes(PFM.encode(np.where(disparity == np.float32(-6.5), np.float32(wrong), disparity)))
        assert checks <= found(), wrong
    path.write_bytes(whole)
    for values in (np.zeros_like(disparity, np.uint8), GREY8.decode(sky, mask) // 2):
        mask.write_bytes(GREY8.encode(values))
        assert {"sky", "oracle"} <= found(200)
        assert said.pop().startswith("sky_left: ")
        assert said == []


def test_a_sky_without_a_disparity_is_no_finding(tmp_path):
    """What has no output to tell where the sky is cannot be judged there; what has one is."""
    for number, outputs in enumerate([("sky", "normals"), ("normals",)]):
        data = tmp_path / str(number)
        generate(open_scenes(0.0, 1.0, signed=False, outputs=outputs), data, 1, SEED, layout="webdataset")
        [pair] = open_dataset(data)
        assert np.isinf(pair.left.disparity).any()
        assert all_findings(data) == [], outputs


def test_layouts_whose_files_have_no_negative_disparities_are_refused():
    config, able = open_scenes(4.0), []
    for name in LAYOUTS:
        if name in ("kitti", "crestereo"):
            with pytest.raises(InputError, match=rf"{name} stores .* choose another layout: .*middlebury.*webdataset"):
                make_plan(config, 0, name, {"train": 1})
        else:
            able.append(name)
            assert make_plan(config, 0, name, {"train": 1}).values()["format"] == 1
    assert len(able) == 5
    assert make_plan(load_config("kitti"), 0, "kitti", {"train": 1}).values()["format"] == 1


@pytest.mark.heavy
def test_the_stream_and_written_datasets_give_the_same_tensors(tmp_path):
    torch = heavy("torch")
    from semisynth_gl.torch import StereoDataset, StereoStream, collate

    config = open_scenes(6.5, 1.0, outputs=("sky", "visibility"))
    generate(config, tmp_path / "data", 2, SEED, layout="webdataset")
    streamed = list(StereoStream(config, SEED, 2))
    for sample, read in zip(streamed, StereoDataset(tmp_path / "data"), strict=True):
        assert list(sample) == list(read)
        for name in ("disparity_left", "disparity_right", "sky_left", "sky_right", "visibility_left"):
            assert torch.equal(sample[name], read[name]), name
        assert sample["sky_left"].dtype == torch.uint8
        valid = torch.isfinite(sample["disparity_left"]) & (sample["sky_left"] == 0)
        assert (sample["disparity_left"][~valid] == -6.5).all()
        assert sample["disparity_left"][valid].min() < 0
    assert collate(streamed)["sky_right"].shape == (2, 80, 120)
