"""The report: its numbers compared with independent ones, and its page in a browser."""

import base64
import io
import os
import re
import shutil
import zlib

import numpy as np
import pytest
from PIL import Image
from processes import wait_for
from tiny_datasets import config_of

from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.histogram import total_variation, wasserstein_px
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.judge import pictures
from semisynth_gl.judge.comparison import MeasuredPair, find_outliers
from semisynth_gl.judge.pictures import embed_pair
from semisynth_gl.judge.report import report
from semisynth_gl.seeds.seeds import spread

PAIRS = {"train": 4, "validation": 2}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "set"
    generate(config_of(), folder, PAIRS, 0)
    return folder


@pytest.fixture
def changed(dataset, tmp_path):
    """Copy the dataset, for tests that change it."""
    return shutil.copytree(dataset, tmp_path / "set", symlinks=True)


@pytest.fixture(scope="module")
def made(dataset):
    return report(dataset, pairs=3)


# Measures.


def test_the_histogram_counts_every_pixel(dataset, made):
    files = [pair.left.disparity for pair in open_dataset(dataset)]
    values = np.concatenate([each[np.isfinite(each)] for each in files]).astype(np.float64)
    shares = np.histogram(values, made.disparity.edges_px)[0] / values.size
    np.testing.assert_allclose(made.disparity.shares, shares, atol=1e-12)
    assert made.disparity.mean_px == pytest.approx(values.mean(), abs=0.02)
    target = read_index(dataset).plan.config.wanted_histogram()
    in_bins = np.histogram(np.clip(values, target.edges_px[0], target.edges_px[-1]), target.edges_px)[0] / values.size
    distance = total_variation(target, made.disparity)
    assert distance == pytest.approx(np.abs(in_bins - target.shares).sum() / 2)
    said = f"total variation {distance:.3f}, Wasserstein-1 {wasserstein_px(target, made.disparity):.3g} px"
    assert said in made.page
    assert read_index(dataset).plan.config_sha256 in made.page


def test_pairs_are_named_by_split_and_scene(made):
    names = [f"{split} middlebury-{number:06d}" for split, count in PAIRS.items() for number in range(count)]
    assert [pair.name for pair in made.pairs] == names


def test_an_unreadable_pair_is_named(changed):
    broken = changed / "train" / "MiddEval3" / "trainingF" / "middlebury-000001" / "disp0GT.pfm"
    broken.write_bytes(broken.read_bytes()[:100])
    with pytest.raises(ReadError, match=r"middlebury-000001/disp0GT\.pfm"):
        report(changed)


def test_outliers_are_the_farthest_from_the_median():
    values = [{"jumps": 10.0 + number % 5, "flat": 7.0} for number in range(50)]
    values[17]["jumps"], values[30]["jumps"] = 40.0, -9.0
    del values[31]["jumps"]
    pairs = [MeasuredPair(number, f"pair-{number}", None, each) for number, each in enumerate(values)]
    [outlier] = find_outliers(pairs)
    assert (outlier.pair.position, outlier.measure.key, outlier.value, outlier.typical) == (17, "jumps", 40, 12)
    assert outlier.deviations == pytest.approx(28 / 1.4826)
    values[3]["flat"] = 8.0
    assert [each.pair.position for each in find_outliers(pairs)] == [3, 17]


# Pictures.


def image_of(embedded, name):
    return Image.open(io.BytesIO(base64.b64decode(embedded[name].partition(",")[2])))


@pytest.mark.parametrize("step", [1, 2, 3])
def test_a_reduced_picture_keeps_stored_disparities(dataset, step, monkeypatch):
    frame = open_dataset(dataset)[0]
    monkeypatch.setattr(pictures, "WIDEST_PX", -(-frame.camera.width_px // step))
    embedded = embed_pair(frame)
    assert embedded["step"] == step
    values = np.frombuffer(zlib.decompress(base64.b64decode(embedded["values"])), "<f4")
    grid = np.s_[step // 2 :: step, step // 2 :: step]
    np.testing.assert_array_equal(values, frame.left.disparity[grid].ravel())
    sizes = {image_of(embedded, name).size for name in ("left", "right", "warped", "disparity", "masks")}
    assert sizes == {(embedded["width"], embedded["height"])}


def test_overlays_show_disparity_and_masks(dataset):
    frame = open_dataset(dataset)[0]
    embedded = embed_pair(frame)
    alpha = np.asarray(image_of(embedded, "masks").convert("RGBA"))[..., 3]
    np.testing.assert_array_equal(alpha > 0, frame.left.visibility != 255)
    brightness = np.asarray(image_of(embedded, "disparity").convert("RGB")).astype(float).sum(axis=-1)
    assert np.corrcoef(brightness.ravel(), frame.left.disparity.ravel())[0, 1] > 0.9
    warped = np.asarray(image_of(embedded, "warped")).astype(int)
    left, right, visible = (frame.left.image.astype(int), frame.right.image.astype(int), frame.left.visibility == 255)
    assert np.abs(warped - left)[visible].mean() < np.abs(right - left)[visible].mean() / 2


# The page as a file.


def test_the_page_names_nothing_outside_itself(made):
    fetched = re.findall(r"""<[^>]*\s(?:src|href|action|srcset|data)\s*=\s*["']?([^"'\s>]*)""", made.page)
    assert fetched
    assert [each for each in fetched if not each.startswith(("#", "data:"))] == []
    assert not re.search(r"url\(|@import|\bfetch\(|XMLHttpRequest|\bimport\(", made.page)


def test_words_of_others_stay_words(changed):
    index = changed / "index.json"
    index.write_text(index.read_text().replace('"llvmpipe', '"</script><script>alert(1)</script>{{data}} llvmpipe'))
    page = report(changed, pairs=1, sample=1).page
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;{{data}}" in page


# The page in a browser.


@pytest.fixture(scope="module")
def browser():
    """Start Debian's Chromium. Without it, the tests are skipped, or fail where CI expects a browser."""
    missing = [name for name in ("chromium", "chromedriver") if shutil.which(name) is None]
    if missing:
        fault = f"no {' and no '.join(missing)} here (`make test` installs them)"
        if os.environ.get("SEMISYNTH_GL_EXPECT_BROWSER"):
            pytest.fail(f"a browser was expected here: {fault}")
        pytest.skip(fault)
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    # Containers have no sandbox and little shared memory.
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    yield driver
    driver.quit()


@pytest.fixture
def opened(browser, made, tmp_path):
    """Open the page from disk and wait for its first pair."""
    path = tmp_path / "report.html"
    path.write_text(made.page, "utf-8")
    browser.set_window_size(1200, 900)
    browser.get_log("performance")
    browser.get(path.as_uri())
    wait_for(lambda: attribute(browser, "pair") == "0")
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
        wait_for(lambda shown=shown: attribute(opened, "image") == shown)
    opened.find_element("id", "flicker").click()
    for overlay in ("disparity", "masks"):
        opened.find_element("css selector", f"[name=overlay][value={overlay}]").click()
        assert shown_layers(opened) == ["left", overlay]
    opened.find_element("css selector", "[name=image][value=warped]").click()
    assert shown_layers(opened) == ["warped", "masks"]
    body.send_keys("n")
    wait_for(lambda: attribute(opened, "pair") == "1")
