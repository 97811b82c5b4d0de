"""Masks: what the disparity maps do not show, and the lists that the steps of the visibility pass hand on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import board, noise_layers, one_model

from semisynth_gl.frame.camera import Crop, StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, VISIBLE
from semisynth_gl.geometry.kinds import COMPLEX_KINDS
from semisynth_gl.render import listed_steps
from semisynth_gl.render.model_buffers import _by_last_corner
from semisynth_gl.scene.scene import make_scene

CAMERA = StereoCamera.centred(200, 24, 100.0, 0.1)


def column(open_renderer, square, x, *boards):
    scene = one_model(CAMERA, [board(CAMERA, *each) for each in boards])
    left = open_renderer([square], noise_layers(1, 16)).render(scene).left
    return left.disparity[:, x], left.visibility[:, x]


@pytest.mark.parametrize(("gap_px", "expected"), [((100.3, 100.7), VISIBLE), ((100.6, 100.9), OCCLUDED)])
def test_a_gap_narrower_than_a_pixel_shows_what_lies_behind(open_renderer, square, gap_px, expected):
    """The wall's pixel 105 is at 100.5 on the right, between two boards; the nearer one is beside it on the left."""
    boards = (-100, 300, 4.5), (96, gap_px[0], 10.5), (gap_px[1], 130, 12.5)
    disparity, mask = column(open_renderer, square, 105, *boards)
    np.testing.assert_allclose(disparity, 4.5, atol=1e-4)
    assert (mask == expected).all()


@pytest.mark.parametrize(("edge_px", "expected"), [(89.05, OCCLUDED), (89.15, VISIBLE)])
@pytest.mark.parametrize("step_px", [0.26, 0.4, 3.0])
def test_a_board_hides_up_to_its_edge_however_little_it_stands_out(open_renderer, square, edge_px, step_px, expected):
    """The wall's pixel 95 is at 89.1 on the right, where disparities between pixels 89 and 90 hardly differ."""
    disparity, mask = column(open_renderer, square, 95, (-100, 300, 5.9), (edge_px, 140, 5.9 + step_px))
    np.testing.assert_allclose(disparity, 5.9, atol=1e-4)
    assert (mask == expected).all()


def cluttered():
    rng = np.random.default_rng(3)
    models = [build(rng) for build in list(COMPLEX_KINDS.values())[:8]]
    camera = StereoCamera(203, 150, 220.0, 0.2, 95.0, 103.0, 70.0)
    matrices = np.tile(np.eye(4), (8, 1, 1))
    depth = rng.uniform(1.0, 3.0, 8)
    matrices[:, :3, :3] *= 0.2 * depth[:, None, None]
    matrices[:, :3, 3] = np.c_[rng.uniform(-0.4, 0.4, 8) * depth, rng.uniform(-0.3, 0.3, 8) * depth, depth]
    return models, make_scene(camera, model=range(8), world_from_model=matrices, layer=[0] * 8)


def test_bands_and_crops_do_not_change_masks(open_renderer, monkeypatch):
    models, scene = cluttered()
    renderer = open_renderer(models, noise_layers(1, 16))
    whole = renderer.render(scene)
    assert {VISIBLE, OCCLUDED} <= set(np.unique(whole.left.visibility))
    monkeypatch.setattr(listed_steps, "_MOST_PIXELS", 3000)
    for crop in (None, Crop(61, 33, 90, 71), Crop(202, 149, 1, 1)):
        part = crop or Crop(0, 0, 203, 150)
        rows, columns = slice(part.y_px, part.bottom_px), slice(part.x_px, part.right_px)
        frame = renderer.render(scene, crop)
        for eye in ("left", "right"):
            expected = whole.view(eye).visibility[rows, columns]
            np.testing.assert_array_equal(frame.view(eye).visibility, expected)


@pytest.mark.parametrize("groups", [1, 2048])
def test_masks_do_not_depend_on_how_many_work_at_a_time(open_renderer, monkeypatch, groups):
    models, scene = cluttered()
    expected = open_renderer(models, noise_layers(1, 16)).render(scene)
    monkeypatch.setattr(listed_steps, "_GROUPS_ON_SOFTWARE", groups)
    frame = open_renderer(models, noise_layers(1, 16)).render(scene)
    for eye in ("left", "right"):
        np.testing.assert_array_equal(frame.view(eye).visibility, expected.view(eye).visibility)


@given(st.lists(st.tuples(*[st.integers(0, 9)] * 3), min_size=1, max_size=30))
def test_triangles_have_the_number_of_their_last_corner(triangles):
    given_ = np.array(triangles, np.int64)
    source, numbered = _by_last_corner(given_, 10)
    np.testing.assert_array_equal(source[numbered], given_)
    np.testing.assert_array_equal(numbered[:, 2], np.arange(len(given_)))
    assert set(source) == set(range(10))
