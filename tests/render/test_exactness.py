"""The renderer compared with equations: planes, spheres, image sizes, and occlusion."""

from dataclasses import replace

import numpy as np
import pytest
from scene_table import CAMERA, DEVIATION, wall
from scenes import SQUARE, assert_equal, board, facing, noise_layers, on_plane, one_model

from semisynth_gl.frame.camera import EYES, CameraDeviation, StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.geometry.mesh import make_mesh, mesh_grid
from semisynth_gl.render import programs
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.scene.scene import make_scene

pytestmark = pytest.mark.one_backend

PLAIN = StereoCamera(160, 120, 225.0, 0.25, 80.1, 80.1, 57.7)
NORMALS = [(0, 0, 1), (0.5, 0.2, 1), (-0.3, -0.6, 1), (0.2, -2.5, 1)]
CAMERAS = {
    "plain": PLAIN,
    "doffs": replace(PLAIN, cx_right_px=94.4),
    "negative doffs": replace(PLAIN, cx_right_px=75.1),
    "high pixels": replace(PLAIN, fy_over_fx=1.25, cx_right_px=83.6),
    "wide pixels": replace(PLAIN, fy_over_fx=0.8),
    "deviation": replace(PLAIN, deviation=DEVIATION),
    "deviation, wide pixels, doffs": replace(PLAIN, deviation=DEVIATION, fy_over_fx=0.8, cx_right_px=83.6),
}


def rotation(deviation):
    """Rotate about z, then about x, both right-handed."""
    roll, pitch = deviation.roll_rad, deviation.pitch_rad
    about_z = [[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]]
    about_x = [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
    return np.array(about_x) @ np.array(about_z)


def lens(camera, eye):
    """Return rotation, focal lengths, principal point and x position of an eye."""
    if eye == "left":
        return np.eye(3), camera.focal_px * np.array([1, camera.fy_over_fx]), (camera.cx_left_px, camera.cy_px), 0.0
    deviation = camera.deviation
    focal = camera.focal_px * deviation.focal_ratio * np.array([1, camera.fy_over_fx])
    return rotation(deviation), focal, (camera.cx_right_px, camera.cy_px + deviation.y_px), camera.baseline_m


def project(camera, eye, points):
    """Project points in the left camera's frame by K R (X - B); return pixel positions (..., 2) and depths."""
    turn, focal, centre, x_m = lens(camera, eye)
    seen = (points - (x_m, 0, 0)) @ turn.T
    return focal * seen[..., :2] / seen[..., 2:] + centre, seen[..., 2]


def on_rays(camera, eye, normal, distance):
    """Return the points (H, W, 3) of a plane that an eye's pixels see, in the left camera's frame."""
    turn, focal, centre, x_m = lens(camera, eye)
    y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    rays = np.stack([(x - centre[0]) / focal[0], (y - centre[1]) / focal[1], np.ones_like(x)], -1) @ turn
    with np.errstate(divide="ignore", invalid="ignore"):
        return (x_m, 0, 0) + rays * ((distance - normal[0] * x_m) / (rays @ normal))[..., None]


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_planes_have_their_analytic_truth(open_renderer, camera):
    outputs = "depth", "normals", "correspondence"
    renderer = open_renderer([SQUARE], noise_layers(1, 16), outputs=outputs, rectified=camera.rectified)
    y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    for normal in np.array(NORMALS, float):
        frame = renderer.render(one_model(camera, [on_plane(normal, 3.0, 10.0)]))
        for eye, other, sign in (("left", "right", -1), ("right", "left", 1)):
            points, view = on_rays(camera, eye, normal, 3.0), frame.view(eye)
            way = project(camera, other, points)[0] - np.stack([x, y], -1)
            seen = (points[..., 2] > 0.5) & (np.abs(points[..., :2]) < 9).all(axis=-1)
            assert seen.mean() > 0.2
            valid, invalid = seen & (sign * way[..., 0] > 1e-3), seen & (sign * way[..., 0] < -1e-3)
            off = np.abs(view.disparity - sign * way[..., 0])[valid]
            assert np.median(off) < 3e-5
            assert np.quantile(off, 0.999) < 1e-4
            assert np.quantile(np.abs(view.correspondence - way)[valid], 0.999) < 1e-4
            # Zero and negative disparities are invalid, never clamped.
            assert np.isposinf(view.disparity[invalid]).all()
            assert np.isposinf(view.correspondence[invalid]).all()
            depth = project(camera, eye, points)[1]
            np.testing.assert_allclose(view.depth[seen], depth[seen], rtol=1e-5)
            unit = lens(camera, eye)[0] @ -normal / np.linalg.norm(normal)
            np.testing.assert_allclose(view.normals[seen], np.broadcast_to(unit, (seen.sum(), 3)), atol=1e-6)


# GPUs round corners to a subpixel grid before they interpolate; llvmpipe does not, so the vertex shader simulates it.
STEPS = 256
MOVE = f"""
    if (gl_Position.w > 0.0) {{
        vec2 size_px = round(2.0 * focal_px / vec2(clip_from_view[0][0], clip_from_view[1][1]));
        precise vec2 place_px = (gl_Position.xy / gl_Position.w * 0.5 + 0.5) * size_px;
        place_px = round(place_px * {STEPS}.0) / {STEPS}.0;
        gl_Position.xy = (place_px / size_px * 2.0 - 1.0) * gl_Position.w;
    }}
}}
"""


@pytest.fixture
def render_moved(open_renderer, monkeypatch):
    """Return a function that renders a square with rounded corners, with or without our correction."""
    original = programs.shader_source

    def source(name, defines=None):
        text = original(name, defines)
        return text.rstrip().removesuffix("}") + MOVE if name == "mesh.vert" else text

    def render(pose, camera, *, corrected=True, shared=False):
        monkeypatch.setattr(programs, "shader_source", source)
        monkeypatch.setattr(GraphicsContext, "corner_steps", STEPS if corrected else None)
        scene, rectified = one_model(camera, [pose]), camera.rectified
        renderer = open_renderer([SQUARE], noise_layers(1, 16), outputs=("depth",), rectified=rectified)
        if shared:
            return renderer.render_rig(scene, [camera, replace(camera, baseline_m=camera.baseline_m / 2)])[0]
        return renderer.render(scene)

    return render


# Two slopes, and half the side of a square. The squares are in front of the camera, since GPUs clip before they round.
PLANES = ((0.5, 0, 2.013), (-0.8, 0.3, 1.613), (0.2, -2.5, 0.613))


@pytest.mark.parametrize(
    "deviation", [CameraDeviation(), CameraDeviation(0.01, -0.01, 3.0, 1.1)], ids=["rectified", "deviating"]
)
def test_planes_are_as_exact_where_corners_move(render_moved, deviation):
    camera = StereoCamera(320, 240, 450.0, 0.25, 160.1, 188.4, 115.7, deviation)
    for *slope, half_m in PLANES:
        normal, errors = np.array([*slope, 1]), {}
        for corrected in (False, True):
            frame = render_moved(on_plane(normal, 2.0, half_m), camera, corrected=corrected)
            for eye in EYES:
                depth = project(camera, eye, on_rays(camera, eye, normal, 2.0))[1]
                known = np.isfinite(frame.view(eye).depth) & (depth > 0.3) & (depth < 7)
                assert known.mean() > 0.2
                found = np.abs(frame.view(eye).depth - depth)[known] * camera.focal_baseline / depth[known] ** 2
                errors.setdefault(corrected, []).append(found)
        moved, exact = (np.concatenate(errors[corrected]) for corrected in (False, True))
        assert np.median(moved) > 3 * np.median(exact)
        assert np.median(exact) < 2e-5
        assert np.quantile(exact, 0.999) < 1e-4


def test_where_corners_move_left_views_are_shared_and_nothing_lies_beyond_the_horizon(render_moved):
    camera, pose = replace(PLAIN, cy_px=57.7), on_plane((-0.8, 0.3, 1), 2.0, 1.613)
    assert_equal(render_moved(pose, camera, shared=True), render_moved(pose, camera))
    ground = np.eye(4)
    ground[:3] = [[2e8, 0, 0, -1e8], [0, 0, 1, 1.5], [0, 1e8, 0, 0.5]]
    # The horizon is closer to a pixel's centre than the rounding of corners.
    for horizon_px in (57.9985, 57.9995, 58.0, 58.0005, 58.0015):
        frame = render_moved(ground, replace(PLAIN, cy_px=horizon_px))
        for eye in EYES:
            assert np.isfinite(frame.view(eye).depth).any()
            assert (frame.view(eye).depth > 0).all()


@pytest.mark.parametrize("size", [(1, 1), (941, 489), (7680, 4320)])
def test_image_sizes(open_renderer, size):
    width, height = size
    camera = StereoCamera.centred(width, height, 0.9 * max(width, 8), 0.1)
    # The plane slopes in both directions, so that a wrong row length changes the result.
    normal, renderer = np.array([0.1, 0.05, 1.0]), open_renderer([SQUARE], noise_layers(1, 64), outputs=())
    frame = renderer.render(one_model(camera, [on_plane(normal, 2.0, 9.0)]))
    step = max(1, height // 200)
    y, x = (values.astype(float) for values in np.mgrid[:height:step, :width:step])
    depth = 2.0 / (camera.rays("left", x, y) @ normal)
    assert frame.left.image.shape == (height, width, 3)
    np.testing.assert_allclose(frame.left.disparity[::step, ::step], camera.disparity_px(depth), rtol=3e-6)


# Masks that can be computed by hand: f B = 10 px m.
PAPER = StereoCamera.centred(200, 4, 100.0, 0.1, doffs_px=20.0)
FLAT = replace(PAPER, cx_left_px=99.5, cx_right_px=99.5)


@pytest.mark.parametrize(
    ("signed", "wall_px", "board_px", "first_px", "last_px"),
    [(False, 5.0, 20.0, 60.25, 140.25), (True, -12.0, -5.0, 60.25, 80.25), (True, -3.0, 4.0, 60.25, 80.25)],
)
def test_a_board_hides_what_paper_says(open_renderer, signed, wall_px, board_px, first_px, last_px):
    """The board's edges are at ``first_px`` and ``last_px`` in the right view."""
    camera = PAPER if signed else FLAT
    scene = one_model(camera, [board(camera, -100, 500, wall_px), board(camera, first_px, last_px, board_px)])
    frame = open_renderer([SQUARE], noise_layers(1, 16), signed=signed).render(scene)
    x, on_left = np.arange(200), (first_px + board_px, last_px + board_px)
    for eye, shown, hidden, sign in (
        ("left", on_left, (first_px, last_px), -1),
        ("right", (first_px, last_px), on_left, 1),
    ):
        on_board = (x > shown[0]) & (x < shown[1])
        disparity = np.where(on_board, board_px, wall_px)
        there = x + sign * disparity
        mask = np.where(~on_board & (there > hidden[0]) & (there < hidden[1]), OCCLUDED, VISIBLE)
        mask[(there < -0.5) | (there >= 199.5)] = OUTSIDE
        np.testing.assert_allclose(frame.view(eye).disparity[2], disparity, atol=1e-4)
        np.testing.assert_array_equal(frame.view(eye).visibility[2], mask)


@pytest.mark.parametrize(
    ("x", "boards", "expected"),
    [
        # The wall's pixel 105 is at 100.5 in the right view, in a gap between two boards or behind one.
        *((105, ((-100, 300, 4.5), (96, a, 10.5), (b, 130, 12.5)), mask)
          for a, b, mask in ((100.3, 100.7, VISIBLE), (100.6, 100.9, OCCLUDED))),
        # Pixel 95 is at 89.1 in the right view. A board begins at 89.05 or 89.15, with a small or a large step.
        *((95, ((-100, 300, 5.9), (edge, 140, 5.9 + step)), mask)
          for edge, mask in ((89.05, OCCLUDED), (89.15, VISIBLE)) for step in (0.26, 3.0)),
    ],
)  # fmt: skip
def test_masks_know_what_lies_between_pixels(open_renderer, x, boards, expected):
    scene = one_model(FLAT, [board(FLAT, *each) for each in boards])
    left = open_renderer([SQUARE], noise_layers(1, 16)).render(scene).left
    np.testing.assert_allclose(left.disparity[:, x], boards[0][2], atol=1e-4)
    assert (left.visibility[:, x] == expected).all()


@pytest.mark.parametrize("begin", np.linspace(20.05, 20.95, 7))
def test_an_edge_of_many_small_triangles_hides_from_where_it_lies(open_renderer, begin):
    # With an odd number of rows, no edge of the mesh is on the scan line.
    u, v, triangles = mesh_grid(201, 200)
    fine = make_mesh("fine", np.stack([u, v, 0 * u], axis=1), np.stack([u, v], axis=1), triangles)
    # In an image of one row, only this row decides about the point.
    camera = StereoCamera.centred(96, 1, 100.0, 1.0)
    far_px, near_px, end = 5.3, 20.0, 41.0
    wall = facing(camera, -200, -200, 600, 500, 100.0 / far_px)
    poses = [wall, board(camera, begin, end, near_px)]
    scene = make_scene(camera, model=[0, 1], world_from_model=poses, layer=[0, 0], near_m=1.0)
    renderer = open_renderer([SQUARE, fine], noise_layers(1, 8), outputs=("visibility", "instances"))
    left = renderer.render(scene).left
    target = np.arange(96) - far_px
    hidden = (target > begin) & (target < end)
    shown = (left.instances == 1) & (target >= 0) & (np.minimum(abs(target - begin), abs(target - end)) > 1e-3)
    assert (hidden & shown).any()
    expected = np.broadcast_to(np.where(hidden, OCCLUDED, VISIBLE), shown.shape)
    np.testing.assert_array_equal(left.visibility[shown], expected[shown])


@pytest.mark.parametrize("shared_at_once", [1, 2048])
def test_masks_do_not_depend_on_how_many_work_at_a_time(open_renderer, monkeypatch, shared_at_once):
    scene = one_model(CAMERA, [wall(CAMERA, 4.0), *(facing(CAMERA, 20 * k, 9, 9.3, 60.2, 1 + k) for k in range(5))])
    expected = open_renderer([SQUARE], noise_layers(1, 16)).render(scene)
    monkeypatch.setattr("semisynth_gl.render.work_list_shader._GROUPS_ON_SOFTWARE", shared_at_once)
    assert_equal(open_renderer([SQUARE], noise_layers(1, 16)).render(scene), expected)
