"""The report: its numbers against independent ones, its page in a browser."""

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
from tiny_datasets import cheap, config_of

from semisynth_gl import oracle
from semisynth_gl.cli import main
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import OCCLUDED
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.histogram import total_variation, wasserstein_px
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.reporting import build, pictures
from semisynth_gl.reporting.measure import QUANTITIES, PairMeasures, find_outliers, measure
from semisynth_gl.reporting.pictures import make_picture, make_pictures, pack_floats
from semisynth_gl.reporting.plots import Bars, count_bars, draw_histogram
from semisynth_gl.reporting.rays import diameters_px, surfaces_at
from semisynth_gl.reporting.redraws import read_redraws
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import make_scene
from semisynth_gl.seeds.spread import spread

PAIRS = {"train": 4, "validation": 2}
CAMERA = StereoCamera.centred(200, 100, 150.0, 0.1)


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
    return measure(pairs, range(len(pairs)), {})


@pytest.fixture(scope="module")
def page(dataset):
    return build.report(dataset, pairs=3, sample=200).page


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


def one_face(matrix, scale, uv=((0, 0), (1, 0), (1, 1), (0, 1))):
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    mesh = make_mesh("square", corners, uv, [[0, 1, 2], [0, 2, 3]])
    return make_scene(CAMERA, model=[0], world_from_model=matrix, layer=[0], uv_scale=scale), (mesh,)


def grid():
    x, y = np.meshgrid(np.linspace(5, 190, 9), np.linspace(5, 90, 7))
    return x.ravel(), y.ravel()


def test_density_is_what_neighbouring_rays_find_and_slant_that_of_the_plane():
    x, y = grid()
    # Stretched, sheared UV on a face turned about two axes: no closed form helps here.
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] = (9, 1, -2), (-1, 8, 3), (-4, -4, 4)
    scene, models = one_face(matrix, (3.0, 7.0), uv=((0, 0), (1, 0.3), (1.5, 1.2), (0.5, 0.9)))
    hits = cast_rays(scene, models, "left", x, y)
    hit = hits.instance == 0

    def texels(x_px, y_px):
        depth = oracle.depth_on_planes(scene, models, "left", x_px, y_px, hits)
        points = CAMERA.rays("left", x_px, y_px) * depth[:, None]
        along = (points - matrix[:3, 3]) @ np.linalg.pinv(matrix[:3, :2]).T
        return 16 * (along @ np.array([[1, 0.3], [0.5, 0.9]])) * (3.0, 7.0)

    step = 1e-4
    dx = (texels(x + step, y) - texels(x - step, y)) / (2 * step)
    dy = (texels(x, y + step) - texels(x, y - step)) / (2 * step)
    expected = np.sqrt(np.abs(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0]))
    slants_deg, measured = surfaces_at(scene, models, np.full(len(scene), 16), x, y, hits)
    np.testing.assert_allclose(measured[hit], expected[hit], rtol=1e-5)
    rays, normal = CAMERA.rays("left", x, y), np.cross(matrix[:3, 0], matrix[:3, 1])
    towards = np.abs(rays @ normal) / np.linalg.norm(rays, axis=1) / np.linalg.norm(normal)
    np.testing.assert_allclose(slants_deg[hit], np.rad2deg(np.arccos(towards))[hit], atol=1e-6)
    assert np.isnan([measured[~hit], slants_deg[~hit]]).all()
    assert hit.sum() > 20


def test_size_is_the_bounding_spheres_diameter_before_stretching(square):
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn * [0.2, 0.5, 0.1]
    matrix[:3, 3] = 0.3, 0.1, 2.0
    scene = make_scene(CAMERA, model=[0], world_from_model=matrix, layer=[0])
    # The square's farthest corner is sqrt(2) from its origin.
    expected = 2 * 150 * 0.5 * np.sqrt(2) / 2.0
    np.testing.assert_allclose(diameters_px(scene, (square,), np.array([0])), [expected], rtol=1e-6)


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


def test_rays_find_what_the_files_and_the_config_say(dataset, measured):
    rays = measured.rays
    assert measured.ray_faults == {}
    assert rays.pairs == len(measured.pairs)
    assert rays.agreeing > 0.99 * rays.cast
    assert rays.slant_deg.min() >= 0
    assert rays.slant_deg.max() <= 90
    config = read_index(dataset).plan.config.model_dump(mode="json")
    low, high = config["particles"]["size_px"]
    # A model that drifts away from its path's middle looks a little smaller or larger.
    assert low * 0.8 < rays.diameter_px.min()
    assert rays.diameter_px.max() < high * 1.25
    # Slant adds texels to what a surface that faces the camera has.
    low, high = config["textures"]["texels_per_pixel"]
    assert low * 0.6 < np.quantile(rays.texels_per_pixel, 0.02)
    assert low < np.median(rays.texels_per_pixel) < 2 * high
    camera = open_dataset(dataset)[0].camera
    assert measured.depth_m.min() > camera.focal_baseline / (config["disparity"]["max_px"] * 3 + camera.doffs_px)


@pytest.mark.filterwarnings("error")
def test_depths_are_those_of_the_rig_however_it_deviates(tmp_path):
    """Of surfaces before a sky, which has none."""
    config = cheap(
        rig={"focal_ratio": 1.1, "right_roll_deg": 1},
        outputs=["depth", "sky"],
        camera={"doffs_px": 8},
        disparity={"signed": True},
        background={"plane": 1, "cuboid": 0, "sky": 1},
    )
    generate(config, tmp_path / "set", 3)
    dataset = open_dataset(tmp_path / "set")
    measured = measure(dataset, range(3), {})
    assert measured.ray_faults == {}
    stored = np.concatenate([pair.left.depth[np.isfinite(pair.left.depth)] for pair in dataset])
    assert np.isfinite(measured.depth_m).all()
    tenths = (0.1, 0.5, 0.9)
    np.testing.assert_allclose(np.quantile(measured.depth_m, tenths), np.quantile(stored, tenths), rtol=0.2)


def test_scenes_that_are_others_are_left_out_with_the_reason(changed):
    path = changed / "train" / "MiddEval3" / "trainingF" / "middlebury-000001" / "pair.json"
    edit_json(path, lambda pair: pair["camera"].update(focal_px=99.0))
    measurement = measure(open_dataset(changed), [0, 1], {})
    assert [*measurement.ray_faults.values()] == [1]
    assert (measurement.rays.pairs, len(measurement.pairs)) == (1, 2)


def test_scenes_of_other_sizes_do_not_pass_for_these(changed):
    def larger(index):
        index["config_values"]["particles"]["size_px"] = [60.0, 70.0]

    edit_json(changed / "index.json", larger)
    assert [*measure(open_dataset(changed), [0, 1], {}).ray_faults.values()] == [2]


def test_keys_of_another_version_are_passed_over(changed):
    edit_json(changed / "index.json", lambda index: index["config_values"].update(of_the_future=1))
    report = build.report(changed, pairs=2, sample=2)
    assert report.measurement.target is not None
    assert report.measurement.ray_faults == {}


def test_an_unreadable_pair_is_reported(changed):
    broken = changed / "train" / "MiddEval3" / "trainingF" / "middlebury-000001" / "disp0GT.pfm"
    broken.write_bytes(broken.read_bytes()[:100])
    report = build.report(changed, pairs=1, sample=6)
    assert len(report.measurement.pairs) == 5
    assert "disp0GT.pfm" in report.page
    shutil.rmtree(changed / "train" / "MiddEval3" / "trainingF")
    with pytest.raises(InputError, match="no pair could be read"):
        build.report(changed, pairs=1, sample=6, split="train")


@pytest.mark.parametrize("layout", ["webdataset", "kitti"])
def test_other_layouts_can_be_reported(layout, tmp_path):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    generate(config_of(), tmp_path / "set", 2, 0, layout=layout, shard_pairs=1)
    report = build.report(tmp_path / "set", pairs=1, sample=1)
    assert report.measurement.ray_faults == {}
    assert report.measurement.rays.pairs == 1
    assert report.shown == 1


def test_a_dataset_at_an_address_can_be_reported(dataset, page):
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    memory.put(str(dataset), "/bucket/far-away", recursive=True)
    try:
        assert build.report("memory://bucket/far-away", pairs=3, sample=200).page == page
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
    assert [(fault.name, fault.attempts) for fault in redraws.faults] == [("too dark", 2), ("too little texture", 1)]
    assert read_redraws(read_index(changed), "validation").attempts == 0
    # Pair 0 is not in the sample of one.
    report = build.report(changed, pairs=0, sample=1)
    assert "too little texture" in report.page
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
    bars = count_bars(np.r_[np.arange(100), np.nan])
    np.testing.assert_allclose(bars.shares, 0.05)
    np.testing.assert_allclose(bars.edges, np.linspace(0, 99, 21))
    assert count_bars([5.0, 5.0]).shares.sum() == 1
    logarithmic = count_bars([0.0, 1, 10, 256], log=True)
    np.testing.assert_allclose(logarithmic.edges, 2.0 ** np.arange(9))
    np.testing.assert_allclose(logarithmic.shares, np.array([1, 0, 0, 1, 0, 0, 0, 1]) / 3)


def test_the_heights_of_bars_are_the_shares():
    svg = draw_histogram("name", Bars(np.arange(5.0), np.array([0.5, 0.25, 0.0, 0.25])), "px")
    bars = [group for group in ET.fromstring(svg).iter() if group.get("class") == "bar"]  # noqa: S314 - its own
    levels = [[float(y) for y in re.findall(r"[\d.]+ ([\d.]+)", bar.find("{*}path").get("d"))] for bar in bars]
    heights = [max(level) - min(level) for level in levels]
    np.testing.assert_allclose(heights, np.array([1, 0.5, 0.5]) * heights[0], atol=0.01)


def unpacked(data, height, width):
    """The page's decoder, once more."""
    planes = np.frombuffer(zlib.decompress(data), np.uint8).reshape(4, -1)
    differences = np.ascontiguousarray(planes.T).view("<u4").reshape(height, width)
    return np.cumsum(differences, axis=1, dtype=np.uint32).view(np.float32)


def test_packed_floats_come_back_bit_for_bit():
    values = np.random.default_rng(0).normal(50, 20, (7, 11)).astype(np.float32)
    values[2, 3], values[4, 0], values[6, 10] = np.inf, np.nan, -0.0
    restored = unpacked(pack_floats(values), 7, 11)
    np.testing.assert_array_equal(restored.view(np.uint32), values.view(np.uint32))


@pytest.mark.parametrize("step", [1, 2, 3])
def test_a_reduced_picture_keeps_stored_disparities(dataset, step):
    frame = open_dataset(dataset)[0]
    picture = make_picture(frame, step)
    disparity = unpacked(b64decode(picture.disparity), picture.height_px, picture.width_px)
    np.testing.assert_array_equal(disparity, frame.left.disparity[step // 2 :: step, step // 2 :: step])
    mask = np.frombuffer(zlib.decompress(b64decode(picture.visibility)), np.uint8)
    np.testing.assert_array_equal(mask, frame.left.visibility[step // 2 :: step, step // 2 :: step].ravel())
    assert b64decode(picture.left)[:2] == b64decode(picture.right)[:2] == b"\xff\xd8"


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
    for value in (f"{np.median(measured.rays.texels_per_pixel):.2f}", read_index(dataset).plan.config_sha256):
        assert value in page


def test_words_of_others_stay_words(changed):
    def spoil(index):
        index["splits"]["train"]["photographs"][0]["licence"] = "</script><script>alert(1)</script>{{data}}"
        index["splits"]["train"]["left_out"] = ["<img src=x onerror=alert(2)>"]

    edit_json(changed / "index.json", spoil)
    page = build.report(changed, pairs=1, sample=1).page
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


def element(browser, name):
    return browser.find_element("id", name)


def attribute(browser, name):
    return browser.execute_script(f"return document.getElementById('stage').dataset.{name} ?? null")


def pixels(browser, canvas="base"):
    """What a canvas shows, (H, W, 4) uint8."""
    data, width, height = browser.execute_script(
        "const c = document.getElementById(arguments[0]);"
        "const copy = Object.assign(document.createElement('canvas'), {width: c.width, height: c.height});"
        "const context = copy.getContext('2d', {willReadFrequently: true});"
        "context.drawImage(c, 0, 0);"
        "const d = context.getImageData(0, 0, c.width, c.height).data;"
        "let text = ''; for (const value of d) text += String.fromCharCode(value);"
        "return [btoa(text), c.width, c.height];",
        canvas,
    )
    return np.frombuffer(b64decode(data), np.uint8).reshape(height, width, 4)


def point_at(browser, x, y):
    """Move the pointer to a pixel's middle."""
    from selenium.webdriver import ActionChains

    stage, shape = element(browser, "stage"), pixels(browser).shape
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", stage)
    box = stage.rect
    right = (x + 0.5) / shape[1] * box["width"] - box["width"] / 2
    down = (y + 0.5) / shape[0] * box["height"] - box["height"] / 2
    ActionChains(browser, duration=0).move_to_element_with_offset(stage, round(right), round(down)).perform()
    return element(browser, "readout").text


def shown_frame(dataset, number=0):
    return open_dataset(dataset)[spread(6, 3)[number]]


def test_the_page_opens_from_disk_without_the_network(opened):
    messages = [json.loads(entry["message"])["message"] for entry in opened.get_log("performance")]
    sent = [each["params"]["request"]["url"] for each in messages if each["method"] == "Network.requestWillBeSent"]
    assert [url.partition(":")[0] for url in sent if not url.startswith("data:")] == ["file"]


def test_the_cursor_reads_the_stored_disparity(opened, dataset):
    frame = shown_frame(dataset)
    words = {255: "visible in", 128: "hidden in", 0: "outside"}
    height, width = frame.left.disparity.shape
    for x, y in ((0, 0), (width - 1, height - 1), (90, 41), (30, 100)):
        text = point_at(opened, x, y)
        assert f"x {x}, y {y}" in text
        disparity = np.float32(re.search(r"disparity (\S+) px", text)[1])
        assert disparity == frame.left.disparity[y, x], (x, y)
        depth = frame.camera.depth_m(float(disparity))
        assert float(re.search(r"depth (\S+) m", text)[1]) == pytest.approx(depth, rel=1e-3)
        assert words[frame.left.visibility[y, x]] in text


def test_the_keyboard_moves_the_cursor_and_the_pair(opened, dataset):
    from selenium.webdriver import Keys

    stage = element(opened, "stage")
    frame = shown_frame(dataset)
    height, width = frame.left.disparity.shape
    stage.send_keys(Keys.ARROW_RIGHT, Keys.SHIFT, Keys.ARROW_DOWN)
    text = element(opened, "readout").text
    assert f"x {width // 2 + 1}, y {height // 2 + 10}" in text
    stage.send_keys("n")
    wait(opened, lambda: attribute(opened, "pair") == "1")
    disparity = np.float32(re.search(r"disparity (\S+) px", element(opened, "readout").text)[1])
    assert disparity == shown_frame(dataset, 1).left.disparity[height // 2 + 10, width // 2 + 1]


def test_flicker_and_hold_change_the_image(opened, dataset):
    from selenium.webdriver import ActionChains

    left, frame = pixels(opened), shown_frame(dataset)
    # JPEG, but nothing else: it is the left image, and not the right one.
    assert np.abs(left[..., :3].astype(int) - frame.left.image).mean() < 8
    element(opened, "flicker").click()
    for shown in ("right", "left", "right"):
        wait(opened, lambda shown=shown: attribute(opened, "image") == shown)
    element(opened, "flicker").click()
    np.testing.assert_array_equal(pixels(opened), left)
    button = element(opened, "hold")
    ActionChains(opened).click_and_hold(button).perform()
    held = pixels(opened)
    assert attribute(opened, "image") == "right"
    assert np.abs(held[..., :3].astype(int) - frame.right.image).mean() < 8
    assert np.abs(held.astype(int) - left).mean() > 8
    ActionChains(opened).release().perform()
    assert attribute(opened, "image") == "left"


def test_the_warped_right_image_is_the_left_one(opened, dataset):
    left = pixels(opened)[..., :3].astype(int)
    opened.find_element("css selector", "[name=image][value=warped]").click()
    warped = pixels(opened)[..., :3].astype(int)
    visible = shown_frame(dataset).left.visibility == 255
    right = np.asarray(shown_frame(dataset).right.image, int)
    assert np.abs(warped - left)[visible].mean() < np.abs(right - left)[visible].mean() / 2
    hidden = shown_frame(dataset).left.visibility != 255
    assert (warped[hidden] == 119).all()


def test_overlays_show_disparity_and_masks(opened, dataset):
    frame = shown_frame(dataset)
    assert not pixels(opened, "overlay").any()
    opened.find_element("css selector", "[name=overlay][value=occlusion]").click()
    alpha = pixels(opened, "overlay")[..., 3]
    np.testing.assert_array_equal(alpha > 0, frame.left.visibility != 255)
    opened.find_element("css selector", "[name=overlay][value=disparity]").click()
    colours = pixels(opened, "overlay")
    assert (colours[..., 3] > 0).all()
    brightness = colours[..., :3].astype(float).sum(axis=-1)
    assert np.corrcoef(brightness.ravel(), frame.left.disparity.ravel())[0, 1] > 0.9
    low, high = (float(re.search(r"[\d.]+", element(opened, f"scale-{end}").text)[0]) for end in ("low", "high"))
    np.testing.assert_allclose([low, high], np.quantile(frame.left.disparity, [0.01, 0.99]), atol=0.051)
    opened.find_element("css selector", "[name=overlay][value=invalid]").click()
    assert not pixels(opened, "overlay").any()


def test_an_undecodable_pair_is_reported(browser, page, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(re.sub(r'(id="pair-1-disparity">)[^<]{40}', r"\1", page), "utf-8")
    browser.get(path.as_uri())
    wait(browser, lambda: attribute(browser, "pair") == "0")
    browser.find_elements("css selector", "#strip button")[1].click()
    wait(browser, lambda: "cannot be shown: " in element(browser, "caption").text)
    assert not pixels(browser).any()
    browser.find_element("css selector", "body").send_keys("n")
    wait(browser, lambda: attribute(browser, "pair") == "2")
    assert pixels(browser).any()
    assert [entry for entry in browser.get_log("browser") if entry["level"] != "DEBUG"] == []
