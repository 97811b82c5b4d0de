"""The command evaluate: matching of files, tables, JSON, error maps, left-right consistency, and refused inputs."""

import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image
from processes import assert_refused
from tiny_datasets import config_of

from semisynth_gl import evaluate
from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import GREY8
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.judge.evaluate import evaluate_views, unconfirmed
from semisynth_gl.judge.truth import find_truth, read_limits

INF = np.float32(np.inf)
SHAPE = 20, 30


def dataset_of(layout, tmp_path_factory, pairs):
    folder = tmp_path_factory.mktemp("evaluate") / layout
    generate(config_of(), folder, pairs, 0, layout=layout)
    return folder


@pytest.fixture(scope="module")
def middlebury(tmp_path_factory):
    return dataset_of("middlebury", tmp_path_factory, {"train": 2, "validation": 1})


@pytest.fixture(scope="module")
def kitti(tmp_path_factory):
    return dataset_of("kitti", tmp_path_factory, {"train": 2})


@pytest.fixture
def run(program):
    """Return a function that runs the command."""
    return lambda pred, gt, *options: program("evaluate", "--pred", pred, "--gt", gt, *options)


def save(path, values):
    """Write a map as .pfm, .npy (with axes of batch and channel, as networks do) or .png."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, values[None, None].astype(np.float64))
    else:
        path.write_bytes((PFM if path.suffix == ".pfm" else KITTI_DISPARITY).encode(values.astype(np.float32)))


def ramp(least=5.0):
    return np.linspace(least, least + 20, SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)


def scenes(folder, names, *, isint=0, ndisp=64):
    """Write scenes as in MiddEval3, with the left six columns occluded and the first row without truth."""
    mask = np.full(SHAPE, 255, np.uint8)
    mask[:, :6] = 128
    for number, name in enumerate(names):
        truth = ramp(5.0 + number)
        truth[0] = INF
        save(folder / name / "disp0GT.pfm", truth)
        (folder / name / "mask0nocc.png").write_bytes(GREY8.encode(mask))
        (folder / name / "calib.txt").write_text(f"cam0=[1 0 0; 0 1 0; 0 0 1]\nndisp={ndisp}\nisint={isint}\n")
    return folder


# --- datasets of this program ---


@pytest.mark.parametrize("extension", ["pfm", "npy"])
def test_truth_plus_one_is_one_off_in_every_split(run, middlebury, tmp_path, extension):
    for frame in open_dataset(middlebury):
        save(tmp_path / "pred" / f"{frame.split}/{frame.name}.{extension}", frame.left.disparity + 1)
    found = evaluate(tmp_path / "pred", middlebury)
    assert run(tmp_path / "pred", middlebury, "--json", "out.json").code == 0
    assert json.loads((tmp_path / "out.json").read_text()) == found
    assert (found["protocol"], found["unit"]) == ("middlebury", "percent")
    names = ["train/middlebury-000000", "train/middlebury-000001", "validation/middlebury-000000"]
    assert [each["name"] for each in found["images"]] == names
    for region in ("all", "non-occluded"):
        assert found["mean"][region]["avgerr"] == pytest.approx(1, abs=1e-5)
        assert [found["mean"][region][name] for name in ("bad-0.5", "bad-2", "coverage")] == [100, 0, 100]
    pixels, left = found["images"][0]["pixels"], open_dataset(middlebury)[0].left
    assert pixels["all"]["judged"] == left.disparity.size
    assert pixels["non-occluded"]["judged"] == int((left.visibility == 255).sum())


@pytest.mark.parametrize("layout", ["middlebury", "kitti", "crestereo", "webdataset"])
def test_a_copy_of_the_truth_is_without_error(tmp_path, tmp_path_factory, layout):
    dataset, pred = dataset_of(layout, tmp_path_factory, {"train": 1}), tmp_path / "pred"
    if layout == "webdataset":
        save(pred / f"{open_dataset(dataset)[0].name}.pfm", open_dataset(dataset)[0].left.disparity)
    else:
        shutil.copytree(dataset, pred)
        with pytest.raises(InputError, match="the truth's own file"):
            evaluate(dataset, dataset)
    found = evaluate(pred, dataset)
    assert found["protocol"] == ("kitti" if layout == "kitti" else "middlebury")
    for figures in found["mean"].values():
        assert (figures["avgerr"], figures["D1-all"], figures["invalid"]) == (0, 0, 0)


def test_kitti_names_holes_and_objects(kitti, tmp_path):
    for number, frame in enumerate(open_dataset(kitti)):
        guess = np.where(np.arange(frame.left.disparity.shape[1]) % 2, INF, frame.left.disparity + 8)
        save(tmp_path / "pred" / f"{number:06d}_10.png", guess)
    found = evaluate(tmp_path / "pred", kitti)
    figures = found["mean"]["all"]
    assert 0.49 < figures["coverage"] < 0.51
    assert 0 < figures["D1-est"] <= 1
    judged = [each["pixels"]["all"]["judged"] for each in found["images"]]
    shares = [each["figures"]["all"]["D1-all"] for each in found["images"]]
    assert figures["D1-all"] == pytest.approx(np.average(shares, weights=judged))
    assert min(figures["D1-bg"], figures["D1-fg"]) <= figures["D1-all"] <= max(figures["D1-bg"], figures["D1-fg"])
    # Copy the folder without the plan, as a KITTI dataset from elsewhere.
    foreign = shutil.copytree(kitti / "training", tmp_path / "foreign" / "training").parent
    again = evaluate(tmp_path / "pred", foreign)
    assert [each["name"] for each in again["images"]] == ["000000_10", "000001_10"]
    assert again["mean"] == found["mean"]


def test_one_split_has_plain_names(middlebury, tmp_path):
    (frame,) = open_dataset(middlebury, "validation")
    save(tmp_path / "pred" / f"{frame.name}.pfm", frame.left.disparity)
    found = evaluate(tmp_path / "pred", middlebury, split="validation")
    assert [each["name"] for each in found["images"]] == [frame.name]
    # Over all splits, two pairs have this name.
    with pytest.raises(InputError, match="no prediction for 3 of 3 pairs"):
        evaluate(tmp_path / "pred", middlebury)


# --- folders of benchmarks ---


def test_middlebury_scenes_with_results_beside_the_truth(run, tmp_path):
    gt = scenes(tmp_path / "trainingF", ["Piano", "Playtable"])
    for name, off in (("Piano", 0.75), ("Playtable", 4.0)):
        guess = read_disparity_map(gt / name / "disp0GT.pfm") + np.float32(off)
        guess[1, :3] = INF
        save(gt / name / "disp0MINE.pfm", guess)
    table = [line.split() for line in run(gt, gt).out.splitlines()]
    heading = next(words for words in table if "avgerr" in words)
    # The first of two tables is for all pixels.
    rows = {
        " ".join(words[: -len(heading)]): dict(zip(heading, words[-len(heading) :], strict=True))
        for words in reversed(table)
        if len(words) > len(heading)
    }
    assert rows["Piano"]["invalid"] == rows["Piano"]["bad-1"] == f"{100 * 3 / 570:.4g}"
    assert rows["Playtable"]["bad-2"] == "100"
    # Playtable has half the weight.
    assert rows["all pairs"]["avgerr"] == f"{(0.75 + 0.5 * 4) / 1.5:.4g}"


def test_sizes_isint_and_ndisp_of_middlebury(tmp_path):
    gt = scenes(tmp_path / "gt", ["a"], isint=1, ndisp=9)
    save(tmp_path / "pred" / "a.pfm", np.full((SHAPE[0] // 2, SHAPE[1] // 2), 30.0))
    truth = read_disparity_map(gt / "a" / "disp0GT.pfm")
    expected = np.abs(10 - truth[1:]).mean()
    assert evaluate(tmp_path / "pred", gt)["mean"]["all"]["avgerr"] == pytest.approx(expected, rel=1e-5)
    for wrong in ("many", "64.5", "nan", "", "-64", "9" * 5000, " " * 60_000 + "x"):
        (tmp_path / "calib.txt").write_text(f"ndisp={wrong}\n")
        with pytest.raises(ReadError, match="ndisp"):
            read_limits(tmp_path / "calib.txt")


def test_a_picture_beside_a_prediction_is_no_prediction(tmp_path):
    # RAFT-Stereo's demo writes such files.
    gt = scenes(tmp_path / "gt", ["Teddy"])
    save(tmp_path / "pred" / "Teddy.npy", ramp())
    Image.new("RGBA", SHAPE[::-1]).save(tmp_path / "pred" / "Teddy.png")
    assert evaluate(tmp_path / "pred", gt)["mean"]["all"]["avgerr"] == 0
    # With a disparity map in 16-bit PNG, or with two truths, the match is ambiguous.
    save(tmp_path / "pred" / "Teddy.png", ramp())
    with pytest.raises(InputError, match=r"2 predictions for Teddy: Teddy.npy, Teddy.png"):
        evaluate(tmp_path / "pred", gt)
    scenes(gt / "again", ["Teddy"])
    with pytest.raises(InputError, match="2 truths for Teddy"):
        evaluate(tmp_path / "pred", gt)


def test_scenes_may_be_links(tmp_path):
    own, gt = scenes(tmp_path / "elsewhere", ["a", "b"]), scenes(tmp_path / "gt", ["c"])
    (gt / "a").symlink_to(own / "a")
    (gt / "more").symlink_to(scenes(tmp_path / "others", ["d"]))
    assert sorted(pair.name for pair in find_truth(str(gt)).pairs) == ["a", "c", "d"]


def test_eth3d_is_known_by_its_folder(tmp_path):
    gt = scenes(tmp_path / "two_view_training_gt", ["lakeside_1l", "forest_1s"])
    for name in ("lakeside_1l", "forest_1s"):
        (gt / name / "mask0nocc.png").unlink()
        save(tmp_path / "low_res_two_view" / f"{name}.pfm", ramp())
    found = evaluate(tmp_path / "low_res_two_view", gt)
    assert (found["protocol"], found["unit"], list(found["mean"])) == ("eth3d", "fraction", ["all"])


def test_a_folder_of_maps_is_truth_too(tmp_path):
    save(tmp_path / "gt" / "disp0001.png", ramp())
    save(tmp_path / "gt" / "disp0002.npy", ramp())
    Image.new("RGB", SHAPE[::-1]).save(tmp_path / "gt" / "disp0002.png")  # a picture, not a map
    for name in ("disp0001", "disp0002"):
        save(tmp_path / "pred" / f"{name}.pfm", ramp() + 3)
    found = evaluate(tmp_path / "pred", tmp_path / "gt", "kitti")
    assert [each["name"] for each in found["images"]] == ["disp0001", "disp0002"]
    assert found["mean"]["all"]["avgerr"] == pytest.approx(3, abs=1 / 256)


# --- error maps, tables, predictions that are missing or cannot be compared ---


@pytest.fixture
def three(tmp_path):
    gt = scenes(tmp_path / "gt", ["a", "b", "c"])
    for name in "abc":
        save(tmp_path / "pred" / f"{name}.pfm", ramp())
    return tmp_path / "pred", gt


def test_error_maps_are_pictures_beside_no_other_files(run, three, tmp_path):
    pred, gt = three
    run(pred, gt, "--maps", tmp_path / "maps" / "new")
    assert {Image.open(path).size for path in (tmp_path / "maps" / "new").iterdir()} == {SHAPE[::-1]}
    for folder in (pred, gt):
        assert_refused(run(pred, gt, "--maps", folder), "has predictions or truth")


@pytest.mark.parametrize("protocol", ["middlebury", "kitti"])
def test_of_many_pairs_the_ten_worst_have_a_row(run, tmp_path, protocol):
    truth, names = np.full(SHAPE, 9, np.float32), [f"pair-{number * 5 % 12:02d}" for number in range(12)]
    for number, name in enumerate(names):
        prediction = truth.copy()
        prediction.ravel()[: 10 * (number + 1)] += 15
        save(tmp_path / "gt" / f"{name}.pfm", truth)
        save(tmp_path / "pred" / f"{name}.pfm", prediction)
    lines = run("pred", "gt", "--protocol", protocol).out.splitlines()
    assert [line.split()[0] for line in lines if re.match("pair-|all pairs", line)] == [*names[:1:-1], "all"]


def test_missing_predictions_are_named(three):
    pred, gt = three
    (pred / "b.pfm").rename(pred / "left_b.pfm")
    with pytest.raises(InputError, match=r"no prediction for 1 of 3 pairs: b: .*left_b\.pfm"):
        evaluate(pred, gt)
    (pred / "b.png").write_bytes(GREY8.encode(np.ones(SHAPE, np.uint8)))
    with pytest.raises(ReadError, match=r"b\.png: expected 16-bit grey, got 8-bit grey"):
        evaluate(pred, gt)


@pytest.mark.parametrize(
    ("changed", "values", "protocol", "words"),
    [
        ("pred/b.pfm", np.ones((7, 9)), None, "b.pfm: the prediction has 9 x 7 pixels"),
        ("pred/b.pfm", np.full(SHAPE, np.nan), None, "b.pfm: has no disparity"),
        ("pred/b.pfm", np.full(SHAPE, INF), None, "b.pfm: has no disparity"),
        ("pred/b.pfm", np.zeros(SHAPE), "kitti", "b.pfm: has no disparity"),
        ("gt/a/mask0nocc.png", np.ones((7, 9), np.uint8), None, "the mask has 9 x 7 pixels.*gt/a"),
    ],
)
@pytest.mark.usefixtures("three")
def test_maps_that_cannot_be_compared_are_refused(tmp_path, changed, values, protocol, words):
    path = tmp_path / changed
    path.write_bytes(GREY8.encode(values) if path.suffix == ".png" else PFM.encode(values.astype(np.float32)))
    with pytest.raises((InputError, ReadError), match=words):
        evaluate(tmp_path / "pred", tmp_path / "gt", protocol)


# --- left against right, without truth ---


def walls():
    """Return both views' true disparities of a wall at 4 px behind a narrower one at 10 px."""
    left, right = (np.full((6, 60), 4, np.float32) for _ in range(2))
    left[:, 30:40] = right[:, 20:30] = 10
    return left, right


def test_the_truth_is_confirmed_but_where_one_eye_alone_sees():
    left, right = walls()
    # In the left view, columns 24 to 29 are occluded and columns 0 to 3 are outside the right view.
    assert unconfirmed(left, right) == pytest.approx(100 * 6 / 56)
    assert unconfirmed(left[:, :20], right[:, :20]) == 0


@pytest.mark.parametrize(("off", "counts"), [(0.9, False), (1.1, True), (-1.1, True), (INF, True), (np.nan, True)])
def test_what_is_off_by_more_than_a_pixel_is_not_confirmed(off, counts):
    for view, columns in ((0, slice(45, 50)), (1, slice(41, 46))):  # the same points in both views
        views = walls()
        views[view][:3, columns] += np.float32(off)
        assert unconfirmed(*views) == pytest.approx(100 * (6 + 2.5 * counts) / 56)


def test_views_that_cannot_be_compared_are_refused():
    left, right = walls()
    with pytest.raises(InputError, match="the left view has 60 x 6, the right one 59 x 6"):
        unconfirmed(left, right[:, 1:])
    for nowhere in (INF, np.float32(60)):
        with pytest.raises(InputError, match="no left disparity points into the right image"):
            unconfirmed(np.full_like(left, nowhere), right)


def test_both_views_are_judged_by_the_command(program, tmp_path):
    (one, other), left, right = walls(), tmp_path / "left", tmp_path / "right"
    save(left / "a.npy", one[:, :20])
    save(right / "a.npy", other[:, :20])
    save(left / "b" / "c.pfm", one)
    save(right / "b" / "c.npy", other)
    done = program("evaluate", "--pred", left, "--pred-right", right, "--json", "out.json")
    rows = [line.split() for line in done.out.splitlines()[2:]]
    assert rows == [["unconfirmed"], ["b/c", "10.71"], ["a", "0"], ["all", "pairs", "5.357"]]
    assert json.loads((tmp_path / "out.json").read_text()) == evaluate_views(left, right)
    (right / "a.npy").rename(right / "d.npy")
    with pytest.raises(InputError, match="only one folder has a, d"):
        evaluate_views(left, right)


# --- refusals ---


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("pred", "nowhere"), "--gt: nowhere"),
        (("gt/a/calib.txt", "gt"), "is a file"),
        (("pred", "empty"), "no true disparities there"),
        (("pred", "gt", "--split", "test"), "has no splits"),
        (("pred", "gt", "--pred-right", "pred"), "give either --gt or --pred-right"),
    ],
)
@pytest.mark.usefixtures("three")
def test_wrong_options_are_refused(run, tmp_path, arguments, words):
    (tmp_path / "empty").mkdir()
    assert_refused(run(*arguments), words)
