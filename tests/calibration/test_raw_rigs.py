"""Calibrations of unrectified cameras, compared with OpenCV's rectification."""

import sys

import numpy as np
import pytest
from calibration_files import D1, D2, IMAGE, K1, K2, RAW, SIZE, R, T, projections, write_storage
from config_texts import parse_config
from hypothesis import given
from hypothesis import strategies as st
from photograph_like import noise, save

from semisynth_gl.calibration.calibrate import calibrate
from semisynth_gl.calibration.rig import RectifiedRig
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.raw_camera import RawCamera, rotation_of
from semisynth_gl.pairs.pipeline import render_pair

cv2 = pytest.importorskip("cv2", reason="OpenCV, the extra opencv, is not installed")


@given(st.tuples(*[st.floats(-1.7, 1.7)] * 3))
def test_a_rotation_vector_has_the_matrix_of_opencv(vector):
    np.testing.assert_allclose(rotation_of(vector), cv2.Rodrigues(np.array(vector))[0], atol=1e-9)


def test_a_reduced_rig_sees_the_same_directions():
    camera = StereoCamera(322, 241, 250.0, 0.2, 160.0, 171.0, 119.0, fy_over_fx=1.01)
    raw = RawCamera(322, 241, 260.0, 261.0, 161.0, 118.0, "radial-tangential", tuple(D1), rotation_of((0.01, 0.02, 0)))
    half = RectifiedRig(camera, "x", {"left": raw}).scaled(0.5)
    assert half.size == (half.raw["left"].width_px, half.raw["left"].height_px) == (161, 121)
    x, y = np.meshgrid(np.arange(0.0, 160), np.arange(0.0, 120))
    whole_x, whole_y = (x + 0.5) * 2 - 0.5, (y + 0.5) * 2 - 0.5
    pinhole = camera.matrix("left")
    seen, whole = half.raw["left"].to_rectified(pinhole, x, y), raw.to_rectified(pinhole, whole_x, whole_y)
    np.testing.assert_allclose(seen, whole, atol=1e-9)
    for eye in EYES:
        np.testing.assert_allclose(half.camera.rays(eye, x, y), camera.rays(eye, whole_x, whole_y), rtol=1e-12)


@pytest.fixture
def place(tmp_path):
    """Write raw photographs of noise, and a calibration whose rectified images keep all pixels (alpha = 1)."""
    save(tmp_path / "photos", one=noise(*SIZE[::-1]), other=noise(*SIZE[::-1], 1))
    stored(tmp_path / "stereo.yml", RAW | projections(alpha=1))
    return tmp_path


def stored(path, values):
    return write_storage(path, values | IMAGE)


def made(place, **arguments):
    return calibrate(
        place / "photos", **({"calib": place / "stereo.yml", "range_px": (2, 40), "trials": 0} | arguments)
    )


def test_raw_photographs_become_a_dataset_with_the_borders_of_rectified_ones(place):
    calibration = made(place)
    config = parse_config(calibration.text)
    assert config == calibration.config
    frame, values = render_pair(config, 0), projections(alpha=1)
    for side, number, matrix, distortion in (("left", "1", K1, D1), ("right", "2", K2, D2)):
        maps = cv2.initUndistortRectifyMap(
            matrix, distortion, values[f"R{number}"], values[f"P{number}"], SIZE, cv2.CV_32FC1
        )
        seen = cv2.remap(np.full(SIZE[::-1], 255, np.uint8), *maps, cv2.INTER_LINEAR)
        valid, border = frame.view(side).valid == 255, seen == 0
        assert border.mean() > 0.05
        assert not (border & valid).any()
        # Other invalid pixels are within two pixels of the border, where OpenCV interpolates across it.
        ring = cv2.dilate(border.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        assert (~valid & ~border & ~ring).mean() < 1e-4
        assert frame.view(side).image[border].max() < 20


def test_alpha_makes_the_borders_of_the_dataset(place):
    stored(place / "stereo.yml", RAW)
    for alpha, least, most in ((0, 0, 1e-3), (1, 0.05, 0.5)):
        border = (render_pair(made(place, alpha=alpha).config, 0).left.valid != 255).mean()
        assert least <= border <= most


FAR = {"K1": np.array([[380.0, 0, 320], [0, 380, 240], [0, 0, 1]]), "D1": np.array([-0.35, 0.12, 0, 0, -0.02])}
FAR |= {"K2": FAR["K1"], "D2": FAR["D1"]}
FAR |= dict(zip(("R1", "R2", "P1", "P2"), cv2.stereoRectify(*FAR.values(), SIZE, R, T[:, None], alpha=1), strict=False))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (RAW | FAR, "bends two directions"),
        (RAW | projections() | {"D1": np.arange(14.0)}, "got 14"),
        (None, "OpenCV, which cannot be imported"),
    ],
)
def test_a_lens_that_cannot_be_used_is_left_out_with_a_note(place, monkeypatch, values, words):
    if values is None:
        monkeypatch.setitem(sys.modules, "cv2", None)
    else:
        stored(place / "stereo.yml", values)
    calibration = made(place)
    assert calibration.config.lens is None
    assert any("the lenses were ignored: " in note and words in note for note in calibration.notes)
