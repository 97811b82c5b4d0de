"""The range of disparity and its histogram: measured from maps, or chosen over a known range."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_files import CAMERA, facts
from config_texts import parse_config
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from semisynth_gl.calibration.arrays import DisparityBounds
from semisynth_gl.calibration.disparity_range import (
    chosen_range,
    disparity_range,
    measure_maps,
    measured_range,
    read_values,
)
from semisynth_gl.calibration.kinds import Size
from semisynth_gl.calibration.rig import Rig, plain_rig
from semisynth_gl.calibration.style import untried_style
from semisynth_gl.calibration.write import write as write_draft
from semisynth_gl.config import Range
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.histogram import Histogram, PixelCount, total_variation
from semisynth_gl.inputs.errors import InputError, ReadError, SemisynthError
from semisynth_gl.judge.place import map_files, read_map

SMALL = plain_rig(30, 0.1, Size(40, 30))


def pfm(values, *, little=True):
    kind, scale = ("<f4", "-1.0") if little else (">f4", "1.0")
    height, width = values.shape
    return f"Pf\n{width} {height}\n{scale}\n".encode() + np.asarray(values[::-1], kind).tobytes()


def test_maps_say_where_there_is_no_value(tmp_path):
    values = np.array([[1.5, 2.25, np.inf], [np.nan, 0.0, -3.0]], np.float32)
    wanted = np.array([[1.5, 2.25, np.nan], [np.nan] * 3], np.float32)
    (tmp_path / "a.pfm").write_bytes(pfm(values))
    (tmp_path / "b.pfm").write_bytes(pfm(values, little=False))
    np.save(tmp_path / "c.npy", values.astype(np.float64))
    np.save(tmp_path / "d.npy", values[None, None])
    np.save(tmp_path / "e.npy", values[..., None].astype(np.float16))
    for name in ("a.pfm", "b.pfm", "c.npy", "d.npy", "e.npy"):
        np.testing.assert_array_equal(read_map(tmp_path / name), wanted)
    Image.fromarray(np.array([[384, 576, 0], [0, 0, 0]], np.uint16)).save(tmp_path / "k.png")
    np.testing.assert_array_equal(read_map(tmp_path / "k.png"), wanted)
    np.testing.assert_array_equal(read_map(tmp_path / "k.png", 128), wanted * 2)


def test_images_beside_maps_are_passed_over(tmp_path):
    (tmp_path / "only").mkdir()
    for name in ("photo.png", "only/photo.png"):
        Image.new("RGB", (40, 30)).save(tmp_path / name)
    (tmp_path / "disp0.pfm").write_bytes(pfm(np.ones((30, 40))))
    Image.fromarray(np.full((30, 40), 256, np.uint16)).save(tmp_path / "disp.png")
    assert [path.name for path in map_files([tmp_path])] == ["disp.png", "disp0.pfm"]
    with pytest.raises(InputError, match=r"no disparity map there"):
        map_files([tmp_path / "only"])
    for name, words in (("photo.png", "expected 16-bit grey"), ("broken.pfm", "expected a PFM header")):
        (tmp_path / "broken.pfm").write_bytes(b"junk")
        with pytest.raises(ReadError, match=words):
            measure_maps([tmp_path / name], [SMALL])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.full((30, 40), np.nan), ["holds no disparity", "40 x 30"]),
        (np.ones((40, 30)), ["has 30 x 40 pixels", "40 x 30", "maps of this rig"]),
        (np.ones((2, 2)), ["has 2 x 2 pixels", "at most 16 times"]),
        (np.full((30, 40), 512.0), ["up to 512 px", "40 px wide", "256 levels per pixel"]),
        (np.ones((3, 30, 40)), ["one value per pixel", "(3, 30, 40)"]),
        (np.ones((30, 40), complex), ["expected numbers, got complex128"]),
    ],
)
def test_maps_that_fit_no_rig_are_refused_with_their_numbers(tmp_path, values, words):
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(SemisynthError) as error:
        measure_maps([tmp_path / "a.npy"], [SMALL])
    for word in ("a.npy", *words):
        assert word in str(error.value)


def test_a_sparse_map_counts_as_much_as_a_dense_one(tmp_path):
    sparse = np.full((30, 40), np.nan)
    sparse[:2, :5] = 10.03
    np.save(tmp_path / "sparse.npy", sparse)
    np.save(tmp_path / "dense.npy", np.full((30, 40), 20.03))
    measured = measure_maps([tmp_path / "sparse.npy", tmp_path / "dense.npy"], [SMALL])
    assert measured.cumulative(15) == pytest.approx(0.5)
    assert measured.mean_px == pytest.approx(15.03, abs=0.04)


def test_maps_of_several_sizes_count_at_the_rigs_width(tmp_path):
    # One view at several resolutions: a ramp from 2 to 10 % of the width.
    sizes = (Size(40, 30), Size(80, 60), Size(100, 56), Size(640, 480))
    for number, (width, height) in enumerate(sizes):
        np.save(
            tmp_path / f"{number}.npy", np.linspace(0.02 * width, 0.1 * width, width * height).reshape(height, width)
        )
    paths = sorted(tmp_path.iterdir())
    same, *others = (measure_maps([path], [SMALL]) for path in paths)
    for found in (*others, measure_maps(paths, [SMALL])):
        assert total_variation(same, found) < 0.03
        assert found.mean_px == pytest.approx(0.06 * 40, abs=0.05)
    # A map that has the size of one of several rigs is taken as it is.
    large = plain_rig(60, 0.1, Size(80, 60))
    assert measure_maps(paths[1:2], [SMALL, large]).mean_px == pytest.approx(0.06 * 80, abs=0.05)
    assert disparity_range([SMALL], paths).origin.startswith("Measured from 4 disparity maps: ")


@settings(max_examples=150, deadline=None)
@given(low=st.floats(0.05, 500), span=st.floats(0.05, 900))
def test_bins_are_of_one_round_width_and_hold_the_range(low, span):
    for found in (chosen_range(low, low + span), measured_range(Histogram.from_counts([low, low + span], [1.0]))):
        edges = found.target.edges_px
        assert 14 <= len(found.target.shares) <= 22
        np.testing.assert_allclose(np.diff(edges), found.bin_px, rtol=1e-5)
        assert edges[0] <= low + 0.002 * span
        assert 0 < found.min_px <= low + 0.002 * span
        assert found.max_px >= low + 0.99 * span
        assert found.target.shares.sum() == pytest.approx(1)
        # What a config wants beyond its own limits is refused from 2 % on.
        inside = np.diff(found.target.cumulative([found.min_px, found.max_px]))[0]
        assert inside > 0.985


@settings(max_examples=100, deadline=None)
@given(
    doffs_px=st.floats(-300, 300),
    wider_px=st.floats(0, 50),
    beyond_px=st.floats(0.01, 200),
    span=st.floats(0.05, 600),
    baseline_m=st.sampled_from([0.001, 100.0]),  # indoor, outdoor
)
def test_nothing_of_a_config_lies_beyond_infinity(doffs_px, wider_px, beyond_px, span, baseline_m):
    cameras = [StereoCamera.centred(640, 480, 500.0, baseline_m, each) for each in (doffs_px, doffs_px + wider_px)]
    farthest = max(-doffs_px, 0)
    low = farthest + beyond_px
    for found in (
        measured_range(Histogram.from_counts([low, low + span], [1.0]), doffs_px),
        chosen_range(None, low + span, doffs_px),
        chosen_range(low, low + span, doffs_px),
    ):
        known = facts([Rig(camera, "x") for camera in cameras], found)
        # The recipes' numbers are looked at below: a config takes much longer to read with them.
        text = write_draft(replace(known, tried=untried_style(known.recipes[-1:])))
        config = parse_config(text)
        assert farthest < config.disparity.min_px < low + span
        if config.background.plane:
            planes = config.background.plane_disparity_px
            assert farthest < planes.low < planes.high < config.disparity.min_px
        if config.background.cuboid:
            assert config.background.wall_disparity_px.low > farthest
        for recipe in known.recipes:
            shown = [layer["disparity_px"] for layer in recipe.keys.get("particles", {}).get("layers", ())]
            keys = ("background", "wall_disparity_px"), ("structures", "panel_disparity_px")
            shown += [recipe.keys[name][key] for name, key in keys if key in recipe.keys.get(name, {})]
            for first, last in shown:
                assert farthest < first <= last <= config.disparity.max_px, recipe.name


def test_the_far_plane_of_a_negative_doffs_is_before_infinity():
    rigs = [Rig(StereoCamera.centred(640, 480, 500.0, 2.0, each), "x") for each in (-5.0, 2.0)]
    found = measured_range(Histogram.from_counts([6.0, 46.0], [1.0]), -5.0)
    known = facts(rigs, found)
    text = write_draft(known)
    assert found.min_px == 6
    assert "plane_disparity_px: [5.1, 5.7]" in text
    camera = parse_config(text).camera
    assert camera.doffs_px == Range(-5, 2)
    assert chosen_range(None, 55, -5.0).min_px == 6
    # 5.2 would be right of 5.15 in two digits and lose what is before infinity.
    assert 5.15 < measured_range(Histogram.from_counts([5.19, 46.0], [1.0]), -5.15).min_px < 5.25


def test_what_lies_beyond_infinity_is_refused_with_its_numbers():
    with pytest.raises(
        InputError, match=r"disparities lies below 4\.042 px, but with doffs = -5 px .* infinity is 5 px"
    ):
        measured_range(Histogram.from_counts([4.0, 46.0], [1.0]), -5.0)
    with pytest.raises(InputError, match=r"range of disparity begins at 5 px, but with doffs = -5 px"):
        chosen_range(5.0, 46.0, -5.0)


def test_a_chosen_histogram_is_smooth_and_covers_its_range():
    found = chosen_range(None, 64)
    shares = found.target.shares[1:-1]
    assert (found.min_px, found.max_px) == (1.28, 64)
    assert shares.min() > 0.2 / len(shares)
    assert (np.sign(np.diff(np.sign(np.diff(shares)))) != 0).sum() <= 1  # one hump
    for low, high in ((5, 5), (9, 3), (0, 8), (-4, 8), (1, float("inf")), (float("nan"), 8)):
        with pytest.raises(InputError, match="expected low < high, both above 0"):
            chosen_range(low, high)


def test_a_measured_range_has_headroom_and_ignores_the_odd_pixel():
    values = np.concatenate([np.linspace(10, 60, 100_000), [399.0, 0.1]])
    counted = PixelCount(np.arange(0, 401, 1 / 16))
    counted.add(values)
    found = measured_range(counted.histogram)
    assert found.min_px == 10
    assert 64 < found.max_px < 72
    assert total_variation(found.target, counted.histogram) < 1e-9


@given(
    focal_px=st.floats(50, 5000),
    baseline_m=st.floats(0.01, 2),
    doffs_px=st.floats(0, 40),
    near_m=st.floats(0.2, 20),
    ratio=st.floats(1.2, 100),
)
def test_a_range_of_distances_is_that_of_their_disparities(focal_px, baseline_m, doffs_px, near_m, ratio):
    rigs = [plain_rig(focal_px, length_m, Size(640, 480)) for length_m in (baseline_m, baseline_m * 1.1)]
    cameras = [replace(rig.camera, cx_right_px=rig.camera.cx_left_px + doffs_px) for rig in rigs]
    rigs = [replace(rig, camera=camera) for rig, camera in zip(rigs, cameras, strict=True)]
    made = disparity_range(rigs, range_m=(near_m, near_m * ratio))
    ends = [[each.focal_baseline / z - each.doffs_px for z in (near_m * ratio, near_m)] for each in cameras]
    assert made.min_px == pytest.approx(min(low for low, _ in ends), rel=1e-9, abs=1e-9)
    assert made.max_px == pytest.approx(max(high for _, high in ends), rel=1e-9, abs=1e-9)


@pytest.fixture
def map_of(tmp_path):
    def make(values):
        (tmp_path / "d.pfm").write_bytes(pfm(values))
        return tmp_path / "d.pfm"

    return make


def test_maps_of_rigs_with_doffs_hold_disparities_below_zero(map_of):
    values = np.random.default_rng(0).uniform(-8, 30, (48, 64)).astype(np.float32)
    values[:4] = np.inf
    path = map_of(values)
    doffs, none = (Rig(StereoCamera.centred(64, 48, 80.0, 0.2, px), "calib.txt") for px in (12.0, 0.0))
    np.testing.assert_array_equal(np.isfinite(read_values(path, [doffs])), np.isfinite(values))
    np.testing.assert_array_equal(np.isfinite(read_values(path, [none])), np.isfinite(values) & (values > 0))
    found = disparity_range([doffs], [path])
    assert found.signed
    assert -12 < found.min_px <= -8
    assert found.target.cumulative(0.0) == pytest.approx(8 / 38, abs=0.02)
    assert not disparity_range([none], [path]).signed
    # What is beyond infinity is no disparity.
    assert (
        np.nanmin(
            read_values(path, [replace(doffs, camera=replace(doffs.camera, cx_right_px=doffs.camera.cx_left_px + 3))])
        )
        > -3
    )


@pytest.mark.parametrize("mark", [0.0, -1.0, -7.5])
def test_a_number_that_many_pixels_share_marks_what_has_no_disparity(map_of, mark):
    values = np.random.default_rng(0).uniform(5, 30, (48, 64)).astype(np.float32)
    values[:2, :20] = mark
    rig = Rig(StereoCamera.centred(64, 48, 80.0, 0.2, 12.0), "calib.txt")
    found = disparity_range([rig], [map_of(values)])
    assert not found.signed
    assert found.min_px == 5


def test_ranges_and_calibrations_may_begin_below_zero():
    assert not chosen_range(None, 60, 30.0).signed
    assert chosen_range(-20, 60, 30.0).signed
    with pytest.raises(InputError, match=r"begins at -30 px, but with doffs = 30 px"):
        chosen_range(-30, 60, 30.0)
    with pytest.raises(InputError, match="low < high, both above 0"):
        chosen_range(-20, 60, 0.0)
    for vmin_px, signed in ((-20.0, True), (0.0, False), (-40.0, False), (7.0, False)):
        rig = Rig(CAMERA, "calib.txt", DisparityBounds(70, vmin_px, 60.0))
        assert disparity_range([rig]).signed == signed
    for range_px, signed in (((7, 60), False), ((-20, 60), True), ((0, 60), True)):
        text = write_draft(facts([Rig(CAMERA, "x")], disparity_range([Rig(CAMERA, "x")], range_px=range_px)))
        assert ("\ndisparity:\n  signed: true " in text) == signed
        assert f"\n  min_px: {range_px[0]}\n" in text


def test_a_calibration_may_bound_the_disparities():
    bounds = (DisparityBounds(70, 7), DisparityBounds(vmin_px=5, vmax_px=90.5), DisparityBounds())
    rigs = [Rig(StereoCamera.centred(640, 480, 700.0, 0.2, 10.0 * k), "x", each) for k, each in enumerate(bounds)]
    for chosen, ends in ((rigs[:1], (7, 70)), (rigs[:2], (5, 90.5)), (rigs, (1.81, 90.5))):
        found = disparity_range(chosen)
        assert (found.min_px, found.max_px) == pytest.approx(ends)
    with pytest.raises(InputError, match=r"as ndisp or vmax; give disparity maps.* 140 / Z - 20 px"):
        disparity_range(rigs[2:])
