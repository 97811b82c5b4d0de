"""The outputs ``raw`` and ``raw_map``: OpenCV and the map rectify a raw file to the image's file."""

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from planted_faults import change_file, change_json, checks, findings
from scenes import assert_equal
from tiny_datasets import EYE, with_lens

from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.frame.camera import EYES, Crop, StereoCamera
from semisynth_gl.frame.raw_camera import RawCamera, rotation_of
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.lens.rectification import EyeRectification
from semisynth_gl.pairs.pipeline import PairRenderer, render_pair

OUTPUTS = ["visibility", "valid", "raw", "raw_map"]
NOISE = {"noise": 5, "blur_px": 0.4}
# Sensors of other sizes than the rectified image. WIDE sees less of the scene with more pixels; FISHEYE sees more.
WIDE = {"raw_width_px": 70, "raw_height_px": 60}
FISHEYE = {
    "model": "fisheye",
    "raw_width_px": 80,
    "raw_height_px": 50,
    "left": {"fx_px": 160, "distortion": [-0.03, 0.01, 0, 0], "rotation_deg": [0, 2, -1]},
    "right": {"fx_px": 150, "distortion": [-0.03, 0.01, 0, 0]},
}


def with_raw(**changes):
    return with_lens(outputs=OUTPUTS, imperfections=NOISE, **changes)


def rectified(frame, eye, border):
    """Rectify a stored raw image with OpenCV from the pair's JSON and calibration, as a user does."""
    record, view = frame.provenance["lens"][eye], frame.view(eye)
    matrix, distortion, rotation = (np.array(record[name]) for name in "KDR")
    size, model = view.image.shape[1::-1], cv2.fisheye if record["model"] == "fisheye" else cv2
    maps = model.initUndistortRectifyMap(matrix, distortion, rotation, frame.camera.matrix(eye), size, cv2.CV_32FC1)
    return cv2.remap(view.raw, *maps, cv2.INTER_LINEAR, borderMode=border)


@pytest.mark.parametrize(
    ("changes", "layout"),
    [
        ({}, "middlebury"),
        ({"lens": WIDE}, "middlebury"),
        ({"lens": FISHEYE}, "middlebury"),
        ({"lens": {"border": "replicate"}}, "middlebury"),
        ({"truth": "left"}, "webdataset"),
        ({"camera": {"colour": "grey"}}, "middlebury"),
    ],
    ids=str,
)
def test_opencv_rectifies_the_raw_file_to_the_images_file(tmp_path, changes, layout):
    config = with_raw(**changes)
    generate(config, tmp_path / "d", 2, layout=layout)
    border = {"black": cv2.BORDER_CONSTANT, "replicate": cv2.BORDER_REPLICATE}[config.lens.border]
    colours = (3,) * (config.camera.colour == "rgb")
    for frame in open_dataset(tmp_path / "d"):
        for eye in EYES:
            view = frame.view(eye)
            assert view.raw.shape == (config.lens.raw_height_px, config.lens.raw_width_px, *colours)
            np.testing.assert_array_equal(rectified(frame, eye, border), view.image)
            by_map = cv2.remap(view.raw, view.raw_map, None, cv2.INTER_LINEAR, borderMode=border)
            np.testing.assert_array_equal(by_map, view.image)
    assert not findings(tmp_path / "d")


def test_a_raw_image_is_black_beyond_the_rectified_view_alone():
    camera = StereoCamera(160, 120, 150.0, 0.1, 78.0, 84.0, 58.5)
    raw = RawCamera(260, 240, 150.0, 150.0, 130.0, 120.0, "radial-tangential", (-0.2, 0.05, 0, 0))
    lens = EyeRectification(raw, camera, "left", "black")
    white = np.full((240, 260), 255, np.uint8)
    shown = lens.within_view(white)
    y, x = np.mgrid[:240, :260].astype(float)
    column, row = raw.to_rectified(camera.matrix("left"), x, y)
    beyond = np.maximum(np.maximum(-0.5 - column, column - 159.5), np.maximum(-0.5 - row, row - 119.5))
    assert (shown[~(beyond > 0)] == 255).all()
    assert (shown[~(beyond <= 2)] == 0).all()
    assert 0.2 < (shown == 0).mean() < 0.8


@st.composite
def _lenses(draw):
    """Sample a rectified camera, a raw camera whose view may be larger or smaller on any side, and a border."""
    camera = StereoCamera(40, 30, draw(st.floats(15, 60)), 0.1, 19.0, 21.0, 14.5)
    width, height = draw(st.integers(2, 60)), draw(st.integers(2, 50))
    model = draw(st.sampled_from(["radial-tangential", "fisheye"]))
    distortion = (draw(st.floats(-0.2, 0.2)), draw(st.floats(-0.05, 0.05)), 0.0, 0.0)
    most_rad = draw(st.sampled_from([0.4, 2.0]))
    turn = rotation_of(tuple(draw(st.floats(-most_rad, most_rad)) for _ in range(3)))
    focal_px = draw(st.floats(10, 80))
    raw = RawCamera(width, height, focal_px, focal_px, width / 2, height / 2, model, distortion, turn)
    return raw, camera, draw(st.sampled_from(["black", "replicate"]))


# At this sensor's border, rectified pixels interpolate raw pixels outside the rectified view.
NARROW = RawCamera(5, 39, 22, 22, 2.5, 19.5, "radial-tangential", (0.1, 0, 0, 0), rotation_of((0.4, -0.3, 0.3)))


# Half of the rectified view is behind this fisheye.
BEHIND = RawCamera(60, 50, 15, 15, 30, 25, "fisheye", (0.0, 0, 0, 0), rotation_of((0, 1.5, 0)))


@pytest.mark.filterwarnings("error")
@given(_lenses(), st.integers(0, 99))
@example((BEHIND, StereoCamera(40, 30, 20.0, 0.1, 19.0, 21.0, 14.5), "black"), 0)
@example((NARROW, StereoCamera(40, 30, 54.0, 0.1, 19.0, 21.0, 14.5), "black"), 0)
def test_any_raw_image_has_all_that_its_rectification_reads(made, seed):
    raw, camera, border = made
    try:
        lens = EyeRectification(raw, camera, "left", border)
    except InputError:  # the lens maps two directions to one pixel
        return
    image = np.random.default_rng(seed).integers(1, 256, (raw.height_px, raw.width_px), np.uint8)
    x, y = lens.raw_map[..., 0], lens.raw_map[..., 1]
    # remap stores positions in 16 bits; a lens that is turned sideways exceeds them.
    near = (np.abs(lens.maps) < 2**15).all(axis=0)
    np.testing.assert_array_equal(lens.rectify(lens.within_view(image))[near], lens.rectify(image)[near])
    assert not np.isnan(lens.raw_map).any()
    assert (np.isfinite(x) == np.isfinite(y)).all()
    assert (np.isfinite(x) | ~lens.valid).all()
    assert 1 <= lens.density < 100


def test_what_lies_behind_a_raw_camera_has_no_place_in_its_image():
    camera = StereoCamera(160, 120, 40.0, 0.1, 79.5, 79.5, 59.5)
    raw = RawCamera(100, 100, 200.0, 200.0, 50.0, 50.0, "radial-tangential", (0.0,) * 4, rotation_of((0, 0.9, 0)))
    places = EyeRectification(raw, camera, "left", "black").raw_map
    x, y = np.meshgrid(np.arange(160.0), np.arange(120.0))
    rays = np.stack([(x - 79.5) / 40, (y - 59.5) / 40, np.ones_like(x)], axis=2) @ np.array(raw.rotation)
    np.testing.assert_array_equal(np.isinf(places).any(axis=2), rays[..., 2] <= 0)
    assert 0 < np.isinf(places).mean() < 0.5


@pytest.mark.parametrize("rig", [{"rig": {"twin": True, "right_roll_deg": 3, "focal_ratio": 1.04}}, {}], ids=str)
def test_a_pair_does_not_depend_on_the_pairs_before_it(rig):
    """Pairs of one scene have the same left eye, even if their right lenses need denser images."""
    camera = {} if rig else {"baselines": 3, "baseline_m": [0.1, 0.2], "doffs_px": 3}
    lens = {"raw_width_px": 130, "raw_height_px": 100, "left": EYE | {"fx_px": 270}, "right": EYE | {"fx_px": 290}}
    config = with_raw(camera=camera, lens=lens, **rig)
    with PairRenderer(config, 0) as renderer:
        frames = [renderer.render(number).frame for number in range(2 if rig else 3)]
    for number, expected in enumerate(frames):
        with PairRenderer(config, 0) as renderer:
            assert_equal(renderer.render(number).frame, expected)
    assert all(np.array_equal(frame.left.raw, frames[0].left.raw) for frame in frames)
    frames[0].right.raw_map += 1  # the caller may write to it


def test_a_crop_keeps_raw_images_whole():
    frame = render_pair(with_raw(), 0)
    crop = frame.cropped(Crop(20, 10, 30, 25))
    assert crop.left.raw.shape == frame.left.raw.shape
    rectified_crop = cv2.remap(crop.left.raw, crop.left.raw_map, None, cv2.INTER_LINEAR)
    np.testing.assert_array_equal(rectified_crop, crop.left.image)
    crop.left.raw[:] = 0
    assert frame.left.raw.any()


def test_what_cannot_be_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"crestereo has no files for the output raw: leave it out"):
        generate(with_lens(outputs=["raw"]), tmp_path / "d", 4, layout="crestereo")
    generate(with_lens(outputs=["raw_map"]), tmp_path / "d", 4, layout="crestereo")
    assert not findings(tmp_path / "d")


def of_lens(**values):
    """Return a function that changes values of the left lens in a pair's JSON."""
    return lambda pair: pair["lens"]["left"].update(values)


def added(place, value):
    def change(array):
        array = array.copy()
        array[place] += value
        return array

    return change


FAULTS = [
    ("raw0.png", lambda image: np.roll(image, 1, axis=1), {"raw"}),
    ("raw1.png", lambda image: np.minimum(image, 253) + 2, {"raw"}),
    ("raw_map1.flo", added((20, 30, 1), 0.01), {"raw_map"}),
    # Outside the sensor too, and a pixel without a position.
    ("raw_map1.flo", added((0, 0, 0), -0.5), {"raw_map"}),
    ("raw_map1.flo", added((0, 0, 0), np.inf), {"raw_map"}),
    ("pair.json", of_lens(R=[[1, 0], [0, 1]]), {"valid"}),
    ("pair.json", of_lens(model="foo"), {"valid"}),
    ("pair.json", of_lens(K=[[140, 0, 32], [0, 140, 24], [0, 0, 1]]), {"raw"}),
    ("raw1.png", lambda image: image[:-1], {"size"}),
]


def test_verify_finds_a_wrong_raw_image_map_and_lens(tmp_path):
    generate(with_raw(), tmp_path / "d", 1, layout="middlebury")
    for name, change, expected in FAULTS:
        path = next((tmp_path / "d").rglob(name))
        right = path.read_bytes()
        (change_json if path.suffix == ".json" else change_file)(path, change)
        found = checks(tmp_path / "d")
        assert found >= expected if name == "pair.json" else found == expected, name
        if expected == {"size"}:
            with pytest.raises(ReadError, match=r"raw1\.png: expected a height and width of \(48, 64\) px"):
                open_dataset(tmp_path / "d")[0]
        path.write_bytes(right)
