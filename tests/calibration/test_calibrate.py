"""From a rig's calibration to a config: scale, photographs, recipes, the written YAML, and messages."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_files import CAMERA, MIDDLEBURY, draft, plain_rig
from config_texts import parse_config
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from photograph_like import noise, save
from PIL import Image
from processes import assert_refused
from skimage.data import stereo_motorcycle

from semisynth_gl.calibration.calibrate import calibrate
from semisynth_gl.calibration.disparity_range import chosen_range, disparity_range, measured_range
from semisynth_gl.calibration.draft import describe, is_outdoors
from semisynth_gl.calibration.rig import RectifiedRig
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.config import Range, load_config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.histogram import Histogram, count_pixels, total_variation
from semisynth_gl.scene.mix import RecipeMixSampler
from semisynth_gl.scene.sources import prepare_sources
from semisynth_gl.seeds.splits import Split


def write(folder, name, text):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def photographs(folder, count=1, size=(741, 500), channels=3):
    for number in range(count):
        pixels = noise(size[1], size[0], number)[..., :channels]
        save(folder, **{f"photo{number}": np.repeat(pixels, 3 // channels, 2)})
    return folder


@pytest.mark.parametrize(("ratio", "written"), [(1.0, None), (1 + 9e-7, None), (1 - 2e-6, 1 - 2e-6), (1.2, 1.2)])
def test_a_config_gets_both_focal_lengths_unless_they_differ_by_rounding(ratio, written):
    camera = parse_config(
        draft(RectifiedRig(replace(CAMERA, fy_over_fx=ratio), "x"), chosen_range(2, 60)).text()
    ).camera
    assert camera.fy_over_fx == pytest.approx(written or 1.0, rel=1e-9, abs=0)
    assert camera.focal_px == Range(994.978, 994.978)


@pytest.mark.parametrize("channels", [1, 3])
def test_grey_photographs_make_grey_cameras(tmp_path, channels):
    folder = photographs(tmp_path / "photos", 2, (300, 280), channels=channels)
    (folder / "broken.png").write_bytes((folder / "photo0.png").read_bytes()[:3000])
    rig = {"focal_px": 300, "baseline_m": 0.1, "size": (300, 280), "range_px": (3, 30)}
    made = calibrate(folder, **rig, trials=0)
    assert made.config.camera.colour == {1: "grey", 3: "rgb"}[channels]
    assert [note for note in made.notes if "broken.png" in note and note.startswith("not usable")]
    assert parse_config(made.text) == made.config


def test_far_pixels_make_a_scene_an_outdoor_one():
    for ends, outdoors in {(30, 40): False, (1, 4): True, (18, 62): True, (1, 2): False}.items():
        found = measured_range(Histogram.from_counts(ends, [1.0]))
        assert is_outdoors(plain_rig(1000, 0.4, 640, 480), found) == outdoors, ends  # 20 m is 20 px


def test_every_kind_of_scene_has_recipes_that_a_config_takes():
    found = measured_range(Histogram.from_counts((19.4, 62), [1.0]))
    for baseline_m, kind in ((0.1, "room"), (4, "street")):
        recipes = parse_config(draft(plain_rig(1000, baseline_m, 640, 480), found).text()).recipes()
        assert sum(recipe.share for recipe in recipes) == pytest.approx(1)
        shown = {name for name in ("room", "street") if any(getattr(each.config.background, name) for each in recipes)}
        assert shown == {kind}
        assert (recipes[-1].name, recipes[-1].config.particles.layers) == ("clutter", None)


@settings(max_examples=4)
@given(
    most_px=st.floats(-0.3, 2.84).map(lambda power: 10**power),
    width=st.floats(-2, -0.005).map(lambda power: 10**power),
    size=st.sampled_from([(320, 240), (1242, 375), (1280, 1024)]),
    view=st.floats(0.4, 3),
    baseline_m=st.floats(0.01, 1),
)
def test_scenes_of_any_range_meet_their_target(tmp_path_factory, most_px, width, size, view, baseline_m):
    assume(most_px * (1 - width) < size[0])
    folder = photographs(tmp_path_factory.mktemp("photos"), size=(300, 300))
    made = calibrate(
        folder,
        focal_px=view * size[0],
        baseline_m=baseline_m,
        size=size,
        range_px=(most_px * (1 - width), most_px),
        other_camera=True,
        trials=0,
    )
    textures = {"source": "procedural", "images": [], "max_patches": 8, "large_px": 0}
    config = load_config(write(folder, "config.yaml", made.text), {"textures": textures, "models.variants": 1})
    sources = prepare_sources(config, Split(0))
    mix = RecipeMixSampler(config, 0, sources.libraries, sources.atlas.patches)
    # Wide ranges outdoors reach 0.17.
    assert total_variation(mix.expected(), config.shown_histogram()) < 0.25
    for index in range(len(mix.recipes)):
        assert len(mix.sample(index).scene) > 0


def test_a_table_top_becomes_a_dataset_that_verifies(tmp_path, program):
    # Enlarge the noise: in photographs, detail is not as fine as a pixel.
    for path in photographs(tmp_path / "photos", 2, size=(320, 300)).iterdir():
        Image.open(path).resize((107, 100)).resize((320, 300)).save(path)
    (tmp_path / "maps").mkdir()
    for number, near in enumerate((57, 62)):
        disparity = np.tile(np.where(np.arange(160) < 70, 50, near).astype(np.float32), (128, 1))
        (tmp_path / f"maps/{number}.pfm").write_bytes(PFM.encode(disparity))
    given = ("calibrate", "--images", "photos", "--other-camera", "--out", "table.yaml")
    rig = ("--focal-px", 500, "--baseline-m", 0.05, "--size", "160x128", "--disparity", "maps", "--trials", 1)
    code, out, _ = program(*given, *rig)
    assert code == 0
    config = load_config(tmp_path / "table.yaml")
    assert config.textures.large_px == 256
    # Maps of two surfaces with one jump per row need hardly any clutter.
    shares = {recipe.name: recipe.share for recipe in config.recipes()}
    assert shares["clutter"] == pytest.approx(0.05)
    assert f"{shares['clutter']:.0%} clutter" in out
    assert program("generate", "--config", "table.yaml", "--out", "table", "--pairs", 5)[0] == 0
    assert program("verify", "table", "--oracle")[0] == 0


@settings(max_examples=25)
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
    rig = RectifiedRig(StereoCamera.centred(30, 20, 40.0, 0.1), str(photograph))
    found = describe(name, rig, [str(photograph)], disparity_range(rig, range_px=(1, 10)), [rig.size])
    config = load_config(write(folder, "config.yaml", found.text()))
    assert config.textures.images == (str(photograph),)


def test_a_real_pair_becomes_a_config(program, tmp_path, monkeypatch):
    left, _, disparity = stereo_motorcycle()
    (tmp_path / "photos").mkdir()
    Image.fromarray(left).save(tmp_path / "photos/im0.png")
    (tmp_path / "disp0.pfm").write_bytes(PFM.encode(np.asarray(disparity, np.float32)))
    write(tmp_path, "calib.txt", MIDDLEBURY)
    given = ("calibrate", "--trials", 0, "--images", "photos", "--calib", "calib.txt", "--disparity", "disp0.pfm")
    given = (*given, "--out", "my rig.yaml")
    code, out, err = program(*given)
    assert (code, err) == (0, "")
    generate = "generate --config 'my rig.yaml' --out data/my-rig"
    for said in ("67.7 px with a margin, mean 34.", "1.94 to 4.95 m", "1, which give 6 patches", generate):
        assert said in out
    monkeypatch.chdir("/")  # paths are absolute
    config = load_config(tmp_path / "my rig.yaml")
    camera = config.camera
    assert (camera.width_px, camera.height_px, camera.focal_px) == (741, 500, Range(994.978, 994.978))
    assert camera.doffs_px.low == pytest.approx(31.086)
    assert config.textures.images == (str(tmp_path / "photos"),)
    target = config.disparity.target
    edges = target.first_px + np.arange(len(target.shares) + 1) * target.bin_px
    truth = Histogram.from_counts(edges, count_pixels(disparity, edges))
    np.testing.assert_allclose(truth.shares, target.shares, atol=2e-3)
    assert config.disparity.min_px == pytest.approx(np.quantile(disparity[np.isfinite(disparity)], 0.001), abs=0.15)

    assert_refused(program(*given), "exists already")
    assert program(*given, "--overwrite")[0] == 0


def test_values_in_wrong_units_are_noted(tmp_path):
    rig = {"focal_px": 300, "baseline_m": 0.1, "size": (300, 280), "range_px": (3, 30), "trials": 0}
    folder = photographs(tmp_path, size=(300, 280))
    for values, option in (
        ({"focal_px": 4}, "--focal-px is in pixels"),
        ({"range_px": (3, 301)}, "exceeds the width: --baseline-m and --range-m are in metres"),
        ({"range_px": None, "range_m": (800, 4000)}, "--range-m are in metres"),
        ({"baseline_m": 1e-4}, "smallest distance is 0.001 m: --baseline-m"),
    ):
        assert option in calibrate(folder, **rig | values).notes[0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--focal-px 700", ["--baseline-m: missing"]),
        ("--focal-px 700 --baseline-m 0.1 --size 741", ["--size 741", "1280x720"]),
        ("--focal-px 700 --baseline-m 0.1 --size 741x500", ["--range-px: missing", "disparity maps"]),
        ("--calib calib.txt --range-px 1e-9 2e-9", ["expected ends that differ by 2.2e-05"]),
        ("--calib calib.txt --range-px 1 1e300", ["both below 1e+06 px"]),
        ("--calib calib.txt --range-px 1 4 --disparity x.pfm", ["--disparity: expected only one of"]),
        ("--calib calib.txt --range-m 4 1", ["--range-m: ", "the nearer one first"]),
        ("--calib calib.txt --scale 0.5", ["--images: ", "of 371 x 250", "--scale 1;", "--other-camera"]),
        ("--calib square.txt", ["they have 741 x 500. If a different camera"]),
        ("--focal-px 700 --baseline-m 0.1 --size 741x500 --unit mm", ["--unit: it needs calibration files"]),
        ("--focal-px 700 --baseline-m 0.1 --size 741x500 --calib-keys K1=k", ["--calib-keys: it needs"]),
        ("--calib calib.txt --alpha 1", ["--alpha: calib.txt has rectified cameras"]),
        ("--calib calib.txt --pair a", ["--pair: expected two"]),
        ("--calib calib.txt --range-px 1 4 --images flat", ["no patch can be cut"]),
    ],
)
def test_wrong_input_writes_nothing(program, tmp_path, arguments, words):
    photographs(tmp_path / "photos")
    (tmp_path / "flat").mkdir()
    Image.new("RGB", (741, 500)).save(tmp_path / "flat/a.png")
    write(tmp_path, "calib.txt", MIDDLEBURY)
    write(tmp_path, "square.txt", MIDDLEBURY.replace("width=741", "width=500"))
    images = () if "--images" in arguments else ("--images", "photos")
    assert_refused(program("calibrate", *images, "--out", "a.yaml", *arguments.split()), *words)
    assert not list(tmp_path.glob("*.yaml"))


@pytest.mark.parametrize("value", ["1e300", "inf", "nan", "-1e300"])
def test_numbers_of_no_rig_are_refused(program, tmp_path, value):
    photographs(tmp_path / "photos", size=(40, 30))
    rig = ("--focal-px", 70, "--baseline-m", 0.1, "--size", "40x30")
    for option in ("--focal-px", "--baseline-m", "--scale", "--png-scale", "--alpha", "--range-px 1", "--range-m 1"):
        reach = ("--range-px", 1, 9) if option != "--range-m 1" else ()
        given = ("--images", "photos", *rig, *reach, "--trials", 0, "--out", "a.yaml", *option.split(), value)
        said = "the range of disparity is 1 to" if option == "--range-px 1" else option.split()[0]
        assert_refused(program("calibrate", *given), said)
