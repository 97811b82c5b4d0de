"""A config from a rig's calibration: every format, the measured histogram, and the numbers in refusals."""

import re
import struct
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from announcements import without_announcements
from backends import backend_fault
from calibration_files import CAMERA, KITTI, MIDDLEBURY, kitti, middlebury, opencv
from config_texts import parse_config
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from PIL import Image
from shared_material import SHARED, needs_shared
from skimage.data import stereo_motorcycle

from semisynth_gl.calibration import write as writing
from semisynth_gl.calibration.calibrate import calibrate
from semisynth_gl.calibration.disparity_range import (
    chosen_range,
    disparity_range,
    measure_maps,
    measured_range,
)
from semisynth_gl.calibration.draft import Draft, describe
from semisynth_gl.calibration.photographs import centre_crop, check_sizes, impossible_splits
from semisynth_gl.calibration.rig import (
    DisparityBounds,
    Rig,
    Size,
    median_size,
    plain_rig,
    rig_ranges,
)
from semisynth_gl.calibration.rig_files import read_rigs
from semisynth_gl.calibration.style import untried_style
from semisynth_gl.calibration.write import write as write_draft
from semisynth_gl.cli import main
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.config import Range, load_config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.raw_camera import RawCamera
from semisynth_gl.histogram import Histogram, PixelCount, total_variation
from semisynth_gl.inputs.errors import InputError, ReadError, SemisynthError
from semisynth_gl.judge.place import map_files, read_map
from semisynth_gl.scene.mix import MixSampler
from semisynth_gl.scene.sources import prepare_sources
from semisynth_gl.seeds.splits import Split

SMALL = plain_rig(30, 0.1, Size(40, 30))


def write(folder, name, text):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def photographs(folder, count=1, size=(741, 500), start=0):
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(start, start + count):
        noise = np.random.default_rng(number).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
        Image.fromarray(noise).save(folder / f"photo{number}.png", compress_level=1)
    return folder


def facts(rigs, disparity):
    return Draft("x", rigs, disparity, ["a"], 1, 1, 256)


def refused(error, *words):
    for word in words:
        assert word in str(error.value), str(error.value)


def test_images_that_no_memory_holds_are_refused():
    for size in ((16384, 16384), (20000, 10)):
        with pytest.raises(InputError, match=f"images of {size[0]} x {size[1]}: expected sides of at most 16384"):
            plain_rig(500, 0.1, Size(*size))


# --- scale, ranges, photographs ---


@given(
    whole=st.tuples(st.integers(20, 3000), st.integers(20, 3000)),
    scale=st.sampled_from([None, 0.5, 0.25, 2]),
    share=st.floats(0.51, 0.99),
    side=st.integers(0, 1),
)
def test_photographs_of_a_cropped_mode_show_the_centre_of_the_calibrated_images(whole, scale, share, side):
    part = list(whole)
    part[side] = int(share * part[side])
    wanted, photographed = Size(*part), Size(*part).scaled(scale or 1)
    seen = Size(*whole).scaled(scale or 1)
    assume(photographed[side] < seen[side] <= 2 * photographed[side])
    found = centre_crop([photographed] * 3 + [Size(7, 7)], [Size(*whole)], scale)
    assert found is None or found.scaled(scale or 1) == photographed
    assert found == wanted or scale in {0.5, 0.25}
    raw = {"left": RawCamera(*whole, 50.0, 51.0, 20.0, 30.0, "fisheye", (0.0,) * 4)}
    rig = replace(plain_rig(30, 0.1, Size(*whole)), raw=raw)
    rig = replace(rig, camera=replace(rig.camera, cx_right_px=rig.camera.cx_right_px + 3))
    crop = rig.cropped(wanted)
    corner = np.subtract(whole, part) / 2
    assert crop.size == wanted
    assert (crop.raw["left"].width_px, crop.raw["left"].height_px) == wanted
    before = [*(rig.camera.lens_px(eye)[:2] for eye in ("left", "right")), (20, 30)]
    after = [*(crop.camera.lens_px(eye)[:2] for eye in ("left", "right"))]
    after.append((crop.raw["left"].cx_px, crop.raw["left"].cy_px))
    np.testing.assert_allclose(np.subtract(before, after), [corner] * 3)


@pytest.mark.parametrize(
    ("photographed", "calibrated"),
    [
        ([(640, 360)], [(1280, 720)]),  # reduced
        ([(1280, 300)], [(1280, 800)]),  # hardly a mode
        ([(1280, 900)], [(1280, 800)]),  # more than was calibrated
        ([(1280, 720), (1280, 800)], [(1280, 800)]),  # at least one fits
        ([(1280, 720), (640, 480)], [(1280, 800)]),  # of several cameras
        ([(1280, 720)], [(1280, 800), (1280, 760)]),  # of several rigs
        ([], [(1280, 800)]),
    ],
)
def test_other_photographs_are_of_no_cropped_mode(photographed, calibrated):
    assert centre_crop([Size(*each) for each in photographed], [Size(*each) for each in calibrated], None) is None


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


def test_scaling_keeps_rays_and_relative_disparities():
    camera = StereoCamera(2964, 2000, 3979.911, 0.193001, 1244.772, 1369.115, 1019.507)
    rig = Rig(camera, "x", DisparityBounds(280, 31, 257)).scaled(0.25)
    assert rig.size == (741, 500)
    assert rig.camera.doffs_px == pytest.approx(124.343 / 4)
    assert rig.bounds == (70, 7.75, 64.25)
    # The corner of the image stays where it was.
    for full, small in ((camera, rig.camera),):
        np.testing.assert_allclose(full.rays("left", -0.5, -0.5), small.rays("left", -0.5, -0.5), rtol=1e-12)


# Of Cityscapes, where fx is 2262.52 and fy 2265.30.
CITYSCAPES = StereoCamera(2048, 1024, 2262.52, 0.209313, 1096.98, 1096.98, 513.137, fy_over_fx=2265.30 / 2262.52)


@pytest.mark.parametrize("text", [middlebury(CITYSCAPES), kitti(CITYSCAPES), opencv(CITYSCAPES)])
def test_a_config_gets_both_focal_lengths(tmp_path, text):
    (rig,) = read_rigs([write(tmp_path, "calib.yml" if "%YAML" in text else "calib.txt", text)])
    assert rig.camera.fy_over_fx == pytest.approx(CITYSCAPES.fy_over_fx, rel=1e-12)
    assert rig.scaled(0.5).camera.focal_y_px == pytest.approx(2265.30 / 2)
    assert rig.cropped(Size(1024, 512)).camera.focal_y_px == pytest.approx(2265.30)
    known = facts([rig.scaled(0.5)], chosen_range(2, 60))
    camera = parse_config(write_draft(known)).camera
    assert camera.fy_over_fx == pytest.approx(CITYSCAPES.fy_over_fx, rel=1e-9)
    assert camera.focal_px == Range(1131.26, 1131.26)


@pytest.mark.parametrize(("ratio", "written"), [(1.0, False), (1 + 9e-7, False), (1 - 2e-6, True)])
def test_a_ratio_that_is_rounding_is_not_written(ratio, written):
    known = facts([Rig(replace(CAMERA, fy_over_fx=ratio), "x")], chosen_range(2, 60))
    assert ("fy_over_fx" in write_draft(known)) == written


def test_photographs_of_another_size_are_refused_with_the_scale_that_fits():
    size, half, other = Size(741, 500), [Size(371, 250)] * 2, [Size(400, 400)]
    assert check_sizes([size, size, *other], [size]) == check_sizes(half, [size], 0.5) == 2
    for sizes, words in ((half, "371 x 250; .*the scale 0.5; "), (other, "400 x 400; no scale gives even half")):
        with pytest.raises(InputError, match=f"images of 741 x 500, .*{words}.*other_camera"):
            check_sizes(sizes, [size])


def test_splits_that_photographs_are_too_few_for():
    found = [impossible_splits(count) for count in (1, 2, 3, 40)]
    assert found == [["validation", "test"], ["both validation and test"], [], []]


def test_several_rigs_give_ranges(tmp_path):
    for number, (width, focal) in enumerate([(700, 900.0), (720, 1000.0), (760, 950.0)]):
        camera = StereoCamera.centred(width, 480 + number, focal, 0.1 * (number + 1), 10.0 * number)
        write(tmp_path, f"scene{number}/calib.txt", middlebury(camera))
    rigs = read_rigs([tmp_path / "*/calib.txt"])
    assert median_size(rigs) == (720, 481)
    ranges = rig_ranges(rigs)
    assert (ranges["focal_px"], ranges["doffs_px"]) == ((900, 1000), (0, pytest.approx(20)))
    assert ranges["baseline_m"] == pytest.approx((0.1, 0.3))
    assert ranges["cx_left_px"] == pytest.approx((359.5 - 10, 359.5))
    assert ranges["cy_px"] == pytest.approx((240, 240))


@pytest.mark.parametrize(
    ("disparities", "scenes"),
    [
        ((30, 40), "indoor"),
        ((1, 4), "outdoor"),
        ((19.4, 62), "indoor and outdoor"),
        ((1, 2), "indoor"),
    ],  # 20 m is 20 px
)
def test_far_pixels_make_a_scene_an_outdoor_one(disparities, scenes):
    rig = plain_rig(1000, 0.4, Size(640, 480))
    assert facts([rig], measured_range(Histogram.from_counts(disparities, [1.0]))).scenes[0] == tuple(
        scenes.split(" and ")
    )


# --- the style ---


def test_every_kind_of_scene_has_recipes_that_a_config_takes():
    found = measured_range(Histogram.from_counts((19.4, 62), [1.0]))
    for baseline_m, kinds in ((0.1, {"room"}), (0.4, {"room", "street"}), (4, {"street"})):
        known = facts([plain_rig(1000, baseline_m, Size(640, 480))], found)
        config = parse_config(write_draft(known))
        recipes = config.recipes()
        assert sum(recipe.share for recipe in recipes) == pytest.approx(1)
        of_kind = {
            kind for kind in ("room", "street") if any(getattr(each.config.background, kind) for each in recipes)
        }
        assert of_kind == kinds
        assert recipes[-1].name == "clutter"
        assert recipes[-1].config.particles.layers is None


# --- maps and histograms ---


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
    photographs(tmp_path, 1, (40, 30))
    (tmp_path / "disp0.pfm").write_bytes(pfm(np.ones((30, 40))))
    Image.fromarray(np.full((30, 40), 256, np.uint16)).save(tmp_path / "disp.png")
    assert [path.name for path in map_files([tmp_path])] == ["disp.png", "disp0.pfm"]
    with pytest.raises(InputError, match=r"no disparity map there"):
        map_files([photographs(tmp_path / "only", 1, (40, 30))])
    with pytest.raises(ReadError, match="expected 16-bit grey"):
        measure_maps([tmp_path / "photo0.png"], [SMALL])


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.npy", b"\x93NUMPY broken", "cannot be read as an array"),
        ("a.pfm", b"Pf\n3 2\n-1.0\n123", "ends after 3 of 24 bytes"),
        ("a.pfm", b"junk", "expected a PFM header"),
        ("a.png", b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 3), "expected a PNG"),
    ],
)
def test_broken_maps_are_refused(tmp_path, name, data, words):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(ReadError, match=words):
        read_map(path)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.full((30, 40), np.nan), ["holds no disparity", "40 x 30"]),
        (np.ones((40, 30)), ["has 30 x 40 pixels", "40 x 30", "shape differs by a factor of 1.78", "maps of this rig"]),
        (np.ones((19, 40)), ["has 40 x 19 pixels", "shape differs by a factor of 1.58, and at most 1.5"]),
        (np.ones((2, 2)), ["has 2 x 2 pixels", "its width by a factor of 20, and at most 16"]),
        (np.full((30, 40), 512.0), ["up to 512 px", "40 px wide", "256 levels per pixel"]),
        (np.ones((3, 30, 40)), ["one value per pixel", "(3, 30, 40)"]),
        (np.ones((30, 40), complex), ["expected numbers, got complex128"]),
    ],
)
def test_maps_that_fit_no_rig_are_refused_with_their_numbers(tmp_path, values, words):
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(SemisynthError) as error:
        measure_maps([tmp_path / "a.npy"], [SMALL])
    refused(error, "a.npy", *words)


def test_a_sparse_map_counts_as_much_as_a_dense_one(tmp_path):
    sparse = np.full((30, 40), np.nan)
    sparse[:2, :5] = 10.03
    np.save(tmp_path / "sparse.npy", sparse)
    np.save(tmp_path / "dense.npy", np.full((30, 40), 20.03))
    measured = measure_maps([tmp_path / "sparse.npy", tmp_path / "dense.npy"], [SMALL])
    assert (measured.pixels, measured.valid) == (2400, 1210)
    assert measured.histogram.cumulative(15) == pytest.approx(0.5)
    assert measured.histogram.mean_px == pytest.approx(15.03, abs=0.04)


@pytest.mark.parametrize("size", [(40, 30), (80, 60)])
@pytest.mark.parametrize("form", ["mm.png", "mm.npy", "m.npy", "m.pfm"])
def test_depths_are_measured_as_their_disparities(tmp_path, form, size):
    rig = replace(SMALL, camera=replace(SMALL.camera, cx_right_px=SMALL.camera.cx_left_px + 1.5))
    ramp = np.linspace(1, 12, size[0] * size[1]).reshape(size[1], size[0]).astype(np.float32)
    depth = (rig.camera.focal_baseline / (ramp + 1.5)).astype(np.float32)
    disparity = ramp * (size[0] / 40)
    for values, missing in ((depth, 0), (disparity, np.nan)):
        values[:2] = missing
    np.save(tmp_path / "disparity.npy", disparity)
    path = tmp_path / f"depth-{form}"
    stored = np.rint(depth * 1000).astype(np.uint16) if form.startswith("mm") else depth
    if form.startswith("mm"):
        stored[2] = 65535
        disparity[2] = np.nan
        np.save(tmp_path / "disparity.npy", disparity)
    {"png": lambda: Image.fromarray(stored).save(path), "npy": lambda: np.save(path, stored)}.get(
        path.suffix[1:], lambda: path.write_bytes(PFM.encode(stored))
    )()
    found = measure_maps([path], [rig], depths=True)
    expected = measure_maps([tmp_path / "disparity.npy"], [rig])
    assert (found.valid, found.pixels) == (expected.valid, expected.pixels)
    # Millimetres are as fine as 0.02 px here, and bins 0.06 px wide.
    assert found.histogram.mean_px == pytest.approx(expected.histogram.mean_px, abs=0.03)
    assert total_variation(found.histogram, expected.histogram) < 0.2
    place = read_map(path, depths_of=rig.camera)
    np.testing.assert_allclose(place, disparity, atol=0.1)


def test_depths_that_are_hardly_metres_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.full((30, 40), 1500.0))
    with pytest.raises(
        ReadError, match=r"a\.npy: holds depths of 1500 m \(median\): expected metres in floating point"
    ):
        measure_maps([tmp_path / "a.npy"], [SMALL], depths=True)
    np.save(tmp_path / "b.npy", np.full((30, 40), 1500))
    with pytest.raises(InputError, match="depth: expected the maps and the calibration of one rig, got 2"):
        disparity_range([SMALL, SMALL], [tmp_path / "b.npy"], depths=True)


def test_maps_of_several_sizes_count_at_the_rigs_width(tmp_path):
    # One view at several resolutions: a ramp from 2 to 10 % of the width.
    sizes = (Size(40, 30), Size(80, 60), Size(100, 56), Size(640, 480))
    for number, (width, height) in enumerate(sizes):
        np.save(
            tmp_path / f"{number}.npy", np.linspace(0.02 * width, 0.1 * width, width * height).reshape(height, width)
        )
    paths = sorted(tmp_path.iterdir())
    same, *others = (measure_maps([path], [SMALL]) for path in paths)
    assert same.scaled == ()
    for found, size in zip(others, sizes[1:], strict=True):
        assert found.scaled == (size,)
        assert total_variation(same.histogram, found.histogram) < 0.03
    together = measure_maps(paths, [SMALL])
    assert together.scaled == sizes[1:]
    assert together.histogram.mean_px == pytest.approx(0.06 * 40, abs=0.05)
    # A map that has the size of one of several rigs is taken as it is.
    large = plain_rig(60, 0.1, Size(80, 60))
    assert measure_maps(paths[1:2], [SMALL, large]).histogram.mean_px == pytest.approx(0.06 * 80, abs=0.05)
    said = disparity_range([SMALL], paths[:3]).origin
    assert "Disparities of the 2 of other sizes (80 x 60 to 100 x 56) are scaled to a width of 40 px" in said
    assert "scaled" not in disparity_range([SMALL], paths[:1]).origin


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
    rigs = [Rig(StereoCamera.centred(640, 480, 500.0, 0.2, each), "x") for each in (-5.0, 2.0)]
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
    with pytest.raises(InputError) as error:
        measured_range(Histogram.from_counts([4.0, 46.0], [1.0]), -5.0)
    refused(error, "a thousandth of the measured disparities lies below 4.042 px", "doffs = -5 px", "infinity is 5 px")
    for ends, words in (((5.0, 46.0), "begins at 5 px"), ((None, 4.0), "ends at 4 px")):
        with pytest.raises(InputError, match=rf"range of disparity {words}, but with doffs = -5 px"):
            chosen_range(*ends, -5.0)


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


# --- the whole ---


SIZES = [(320, 240), (1242, 375), (1280, 1024), (2448, 2048)]


@settings(max_examples=8, deadline=None)
@given(
    most_px=st.floats(-0.3, 2.84).map(lambda power: 10**power),
    width=st.floats(-2, -0.005).map(lambda power: 10**power),
    size=st.sampled_from(SIZES),
    view=st.floats(0.4, 3),
    baseline_m=st.floats(0.01, 1),
)
def test_scenes_of_any_range_meet_their_target(tmp_path_factory, most_px, width, size, view, baseline_m):
    """Ranges up to 0.5 to 700 px, from 1 % to 99 % of the largest disparity wide."""
    made = calibrate(
        photographs(tmp_path_factory.mktemp("photos"), size=(40, 30)),
        focal_px=view * size[0],
        baseline_m=baseline_m,
        size=size,
        range_px=(most_px * (1 - width), most_px),
        other_camera=True,
        trials=0,
        overrides=["textures.source=procedural", "textures.images=[]", "textures.max_patches=8", "textures.large_px=0"],
    )
    sources = prepare_sources(made.config, Split(0))
    mix = MixSampler(made.config, 0, sources.libraries, sources.atlas.patches)
    # Wide ranges outdoors come to 0.17.
    assert total_variation(mix.expected(), made.config.shown_histogram()) < 0.25
    for index in range(len(mix.recipes)):
        assert len(mix.sample(index).scene) > 0


def test_a_table_top_becomes_a_dataset_that_verifies(tmp_path, call):
    if fault := backend_fault("auto"):
        pytest.skip(fault)
    photographs(tmp_path / "photos", 2, size=(320, 240))
    given = ("calibrate", "--images", "photos", "--other-camera", "--set", "particles.most=900", "--out", "table.yaml")
    rig = ("--focal-px", 500, "--baseline-m", 0.05, "--size", "160x128", "--range-px", 50, 62.5)
    assert call(*given, *rig, "--trials", 1)[0] == 0
    config = load_config(tmp_path / "table.yaml")
    assert (config.particles.most, config.textures.patch_px, config.textures.large_px) == (900, 128, 160)
    assert call("generate", "--config", "table.yaml", "--out", "table", "--pairs", 5)[0] == 0
    assert call("verify", "table", "--oracle")[0] == 0


def test_keys_that_are_set_are_written_beside_the_comments(tmp_path, call):
    photographs(tmp_path / "photos", 1, size=(40, 30))
    rig = ("--focal-px", 30, "--baseline-m", 0.1, "--size", "40x30", "--range-px", 2, 20)
    given = ("calibrate", "--images", "photos", "--other-camera", *rig)
    keys = ["camera.colour=grey", "imperfections.noise=2", "name=other", "checks.min_valid=0.25"]
    assert call(*given, "--trials", 0, "--out", "plain.yaml")[0] == 0
    assert call(*given, "--trials", 0, "--out", "set.yaml", *(word for key in keys for word in ("--set", key)))[0] == 0
    plain, changed = (load_config(tmp_path / name) for name in ("plain.yaml", "set.yaml"))
    assert changed == load_config(tmp_path / "plain.yaml", keys) != plain
    # The first comment has the file's name.
    comments = [
        [line for line in (tmp_path / name).read_text().splitlines()[1:] if line.startswith("#")]
        for name in ("plain.yaml", "set.yaml")
    ]
    assert comments[0] == comments[1]
    for key in ("camera.widht_px=3", "scenes=[]"):
        code, _, err = call(*given, "--trials", 1, "--out", "no.yaml", "--set", key)
        assert code == 2
        assert key.partition("=")[0] in err


@settings(max_examples=25, deadline=None)
@example("\x85")
@example("\u2028 a  b")
@given(name=st.text(st.characters(exclude_characters="/\x00", exclude_categories=("Cs",)), min_size=1, max_size=20))
def test_whatever_files_are_called_the_yaml_is_read_back(tmp_path_factory, name):
    folder = tmp_path_factory.mktemp("names")
    try:
        photograph = folder / f"{name}.png"
        Image.fromarray(np.zeros((20, 30, 3), np.uint8)).save(photograph)
    except OSError:
        return
    rig = Rig(StereoCamera.centred(30, 20, 40.0, 0.1), str(photograph))
    found = describe(name, [rig], [str(photograph)], disparity_range([rig], range_px=(1, 10)))
    config = load_config(write(folder, "config.yaml", write_draft(found)))
    assert config.textures.images == (str(photograph),)


@pytest.fixture
def call(monkeypatch, capsys, tmp_path):
    """Run the program in this process, in a folder of the test."""

    def caller(*arguments):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["semisynth-gl", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            main()
        out, err = capsys.readouterr()
        return stopped.value.code, out, without_announcements(err)

    return caller


def test_a_real_pair_becomes_a_config_that_renders(call, tmp_path, monkeypatch):
    left, _, disparity = stereo_motorcycle()
    (tmp_path / "photos").mkdir()
    Image.fromarray(left).save(tmp_path / "photos/im0.png")
    (tmp_path / "disp0.pfm").write_bytes(pfm(disparity))
    write(tmp_path, "calib.txt", MIDDLEBURY)
    given = ("calibrate", "--trials", 0, "--images", "photos", "--calib", "calib.txt", "--disparity", "disp0.pfm")
    given = (*given, "--out", "my rig.yaml")
    code, out, err = call(*given)
    assert (code, err) == (0, "")
    for said in ("741 x 500", "994.978 px", "mean 34.", "1 disparity map", "92.7%", "1, which give 6 patches",
                 "validation or test", "generate --config 'my rig.yaml' --out data/my-rig",
                 "report data/my-rig --images photos --disparity disp0.pfm"):  # fmt: skip
        assert said in out
    assert "# From calib.txt." in (tmp_path / "my rig.yaml").read_text()
    monkeypatch.chdir("/")  # paths are absolute
    config = load_config(tmp_path / "my rig.yaml")
    camera = config.camera
    assert (camera.width_px, camera.height_px, camera.focal_px) == (741, 500, Range(994.978, 994.978))
    assert camera.doffs_px.low == pytest.approx(31.086)
    assert config.textures.images == (str(tmp_path / "photos"),)
    assert (config.background.cuboid, config.background.plane) == (1, 0)
    target = config.disparity.target
    truth = PixelCount(target.first_px + np.arange(len(target.shares) + 1) * target.bin_px)
    truth.add(disparity)
    np.testing.assert_allclose(truth.histogram.shares, target.shares, atol=2e-3)
    assert config.disparity.min_px == pytest.approx(np.quantile(disparity[np.isfinite(disparity)], 0.001), abs=0.15)

    from semisynth_gl.pairs.pipeline import render_pair

    if backend_fault("auto"):
        pytest.skip("no OpenGL here: the config was not rendered")
    # Without its recipes: rooms take long to begin with, and trial pairs are of all recipes.
    small = load_config(tmp_path / "my rig.yaml", {"models.variants": 1, "models.complex": 0.0, "scenes": []})
    frame = render_pair(small, index=0, seed=0)
    seen = frame.left.disparity[np.isfinite(frame.left.disparity)]
    assert frame.left.image.shape == (500, 741, 3)
    assert seen.max() <= config.disparity.max_px
    assert abs(np.median(seen) - np.nanmedian(read_map(tmp_path / "disp0.pfm"))) < 20

    code, _, err = call(*given)
    assert code == 2
    assert "exists already" in err
    assert call(*given, "--overwrite")[0] == 0


def test_trial_pairs_set_what_the_place_shows(call, tmp_path):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    size = (96, 64)
    (tmp_path / "scene").mkdir()
    for number, near in enumerate((5, 12)):
        disparity = np.tile(np.where(np.arange(size[0]) < 40, 4, near).astype(np.float32), (size[1], 1))
        (tmp_path / f"scene/{number}.pfm").write_bytes(pfm(disparity))
    photographs(tmp_path / "photos", 2, (300, 300))
    code, out, _ = call(
        "calibrate", "--trials", 1, "--images", "photos", "--focal-px", 90, "--baseline-m", 0.2, "--size", "96x64",
        "--disparity", "scene", "--other-camera", "--out", "a.yaml",
    )  # fmt: skip
    assert code == 0
    # Two pictures are too few to say how near their measures are.
    assert not re.search("^place ", out, re.MULTILINE)
    config, text = load_config(tmp_path / "a.yaml"), (tmp_path / "a.yaml").read_text()
    # Two surfaces and one jump a row are next to nothing floating.
    shares = {recipe.name: recipe.share for recipe in config.recipes()}
    assert shares["clutter"] == pytest.approx(0.05)
    assert "# Weights by depth jumps above 1 px" in text
    assert f"recipes          {', '.join(f'{share:.0%} {name}' for name, share in shares.items())}" in out
    assert f"blurred by {config.imperfections.blur_px.low:g} px" in out
    for line in ("black border +0\\.0% of the photographs",
                 " +disparities expected at a total variation of 0\\.[0-9]{3} from the wanted ones"):  # fmt: skip
        assert re.search(f"^{line}$", out, re.MULTILINE), line


PLAIN = ("--focal-px", 700, "--baseline-m", 0.12, "--size", "640x480", "--other-camera", "--range-px", 2, 96)


def calibrated(call, *options):
    """Calibrate without trials, by the photographs in the folder of the test; return what is said."""
    code, out, err = call("calibrate", "--trials", 0, "--images", "photos", "--out", "a.yaml", "--overwrite", *options)
    assert code == 0, err
    return out, err


def test_both_views_of_a_pair_are_one_subject(call, tmp_path):
    for number in range(2):
        folder = photographs(tmp_path / f"photos/scene{number}", 2, (300, 300), 2 * number)
        for eye in (0, 1):
            (folder / f"photo{2 * number + eye}.png").rename(folder / f"im{eye}.png")
    out, err = calibrated(call, *PLAIN)
    assert err == ""
    assert "photographs      4 of 2 subjects, which give" in out
    assert "too few to hold some out for both validation and test" in out
    assert "# Photographs: 4 of 2 subjects when this was written." in (tmp_path / "a.yaml").read_text()
    config = load_config(tmp_path / "a.yaml")
    assert (config.disparity.min_px, config.disparity.max_px >= 96) == (2, True)
    assert (config.camera.cx_left_px.low, config.background.plane, config.particles.size_px.low) == (319.5, 1, 26)


KITTI_CAMERA = StereoCamera(1242, 375, 721.5377, 0.54, 609.5593, 609.5593, 172.854)


@pytest.mark.parametrize(
    ("files", "options", "layout"),
    [
        ({"calib.txt": KITTI}, (), "kitti"),
        ({"calib.txt": kitti(replace(KITTI_CAMERA, width_px=1226, height_px=370))}, (), "kitti"),
        ({"calib.txt": KITTI}, ("--range-px", 2, 400), None),  # above what 16-bit PNG holds
        ({"calib.txt": kitti(replace(KITTI_CAMERA, cx_right_px=640))}, ("--range-px", -20, 90), None),  # signed
        ({"two_view_training/hall/calib.txt": middlebury()}, (), "eth3d"),
        ({"calib.txt": MIDDLEBURY}, (), "middlebury"),
        ({"a/calib.txt": middlebury(), "two_view_training/b/calib.txt": middlebury()}, (), None),
        ({"rig.yaml": opencv()}, (), None),
    ],
)
def test_the_layout_is_that_of_the_rigs_benchmark_if_it_can_hold_the_disparities(
    call, tmp_path, files, options, layout
):
    photographs(tmp_path / "photos", 1, (300, 300))
    given = [option for name, text in files.items() for option in ("--calib", write(tmp_path, name, text))]
    given += options if "--range-px" in options else ("--range-px", 2, 90, *options)
    out, err = calibrated(call, *given, "--other-camera")
    assert (err, load_config(tmp_path / "a.yaml").layout) == ("", layout)
    assert f"layout           {layout or 'middlebury, and webdataset from 10,000 pairs on'}\n" in out
    assert "--pairs 1000" in out


@pytest.mark.parametrize(("baseline_m", "told"), [(0.001, True), (0.005, False), (4.5, False), (120, True)])
def test_a_baseline_in_another_unit_is_noticed(call, tmp_path, baseline_m, told):
    photographs(tmp_path / "photos", 1, (300, 300))
    _, err = calibrated(call, *PLAIN, "--baseline-m", baseline_m)
    assert (f"note: the baseline is {baseline_m:g} m: check the unit" in err) == told


def test_comments_say_where_numbers_are_from(call, tmp_path):
    for number, ends in enumerate(("ndisp=70\nvmin=7\n", "vmax=90.5\nvmin=5\n", "")):
        text = middlebury(StereoCamera.centred(640, 480, 700.0, 0.2, 10.0 * number)) + ends
        write(tmp_path, f"scene{number}/calib.txt", text)
    photographs(tmp_path / "photos", 1, (640, 480))
    out, err = calibrated(call, "--calib", "*/calib.txt")
    assert err == ""
    assert "max_px is the largest of 2 calibrations, vmax of scene1/calib.txt, min_px a fiftieth of that;" in out
    assert "min_px the least vmin of all;" in calibrated(call, "--calib", "scene[01]/calib.txt")[0]
    assert "max_px is ndisp of the calibration, min_px vmin of" in calibrated(call, "--calib", "scene0/calib.txt")[0]
    assert "# the back wall: the farthest 5% of the pixels" in (tmp_path / "a.yaml").read_text()
    calibrated(call, "--calib", "scene0/calib.txt", "--range-px", 0.5, 40)
    assert "# the far plane: between infinity and min_px" in (tmp_path / "a.yaml").read_text()


def test_an_invalid_config_is_reported_under_its_own_name(call, tmp_path, monkeypatch):
    photographs(tmp_path / "photos", 1, (300, 300))
    monkeypatch.setattr(writing, "_PLANE_OF_MIN", (-0.1, 0.7))
    code, _, err = call("calibrate", "--images", "photos", *PLAIN, "--out", "lab.yaml", "--trials", 0)
    assert code == 2
    assert "Error: the numbers make no valid config" in err
    assert re.search(r"^lab\.yaml: background\.plane_disparity_px: expected numbers above 0", err, re.MULTILINE)
    assert "partial" not in err
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--calib", "calib.txt", "--focal-px", "7"], ["--focal-px: "]),
        (["--focal-px", "700"], ["--baseline-m: missing"]),
        (["--focal-px", "700", "--baseline-m", "-0.1", "--size", "741x500"], ["--baseline-m: ", "above 0"]),
        (["--focal-px", "700", "--baseline-m", "0.1", "--size", "741"], ["--size 741", "1280x720"]),
        (["--focal-px", "700", "--baseline-m", "0.1", "--size", "741x500"], ["as ndisp or vmax", "disparity maps"]),
        (["--calib", "calib.txt", "--out", "a.txt"], ["ends in .yaml"]),
        (["--calib", "calib.txt", "--out", "no/a.yaml"], ["does not exist"]),
        (["--calib", "calib.txt", "--range-px", "9", "4"], ["9 to 4 px"]),
        (["--calib", "calib.txt", "--range-px", "1e-9", "2e-9"], ["expected ends that differ by 2.2e-05"]),
        (["--calib", "calib.txt", "--range-px", "1", "4", "--disparity", "x.pfm"], ["give only one of them"]),
        (["--calib", "calib.txt", "--scale", "0.5"], ["371 x 250 times 0.5", "without a scale they fit"]),
        (["--calib", "calib.txt", "--range-m", "1", "4", "--range-px", "2", "9"], ["--range-m: range_px also"]),
        (["--calib", "calib.txt", "--range-m", "4", "1"], ["--range-m: ", "the nearer one first"]),
        (["--calib", "calib.txt", "--range-px", "1", "4", "--fov", "90"], ["--fov: calib.txt states how"]),
        (["--calib", "calib.txt", "--fov", "200"], ["--fov", "10<=x<=170"]),
        (["--calib", "calib.txt", "--depth", "none.png"], ["none.png: no depth map there"]),
        (["--calib", "calib.txt", "--disparity", "none.pfm"], ["none.pfm: no disparity map there"]),
        (["--calib", "calib.txt", "--images", "flat"], ["no patch can be cut"]),
    ],
)
def test_wrong_input_writes_nothing(call, tmp_path, arguments, words):
    photographs(tmp_path / "photos")
    (tmp_path / "flat").mkdir()
    Image.new("RGB", (741, 500)).save(tmp_path / "flat/a.png")
    write(tmp_path, "calib.txt", MIDDLEBURY)
    images = () if "--images" in arguments else ("--images", "photos")
    out = () if "--out" in arguments else ("--out", "a.yaml")
    code, said, err = call("calibrate", *images, *out, *arguments)
    assert (code, said) == (2, "")
    for word in words:
        assert word in err
    assert not list(tmp_path.glob("*.yaml"))
    assert not list(tmp_path.glob(".*"))


def test_the_command_loads_no_package_that_it_does_not_use():
    for module in ("calibrate", "preview"):
        show = f"import sys, semisynth_gl.cli.{module}; print({{'trimesh', 'scipy', 'matplotlib'}} & {{*sys.modules}})"
        assert run_python(show) == "set()", module


def run_python(program):
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.strip()


@needs_shared
def test_real_photographs_of_two_benchmarks(call, tmp_path):
    eth3d = (
        "cam0=[541.764 0 553.869; 0 541.764 232.396; 0 0 1]\ncam1=[541.764 0 553.869; 0 541.764 232.396; 0 0 1]\n"
        "doffs=0\nbaseline=59.9079\nwidth=942\nheight=489\nndisp=64\n"
    )
    write(tmp_path, "calib.txt", eth3d)
    images = SHARED / "textures/eth3d"
    given = ("calibrate", "--trials", 0, "--images", images, "--calib", "calib.txt")
    code, out, err = call(*given, "--out", "eth3d.yaml")
    assert (code, err) == (0, "")
    assert "5 differ in size from the rig's images" in out
    write(tmp_path, "full.txt", MIDDLEBURY.replace("width=741", "width=1434").replace("height=500", "height=984"))
    code, _, err = call("calibrate", "--images", SHARED / "textures/middlebury/AustraliaP.png", "--calib", "full.txt",
                        "--out", "m.yaml")  # fmt: skip
    assert code == 2
    assert "scale 0.5" in err
    sizes = Counter(Image.open(path).size for path in (SHARED / "textures/middlebury").glob("*.png"))
    assert len(sizes) == 11
