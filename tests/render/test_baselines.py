"""Several baselines of one scene: pairs that share a left view, in the renderer, in sequences, in files."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from backends import backend_fault
from planted_faults import findings
from recorder import Recorder
from scenes import assert_equal, one_model
from tiny_datasets import cheap, digests

from semisynth_gl import oracle
from semisynth_gl.config import Config, Range
from semisynth_gl.config.rig_sections import CameraSection
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.frame.camera import EYES, Crop, StereoCamera
from semisynth_gl.frame.channels import DRAWN_OUTPUTS
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.verify import verify_dataset
from semisynth_gl.layouts import Key
from semisynth_gl.pairs import pipeline
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.rig import sample_camera, sample_views
from semisynth_gl.seeds.seeds import Purpose, generator

SEVERAL = [0.4, 1.0, 0.7]
MOVING = {"length": 2, "frame_s": 0.1}
SEED = 3


def several(baselines=SEVERAL, camera=None, **changes):
    """A config of pairs that take milliseconds, in colour and with a camera that sways."""
    values = cheap().model_dump(mode="json")
    values["camera"] |= {"sway_m": 0.02, "sway_deg": 1.0, "baselines": baselines} | (camera or {})
    if isinstance(baselines, list):
        del values["camera"]["baseline_m"]
    return Config.model_validate(values | changes)


# Rendering


@pytest.mark.one_backend
@pytest.mark.parametrize(
    "changes",
    [{}, {"antialias": "edges"}, {"antialias": "ssaa2", "truth": "left"}, {"rig": {"right_roll_deg": 2.0}}],
    ids=["rectified", "outlines", "samples-left", "deviating"],
)
def test_each_pair_is_that_of_a_rig_of_its_baseline_alone_bit_for_bit(backend, changes):
    """All outputs of both views, whole and cropped, asked for in any order."""
    outputs = [output for output in DRAWN_OUTPUTS if output != "disparity_change" or "rig" not in changes]
    config, crop = several(sequence=MOVING, outputs=outputs, **changes), Crop(9, 7, 30, 21)
    options = {"truth": config.truth, "antialias": config.antialias, "rectified": config.rig.none()}
    with PairRenderer(config, SEED, backend) as pairs:
        models, atlas = pairs.sampler.models, pairs.sources.atlas.layers
        with Renderer(models, atlas, outputs=outputs, backend=backend, **options) as alone:
            for index, part in ((4, None), (3, None), (0, None), (5, crop), (3, crop), (1, crop), (2, None)):
                frame = pairs.render(index, crop=part).frame
                sampled = pairs.sampler.sample(index)
                motions = {"future": sampled.motion(1), "past": sampled.motion(-1)}
                assert sampled.scene.camera.baseline_m == SEVERAL[index % 3]
                assert_equal(frame, alone.render(sampled.scene, part, **motions), message=f"of pair {index}")


@pytest.mark.one_backend
def test_pairs_of_a_scene_have_the_disparities_of_rays(backend):
    config = several(outputs=["visibility", "instances"])
    with PairRenderer(config, SEED, backend) as pairs:
        for index in range(3):
            frame, scene = pairs.render(index).frame, pairs.sampler.sample(index).scene
            for eye in EYES:
                y, x = (axis.ravel() for axis in np.mgrid[1:48:3, 1:64:2])
                view, models = frame.view(eye), pairs.sampler.models
                hits = cast_rays(scene, models, eye, x, y)
                # Off edges: rasteriser and ray meet the same instance.
                same = view.instances[y, x] == hits.instance + 1
                assert same.mean() > 0.98
                error = np.abs(view.disparity[y, x] - oracle.disparity_px(scene.camera, hits))[same]
                assert np.quantile(error, 0.999) <= 1e-4
                wrong = view.visibility[y, x] != oracle.visibility(scene, models, eye, x, y, hits)
                assert wrong[same].mean() < 5e-3


@pytest.mark.one_backend
def test_a_left_view_is_drawn_and_read_once_for_all_its_pairs(backend):
    recorder = Recorder()
    with PairRenderer(several(outputs=["visibility", "depth"]), SEED, backend) as pairs:
        pairs.renderer.listener = recorder
        made = [pairs.render(index).frame for index in range(3)]
        assert recorder.stages.count("sample") == 1
        assert recorder.stages.count("draw") == 3
    for frame in made[1:]:
        for name in ("image", "depth"):
            assert frame.left[name] is made[0].left[name]
        assert not np.array_equal(frame.left.disparity, made[0].left.disparity)
    with pytest.raises(ValueError, match="read-only"):
        made[0].left.image[0, 0] = 0


@pytest.mark.one_backend
def test_one_pair_that_fails_its_checks_draws_its_scene_again_for_all(backend, monkeypatch):
    """Of the first frame alone, and all right views are judged."""
    judged = []

    def faults(frame, _config, _closed):
        judged.append(frame.camera.baseline_m)
        return ["too short"] if judged.count(0.7) == 1 and frame.camera.baseline_m == 0.7 else []

    monkeypatch.setattr(pipeline, "faults", faults)
    with PairRenderer(several(sequence=MOVING), SEED, backend) as pairs:
        made = [pairs.render(index) for index in (4, 0, 5, 2)]
        assert judged == [0.4, 1.0, 0.7] * 2
        for pair in made:
            assert pair.provenance["redrawn"] == ["too short"]
            assert pair.provenance["view"] == pair.index % 3
            expected = pairs.sampler.sample(pair.index, 1)
            assert (expected.frame, expected.view) == divmod(pair.index, 3)
            assert pair.provenance["camera"]["baseline_m"] == expected.scene.camera.baseline_m


@pytest.mark.one_backend
def test_imperfections_of_the_left_eye_belong_to_the_scene_and_of_the_right_one_to_the_pair(backend):
    imperfections = {"exposure_stops": [-0.5, 0.5], "noise": [2.0, 4.0], "blur_px": [0.0, 1.0]}
    imperfections |= {"motion_blur": [0.3, 0.6], "jpeg_quality": [60, 95]}
    config = several(imperfections=imperfections)
    alone = several([SEVERAL[0]], imperfections=imperfections)
    with PairRenderer(config, SEED, backend) as pairs, PairRenderer(config, SEED, backend) as others:
        made = [pairs.render(index) for index in range(6)]
        assert_equal(others.render(4).frame, made[4].frame)
        assert_equal(others.render(2, checked=False).frame, made[2].frame)
        for index, expected in enumerate(made[3:], 3):
            pair = others.render(index)
            assert pair.provenance == expected.provenance
            assert_equal(pair.frame, expected.frame)
        assert_equal(others.render(4, crop=Crop(3, 2, 20, 10)).frame, made[4].frame, Crop(3, 2, 20, 10))
    drawn = [pair.provenance["imperfections"] for pair in made]
    for first in (0, 3):
        for pair in made[first : first + 3]:
            np.testing.assert_array_equal(pair.frame.left.image, made[first].frame.left.image)
        assert len({json.dumps(each["left"]) for each in drawn[first : first + 3]}) == 1
        assert len({json.dumps(each["right"]) for each in drawn[first : first + 3]}) == 3
    assert drawn[0]["left"] != drawn[3]["left"]
    # A scene of one pair has the same: composed for another baseline, so that its images differ, but not in this.
    with PairRenderer(alone, SEED, backend) as pairs:
        assert [pairs.render(index).provenance["imperfections"] for index in range(2)] == [drawn[0], drawn[3]]


def test_cameras_that_differ_in_the_left_eye_share_no_view(open_renderer, square):
    camera = StereoCamera.centred(32, 24, 30.0, 0.1)
    renderer = open_renderer([square], np.full((1, 4, 4, 4), 255, np.uint8))
    scene = one_model(camera, [np.eye(4)])
    for changed in ({"focal_px": 31.0}, {"cx_left_px": 3.0}, {"cy_px": 1.0}, {"width_px": 31}):
        with pytest.raises(InputError, match="differ from the scene's in the right eye alone"):
            renderer.render_rig(scene, [camera, replace(camera, **changed)])
    with pytest.raises(InputError, match="expected at least one, got none"):
        renderer.render_rig(scene, [])


# Scenes


def test_scenes_are_made_for_their_longest_baseline():
    section = CameraSection(width_px=64, height_px=48, focal_px=Range(60, 80), baseline_m=Range(0.1, 0.5), baselines=4)
    plain = section.model_copy(update={"baselines": 1})
    for number in range(20):
        camera = sample_camera(section, generator(0, Purpose.CAMERA, number))
        assert camera == sample_camera(plain, generator(0, Purpose.CAMERA, number))
        rng = generator(0, Purpose.CAMERA, number)
        views = sample_views(section, sample_camera(section, rng), rng)
        assert views[0].baseline_m == camera.baseline_m
        assert len({view.baseline_m for view in views}) == 4
        assert all(0.1 <= view.baseline_m <= 0.5 and view.left_alone == camera.left_alone for view in views)


def test_doffs_is_the_longest_baselines_unless_the_right_principal_point_is_stated():
    base = {"width_px": 64, "height_px": 48, "focal_px": 60, "cx_left_px": 30, "baselines": [0.1, 0.4, 0.2]}
    for keys, expected in (({"doffs_px": 8}, [2, 8, 4]), ({"cx_right_px": 38}, [8, 8, 8])):
        section, rng = CameraSection.model_validate({**base, **keys}), np.random.default_rng(0)
        views = sample_views(section, sample_camera(section, rng), rng)
        assert [view.doffs_px for view in views] == pytest.approx(expected)
        far_m = [view.depth_m(0.0) for view in views]
        assert (max(far_m) == pytest.approx(min(far_m))) == ("doffs_px" in keys)


@pytest.mark.parametrize("principal", [{"doffs_px": 1.5}, {"cx_left_px": 30, "cx_right_px": 31.5}])
@pytest.mark.parametrize("baselines", [[0.1, 0.4, 0.3], 3, 2])
def test_pairs_are_expected_to_show_what_their_baselines_make_of_the_target(baselines, principal):
    """Against draws: a disparity of the longest baseline, and the others of its scene."""
    config = several(baselines, {"baseline_m": [0.1, 0.4]} | principal)
    doffs_px = 1.5 if "cx_right_px" in principal else 0
    rng, shown = np.random.default_rng(0), []
    wanted = config.wanted_histogram()
    for _ in range(6_000):
        drawn = np.array([each.sample(rng) for each in config.camera.baseline_ranges_m])
        longest_px = wanted.quantile(rng.random())
        shown.append(drawn / drawn.max() * (longest_px + doffs_px) - doffs_px)
    shown = np.concatenate(shown)
    expected = config.shown_histogram()
    assert expected.shares.sum() == pytest.approx(1)
    assert np.isin(np.round(wanted.edges_px, 9), np.round(expected.edges_px, 9)).all()
    below = [(shown[shown > 0] < px).mean() for px in expected.edges_px]
    np.testing.assert_allclose(expected.cumulative(expected.edges_px), below, atol=0.015)
    assert expected.mean_px < wanted.mean_px
    one = several([0.4])
    assert one.across_baselines(wanted) is wanted


def test_signed_disparities_of_shorter_baselines_are_counted_below_0():
    signed = {"signed": True, "min_px": -8, "max_px": 10, "target": {"form": "uniform"}}
    principal = {"cx_left_px": 30, "cx_right_px": 40}
    others = {"disparity": signed, "background": {"wall_disparity_px": -8}, "particles": {}}
    shown = several([0.4, 0.1], principal, **others).shown_histogram()
    # A quarter of the baseline: (d + 10) / 4 - 10 for d from -8 to 10, which is -9.5 to -5.
    assert shown.edges_px[0] == pytest.approx(-9.5, abs=0.5)
    assert shown.cumulative(-8) == pytest.approx(1 / 6, abs=0.02)
    assert shown.cumulative(-5) == pytest.approx(1 / 2 + 1 / 12, abs=0.02)
    # All disparities are in proportion: -2 to 2.5.
    shown = several([0.4, 0.1], {"doffs_px": 10}, **others).shown_histogram()
    assert shown.edges_px[0] == pytest.approx(-8)
    assert shown.cumulative(-2) == pytest.approx(1 / 6, abs=0.02)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"baselines": 2, "baseline_m": 0.2}, "expected a range for 2 baselines, got only 0.2 m"),
        ({"baselines": [0.1, 0.2], "baseline_m": 0.2}, "give either baseline_m"),
        ({"baselines": 3}, "give either baseline_m"),
        *(({"baselines": number, "baseline_m": [1, 2]}, "baselines") for number in (0, 65, True)),
        *(({"baselines": metres}, "baselines") for metres in ([], [0.1, "0.2"], [0.1, 0])),
    ],
)
def test_baselines_that_cannot_be_are_refused(keys, said):
    with pytest.raises(ValueError, match=said):
        CameraSection.model_validate({"width_px": 64, "height_px": 48, "focal_px": 60, **keys})


# Files


def test_loaders_of_sequences_get_one_for_each_right_view():
    keys = [Key("a", "train", index, 2, 3) for index in range(14)]
    assert [(key.sequence, key.frame) for key in keys] == [
        *((0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)),
        *((3, 0), (4, 0), (5, 0), (3, 1), (4, 1), (5, 1)),
        *((6, 0), (7, 0)),
    ]
    assert [Key("a", "train", index, None, 3).sequence for index in range(4)] == [0, 1, 2, 3]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A sequence of two frames and three baselines, and the beginning of another one; and what it is made by."""
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    root = tmp_path_factory.mktemp("baselines")
    config = several(sequence=MOVING, outputs=["visibility", "instances", "depth", "flow", "flow_backward"])
    generate(config, root / "whole", 8, SEED, layout="sceneflow", shard_pairs=4)
    return config, root


def test_a_dataset_of_several_baselines_is_whole(written):
    root = written[1]
    index = read_index(root / "whole")
    assert index.plan.views == 3
    verdicts = list(verify_dataset(index, 20))
    assert [str(finding) for verdict in verdicts for finding in verdict.findings] == []
    # Flow was compared with the same view's frame before.
    compared = ["flow_left_frames_median_px" in verdict.measures for verdict in verdicts[1:]]
    assert compared == [index // 3 % 2 == 1 for index in range(8)]
    dataset = open_dataset(root / "whole")
    lefts = {}
    for pair in dataset:
        scene, view = divmod(pair.index, 3)
        assert (pair.provenance["view"], pair.camera.baseline_m) == (view, SEVERAL[view])
        assert (pair.provenance["sequence"], pair.provenance["frame"]) == divmod(scene, 2)
        files = index.plan.files("train", pair.index)
        for role in ("left", "instances_left", "depth_left", "flow_left", "flow_visibility_left"):
            assert lefts.setdefault((scene, role), data := (root / "whole" / files[role]).read_bytes()) == data
    assert len({data for (_, role), data in lefts.items() if role == "left"}) == 3


def test_a_run_that_ends_within_a_scene_goes_on_there(written, tmp_path):
    """A shard of four pairs ends within a scene of three too."""
    config, root = written
    recorder = Recorder(lambda pair: pair.index == 4)
    result = generate(config, tmp_path / "out", 8, SEED, layout="sceneflow", shard_pairs=4, listener=recorder)
    assert result.stopped
    generate(config, tmp_path / "out", 8, SEED, layout="sceneflow")
    assert digests(tmp_path / "out") == digests(root / "whole")


def test_the_number_of_a_pairs_view_is_compared(written, tmp_path):
    dataset = shutil.copytree(written[1] / "whole", tmp_path / "changed", symlinks=True)
    path = dataset / read_index(dataset).plan.files("train", 2)["provenance"]
    path.write_text(json.dumps(json.loads(path.read_text()) | {"view": 1}))
    (found,) = findings(dataset)
    assert (found.check, found.message) == ("origin", "view is 1, in the index 2")
