"""Calibrations of cameras before rectification, and photographs as these take them, beside OpenCV's rectification."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from calibration_files import D1, D2, IMAGE, K1, K2, RAW, SIZE, R, T, projections, write_storage
from click.testing import CliRunner
from config_texts import parse_config
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from semisynth_gl.calibration.calibrate import calibrate
from semisynth_gl.cli.calibrate import calibrate as command
from semisynth_gl.config.load import load_config
from semisynth_gl.frame.raw_camera import RawCamera, rotation_of, vector_of
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs.pipeline import render_pair
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.borders import black_border
from semisynth_gl.textures.images import read_image
from semisynth_gl.textures.prepare import prepare_atlas
from semisynth_gl.textures.subjects import is_right

cv2 = pytest.importorskip("cv2", reason="OpenCV, the extra opencv, is not installed")


@given(st.tuples(*[st.floats(-1.7, 1.7)] * 3))
def test_a_rotation_vector_comes_back(vector):
    np.testing.assert_allclose(vector_of(rotation_of(vector)), vector, atol=1e-9)


def test_a_reduced_rig_sees_the_same_directions():
    raw = RawCamera(320, 240, 260.0, 261.0, 161.0, 118.0, "radial-tangential", tuple(D1), rotation_of((0.01, 0.02, 0)))
    half, pinhole = raw.scaled(0.5), np.array([[250.0, 0, 160], [0, 250, 120], [0, 0, 1]])
    x, y = np.meshgrid(np.arange(0.0, 160), np.arange(0.0, 120))
    seen, whole = half.rectified(pinhole, x, y), raw.rectified(pinhole, (x + 0.5) * 2 - 0.5, (y + 0.5) * 2 - 0.5)
    np.testing.assert_allclose(seen, whole, atol=1e-9)
    assert (half.width_px, half.height_px) == (160, 120)


@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("a/right/0001.png", True),
        ("mav0/cam1/data/14.png", True),
        ("right/left_3.png", False),
        ("scene_R.png", True),
        ("bright/moor.png", False),
        ("R0010123.JPG", False),
        ("image_3/000017_10.png", True),
        ("image_2/000017_10.png", False),
        ("Adirondack/im1.png", True),
    ],
)
def test_names_tell_right_views(name, right):
    assert is_right(Path(name)) == right


# --- photographs ---


@pytest.fixture
def place(tmp_path):
    """Twelve raw photographs of noise, none of it black, and a calibration whose rectified images keep all of them."""
    rng = np.random.default_rng(0)
    folder = tmp_path / "photos"
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        for number in range(6):
            noise = rng.integers(0, 256, (*SIZE[::-1], 3), dtype=np.uint8)
            image = np.clip(cv2.GaussianBlur(noise, (0, 0), 1.0).astype(int) * 3 - 250, 60, 255).astype(np.uint8)
            Image.fromarray(image).save(folder / side / f"{number:02}.png")
    stored(tmp_path / "stereo.yml", RAW | projections(alpha=1))
    return tmp_path


def stored(path, values):
    return write_storage(path, values | IMAGE)


def made(place, **arguments):
    settings = {"calib": place / "stereo.yml", "range_px": (2, 40), "trials": 0} | arguments
    return calibrate(place / "photos", **({"rectify_to": place / "rectified"} | settings))


def opencvs(place, side):
    """The rectified photographs of one eye as a user's program makes them."""
    values = projections(alpha=1)
    matrix, distortion, number = (K1, D1, "1") if side == "left" else (K2, D2, "2")
    maps = cv2.initUndistortRectifyMap(
        matrix, distortion, values[f"R{number}"], values[f"P{number}"], SIZE, cv2.CV_32FC1
    )
    for path in sorted((place / "photos" / side).iterdir()):
        yield place / "rectified" / side / path.name, cv2.remap(read_image(path), *maps, cv2.INTER_LINEAR)


def test_raw_photographs_become_a_dataset_with_their_borders(place):
    calibration = made(place)
    config = parse_config(calibration.text)
    assert config == calibration.config
    frame = render_pair(config, 0)
    for side in ("left", "right"):
        valid = frame.view(side).valid == 255
        for path, image in opencvs(place, side):
            # OpenCV's maps of single precision, from a rotation that went through a vector of ten digits.
            assert np.abs(read_image(path).astype(int) - image).max() <= 1
            border = black_border(image)
            assert border.mean() > 0.05
            assert not (border & valid).any()
            # What is left is mixed from pixels inside and outside, in a ring up to two pixels wide.
            ring = cv2.dilate(border.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
            assert (~valid & ~border & ~ring).mean() < 1e-4
        drawn = frame.view(side).image
        assert drawn[border].max() < 20
    assert "photographs      12 of 6 subjects" in "\n".join(calibration.summary)
    assert any(line.startswith("lens ") and "borders" in line for line in calibration.summary)


def test_alpha_makes_the_borders_of_photographs_and_dataset(place):
    stored(place / "stereo.yml", RAW)
    for alpha, least, most in ((0, 0, 1e-3), (1, 0.05, 0.5)):
        config = made(place, alpha=alpha, rectify_to=place / f"at {alpha}").config
        border = (render_pair(config, 0).left.valid != 255).mean()
        photograph = black_border(read_image(place / f"at {alpha}" / "left" / "00.png")).mean()
        assert least <= border <= most
        assert abs(border - photograph) < 0.03


def test_patches_keep_clear_of_borders(place):
    config = made(place).config

    atlas = prepare_atlas(config.textures, Split(0))
    assert len(atlas.patches) > 10
    for layers in (atlas.layers, atlas.large_layers):
        assert len(layers)
        assert layers[..., :3].min() > 30


def test_the_command_rectifies_twice_alike(place):
    arguments = ["--images", place / "photos", "--calib", place / "stereo.yml", "--rectify-to", place / "rectified"]
    arguments += ["--range-px", 2, 40, "--trials", 0, "--overwrite", "--out", place / "rig.yaml"]
    texts = []
    for _ in range(2):
        result = CliRunner().invoke(command, list(map(str, arguments)), catch_exceptions=False)
        assert result.exit_code == 0, result.output
        assert f"report data/rig --images {place / 'rectified'}" in result.output
        texts.append((place / "rig.yaml").read_text())
    assert texts[0] == texts[1]
    assert load_config(place / "rig.yaml").textures.images == (str(place / "rectified"),)


def test_wrong_photographs_are_refused_before_anything_is_written(place):
    with pytest.raises(InputError, match="lies among the photographs"):
        calibrate(place / "photos", calib=place / "stereo.yml", rectify_to=place / "photos" / "out", range_px=(2, 40))
    with pytest.raises(InputError, match="other_camera is set"):
        made(place, other_camera=True)
    stored(place / "only-p.yml", projections())
    with pytest.raises(InputError, match="its cameras before rectification"):
        made(place, calib=place / "only-p.yml")
    with pytest.raises(InputError, match=r"raw images have 320 x 240, but of 12 photographs none.*640 x 480"):
        made(place, scale=0.5)
    for sources in (str(place / "photos" / "*" / "0*.png"), sorted((place / "photos" / "left").iterdir())):
        top = place / "photos" if isinstance(sources, str) else place / "photos" / "left"
        with pytest.raises(InputError, match=r"with other pixels|lies among the photographs"):
            calibrate(sources, calib=place / "stereo.yml", rectify_to=top, range_px=(2, 40), trials=0)
    Image.new("RGB", SIZE).save(place / "photos" / "left" / "00.jpg")
    with pytest.raises(InputError, match="differ only in the endings"):
        made(place)
    (place / "photos" / "left" / "00.jpg").unlink()
    assert not (place / "rectified").exists()
    (place / "rectified").write_text("")
    with pytest.raises(InputError, match="holds other images: name a new folder"):
        made(place)
    (place / "rectified").unlink()
    (place / "rectified").mkdir()
    Image.new("RGB", SIZE).save(place / "rectified" / "holiday.png")
    with pytest.raises(InputError, match="holds other images"):
        made(place)


def test_photographs_below_another_folder_and_turned_ones(place, monkeypatch):
    Image.new("RGB", (100, 80)).save(place / "photos" / "small.png")
    monkeypatch.chdir(place / "photos" / "left")
    notes = made(Path("../.."), calib="../../stereo.yml").notes
    assert "photographs rectified: 6 of the left camera, 6 of the right one" in notes
    assert any("1 photograph left out" in note and "640 x 480" in note for note in notes)
    assert len(list((place / "rectified").rglob("*.png"))) == 12
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("RGB", SIZE, (200, 90, 90)).save(place / "photos" / "turned.jpg", exif=exif)
    with pytest.raises(InputError, match="turned by its EXIF"):
        made(place)


FAR = {"K1": np.array([[380.0, 0, 320], [0, 380, 240], [0, 0, 1]]), "D1": np.array([-0.35, 0.12, 0, 0, -0.02])}
FAR |= {"K2": FAR["K1"], "D2": FAR["D1"]}
FAR |= dict(zip(("R1", "R2", "P1", "P2"), cv2.stereoRectify(*FAR.values(), SIZE, R, T[:, None], alpha=1), strict=False))


@pytest.mark.parametrize(
    ("values", "words"),
    [(RAW | FAR, "bends two directions"), (RAW | projections() | {"D1": np.arange(14.0)}, "tilted")],
)
def test_a_lens_that_cannot_be_used_is_left_out_with_a_note(place, values, words):
    stored(place / "other.yml", values)
    calibration = calibrate(place / "photos", calib=place / "other.yml", range_px=(2, 40), trials=0)
    assert calibration.config.lens is None
    assert any(words in note for note in calibration.notes)
    with pytest.raises(InputError, match=words):
        made(place, calib=place / "other.yml")


def test_rectified_photographs_of_another_calibration_are_not_replaced(place):
    made(place)
    files = {path: path.read_bytes() for path in (place / "rectified").rglob("*.png")}
    made(place)  # the same ones
    stored(place / "other.yml", RAW | {"K1": np.add(K1, [[0, 0, 3], [0, 0, 0], [0, 0, 0]])} | projections())
    with pytest.raises(InputError, match="with other pixels: name a new folder"):
        made(place, calib=place / "other.yml")
    assert files == {path: path.read_bytes() for path in (place / "rectified").rglob("*.png")}


def test_lenses_of_several_rigs_or_without_opencv_are_left_out_with_a_note(place, monkeypatch):
    stored(place / "other.yml", RAW | projections())
    both = [place / "stereo.yml", place / "other.yml"]
    for calib, words in ((both, "lenses of 2 rigs were left out"), (both[:1], "left out: .*OpenCV")):
        calibration = calibrate(place / "photos", calib=calib, range_px=(2, 40), trials=0)
        assert calibration.config.lens is None
        assert any(re.search(words, note) for note in calibration.notes)
        monkeypatch.setitem(sys.modules, "cv2", None)
