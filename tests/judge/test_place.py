"""The report beside a place: measures with known answers, the files of a place, the table, and what is refused."""

import json
import re
from dataclasses import replace
from itertools import product
from math import erf, sqrt

import numpy as np
import pytest
from hand_made_datasets import write_dataset
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.stats import wasserstein_distance
from shared_material import SHARED, needs_shared
from tiny_datasets import cheap

from semisynth_gl.cli import main
from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import GREY16, RGB8
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.config import Config, load_config
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.inputs.errors import SemisynthError
from semisynth_gl.judge.advice import CHANGES, advice
from semisynth_gl.judge.comparison import FEWEST, Comparison, MeasuredPlace, Side, distance, frame_view
from semisynth_gl.judge.measured_view import WORKING_WIDTH, fill_holes, make_view, mean_luminance
from semisynth_gl.judge.measures import MEASURES
from semisynth_gl.judge.place import map_files, map_view, one_of_each_scene
from semisynth_gl.judge.quantities import (
    border_hardness,
    gradients,
    hidden,
    local_contrasts,
    octave_contrasts,
    run_lengths,
    slants,
)
from semisynth_gl.judge.report import report
from semisynth_gl.textures.image_files import find_images

INF = np.float32(np.inf)
BY_KEY = {measure.key: measure for measure in MEASURES}


def value(key, picture):
    return BY_KEY[key].measure(picture)


def picture_of(disparity=None, grey=None, width_px=None):
    """A picture of a map, an image or both, by default at its own width."""
    disparity = None if disparity is None else np.asarray(disparity, np.float32)
    image = None if grey is None else np.repeat(np.asarray(grey, np.uint8)[..., None], 3, axis=2)
    own = (disparity if disparity is not None else image).shape[1]
    return make_view("made", width_px or own, image=image, disparity=disparity)


# --- measures with known answers ---


@pytest.mark.parametrize(("tread", "rise"), [(10, 3.0), (50, -4.0)])
def test_a_staircase(tread, rise):
    width, height = 200, 40
    disparity = np.tile(120 + rise * (np.arange(width) // tread), (height, 1))
    steps = width // tread - 1
    picture = picture_of(disparity)
    assert value("jumps", picture) == pytest.approx(100 * steps / (width - 1))
    assert value("runs", picture) == pytest.approx(tread)
    # Each tread is level; windows of 16 px lie on one tread or are left out.
    assert value("slant", picture) == (0 if tread > 16 else None)


@pytest.mark.parametrize(("along", "down"), [(0.0, 0.0), (0.75, -0.5)])
def test_a_plane_has_the_slant_of_its_gradient(along, down):
    row, column = np.mgrid[:60, :80]
    surfaces = (100 + along * column + down * row).astype(np.float32)
    found = slants(surfaces)
    assert found.shape == ((60 - 16) * (80 - 16),)
    np.testing.assert_allclose(found, np.hypot(along, down), atol=1e-6)
    assert len(run_lengths(surfaces)) == 60
    # A rounded map has nearly the same slant: the span is long enough.
    rounded = (np.round(2 * surfaces) / 2).astype(np.float32)
    assert slants(rounded).mean() == pytest.approx(np.hypot(along, down), abs=0.02)


@pytest.mark.parametrize(("front", "back"), [(30, 7), (9, 8)])
def test_a_card_hides_as_many_columns_as_its_disparity_exceeds_the_wall(front, back):
    disparity = np.full((20, 120), back, np.float32)
    disparity[5:15, 60:90] = front
    expected = np.zeros((20, 120), bool)
    expected[:, :back] = True  # outside the right view
    if front - back > 1:
        expected[5:15, 60 - (front - back) : 60] = True
    np.testing.assert_array_equal(hidden(disparity), expected)
    # Where nothing is known, nothing is hidden; shares are of what is known.
    disparity[:, 100:] = np.nan
    assert hidden(disparity).sum() == expected.sum()
    picture = picture_of(disparity)
    assert value("occluded", picture) == pytest.approx(100 * expected.sum() / 2000)


def test_a_picture_of_another_exposure_measures_as_one_that_is_made_so():
    image, other = np.random.default_rng(5).integers(0, 256, (2, 40, 60, 3)).astype(np.uint8)
    picture = make_view("made", 50, image=image).with_image(other)
    expected = make_view("made", 50, image=other)
    darker = replace(expected, luminance=expected.luminance * np.float32(2**-0.6))
    for one, as_made in ((picture, expected), (picture.exposed(-0.6), darker)):
        for measure in MEASURES:
            found = measure.measure(as_made)
            assert measure.measure(one) == (None if found is None else pytest.approx(found, rel=1e-6)), measure.key


def edge(profile, columns=100):
    """An image whose rows go from 40 to 200 about the middle, and the map whose jump is there."""
    x = np.arange(columns) - (columns / 2 - 0.5)
    luminance = np.tile(40 + 160 * profile(x), (30, 1)).astype(np.float32)
    surfaces = np.tile(np.where(x < 0, 5, 20), (30, 1)).astype(np.float32)
    return luminance, surfaces


@pytest.mark.parametrize("sigma", [0.4, 1.2])
def test_an_edge_blurred_by_a_gaussian_has_the_step_of_its_error_function(sigma):
    luminance, surfaces = edge(lambda x: np.array([(1 + erf(each / (sigma * sqrt(2)))) / 2 for each in x]))
    step = erf(0.5 / (sigma * sqrt(2)))
    contrast = np.mean([erf(far / (sigma * sqrt(2))) for far in (2.5, 3.5, 4.5)])
    assert border_hardness(luminance, surfaces) == pytest.approx(step / contrast, abs=1e-5)
    # One pixel off, as measured maps are.
    assert border_hardness(np.roll(luminance, 1, axis=1), surfaces) == pytest.approx(step / contrast, rel=0.05)


def test_octaves_of_noise_whose_detail_is_known():
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 20, (512, 512)).astype(np.float32)
    # Means of 2 x 2 have half the deviation; within a block, three quarters of the variance are left.
    np.testing.assert_allclose(octave_contrasts(noise), 20 * sqrt(3 / 4) / 2.0 ** np.arange(5), rtol=0.05)
    for octave in range(4):
        coarse = np.kron(noise[: 512 >> octave, : 512 >> octave], np.ones((1 << octave, 1 << octave)))
        contrasts = octave_contrasts(coarse.astype(np.float32))
        np.testing.assert_allclose(contrasts[:octave], 0, atol=1e-4)
        assert contrasts[octave] == pytest.approx(20 * sqrt(3 / 4), rel=0.1)
    assert np.isnan(octave_contrasts(noise[:8, :8])[3:]).all()


def test_contrast_and_gradient_of_checks_and_ramps():
    checks = 100 + 6 * (np.indices((40, 50)).sum(axis=0) % 2 * 2.0 - 1)
    np.testing.assert_allclose(local_contrasts(checks.astype(np.float32)), 6 * sqrt(1 - 1 / 81**2), rtol=1e-6)
    for amplitude, flat in ((3, 100), (6, 0)):
        assert value("flat", picture_of(grey=100 + amplitude * (np.indices((40, 50)).sum(axis=0) % 2 * 2 - 1))) == flat
    row, column = np.mgrid[:20, :30]
    np.testing.assert_allclose(gradients((3 * column + 4 * row).astype(np.float32)), 5)
    ramp = picture_of(grey=3 * column)
    assert value("gradient", ramp) == pytest.approx(3, abs=1e-5)
    assert value("luminance", ramp) == pytest.approx(3 * 14.5, abs=1e-4)
    assert value("contrast", ramp) == pytest.approx(3 * np.arange(30).std(), abs=1e-4)


@pytest.mark.parametrize("shape", [(1, 1), (1, 90), (90, 1), (17, 17)])
def test_images_of_any_size_are_measured(shape):
    rng = np.random.default_rng(4)
    several = rng.uniform(1, 40, shape), rng.integers(0, 256, shape)
    for width_px, (disparity, grey) in product((shape[1], 33, 64), (several, (np.full(shape, 7), np.full(shape, 255)))):
        picture = picture_of(disparity, grey, width_px)
        for each in MEASURES:
            found = each.measure(picture)
            assert found is None or np.isfinite(found).all(), each.key
        assert value("luminance", picture) == pytest.approx(grey.mean(), abs=0.01)


# --- the working width ---


def test_means_over_areas():
    rng = np.random.default_rng(3)
    image = rng.integers(0, 256, (60, 84, 3), np.uint8)
    luminance = image @ [0.299, 0.587, 0.114]
    np.testing.assert_allclose(mean_luminance(image, (60, 84)), luminance, rtol=1e-6)
    blocks = luminance.reshape(20, 3, 21, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(mean_luminance(image, (20, 21)), blocks, rtol=1e-5)
    for size in ((17, 25), (60, 50), (100, 200)):
        assert mean_luminance(image, size).mean() == pytest.approx(luminance.mean(), rel=1e-5)
    # Two thirds of the second element belong to the first part.
    row = np.tile(np.array([[0, 90, 180]], np.uint8)[..., None], (1, 1, 3))
    np.testing.assert_allclose(mean_luminance(row, (1, 2)), [[30, 150]], rtol=1e-5)


def test_black_borders_are_those_of_rectification():
    grey = np.random.default_rng(2).integers(40, 256, (480, 640))
    assert value("border", picture_of(grey=grey)) == 0
    bordered = grey.copy()
    bordered[:24] = bordered[-24:] = 0
    assert value("border", picture_of(grey=bordered)) == pytest.approx(10)
    dark = grey.copy()
    dark[:160, :160] = 0  # a thing in one corner
    assert value("border", picture_of(grey=dark)) == 0
    black, night = np.zeros((480, 640)), grey.copy()
    night[:300] = 0
    assert value("border", picture_of(grey=black)) == value("border", picture_of(grey=night)) == 0


def test_a_border_makes_no_corner_sharper_or_softer():
    # Of low contrast, beside which the border's edge is a large step; its row belongs to no block of an octave.
    plain = 120 + 10 * gaussian_filter(np.random.default_rng(2).normal(size=(480, 640)), 0.7)
    bordered = plain.copy()
    bordered[:21] = bordered[-21:] = 0
    found, expected = (value("corners", picture_of(grey=each)) for each in (bordered, plain))
    assert found == pytest.approx(expected, abs=0.05)


def test_corners_are_as_sharp_as_they_are_drawn():
    rng = np.random.default_rng(2)
    grey = gaussian_filter(rng.uniform(0, 255, (240, 320)), 0.7)
    assert value("corners", picture_of(grey=grey)) == pytest.approx(1, abs=0.05)
    for soft in (1.0, 2.0):
        blurred = gaussian_filter(grey, soft)
        mixed = blurred.copy()
        mixed[60:180, 80:240] = grey[60:180, 80:240]
        expected = value("octaves", picture_of(grey=blurred)) / value("octaves", picture_of(grey=grey))
        assert expected < 0.6
        assert value("corners", picture_of(grey=mixed)) == pytest.approx(expected, rel=0.1)


def test_a_map_takes_no_value_between_two_surfaces():
    disparity = np.tile(np.where(np.arange(101) < 37, 10.0, 40.0), (50, 1))
    picture = picture_of(disparity, width_px=64)
    assert np.unique(picture.disparity) == pytest.approx(np.array([10, 40]) * 64 / 101)


def test_holes_become_the_farther_neighbour():
    nan = np.nan
    holes = np.array([[nan] * 5, [nan, 3, nan, 8, nan], [9, nan, nan, nan, 2], [nan] * 5], np.float32)
    row = [3, 3, 3, 8, 8]
    np.testing.assert_array_equal(fill_holes(holes), [row, row, [9, 2, 2, 2, 2], [9, 2, 2, 2, 2]])


def test_sparse_maps_count_for_disparity_alone():
    disparity = np.full((40, 60), np.inf)
    disparity[::3] = 6
    picture = picture_of(disparity)
    found = {measure.key for measure in MEASURES if measure.measure(picture) is not None}
    assert found == {"disparity", "largest_disparity"}
    assert value("disparity", picture) == pytest.approx(10)


# --- the files of a place ---


def write(path, data):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def pixels(seed=0, shape=(48, 64)):
    return np.random.default_rng(seed).integers(0, 256, (*shape, 3), np.uint8)


def steps(shape=(48, 64)):
    return np.tile(np.where(np.arange(shape[1]) < 30, 5, 12).astype(np.float32), (shape[0], 1))


def test_a_right_view_alone_is_mirrored(tmp_path):
    disparity = steps()
    write(tmp_path / "disp1.pfm", PFM.encode(disparity[:, ::-1].copy()))
    write(tmp_path / "im1.png", RGB8.encode(pixels()[:, ::-1].copy()))
    picture = map_view(tmp_path / "disp1.pfm", 64)
    np.testing.assert_array_equal(picture.disparity, disparity)
    np.testing.assert_allclose(picture.luminance, pixels() @ [0.299, 0.587, 0.114], rtol=1e-5)


@pytest.mark.parametrize(
    ("files", "photographs", "found"),
    [
        (["im0.png", "im1.png", "mask0nocc.png", "disp0GT.pfm", "disp1GT.pfm"], ["im0.png", "im1.png"], "disp0GT.pfm"),
        (
            [f"{name}/7.png" for name in ("image_2", "disp_noc_0", "disp_occ_1", "disp_occ_0", "obj_map")],
            ["image_2/7.png"],
            "disp_occ_0/7.png",
        ),
        ([f"{name}/7.png" for name in ("colored_0", "disp_noc", "disp_occ")], ["colored_0/7.png"], "disp_occ/7.png"),
    ],
)
def test_a_folder_of_a_benchmark_has_photographs_and_one_map(tmp_path, files, photographs, found):
    for name in files:
        disparity = PFM.encode(steps()) if name.endswith(".pfm") else KITTI_DISPARITY.encode(steps())
        write(tmp_path / name, disparity if "disp" in name else RGB8.encode(pixels()))

    def names(paths):
        return [path.relative_to(tmp_path).as_posix() for path in paths]

    assert names(find_images([tmp_path])) == photographs
    (disparity,) = one_of_each_scene(map_files([tmp_path]))
    assert names([disparity]) == [found]
    picture = map_view(disparity, 64)
    np.testing.assert_array_equal(picture.disparity, steps())
    if "colored_0/7.png" not in files:  # beside KITTI 2012's maps no image is looked for
        np.testing.assert_allclose(picture.luminance, pixels() @ [0.299, 0.587, 0.114], rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("disp0GT.pfm", PFM.encode(steps((24, 32)))),
        ("disp0GT.pfm", PFM.encode(np.full((48, 64), INF))),
        ("disp0GT.pfm", b"Pf\n64 48\n-1\n"),
        ("im0.png", b"no picture"),
    ],
)
def test_maps_that_cannot_be_compared_are_named(tmp_path, name, data):
    write(tmp_path / "disp0GT.pfm", PFM.encode(steps()))
    for image in ("im0.png", "im1.png"):
        write(tmp_path / image, RGB8.encode(pixels()))
    write(tmp_path / name, data)
    with pytest.raises(SemisynthError, match=name):
        map_view(tmp_path / "disp0GT.pfm", 64)


# --- the command ---


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare") / "set"
    write_dataset(folder, "middlebury", {"train": 5}, 2)
    return folder


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photographs")
    for seed in range(FEWEST):
        write(folder / f"{seed}.png", RGB8.encode(pixels(seed)))
    return folder


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run the command, without a process of its own: exit code, standard output and error."""
    monkeypatch.chdir(tmp_path)

    def called(*arguments):
        monkeypatch.setattr("sys.argv", ["semisynth-gl", "report", *map(str, arguments), "--pairs", "0"])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, *capsys.readouterr()

    return called


def compared(dataset, photographs, **options):
    return report(dataset, images=photographs, pairs=0, **options).comparison


def row_of(comparison, key):
    return next(row for row in comparison.rows if row.measure.key == key)


def test_a_dataset_beside_its_own_files_is_without_difference(run, dataset, tmp_path):
    files = ["--images", f"{dataset}/**/im0.png", "--disparity", f"{dataset}/**/disp0GT.pfm"]
    code, out, err = run(dataset, *files, "--width", 48, "--json", tmp_path / "figures.json")
    assert (code, err.splitlines()[1:]) == (0, []), err
    said = json.loads((tmp_path / "figures.json").read_text())
    assert (said["pairs"], said["photographs"], said["maps"]) == (5, 5, 5)
    found = {each["name"]: each for each in said["measures"]}
    assert found.keys() <= BY_KEY.keys()
    for name, each in found.items():
        assert each["dataset"]["values"] == pytest.approx(each["place"]["values"]), name
        assert each["difference"] in (None, pytest.approx(0, abs=1e-9)), name
        assert each["distance"] in (None, pytest.approx(0, abs=1e-9)), name
        assert each["advice"] == ""
    assert found["jumps"]["dataset"]["mean"] > 0
    near = sum(each["note"] == "near" for each in found.values())
    assert near > 8
    assert f"{near} of {near} measures within one standard deviation" in out
    page = (tmp_path / "set-report.html").read_text("utf-8")
    assert "Beside the place" in page
    assert "depth jumps above 1 px" in page


def test_both_views_of_a_pair_are_one_picture_of_a_place(dataset, tmp_path):
    for number in range(3):
        for eye in (0, 1):
            write(tmp_path / f"scene{number}/im{eye}.png", RGB8.encode(pixels(10 * number + eye)))
    said = compared(dataset, tmp_path, width_px=48)
    assert (said.place.photographs, said.place.subjects) == (6, 3)
    views = [make_view("", 48, image=pixels(10 * number + eye)) for number in range(3) for eye in (0, 1)]
    measure = BY_KEY["luminance"]
    means = [np.mean([measure.measure(view) for view in views[at : at + 2]]) for at in (0, 2, 4)]
    assert said.place.side.values["luminance"] == pytest.approx(means)


def test_figures_are_means_and_deviations(dataset, photographs):
    comparison = compared(dataset, photographs, width_px=48)
    frames = [frame_view(frame, 48) for frame in open_dataset(dataset)]
    advised = 0
    for row in comparison.rows:
        measure = row.measure
        values = [found for frame in frames if (found := measure.measure(frame)) is not None]
        assert comparison.dataset.values[measure.key].tolist() == pytest.approx(values)
        theirs = comparison.place.side.values[measure.key]
        if not measure.of_images or theirs.std() == 0:
            assert row.difference is row.distance is None
            continue
        deviation, apart = np.std(theirs, ddof=1), wasserstein_distance(values, theirs)
        assert row.difference == pytest.approx((np.mean(values) - theirs.mean()) / deviation)
        assert row.distance == pytest.approx(apart / deviation)
        assert (row.note == "far") == (apart > deviation)
        assert not row.advice or apart > deviation
        advised += bool(row.advice)
    assert advised > 0


@given(*[st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=9)] * 2)
def test_the_distance_of_two_samples_is_that_of_scipy(first, second):
    ours = distance(np.array(first), np.array(second))
    assert ours == pytest.approx(wasserstein_distance(first, second), rel=1e-9, abs=1e-6)


def made_up(recipes=({}, {}), **values):
    """A comparison of one measure: its values in the dataset and in the place."""
    none = {measure.key: np.zeros(0) for measure in MEASURES}
    ((key, sides),) = values.items()
    ours, theirs = (Side(none | {key: np.asarray(each, float)}) for each in sides)
    place = MeasuredPlace(theirs, len(sides[1]), len(sides[1]), 0, 0, 0, 0, ())
    return row_of(Comparison(512, ours, len(sides[0]), place, recipes), key)


@pytest.mark.parametrize(("factor", "alike"), [(1.0, True), (3.0, False), (-0.1, True)])
def test_a_mix_of_extremes_with_the_mean_of_its_place_does_not_pass(factor, alike):
    theirs = np.linspace(-1, 1, 20)
    row = made_up(gradient=(10 + factor * theirs, 10 + theirs))
    # Each quantile of one sample, and the same of the other.
    apart = abs(abs(factor) - 1) * np.abs(theirs).mean() / theirs.std(ddof=1)
    assert row.distance == pytest.approx(apart)
    assert row.difference == pytest.approx(0, abs=1e-12)
    assert ("spread" in row.advice) != alike
    assert (row.note == "near") == alike


@pytest.mark.parametrize(("border", "note"), [(0.0, ""), (2.5, "unlike")])
def test_a_border_that_no_picture_of_the_place_has_is_named(border, note):
    row = made_up([{"lens": {}}], border=(np.full(5, border), np.zeros(5)))
    assert row.note == note
    assert bool(row.advice) == bool(note)


def test_pairs_of_a_scene_count_once(tmp_path, photographs):
    generate(cheap(camera={"baselines": 2, "baseline_m": [0.5, 1]}), tmp_path / "set", 6)
    luminance = compared(tmp_path / "set", photographs).dataset.values["luminance"]
    assert len({*luminance.tolist()}) == len(luminance) == 3


def test_few_pictures_of_a_place_are_said_to_tell_nothing(dataset, photographs, tmp_path):
    few = min(photographs.iterdir())
    # Views of a scene are one subject, and count as one picture.
    for number in range(FEWEST):
        write(tmp_path / f"alike/im{number}.png", few.read_bytes())
    for images in (few, tmp_path / "alike"):
        said = compared(dataset, images, width_px=48)
        assert said.place.subjects == 1
        assert {row.note for row in said.rows} == {"", "too few"}
        assert any(f"at least {FEWEST} pictures are needed" in line for line in said.lines())


def test_what_is_left_out_is_said(run, dataset, photographs, tmp_path):
    broken = write(tmp_path / "broken.png", b"\x89PNG no more")
    sparse = steps()
    sparse[:, 3:] = INF
    write(tmp_path / "lidar.pfm", PFM.encode(sparse))
    code, _, err = run(dataset, "--images", photographs, "--images", broken, "--disparity", tmp_path, "--width", 100)
    assert code == 0
    for words in (str(broken), f"{FEWEST} photographs narrower than 100 px", "1 map with disparities in fewer than"):
        assert words in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("{set}", "--images", "{empty}/none.png"), "none.png"),
        (("{set}", "--images", "{broken}"), "photograph"),
        (("{set}", "--images", "{photos}", "--disparity", "{photos}"), "no disparity map"),
        (("{set}", "--disparity", "{photos}"), "--images"),
        (("{set}", "--json", "figures.json"), "--images"),
        (("{set}", "--images", "{photos}", "--png-scale", "nan"), "--png-scale"),
    ],
)
def test_what_cannot_be_compared_is_refused(run, dataset, photographs, tmp_path, arguments, words):
    broken = write(tmp_path / "broken.png", b"no picture")
    places = {"set": dataset, "empty": tmp_path / "empty", "photos": photographs, "broken": broken}
    code, out, err = run(*(argument.format(**places) for argument in arguments))
    assert (code, out) == (2, "")
    assert words in err
    assert "Traceback" not in err
    assert not list(tmp_path.glob("*.html"))


def test_levels_of_png_maps_can_be_told(dataset, photographs, tmp_path):
    write(tmp_path / "a.png", GREY16.encode(np.full((48, 64), 640, np.uint16)))
    for scale, share in ((256, 100 * 2.5 / 64), (100, 10)):
        said = compared(dataset, photographs, disparity=tmp_path / "a.png", png_scale=scale, width_px=48)
        assert said.place.side.mean(BY_KEY["disparity"]) == pytest.approx(share, rel=1e-5)


# --- the advice ---


def test_advice_names_keys_that_a_config_has():
    for change in CHANGES:
        section, _, key = change.key.rpartition(".")
        fields = Config.model_fields[section].annotation.model_fields if section else Config.model_fields
        assert key in fields, change.key
        assert {*change.up, *change.down} <= BY_KEY.keys(), change.key
        assert not {*change.up} & {*change.down}, change.key


def recipe_with(*kinds, **sections):
    """Values of a config whose scenes have these kinds of background."""
    weights = {kind: float(kind in kinds) for kind in ("cuboid", "plane", "room", "street")}
    return load_config("middlebury", {"scenes": [], "background": weights, **sections}).model_dump(mode="json")


def named_keys(*recipes):
    """Keys that the advice on any measure names."""
    texts = [advice(measure, recipes, more=more) for measure in MEASURES for more in (True, False)]
    return {change.key for change in CHANGES for text in texts if re.search(rf"\b{change.key}\b", text)}


@pytest.mark.parametrize(
    ("kinds", "sections"),
    [
        ({"cuboid"}, {"structures"}),
        ({"street"}, {"street"}),
        ({"cuboid", "room"}, {"structures", "room", "background"}),
    ],
)
def test_advice_names_no_key_that_moves_nothing_in_the_scenes(kinds, sections):
    named = {key.partition(".")[0] for key in named_keys(recipe_with(*kinds))}
    assert named & {"room", "street", "structures", "background"} == sections
    # Scenes have the sections of any of their recipes.
    both = {key.partition(".")[0] for key in named_keys(recipe_with(*kinds), recipe_with("street"))}
    assert both & {"room", "street", "structures", "background", "scenes"} == sections | {"street", "scenes"}


# --- real scenes ---


@needs_shared
def test_real_scenes_are_calm_soft_and_mostly_visible():
    maps = sorted((SHARED / "real").glob("*/disp0GT.pfm"))
    found = {measure.key: [] for measure in MEASURES}
    for path in maps:
        picture = map_view(path, WORKING_WIDTH)
        for measure in MEASURES:
            found[measure.key].append(measure.measure(picture))
        truth = read_disparity_map(path)
        mask = np.asarray(Image.open(path.with_name("mask0nocc.png")))
        known = np.isfinite(truth)
        # The masks come from both maps; the measure has one.
        assert found["occluded"][-1] == pytest.approx(100 * (known & (mask != 255)).sum() / known.sum(), abs=2)
    # Pipes, whose thin tubes cross everywhere, is at the far end of most ranges.
    ranges = {"jumps": (0, 5), "runs": (60, 500), "border_hardness": (0.4, 0.8), "occluded": (5, 20)}
    for key, (low, high) in ranges.items():
        assert low < min(value for value in found[key] if value is not None), key
        assert max(value for value in found[key] if value is not None) < high, key
