"""The report: its numbers against independent ones, its page in a browser."""

import io
import json
import re
import shutil
import sys
import zlib
from base64 import b64decode
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from backends import backend_fault
from browser import open_browser, wait
from PIL import Image
from tiny_datasets import config_of

from semisynth_gl.cli import main
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.frame.channels import OCCLUDED
from semisynth_gl.histogram import total_variation, wasserstein_px
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge import pictures
from semisynth_gl.judge.measured_pairs import QUANTITIES, PairMeasures, find_outliers, measure, read_redraws
from semisynth_gl.judge.pictures import make_picture, make_pictures
from semisynth_gl.judge.plots import count_bars, draw_histogram
from semisynth_gl.judge.report import report
from semisynth_gl.seeds.spread import spread

PAIRS = {"train": 4, "validation": 2}
LAYERS = ("left", "right", "warped", "disparity", "masks")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    folder = tmp_path_factory.mktemp("report") / "set"
    generate(config_of(), folder, PAIRS, 0)
    return folder


@pytest.fixture
def changed(dataset, tmp_path):
    """A copy, to change something in."""
    return shutil.copytree(dataset, tmp_path / "set", symlinks=True)


@pytest.fixture(scope="module")
def measured(dataset):
    pairs = open_dataset(dataset)
    return measure(pairs, range(len(pairs)))


@pytest.fixture(scope="module")
def page(dataset):
    return report(dataset, pairs=3, sample=200).page


def run_report(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["semisynth-gl", "report", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code, *capsys.readouterr()


def edit_json(path, change):
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))


# What is measured.


def test_the_histogram_counts_every_pixel(dataset, measured):
    files = [pair.left.disparity for pair in open_dataset(dataset)]
    values = np.concatenate([each[np.isfinite(each)] for each in files]).astype(np.float64)
    shares = np.histogram(values, measured.disparity.edges_px)[0] / values.size
    np.testing.assert_allclose(measured.disparity.shares, shares, atol=1e-12)
    assert measured.disparity.mean_px == pytest.approx(values.mean(), abs=0.02)
    target = read_index(dataset).plan.config.wanted_histogram()
    in_bins = np.histogram(np.clip(values, target.edges_px[0], target.edges_px[-1]), target.edges_px)[0] / values.size
    assert total_variation(target, measured.disparity) == pytest.approx(np.abs(in_bins - target.shares).sum() / 2)


def test_pairs_have_the_measures_of_their_files(dataset, measured):
    assert [pair.name for pair in measured.pairs] == [
        f"{split} middlebury-{number:06d}" for split, count in PAIRS.items() for number in range(count)
    ]
    for pair, frame in zip(measured.pairs, open_dataset(dataset), strict=True):
        assert pair.median_px == np.median(frame.left.disparity)
        assert pair.occluded == (frame.left.visibility == OCCLUDED).mean()
        assert pair.invalid == 0
    assert len({pair.median_px for pair in measured.pairs}) == len(measured.pairs)


def test_an_unreadable_pair_is_reported(changed):
    broken = changed / "train" / "MiddEval3" / "trainingF" / "middlebury-000001" / "disp0GT.pfm"
    broken.write_bytes(broken.read_bytes()[:100])
    made = report(changed, pairs=1, sample=6)
    assert len(made.measurement.pairs) == 5
    assert "disp0GT.pfm" in made.page
    shutil.rmtree(changed / "train" / "MiddEval3" / "trainingF")
    with pytest.raises(InputError, match="no pair could be read"):
        report(changed, pairs=1, sample=6, split="train")


@pytest.mark.parametrize("layout", ["webdataset", "kitti"])
def test_other_layouts_can_be_reported(layout, tmp_path):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    generate(config_of(), tmp_path / "set", 2, 0, layout=layout, shard_pairs=1)
    made = report(tmp_path / "set", pairs=1, sample=1)
    assert (len(made.measurement.pairs), made.shown) == (1, 1)


def test_a_dataset_at_an_address_can_be_reported(dataset, page):
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    memory.put(str(dataset), "/bucket/far-away", recursive=True)
    try:
        assert report("memory://bucket/far-away", pairs=3, sample=200).page == page
    finally:
        memory.rm("/bucket", recursive=True)


# What was drawn again.


def test_redraws_are_those_of_all_records(changed):
    records = sorted((changed / "shards").glob("semisynth-middlebury-train-*.json"))

    def redraw(record):
        record["samples"][0]["redrawn"] = ["too dark: 3; too little texture: 1", "too dark: 4"]

    edit_json(records[0], redraw)
    redraws = read_redraws(read_index(changed))
    assert (redraws.pairs, redraws.attempts) == (6, 2)
    assert {key: len(reasons) for key, reasons in redraws.messages.items()} == {("train", 0): 2}
    assert {name: count for name, (count, _) in redraws.faults.items()} == {"too dark": 2, "too little texture": 1}
    assert read_redraws(read_index(changed), "validation").attempts == 0
    # Pair 0 is not in the sample of one.
    made = report(changed, pairs=0, sample=1)
    assert "too little texture" in made.page
    records[0].unlink()
    incomplete = read_redraws(read_index(changed))
    assert incomplete.pairs < 6
    assert records[0].name in incomplete.unread[0]


def pair_measures(number, median=10.0, redraws=0):
    return PairMeasures(number, ("train", number), f"pair-{number}", median, None, 0.0, 5.0, redraws)


def test_outliers_are_the_farthest_from_the_median():
    pairs = [pair_measures(number, 10 + number % 5) for number in range(50)]
    pairs[17] = pair_measures(17, 40)
    pairs[30] = pair_measures(30, -9)
    pairs[31] = pair_measures(31, float("nan"))
    outliers = find_outliers(pairs, QUANTITIES[0], most=2)
    assert [(outlier.pair.position, outlier.value) for outlier in outliers] == [(17, 40), (30, -9)]
    assert outliers[0].typical == 12
    assert outliers[0].deviations == pytest.approx(28 / 1.4826)
    assert find_outliers(pairs, QUANTITIES[1]) == []
    assert find_outliers(pairs, QUANTITIES[4]) == []
    pairs[3] = pair_measures(3, redraws=4)
    [redrawn] = find_outliers(pairs, QUANTITIES[4])
    assert (redrawn.pair.position, redrawn.value) == (3, 4)


# Plots and pictures.


def test_bars_count_all_values_once():
    edges, shares = count_bars(np.r_[np.arange(100), np.nan])
    np.testing.assert_allclose(shares, 0.05)
    np.testing.assert_allclose(edges, np.linspace(0, 99, 21))
    assert count_bars([5.0, 5.0])[1].sum() == 1
    np.testing.assert_allclose(count_bars([-1, 1, 2, 9], np.array([0.0, 2, 4]))[1], [0.5, 0.5])


def test_the_heights_of_bars_are_the_shares():
    svg = draw_histogram(np.arange(5.0), np.array([0.5, 0.25, 0.0, 0.25]), "px")
    bars = [path for path in ET.fromstring(svg).iter() if path.get("class") == "bar"]  # noqa: S314 - its own
    floor, tops = (
        np.array([float(re.search(rf"{before}([\d.]+)", bar.get("d"))[1]) for bar in bars])
        for before in (r"M[\d.]+ ", "V")
    )
    np.testing.assert_allclose(floor - tops, np.array([1, 0.5, 0.5]) * (floor - tops)[0], atol=0.02)


@pytest.mark.parametrize("step", [1, 2, 3])
def test_a_reduced_picture_keeps_stored_disparities(dataset, step):
    frame = open_dataset(dataset)[0]
    picture = make_picture(frame, step)
    values = np.frombuffer(zlib.decompress(b64decode(picture.texts["values"])), "<f4")
    grid = np.s_[step // 2 :: step, step // 2 :: step]
    np.testing.assert_array_equal(values, frame.left.disparity[grid].ravel())
    sizes = {name: Image.open(io.BytesIO(b64decode(picture.texts[name]))).size for name in LAYERS}
    assert set(sizes.values()) == {(picture.width_px, picture.height_px)}


def test_overlays_show_disparity_and_masks(dataset):
    frame = open_dataset(dataset)[0]
    picture = make_picture(frame, 1)
    masks, disparity = (Image.open(io.BytesIO(b64decode(picture.texts[name]))) for name in ("masks", "disparity"))
    alpha = np.asarray(masks.convert("RGBA"))[..., 3]
    np.testing.assert_array_equal(alpha > 0, frame.left.visibility != 255)
    brightness = np.asarray(disparity.convert("RGB")).astype(float).sum(axis=-1)
    assert np.corrcoef(brightness.ravel(), frame.left.disparity.ravel())[0, 1] > 0.9


def test_the_warped_right_image_is_the_left_one(dataset):
    frame = open_dataset(dataset)[0]
    picture = make_picture(frame, 1)
    warped = np.asarray(Image.open(io.BytesIO(b64decode(picture.texts["warped"])))).astype(int)
    left, right, visible = (frame.left.image.astype(int), frame.right.image.astype(int), frame.left.visibility == 255)
    assert np.abs(warped - left)[visible].mean() < np.abs(right - left)[visible].mean() / 2


def test_pictures_are_reduced_until_they_fit(dataset, monkeypatch):
    pairs = open_dataset(dataset)
    read, shown = pairs.__getitem__, spread(len(pairs), 2)
    complete = make_pictures(shown, read)
    assert [picture.step for picture in complete] == [1, 1]
    # Room for pictures of every second pixel, and not for complete ones.
    most = 2 * max(make_picture(read(position), 2).size for position in shown)
    assert sum(picture.size for picture in complete) > most
    monkeypatch.setattr(pictures, "MOST_BYTES", most)
    reduced = make_pictures(shown, read)
    assert {picture.step for picture in reduced} == {2}
    assert sum(picture.size for picture in reduced) <= most


# The page as a file.


def test_the_page_names_nothing_outside_itself(page):
    fetched = re.findall(r"""<[^>]*\s(?:src|href|action|srcset|data)\s*=\s*["']?([^"'\s>]*)""", page)
    assert fetched
    assert [each for each in fetched if not each.startswith(("#", "data:,"))] == []
    assert not re.search(r"url\(|@import|\bfetch\(|XMLHttpRequest|\bimport\(", page)


def test_the_page_says_the_numbers(dataset, measured, page):
    target = read_index(dataset).plan.config.wanted_histogram()
    assert f"{total_variation(target, measured.disparity):.3f}" in page
    assert f"{wasserstein_px(target, measured.disparity):.3g} px" in page
    assert read_index(dataset).plan.config_sha256 in page


def test_words_of_others_stay_words(changed):
    def spoil(index):
        index["splits"]["train"]["photographs"][0]["licence"] = "</script><script>alert(1)</script>{{data}}"
        index["splits"]["train"]["left_out"] = ["<img src=x onerror=alert(2)>"]

    edit_json(changed / "index.json", spoil)
    page = report(changed, pairs=1, sample=1).page
    assert "<script>alert" not in page
    assert "<img src=x" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;{{data}}" in page


def test_the_command_writes_a_page_beside_the_dataset(dataset, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run_report(monkeypatch, capsys, dataset, "--pairs", 1, "--sample", 2, "--split", "train")[0] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["set-report.html"]


def test_the_command_refuses_what_it_cannot_do(dataset, changed, tmp_path, monkeypatch, capsys):
    (changed / "index.json").unlink()
    page = tmp_path / "report.html"
    for arguments, words in (
        ((dataset, "--out", tmp_path / "report.txt"), "--out"),
        ((dataset, "--out", page, "--split", "test"), "split"),
        ((tmp_path / "nowhere",), "nowhere"),
        ((changed, "--out", page), "not finished"),
    ):
        code, _, err = run_report(monkeypatch, capsys, *arguments)
        assert (code, words in err) == (2, True), err
    assert not page.exists()


# The page in a browser.


browser = pytest.fixture(scope="module")(open_browser)


@pytest.fixture
def opened(browser, page, tmp_path):
    """The page, opened from disk, with its first pair shown."""
    path = tmp_path / "report.html"
    path.write_text(page, "utf-8")
    browser.set_window_size(1200, 900)
    browser.get_log("performance")
    browser.get(path.as_uri())
    wait(browser, lambda: attribute(browser, "pair") == "0")
    yield browser
    assert [entry for entry in browser.get_log("browser") if entry["level"] != "DEBUG"] == []


def attribute(browser, name):
    return browser.execute_script(f"return document.getElementById('stage').dataset.{name} ?? null")


def shown_layers(browser):
    script = (
        "return [...document.querySelectorAll('#stage img')].filter((each) => each.style.visibility === 'visible')"
        ".map((each) => each.dataset.image ?? each.dataset.overlay)"
    )
    return browser.execute_script(script)


def point_at(browser, x, y, shape):
    """Move the pointer to a pixel's middle."""
    from selenium.webdriver import ActionChains

    stage = browser.find_element("id", "stage")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", stage)
    box, (height, width) = stage.rect, shape
    right = (x + 0.5) / width * box["width"] - box["width"] / 2
    down = (y + 0.5) / height * box["height"] - box["height"] / 2
    ActionChains(browser, duration=0).move_to_element_with_offset(stage, round(right), round(down)).perform()
    return browser.find_element("id", "readout").text


def test_the_cursor_reads_the_stored_disparity(opened, dataset):
    frame = open_dataset(dataset)[spread(6, 3)[0]]
    height, width = frame.left.disparity.shape
    for x, y in ((0, 0), (width - 1, height - 1), (90, 41), (30, 100)):
        text = point_at(opened, x, y, (height, width))
        assert f"x {x}, y {y}" in text
        disparity = np.float32(re.search(r"disparity (\S+) px", text)[1])
        assert disparity == frame.left.disparity[y, x], (x, y)
        depth = frame.camera.depth_m(float(disparity))
        assert float(re.search(r"depth (\S+) m", text)[1]) == pytest.approx(depth, rel=1e-3)


def test_keys_and_buttons_change_image_overlay_and_pair(opened):
    body = opened.find_element("css selector", "body")
    assert shown_layers(opened) == ["left"]
    opened.find_element("id", "flicker").click()
    for shown in ("right", "left", "right"):
        wait(opened, lambda shown=shown: attribute(opened, "image") == shown)
    opened.find_element("id", "flicker").click()
    for overlay in ("disparity", "masks"):
        body.send_keys("o")
        assert shown_layers(opened) == ["left", overlay]
    opened.find_element("css selector", "[name=image][value=warped]").click()
    assert shown_layers(opened) == ["warped", "masks"]
    body.send_keys("n")
    wait(opened, lambda: attribute(opened, "pair") == "1")


def test_an_undecodable_pair_is_reported(browser, page, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(re.sub(r'(id="pair-0-values">)[^<]{40}', r"\1", page), "utf-8")
    browser.get(path.as_uri())
    wait(browser, lambda: "cannot be read: " in browser.find_element("id", "readout").text)
