"""The report compared with a place: measures with known results, the place's files, the table, refused inputs."""

import json
import re

import numpy as np
import pytest
from hand_made_datasets import write_dataset
from photograph_like import noise, save
from processes import assert_refused

from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import RGB8
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.config import Config, load_config
from semisynth_gl.judge.comparison import MIN_PICTURES, compare, gather, summary
from semisynth_gl.judge.interpolation import fill_holes
from semisynth_gl.judge.measure_input import make_measure_input, mean_luminance
from semisynth_gl.judge.measures import (
    MEASURES,
    advice,
    fine_detail,
    flat,
    gradient,
    hidden,
    jumps,
    measure_view,
    occluded,
    run_length,
    slant,
)
from semisynth_gl.judge.place import map_files, read_map
from semisynth_gl.judge.report import report
from semisynth_gl.textures.image_files import find_images

INF = np.float32(np.inf)


# --- measures with known results ---


@pytest.mark.parametrize(("tread", "rise"), [(10, 3.0), (50, -4.0)])
def test_a_staircase(tread, rise):
    width, height = 200, 40
    surfaces = np.tile(120 + rise * (np.arange(width) // tread), (height, 1)).astype(np.float32)
    assert jumps(surfaces) == pytest.approx(100 * (width // tread - 1) / (width - 1))
    assert run_length(surfaces) == pytest.approx(tread)
    # Each tread is level; windows of 16 px are inside one tread or are skipped.
    assert slant(surfaces) == 0 if tread > 16 else np.isnan(slant(surfaces))


@pytest.mark.parametrize(("along", "down"), [(0.0, 0.0), (0.75, -0.5)])
def test_a_plane_has_the_slant_of_its_gradient(along, down):
    row, column = np.mgrid[:60, :80]
    surfaces = (100 + along * column + down * row).astype(np.float32)
    assert slant(surfaces) == pytest.approx(np.hypot(along, down), abs=1e-6)
    # The span is long enough that rounding hardly changes the slant.
    assert slant(np.round(2 * surfaces) / 2) == pytest.approx(np.hypot(along, down), abs=0.02)


@pytest.mark.parametrize(("front", "back"), [(30, 7), (9, 8)])
def test_a_card_hides_as_many_columns_as_its_disparity_exceeds_the_wall(front, back):
    disparity = np.full((20, 120), back, np.float32)
    disparity[5:15, 60:90] = front
    expected = np.zeros((20, 120), bool)
    expected[:, :back] = True  # outside the right view
    if front - back > 1:
        expected[5:15, 60 - (front - back) : 60] = True
    np.testing.assert_array_equal(hidden(disparity), expected)
    # Pixels without disparity are never occluded, and do not count in shares.
    disparity[:, 100:] = np.nan
    assert occluded(disparity) == pytest.approx(100 * expected.sum() / 2000)


def test_detail_of_noise_of_one_octave():
    normal = np.random.default_rng(1).normal(0, 20, (512, 512)).astype(np.float32)
    # Means of 2 x 2 pixels have half the standard deviation.
    assert fine_detail(normal) == pytest.approx(4, rel=0.05)
    assert fine_detail(np.kron(normal[:128, :128], np.ones((4, 4), np.float32))) == pytest.approx(0, abs=1e-4)


def test_contrast_gradient_and_luminance_of_checks_and_ramps():
    checks = np.indices((40, 50)).sum(axis=0) % 2 * 2 - 1
    for amplitude, share in ((3, 100), (6, 0)):
        assert flat(np.float32(100 + amplitude * checks)) == share
    row, column = np.mgrid[:20, :30]
    assert gradient(np.float32(3 * column + 4 * row)) == pytest.approx(5)
    found = measure_view(make_measure_input(30, np.uint8(3 * column)))
    assert found["luminance"] == pytest.approx(3 * 14.5, abs=1e-4)
    assert found["contrast"] == pytest.approx(3 * np.arange(30).std(), abs=1e-4)


# --- the working width ---


def test_means_over_areas():
    image = np.random.default_rng(3).integers(0, 256, (60, 84, 3), np.uint8)
    luminance = image @ [0.299, 0.587, 0.114]
    blocks = luminance.reshape(20, 3, 21, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(mean_luminance(image, (20, 21)), blocks, rtol=1e-5)
    for size in ((17, 25), (60, 50), (100, 200)):
        assert mean_luminance(image, size).mean() == pytest.approx(luminance.mean(), rel=1e-5)
    # Each of the two outputs covers one and a half inputs.
    np.testing.assert_allclose(mean_luminance(np.array([[0, 90, 180]], np.uint8), (1, 2)), [[30, 150]], rtol=1e-5)


def test_a_map_takes_no_value_between_two_surfaces():
    disparity = np.tile(np.where(np.arange(101) < 37, 10.0, 40.0), (50, 1))
    assert np.unique(make_measure_input(64, disparity=disparity).disparity) == pytest.approx(
        np.array([10, 40]) * 64 / 101
    )


def test_holes_become_the_farther_neighbour():
    nan = np.nan
    holes = np.array([[nan] * 5, [nan, 3, nan, 8, nan], [nan] * 5, [9, nan, nan, nan, 2], [nan] * 5], np.float32)
    row = [3, 3, 3, 8, 8]
    np.testing.assert_array_equal(fill_holes(holes), [row, row, [-1] * 5, [9, 2, 2, 2, 2], [9, 2, 2, 2, 2]])


def test_rows_without_a_disparity_make_no_jumps():
    disparity = np.full((40, 60), 6.0)
    disparity[7:10] = disparity[30] = np.inf
    np.testing.assert_array_equal(make_measure_input(60, disparity=disparity).surfaces, np.full((40, 60), 6))


def test_sparse_maps_count_for_disparity_alone():
    disparity = np.full((40, 60), np.inf)
    disparity[::3] = 6
    assert measure_view(make_measure_input(60, disparity=disparity)) == {
        "disparity": pytest.approx(10),
        "largest_disparity": pytest.approx(10),
    }


# --- the files of a place ---


def write(path, data):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def steps(shape=(48, 64)):
    return np.tile(np.where(np.arange(shape[1]) < 30, 5, 12).astype(np.float32), (shape[0], 1))


@pytest.mark.parametrize(
    ("image", "disparity", "codec", "others"),
    [
        ("im0.png", "disp0GT.pfm", PFM, ["mask0nocc.png"]),
        ("image_3/7.png", "disp_occ_1/7.png", KITTI_DISPARITY, ["obj_map/7.png", "flow_occ/7.png"]),
    ],
)
def test_a_benchmark_has_photographs_and_maps(tmp_path, image, disparity, codec, others):
    for name in (image, *others):
        write(tmp_path / name, RGB8.encode(noise(48, 64)))
    path = write(tmp_path / disparity, codec.encode(steps()))
    assert find_images([tmp_path]) == [tmp_path / image]
    assert map_files([tmp_path]) == [path]
    np.testing.assert_array_equal(read_map(path), steps())


# --- the comparison ---


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare") / "set"
    write_dataset(folder, "middlebury", {"train": 5}, 2)
    return folder


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photographs")
    save(folder, **{f"{seed}": noise(48, 64, seed) for seed in range(MIN_PICTURES)})
    return folder


@pytest.fixture
def run(program):
    """Return a function that runs the command without pictures of pairs."""
    return lambda *arguments: program("report", *arguments, "--pairs", 0)


def test_a_dataset_beside_its_own_files_is_without_difference(run, dataset, tmp_path):
    files = ["--images", f"{dataset}/**/im0.png", "--disparity", f"{dataset}/**/disp0GT.pfm"]
    code, out, err = run(dataset, *files, "--json", tmp_path / "figures.json")
    assert (code, err.splitlines()[1:]) == (0, []), err
    said = json.loads((tmp_path / "figures.json").read_text())
    assert (said["pairs"], said["place"]) == (5, "5 photographs, 5 disparity maps")
    found = {each["name"]: each for each in said["measures"]}
    assert found.keys() <= {measure.key for measure in MEASURES}
    for name, each in found.items():
        assert each["dataset"]["values"] == pytest.approx(each["place"]["values"]), name
        assert each["difference"] in (None, pytest.approx(0, abs=1e-9)), name
        assert each["distance"] in (None, pytest.approx(0, abs=1e-9)), name
        assert each["advice"] == ""
    assert found["jumps"]["dataset"]["mean"] > 0
    near = sum(each["distance"] is not None for each in found.values())
    assert near > 7
    assert f"{near} of {near} measures within one standard deviation" in out
    assert "depth jumps above 1 px" in (tmp_path / "set-report.html").read_text("utf-8")


def test_both_views_of_a_pair_are_one_picture_of_a_place(dataset, tmp_path):
    images = [noise(48, 64, seed) for seed in range(6)]
    for number, image in enumerate(images):
        write(tmp_path / f"scene{number // 2}/im{number % 2}.png", RGB8.encode(image))
    said = report(dataset, images=tmp_path, pairs=0)
    assert said.place.summary == "6 photographs of 3 subjects, 0 disparity maps"
    luminance = [measure_view(make_measure_input(said.width_px, image))["luminance"] for image in images]
    assert said.place.values["luminance"] == pytest.approx(np.reshape(luminance, (3, 2)).mean(axis=1))
    # Three pictures are too few for distances.
    assert {row.distance for row in said.rows} == {None}


@pytest.mark.parametrize(("factor", "alike"), [(1.0, True), (3.0, False), (-0.1, True)])
def test_a_mix_of_extremes_with_the_mean_of_its_place_does_not_pass(factor, alike):
    theirs = np.linspace(-1, 1, 20)
    dataset, place = (gather({"gradient": value} for value in values) for values in (10 + factor * theirs, 10 + theirs))
    [row] = compare(dataset, place, ({}, {}))
    # The Wasserstein distance compares equal quantiles of both samples.
    apart = abs(abs(factor) - 1) * np.abs(theirs).mean() / theirs.std(ddof=1)
    assert row.distance == pytest.approx(apart)
    assert row.difference == pytest.approx(0, abs=1e-12)
    assert (row.distance <= 1) == alike
    assert ("1 of 1 measures" in "".join(summary([row]))) == alike
    assert ("vary" in row.advice) != alike


def test_what_is_left_out_is_said(run, dataset, tmp_path):
    broken = write(tmp_path / "broken.png", b"\x89PNG no more")
    write(tmp_path / "photos/narrow.png", RGB8.encode(noise(20, 30)))
    sparse = steps()
    sparse[:, 3:] = INF
    write(tmp_path / "lidar.pfm", PFM.encode(sparse))
    code, _, err = run(dataset, "--images", tmp_path / "photos", "--images", broken, "--disparity", tmp_path)
    assert code == 0
    for words in (str(broken), "1 photograph narrower than", "1 map with disparities in fewer than"):
        assert words in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("{set} --images {empty}/none.png", "none.png"),
        ("{set} --images {broken}", "photograph"),
        ("{set} --images {photos} --disparity {photos}", "no disparity map"),
        ("{set} --disparity {photos}", "--images"),
        ("{set} --images {photos} --png-scale 0", "--png-scale"),
        ("{set} --out a.txt", "--out"),
    ],
)
def test_what_cannot_be_reported_is_refused(run, dataset, photographs, tmp_path, arguments, words):
    broken = write(tmp_path / "broken.png", b"no picture")
    arguments = arguments.format(set=dataset, empty=tmp_path / "empty", photos=photographs, broken=broken)
    assert_refused(run(*arguments.split()), words)
    assert not list(tmp_path.glob("*.html"))


# --- the advice ---


def test_advice_names_keys_that_a_config_has():
    for key in {key for measure in MEASURES for key in measure.moves}:
        section, _, name = key.rpartition(".")
        fields = Config.model_fields[section].annotation.model_fields if section else Config.model_fields
        assert name in fields, key


def recipe_with(*kinds, **sections):
    """Return the values of a config whose scenes have these kinds of background."""
    weights = {kind: float(kind in kinds) for kind in ("cuboid", "plane", "room", "street")}
    return load_config("middlebury", {"scenes": [], "background": weights, **sections}).model_dump(mode="json")


def test_advice_says_in_which_direction():
    by_key = {measure.key: measure for measure in MEASURES}
    recipe = recipe_with("cuboid", antialias="none")
    assert advice(by_key["slant"], [recipe], more=True) == (
        "raise structures.panel_slant_deg; lower structures.panels, particles.thinness"
    )
    assert advice(by_key["octaves"], [recipe], more=False).startswith("antialias: edges; raise imperfections.blur_px")
    assert "antialias" not in advice(by_key["octaves"], [recipe_with("cuboid", antialias="edges")], more=False)


@pytest.mark.parametrize(
    ("kinds", "sections"),
    [
        ({"cuboid"}, {"structures"}),
        ({"street"}, {"street"}),
        ({"cuboid", "room"}, {"structures", "room", "background"}),
    ],
)
def test_advice_names_no_key_that_moves_nothing_in_the_scenes(kinds, sections):
    def named(*recipes):
        texts = " ".join(advice(measure, recipes, more=more) for measure in MEASURES for more in (True, False))
        return set(re.findall(r"\b(room|street|structures|background|scenes)\b", texts))

    assert named(recipe_with(*kinds)) == sections
    layers = {"layers": [{"disparity_px": [2, 12], "count": 5}]}
    by_layers = advice(MEASURES[0], [recipe_with(*kinds, particles=layers)], more=True)
    assert "particles.density" in advice(MEASURES[0], [recipe_with(*kinds)], more=True)
    assert "particles.density" not in by_layers
    # Advice may name the sections of any recipe.
    assert named(recipe_with(*kinds), recipe_with("street")) == sections | {"street", "scenes"}
