import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.render.projection import clip_from_view, in_view

positive = st.floats(0.01, 1e4)
cameras = st.builds(
    StereoCamera,
    st.integers(1, 4000),
    st.integers(1, 4000),
    positive,
    st.just(0.0) | st.floats(1e-9, 10),
    st.floats(-2000, 2000),
    st.floats(-2000, 2000),
    st.floats(-2000, 2000),
)


@given(cameras, st.floats(0.01, 1e5))
def test_depth_and_disparity_are_inverse(camera, depth):
    assume(camera.baseline_m > 1e-3)
    disparity = camera.disparity_px(depth)
    # If f B / Z is far smaller than doffs, the subtraction loses digits.
    digits = (abs(disparity) + abs(camera.doffs_px)) / (camera.focal_baseline / depth)
    assert camera.depth_m(disparity) == pytest.approx(depth, rel=1e-14 * digits + 1e-12)


@pytest.mark.parametrize("eye", ["left", "right"])
def test_projection_puts_pixel_centres_at_half_window_coordinates(eye):
    camera = StereoCamera(641, 480, 500.0, 0.1, 310.2, 330.9, 250.4, fy_over_fx=1.1)
    x, y, depth = 17.0, 460.0, 3.3
    view = camera.rays(eye, np.array(x), np.array(y)) * depth
    clip = clip_from_view(camera, eye, 0.1) @ [*view, 1]
    window = (clip[:2] / clip[3] + 1) / 2 * [camera.width_px, camera.height_px]
    np.testing.assert_allclose(window, [x + 0.5, y + 0.5], atol=1e-10)
    assert clip[3] == pytest.approx(depth)
    assert clip[2] / clip[3] == pytest.approx(0.1 / depth)


# Hypothesis discards the many spheres outside the view.
@settings(suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow])
@given(
    st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-5, 30)),
    st.floats(0.001, 5),
    st.sampled_from(["left", "right"]),
    st.sampled_from([0.6, 1.0, 1.5]),
)
def test_no_sphere_that_reaches_into_the_view_is_culled(centre, radius, eye, fy_over_fx):
    camera = StereoCamera(200, 100, 150.0, 0.1, 90.0, 110.0, 40.0, fy_over_fx=fy_over_fx)
    points = np.random.default_rng(0).normal(size=(2000, 3))
    points = np.array(centre) + radius * points / np.linalg.norm(points, axis=1, keepdims=True)
    front = points[points[:, 2] > 0.5]
    x = camera.focal_px * front[:, 0] / front[:, 2] + camera.intrinsics_px(eye)[0]
    y = camera.focal_y_px * front[:, 1] / front[:, 2] + camera.cy_px
    assume(((x > -0.5) & (x < 199.5) & (y > -0.5) & (y < 99.5)).any())
    assert in_view(camera, eye, 0.5, np.array([centre]), np.array([radius]))[0]


def test_spheres_beside_the_view_are_culled():
    camera = StereoCamera(200, 100, 150.0, 0.1, 99.5, 99.5, 49.5)
    centres = np.array([[0, 0, 5], [-9, 0, 5], [9, 0, 5], [0, -9, 5], [0, 9, 5], [0, 0, -5]], float)
    assert in_view(camera, "left", 0.1, centres, np.ones(6)).tolist() == [True, False, False, False, False, False]
