"""The disparity range and histogram: measured from maps, or chosen for a known range."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_files import CAMERA, draft, plain_rig
from config_texts import parse_config
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from semisynth_gl.calibration.disparity_range import chosen_range, disparity_range, measure_maps, measured_range
from semisynth_gl.calibration.rig import RectifiedRig
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.histogram import Histogram, count_pixels, total_variation
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.judge.place import map_files, read_map

SMALL = plain_rig(30, 0.1, 40, 30)


def test_maps_say_where_there_is_no_value(tmp_path):
    values = np.array([[1.5, 2.25, np.inf], [np.nan, 0.0, -3.0]], np.float32)
    wanted = np.array([[1.5, 2.25, np.nan], [np.nan] * 3], np.float32)
    (tmp_path / "a.pfm").write_bytes(PFM.encode(values))
    (tmp_path / "b.pfm").write_bytes(b"Pf\n3 2\n1.0\n" + values[::-1].astype(">f4").tobytes())
    np.save(tmp_path / "c.npy", values[None, None].astype(np.float64))
    Image.fromarray(np.array([[384, 576, 0], [0, 0, 0]], np.uint16)).save(tmp_path / "k.png")
    Image.new("RGB", (3, 2)).save(tmp_path / "photo.png")
    assert [path.name for path in map_files([tmp_path])] == ["a.pfm", "b.pfm", "c.npy", "k.png"]
    for path in map_files([tmp_path]):
        np.testing.assert_array_equal(read_map(path), wanted)
    np.testing.assert_array_equal(read_map(tmp_path / "k.png", 128), wanted * 2)
    with pytest.raises(ReadError, match="expected 16-bit grey"):
        measure_maps([tmp_path / "photo.png"], SMALL.size)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.full((30, 40), np.nan), ["disparities above 0"]),
        (np.full((30, 40), 512.0), ["of 512 px", "256 levels per pixel"]),
        (np.ones((40, 30)), ["has 30 x 40 pixels", "40 x 30"]),
        (np.ones((15, 40)), ["has 40 x 15 pixels"]),
    ],
)
def test_maps_that_fit_no_rig_are_refused_with_their_numbers(tmp_path, values, words):
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(InputError) as error:
        measure_maps([tmp_path / "a.npy"], SMALL.size)
    for word in ("a.npy", *words):
        assert word in str(error.value)


def test_a_sparse_map_counts_as_much_as_a_dense_one(tmp_path):
    for number, (count, px) in enumerate(((10, 10.03), (1200, 20.03))):
        values = np.full(1200, np.nan)
        values[:count] = px
        np.save(tmp_path / f"{number}.npy", values.reshape(30, 40))
    measured = measure_maps(sorted(tmp_path.iterdir()), SMALL.size)
    assert measured.cumulative(15) == pytest.approx(0.5)
    assert measured.mean_px == pytest.approx(15.03, abs=0.04)


def test_maps_of_several_sizes_count_at_the_rigs_width(tmp_path):
    # The same view at several resolutions: a ramp from 2 to 10 % of the width.
    for number, (width, height) in enumerate([(40, 30), (80, 60), (100, 56), (640, 480)]):
        ramp = np.linspace(0.02 * width, 0.1 * width, width * height).reshape(height, width)
        np.save(tmp_path / f"{number}.npy", ramp)
    paths = sorted(tmp_path.iterdir())
    same, *others = (measure_maps([path], SMALL.size) for path in paths)
    for found in (*others, measure_maps(paths, SMALL.size)):
        assert total_variation(same, found) < 0.03
        assert found.mean_px == pytest.approx(0.06 * 40, abs=0.05)


@settings(max_examples=100)
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
        # A config with 2 % of its target outside its limits would be refused.
        assert np.diff(found.target.cumulative([found.min_px, found.max_px]))[0] > 0.985


@settings(max_examples=60)
@given(
    doffs_px=st.floats(-300, 300),
    beyond_px=st.floats(0.01, 200),
    span=st.floats(0.05, 600),
    baseline_m=st.sampled_from([0.001, 100.0]),  # indoor, outdoor
)
def test_nothing_of_a_config_lies_beyond_infinity(doffs_px, beyond_px, span, baseline_m):
    rig = RectifiedRig(StereoCamera.centred(640, 480, 500.0, baseline_m, doffs_px), "x")
    positive = max(-doffs_px, 0) + beyond_px
    for found in (
        measured_range(Histogram.from_counts([positive, positive + span], [1.0]), doffs_px),
        chosen_range(positive, positive + span, doffs_px),
        chosen_range(-doffs_px + beyond_px, -doffs_px + beyond_px + span, doffs_px),
    ):
        farthest = -doffs_px if found.min_px <= 0 else max(-doffs_px, 0)
        known = draft(rig, found)
        scenes = known.sections["scenes"]
        # Load the config with only one recipe, which is much faster.
        config = parse_config(replace(known, sections=known.sections | {"scenes": scenes[-1:]}).text())
        assert farthest < config.disparity.min_px < positive + span
        if config.background.plane:
            planes = config.background.plane_disparity_px
            assert farthest < planes.low < planes.high < config.disparity.min_px
        if config.background.cuboid:
            assert config.background.wall_disparity_px.low > farthest
        for recipe in scenes:
            shown = [layer["disparity_px"] for layer in recipe.get("particles", {}).get("layers", ())]
            keys = ("background", "wall_disparity_px"), ("structures", "panel_disparity_px")
            shown += [recipe[name][key] for name, key in keys if key in recipe.get(name, {})]
            for first, last in shown:
                assert farthest < first <= last <= config.disparity.max_px, recipe


def test_a_range_that_is_none_is_refused_with_its_numbers():
    for low, high, doffs_px in ((9, 3, 0), (0, 8, 0), (1, np.inf, 0), (np.nan, 8, 0), (1, 1 + 1e-9, 0), (-30, 60, 30)):
        with pytest.raises(InputError, match=f"is {low:g} to {high:g} px: expected .* above {-doffs_px:g} px"):
            chosen_range(low, high, doffs_px)
    with pytest.raises(InputError, match="above 5 px, the disparity of infinity"):
        measured_range(Histogram.from_counts([4.0, 46.0], [1.0]), -5.0)


def test_a_chosen_histogram_is_smooth_and_covers_its_range():
    shares = chosen_range(1.5, 64).target.shares[1:-1]
    assert shares.min() > 0.2 / len(shares)
    assert (np.sign(np.diff(np.sign(np.diff(shares)))) != 0).sum() <= 1  # one hump


def test_a_measured_range_has_headroom_and_ignores_the_odd_pixel():
    values = np.concatenate([np.linspace(10, 60, 100_000), [399.0, 0.1]])
    edges = np.arange(0, 401, 1 / 16)
    measured = Histogram.from_counts(edges, count_pixels(values, edges))
    found = measured_range(measured)
    assert found.min_px == 10
    assert 64 < found.max_px < 72
    assert total_variation(found.target, measured) < 1e-9


@pytest.mark.parametrize("doffs_px", [0, 31.5])
def test_a_range_of_distances_is_that_of_their_disparities(doffs_px):
    rig = RectifiedRig(StereoCamera.centred(640, 480, 500.0, 0.2, doffs_px), "x")
    made = disparity_range(rig, range_m=(0.5, 2))
    assert (made.min_px, made.max_px) == pytest.approx((50 - doffs_px, 200 - doffs_px), rel=1e-12)


@pytest.mark.parametrize(("low_px", "signed"), [(7, False), (-20, True), (0, True)])
def test_ranges_may_begin_below_zero(low_px, signed):
    text = draft(RectifiedRig(CAMERA, "x"), disparity_range(RectifiedRig(CAMERA, "x"), range_px=(low_px, 60))).text()
    assert ("\n  signed: true\n" in text) == signed
    assert f"\n  min_px: {low_px}\n" in text
