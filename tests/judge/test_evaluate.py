"""The command evaluate: pairing of files, tables, JSON, error maps, and what it refuses."""

import io
import json
import re
import shutil
from contextlib import redirect_stderr, redirect_stdout

import numpy as np
import pytest
from backends import backend_fault
from PIL import Image
from tiny_datasets import config_of

from semisynth_gl import evaluate
from semisynth_gl.cli import main
from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import GREY8
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.judge.predictions import find_predictions
from semisynth_gl.judge.truth import find_truth, read_limits

INF = np.float32(np.inf)
SHAPE = 20, 30


def dataset_of(layout, tmp_path_factory, pairs):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    folder = tmp_path_factory.mktemp("evaluate") / layout
    generate(config_of(), folder, pairs, 0, layout=layout)
    return folder


@pytest.fixture(scope="module")
def middlebury(tmp_path_factory):
    return dataset_of("middlebury", tmp_path_factory, {"train": 2, "validation": 1})


@pytest.fixture(scope="module")
def kitti(tmp_path_factory):
    return dataset_of("kitti", tmp_path_factory, {"train": 2})


def run(*arguments):
    """Exit code, standard output and error of the command, without a process of its own."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr("sys.argv", ["semisynth-gl", "evaluate", *map(str, arguments)])
        try:
            main()
        except SystemExit as ended:
            return ended.code, out.getvalue(), err.getvalue()


def figures_of(tmp_path, *arguments):
    """What --json writes, and Python returns."""
    path = tmp_path / "figures.json"
    assert run(*arguments, "--json", path)[0] == 0
    said = json.loads(path.read_text())
    given = dict(zip(arguments[::2], arguments[1::2], strict=True))
    options = {"split": given.get("--split"), "masks": given.get("--mask")}
    assert evaluate(given["--pred"], given["--gt"], given.get("--protocol"), **options) == said
    return said


def write(path, data):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def ramp(least=5.0):
    return np.linspace(least, least + 20, SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)


def scenes(folder, names, *, isint=0, ndisp=64):
    """Scenes as MiddEval3 has them, their left six columns occluded and the first row without truth."""
    for number, name in enumerate(names):
        truth = ramp(5.0 + number)
        truth[0] = INF
        mask = np.full(SHAPE, 255, np.uint8)
        mask[:, :6] = 128
        write(folder / name / "disp0GT.pfm", PFM.encode(truth))
        write(folder / name / "mask0nocc.png", GREY8.encode(mask))
        write(folder / name / "calib.txt", f"cam0=[1 0 0; 0 1 0; 0 0 1]\nndisp={ndisp}\nisint={isint}\n".encode())
    return folder


# --- datasets of this program ---


def predictions(dataset, folder, change, save):
    for frame in open_dataset(dataset):
        save(folder / f"{frame.split}/{frame.name}", change(frame.left.disparity))
    return folder


def save_pfm(path, values):
    write(path.with_name(f"{path.name}.pfm"), PFM.encode(values.astype(np.float32)))


def save_npy(path, values):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path.with_name(f"{path.name}.npy"), values[None, None].astype(np.float64))


@pytest.mark.parametrize("save", [save_pfm, save_npy])
def test_truth_plus_one_is_one_off_in_every_split(middlebury, tmp_path, save):
    pred = predictions(middlebury, tmp_path / "pred", lambda truth: truth + 1, save)
    said = figures_of(tmp_path, "--pred", pred, "--gt", middlebury)
    assert (said["protocol"], said["unit"], said["missing"]) == ("middlebury", "percent", [])
    names = ["train/middlebury-000000", "train/middlebury-000001", "validation/middlebury-000000"]
    assert [each["name"] for each in said["images"]] == names
    for region in ("all", "non-occluded"):
        assert said["mean"][region]["avgerr"] == pytest.approx(1, abs=1e-5)
        assert said["mean"][region]["epe"] == said["mean"][region]["avgerr"]
        assert said["mean"][region]["bad-0.5"] == 100
        assert said["mean"][region]["bad-2"] == 0
        assert said["mean"][region]["coverage"] == 100
    pixels = said["images"][0]["pixels"]
    frame = open_dataset(middlebury)[0]
    assert pixels["all"]["judged"] == frame.left.disparity.size
    assert pixels["non-occluded"]["judged"] == int((frame.left.visibility == 255).sum())


def test_the_truth_itself_is_without_error(middlebury, kitti, tmp_path_factory, tmp_path):
    crestereo = dataset_of("crestereo", tmp_path_factory, {"train": 1})
    for dataset, protocol in ((middlebury, "middlebury"), (kitti, "kitti"), (crestereo, "middlebury")):
        said = figures_of(tmp_path, "--pred", dataset, "--gt", dataset)
        assert said["protocol"] == protocol
        for region in ("all", "non-occluded"):
            figures = said["mean"][region]
            assert (figures["avgerr"], figures["D1-all"], figures["invalid"]) == (0, 0, 0)


def test_a_packed_dataset_is_read_too(tmp_path_factory, tmp_path):
    webdataset = dataset_of("webdataset", tmp_path_factory, {"train": 1})
    (frame,) = open_dataset(webdataset)
    save_pfm(tmp_path / "pred" / frame.name, frame.left.disparity + 2)
    said = figures_of(tmp_path, "--pred", tmp_path / "pred", "--gt", webdataset)
    assert said["mean"]["all"]["avgerr"] == pytest.approx(2, abs=1e-5)


def test_kitti_names_holes_and_objects(kitti, tmp_path):
    for number, frame in enumerate(open_dataset(kitti)):
        guess = np.where(np.arange(frame.left.disparity.shape[1]) % 2, INF, frame.left.disparity + 8)
        write(tmp_path / "pred" / f"{number:06d}_10.png", KITTI_DISPARITY.encode(guess.astype(np.float32)))
    said = figures_of(tmp_path, "--pred", tmp_path / "pred", "--gt", kitti)
    assert (said["unit"], said["average"]) == ("fraction", "pooled pixels")
    figures = said["mean"]["all"]
    assert 0.49 < figures["coverage"] < 0.51
    assert 0 < figures["D1-est"] <= 1
    judged = [each["pixels"]["all"]["judged"] for each in said["images"]]
    shares = [each["figures"]["all"]["D1-all"] for each in said["images"]]
    assert figures["D1-all"] == pytest.approx(np.average(shares, weights=judged))
    assert min(figures["D1-bg"], figures["D1-fg"]) <= figures["D1-all"] <= max(figures["D1-bg"], figures["D1-fg"])
    # The same files by their folder alone, as anyone's KITTI.
    foreign = tmp_path / "foreign"
    shutil.copytree(kitti / "training", foreign / "training")
    again = figures_of(tmp_path, "--pred", tmp_path / "pred", "--gt", foreign)
    assert [each["name"] for each in again["images"]] == ["000000_10", "000001_10"]
    assert again["mean"] == said["mean"]


def test_one_split_has_plain_names(middlebury, tmp_path):
    (frame,) = open_dataset(middlebury, "validation")
    save_pfm(tmp_path / "pred" / frame.name, frame.left.disparity)
    said = figures_of(tmp_path, "--pred", tmp_path / "pred", "--gt", middlebury, "--split", "validation")
    assert [each["name"] for each in said["images"]] == [frame.name]
    # Over all splits the name is two pairs'.
    pairs = find_truth(str(middlebury)).pairs
    with pytest.raises(InputError, match=f"no prediction for {len(pairs)} of {len(pairs)} pairs"):
        find_predictions(tmp_path / "pred", pairs, partial=True)


# --- folders of benchmarks ---


def test_middlebury_scenes_with_results_beside_the_truth(tmp_path):
    gt = scenes(tmp_path / "trainingF", ["Piano", "Playtable"])
    for name, off in (("Piano", 0.75), ("Playtable", 4.0)):
        guess = read_disparity_map(gt / name / "disp0GT.pfm") + np.float32(off)
        guess[1, :3] = INF
        write(gt / name / "disp0MINE.pfm", PFM.encode(guess))
    code, out, _ = run("--pred", gt, "--gt", gt)
    assert code == 0
    table = [line.split() for line in out.splitlines()]
    heading = next(words for words in table if "avgerr" in words)
    # The first of the two tables is that of all pixels.
    rows = {words[0]: words[1:] for words in reversed(table) if words and words[0] in ("Piano", "Playtable", "mean")}
    invalid = f"{100 * 3 / 570:.2f}"
    assert rows["Piano"][heading.index("invalid")] == invalid
    assert rows["Piano"][heading.index("bad-1")] == invalid
    assert rows["Playtable"][heading.index("bad-2")] == "100.00"
    # Playtable weighs half.
    assert rows["mean"][heading.index("avgerr")] == f"{(0.75 + 0.5 * 4) / 1.5:.2f}"


def test_sizes_isint_and_ndisp_of_middlebury(tmp_path):
    gt = scenes(tmp_path / "gt", ["a"], isint=1, ndisp=9)
    half = np.full((SHAPE[0] // 2, SHAPE[1] // 2), 30.0, np.float32)
    write(tmp_path / "pred" / "a.pfm", PFM.encode(half))
    said = figures_of(tmp_path, "--pred", tmp_path / "pred", "--gt", gt)
    truth = read_disparity_map(gt / "a" / "disp0GT.pfm")
    assert said["mean"]["all"]["avgerr"] == pytest.approx(np.abs(10 - truth[1:]).mean(), rel=1e-5)
    for wrong in ("many", "64.5", "nan", "", "-64", "9" * 5000, "1e9", " " * 60_000 + "x"):
        write(tmp_path / "calib.txt", f"ndisp={wrong}\n".encode())
        with pytest.raises(ReadError, match="ndisp"):
            read_limits(tmp_path / "calib.txt")


def test_a_picture_beside_a_prediction_is_no_prediction(tmp_path):
    # So does RAFT-Stereo's demo leave its results.
    gt = scenes(tmp_path / "gt", ["Teddy"])
    save_npy(tmp_path / "pred" / "Teddy", ramp())
    Image.new("RGBA", SHAPE[::-1]).save(tmp_path / "pred" / "Teddy.png")
    assert figures_of(tmp_path, "--pred", tmp_path / "pred", "--gt", gt)["mean"]["all"]["avgerr"] == 0
    # A disparity map in 16-bit PNG beside another one leaves a doubt, and so do two truths.
    write(tmp_path / "pred" / "Teddy.png", KITTI_DISPARITY.encode(ramp()))
    assert "2 predictions for Teddy: Teddy.npy, Teddy.png" in refused(tmp_path / "pred", gt)
    scenes(gt / "again", ["Teddy"])
    assert "2 truths for Teddy" in refused(tmp_path / "pred", gt)


def test_scenes_may_be_links(tmp_path):
    own, gt = scenes(tmp_path / "elsewhere", ["a", "b"]), scenes(tmp_path / "gt", ["c"])
    (gt / "a").symlink_to(own / "a")
    (gt / "more").symlink_to(own)
    assert sorted(pair.name for pair in find_truth(str(gt)).pairs) == ["a", "b", "c"]


def test_negative_predictions_are_asked_for_their_sign(tmp_path):
    gt = scenes(tmp_path / "gt", ["Teddy", "Vintage"])
    for sign in (1, -1):
        for name in ("Teddy", "Vintage"):
            save_npy(tmp_path / "pred" / name, sign * ramp())
        assert ("negative" in run("--pred", tmp_path / "pred", "--gt", gt)[2]) == (sign < 0)


def test_eth3d_is_known_by_its_folder_and_masks_may_be_given(tmp_path):
    gt = scenes(tmp_path / "two_view_training_gt", ["lakeside_1l", "forest_1s"])
    for path in gt.glob("*/mask0nocc.png"):
        path.unlink()
    pred = tmp_path / "low_res_two_view"
    for name in ("lakeside_1l", "forest_1s"):
        write(pred / f"{name}.pfm", PFM.encode(read_disparity_map(gt / name / "disp0GT.pfm")))
        mask = np.zeros(SHAPE, np.uint8)
        mask[2, :5] = 255
        write(tmp_path / "masks" / name / "mask0nocc.png", GREY8.encode(mask))
    said = figures_of(tmp_path, "--pred", pred, "--gt", gt)
    assert said["protocol"] == "eth3d"
    assert list(said["mean"]) == ["all"]
    said = figures_of(tmp_path, "--pred", pred, "--gt", gt, "--mask", tmp_path / "masks", "--protocol", "paper")
    assert said["images"][1]["pixels"]["non-occluded"]["judged"] == 5
    shutil.rmtree(tmp_path / "masks" / "forest_1s")
    with pytest.raises(InputError, match=r"no mask for forest_1s: expected .*\.png"):
        find_truth(str(gt), masks=tmp_path / "masks")


def test_a_folder_of_maps_is_truth_too(tmp_path):
    write(tmp_path / "gt" / "a.png", KITTI_DISPARITY.encode(ramp()))
    np.save(tmp_path / "gt" / "b.npy", ramp())
    for name in "ab":
        write(tmp_path / "pred" / f"{name}.pfm", PFM.encode(ramp() + 3))
    said = figures_of(tmp_path, "--pred", tmp_path / "pred", "--gt", tmp_path / "gt", "--protocol", "kitti")
    assert [each["name"] for each in said["images"]] == ["a", "b"]
    assert said["mean"]["all"]["epe"] == pytest.approx(3, abs=1 / 256)
    assert list(said["mean"]) == ["all"]


def test_an_empty_mask_leaves_a_pair_out_of_the_mean(tmp_path):
    gt = scenes(tmp_path / "gt", ["a", "b"])
    write(gt / "a" / "mask0nocc.png", GREY8.encode(np.zeros(SHAPE, np.uint8)))
    for name in "ab":
        write(tmp_path / "pred" / f"{name}.pfm", PFM.encode(ramp()))
    assert run("--pred", tmp_path / "pred", "--gt", gt, "--json", tmp_path / "j.json")[0] == 0
    said = json.loads((tmp_path / "j.json").read_text())
    assert said["images"][0]["figures"]["non-occluded"]["avgerr"] is None
    assert said["mean"]["non-occluded"]["avgerr"] == said["images"][1]["figures"]["non-occluded"]["avgerr"]


# --- error maps ---


def test_error_maps_are_pictures_of_the_truths_size(tmp_path):
    gt = scenes(tmp_path / "gt", ["a"])
    guess = read_disparity_map(gt / "a" / "disp0GT.pfm")
    guess[5:10] += 3
    write(tmp_path / "pred" / "a.pfm", PFM.encode(guess))
    figures_of(tmp_path, "--pred", tmp_path / "pred", "--gt", gt, "--maps", tmp_path / "maps" / "new")
    with Image.open(tmp_path / "maps" / "new" / "a.png") as picture:
        pixels = np.asarray(picture)
    assert pixels.shape == (*SHAPE, 3)
    # test_metrics.py has the colours.
    assert (pixels[5:10, :6] == 128).all()
    assert [path.name for path in (tmp_path / "maps" / "new").iterdir()] == ["a.png"]


def test_error_maps_do_not_go_where_they_would_be_read(tmp_path):
    gt = scenes(tmp_path / "gt", ["a"])
    for folder, option in (("pred", "--pred"), ("gt", "--gt"), ("masks", "--mask")):
        write(tmp_path / "masks" / "a" / "mask0nocc.png", GREY8.encode(np.full(SHAPE, 255, np.uint8)))
        (tmp_path / "pred").mkdir(exist_ok=True)
        said = refused(tmp_path / "pred", gt, "--mask", tmp_path / "masks", "--maps", tmp_path / folder)
        assert f"folder of {option}" in said


# --- refusals ---


def refused(pred, gt, *more):
    code, _, err = run("--pred", pred, "--gt", gt, *more)
    assert code == 2
    return err


@pytest.fixture
def three(tmp_path):
    gt = scenes(tmp_path / "gt", ["a", "b", "c"])
    for name in "abc":
        write(tmp_path / "pred" / f"{name}.pfm", PFM.encode(ramp()))
    return tmp_path / "pred", gt


def test_missing_predictions_are_named_and_may_be_passed_over(three):
    pred, gt = three
    (pred / "b.pfm").unlink()
    said = refused(pred, gt)
    assert "no prediction for 1 of 3 pairs: b" in said
    assert "partial" in said
    code, out, err = run("--pred", pred, "--gt", gt, "--partial", "--json", pred / "j.json")
    assert code == 0
    assert out.startswith("2 of 3 pairs")
    assert "No prediction for 1 pair: b" in err
    assert json.loads((pred / "j.json").read_text())["missing"] == ["b"]


def test_other_sizes_are_refused_with_the_files(three):
    pred, gt = three
    write(pred / "b.pfm", PFM.encode(np.ones((7, 9), np.float32)))
    said = refused(pred, gt)
    assert str(pred / "b.pfm") in said
    assert "9 x 7" in said
    write(gt / "a" / "mask0nocc.png", GREY8.encode(np.ones((7, 9), np.uint8)))
    assert "mask0nocc.png" in refused(pred, gt)


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_predictions_and_truths_without_any_disparity_are_refused(three, value):
    pred, gt = three
    write(pred / "b.pfm", PFM.encode(np.full(SHAPE, value, np.float32)))
    said = refused(pred, gt, "--partial")
    assert f"{pred / 'b.pfm'}: has no disparity" in said
    write(pred / "b.pfm", PFM.encode(np.zeros(SHAPE, np.float32)))
    assert "has no disparity" in refused(pred, gt, "--protocol", "kitti")
    write(gt / "a" / "disp0GT.pfm", PFM.encode(np.full(SHAPE, INF, np.float32)))
    said = refused(pred, gt)
    assert "the truth of a has no disparity" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--pred", "pred", "--gt", "nowhere"), "--gt: nowhere"),
        (("--pred", "gt/a/calib.txt", "--gt", "gt"), "is a file"),
        (("--pred", "pred", "--gt", "empty"), "no true disparities there"),
        (("--pred", "pred", "--gt", "gt", "--split", "test"), "has no splits"),
        (("--pred", "pred", "--gt", "gt", "--mask", "empty"), "no mask for a"),
    ],
)
@pytest.mark.usefixtures("three")
def test_wrong_options_are_refused(tmp_path, monkeypatch, arguments, words):
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    code, _, err = run(*arguments)
    assert code == 2
    assert words in err


# --- many pairs ---


def rows_of(out):
    """The names of the rows of a table, but for its head."""
    return [line.split()[0] for line in out.splitlines() if re.match(r"(pair-|mean|pooled)", line)]


@pytest.mark.parametrize(("protocol", "last"), [("middlebury", "mean"), ("kitti", "pooled")])
def test_of_many_pairs_the_ten_worst_have_a_row(tmp_path, protocol, last):
    truth, names = np.full(SHAPE, 9, np.float32), [f"pair-{number * 5 % 12:02d}" for number in range(12)]
    for number, name in enumerate(names):
        prediction = truth.copy()
        prediction.ravel()[: 10 * (number + 1)] += 15
        write(tmp_path / "gt" / f"{name}.pfm", PFM.encode(truth))
        write(tmp_path / "pred" / f"{name}.pfm", PFM.encode(prediction))
    given = ("--pred", tmp_path / "pred", "--gt", tmp_path / "gt", "--protocol", protocol)
    code, out, _ = run(*given)
    assert (code, rows_of(out)) == (0, [*names[:1:-1], last])
    code, every, _ = run(*given, "--all")
    assert (code, rows_of(every)) == (0, [*sorted(names), last])
    # The means are of all pairs in both.
    assert [line for line in out.splitlines() if line.startswith(last)] == [
        line for line in every.splitlines() if line.startswith(last)
    ]
