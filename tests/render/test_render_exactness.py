"""What the renderer claims, against analytic scenes: patches bit for bit, planes and spheres at their disparity."""

import numpy as np
import pytest
from scenes import facing, noise_layers

from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene.scene import make_scene

SIDE = 64


def folded(index, wrap):
    index = np.asarray(index)
    if wrap == "repeat":
        return index % SIDE
    return np.where((index // SIDE) % 2 == 1, SIDE - 1 - index % SIDE, index % SIDE)


@pytest.mark.parametrize("anisotropy", [1, 8])
@pytest.mark.parametrize("wrap", ["mirror", "repeat"])
@pytest.mark.parametrize("size", [(256, 192), (941, 489), (1, 1), (17, 3)])
def test_a_patch_at_one_texel_per_pixel_comes_out_bit_for_bit(open_renderer, square, wrap, size, anisotropy):
    width, height = size
    layers = noise_layers(3, SIDE)
    camera = StereoCamera(width, height, 700.0, 0.05, 0.47 * width, 0.5 * width, 0.4 * height)
    renderer = open_renderer([square], layers, wrap=wrap, anisotropy=anisotropy)
    repeats = 40
    y, x = np.mgrid[:height, :width]
    expected = layers[2][folded(y + 900, wrap), folded(x + 700, wrap), :3]
    for depth in (0.731, 7.77, 1234.5):
        matrix = facing(camera, -700, -900, repeats * SIDE, repeats * SIDE, depth)
        frame = renderer.render(make_scene(camera, model=[0], world_from_model=[matrix], layer=[2], uv_scale=repeats))
        np.testing.assert_array_equal(frame.left.image, expected, err_msg=f"at {depth} m")


@pytest.mark.parametrize("antialias", ["none", "edges", "ssaa2"])
def test_large_patches_are_counted_behind_the_others_and_come_out_bit_for_bit(open_renderer, square, antialias):
    camera = StereoCamera.centred(120, 80, 700.0, 0.05)
    layers, large = noise_layers(3, SIDE), noise_layers(2, 4 * SIDE, seed=1)
    renderer = open_renderer([square], layers, large_layers=large, large_anisotropy=4, antialias=antialias)
    whole = facing(camera, 0, 0, 4 * SIDE, 4 * SIDE, 5.0)
    part = facing(camera, 40, 20, SIDE, SIDE, 2.0)
    # The large patch is drawn last, though it stands first; what is nearer hides it.
    scene = make_scene(camera, model=[0, 0], world_from_model=[whole, part], layer=[4, 1])
    expected = large[1][:80, :120, :3].copy()
    expected[20:80, 40:104] = layers[1][:60, :, :3]
    if antialias == "none":
        np.testing.assert_array_equal(renderer.render(scene).left.image, expected)
    else:
        inside = np.ones((80, 120), bool)
        inside[18:, 38:42] = inside[18:, 102:106] = inside[18:22, 38:106] = False
        alone = [
            open_renderer([square], patches, antialias=antialias).render(
                make_scene(camera, model=[0], world_from_model=[matrix], layer=[1])
            )
            for patches, matrix in ((large, whole), (layers, part))
        ]
        shown = np.where(np.isfinite(alone[1].left.disparity)[..., None], alone[1].left.image, alone[0].left.image)
        np.testing.assert_array_equal(renderer.render(scene).left.image[inside], shown[inside])
    with pytest.raises(InputError, match="layer must be 0 to 4, got 5 to 5"):
        renderer.render(make_scene(camera, model=[0], world_from_model=[whole], layer=[5]))


def test_anisotropy_keeps_detail_at_grazing_angles(open_renderer, square):
    """Against a supersampled reference, more samples along the longer side come nearer to the truth."""
    camera = StereoCamera.centred(160, 120, 150.0, 0.1)
    layers = np.random.default_rng(0).integers(0, 256, (1, 32, 32, 4)).repeat(8, 1).repeat(8, 2).astype(np.uint8)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] = (8, 0, 0), (0, 1.2, -7), (-4, -0.3, 8)
    scene = make_scene(camera, model=[0], world_from_model=[matrix], layer=[0], uv_scale=[[4, 4]])

    def draw(**options):
        return open_renderer([square], layers, outputs=(), **options).render(scene).left.image.astype(float)

    reference = draw(antialias="ssaa8", anisotropy=16)
    error = [np.sqrt(np.mean((draw(anisotropy=samples) - reference) ** 2)) for samples in (1, 4, 16)]
    assert error[1] < 0.8 * error[0]
    assert error[2] < error[1]


def test_whole_disparities_shift_the_same_pixels_in_the_right_view(open_renderer, square):
    camera = StereoCamera.centred(200, 100, 400.0, 0.1)
    layers = noise_layers(1, SIDE)
    matrix = facing(camera, -500, -500, 30 * SIDE, 30 * SIDE, 400 * 0.1 / 16)
    frame = open_renderer([square], layers).render(
        make_scene(camera, model=[0], world_from_model=[matrix], layer=[0], uv_scale=30)
    )
    np.testing.assert_array_equal(frame.left.image[:, 16:], frame.right.image[:, :-16])
    np.testing.assert_allclose(frame.left.disparity, 16, atol=1e-5)
    np.testing.assert_allclose(frame.right.disparity, 16, atol=1e-5)
    assert (frame.left.visibility[:, 16:] == VISIBLE).all()
    assert (frame.left.visibility[:, :16] == OUTSIDE).all()
    assert (frame.right.visibility[:, :-16] == VISIBLE).all()
    assert (frame.right.visibility[:, -16:] == OUTSIDE).all()


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.5, 0, 1), (-0.8, 0.3, 1), (0.2, -3.0, 1)])
@pytest.mark.parametrize("doffs", [0.0, 57.3, -20.0])
def test_planes_have_their_analytic_disparity(open_renderer, square, normal, doffs):
    camera = StereoCamera(640, 480, 900.0, 0.25, 320.1, 320.1 + doffs, 230.7)
    normal = np.array(normal)
    matrix = np.eye(4)
    for column, direction in enumerate(((16.0, 0.0), (0.0, 16.0))):
        matrix[:3, column] = *direction, -(normal[:2] @ direction)
    corner = np.array([-8.0, -8.0])
    matrix[:3, 3] = *corner, 2.0 - normal[:2] @ corner
    frame = open_renderer([square], noise_layers(1, SIDE)).render(
        make_scene(camera, model=[0], world_from_model=[matrix], layer=[0])
    )
    y, x = np.mgrid[:480, :640].astype(float)
    for eye, disparity in (("left", frame.left.disparity), ("right", frame.right.disparity)):
        along = camera.rays(eye, x, y) @ normal
        # A sloping plane is seen only in front of its horizon, and where its quad reaches; both are far out here.
        depth = np.where(
            along > 0.2, (2.0 - normal[0] * camera.offset_m(eye)) / np.where(along > 0.2, along, 1), np.nan
        )
        expected = camera.disparity_px(depth)
        valid = (depth > 0.05) & (depth < 7) & (expected > 0)
        assert valid.mean() > 0.2
        np.testing.assert_allclose(disparity[valid], expected[valid], rtol=0, atol=1e-3)
        assert np.median(np.abs(disparity[valid] - expected[valid])) < 1e-4


def fine_sphere():
    rows, columns = 500, 1000
    v, u = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij")
    positions = np.stack([np.sin(v) * np.cos(u), np.cos(v), np.sin(v) * np.sin(u)], axis=-1).reshape(-1, 3)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1)
    low = np.stack([first, first + 1, first + columns + 1], axis=1)
    high = np.stack([first + 1, first + columns + 2, first + columns + 1], axis=1)
    return make_mesh("fine sphere", positions, np.stack([u, v], -1).reshape(-1, 2), np.concatenate([low, high]))


def test_a_sphere_has_its_analytic_disparity(open_renderer):
    camera = StereoCamera.centred(400, 300, 500.0, 0.2)
    centre, radius = np.array([0.1, -0.05, 2.0]), 0.5
    matrix = np.diag([radius, radius, radius, 1.0])
    matrix[:3, 3] = centre
    frame = open_renderer([fine_sphere()], noise_layers(1, SIDE)).render(
        make_scene(camera, model=[0], world_from_model=[matrix], layer=[0])
    )
    y, x = np.mgrid[:300, :400].astype(float)
    for eye, disparity in (("left", frame.left.disparity), ("right", frame.right.disparity)):
        rays = camera.rays(eye, x, y)
        offset = centre - [camera.offset_m(eye), 0, 0]
        a, b, c = (rays**2).sum(-1), rays @ offset, offset @ offset - radius**2
        square_root = np.sqrt(np.maximum(b * b - a * c, 0))
        depth = (b - square_root) / a
        # The cosine between ray and normal; beside the limb the facets' own error is magnified without bound.
        cosine = square_root / np.sqrt(a) / radius
        valid = cosine > 0.3
        assert valid.sum() > 20_000
        np.testing.assert_allclose(disparity[valid], camera.disparity_px(depth[valid]), rtol=0, atol=1e-3)
        assert np.isinf(disparity[b * b - a * c < -0.02]).all()


def test_the_nearer_of_two_surfaces_is_seen_and_hides_the_other(open_renderer, square):
    camera = StereoCamera.centred(300, 100, 300.0, 0.1)
    near, far = 300 * 0.1 / 20, 300 * 0.1 / 5
    wall = facing(camera, -200, -200, 800, 600, far)
    board = facing(camera, 100, 0, 80, 100, near)
    frame = open_renderer([square], noise_layers(2, SIDE)).render(
        make_scene(camera, model=[0, 0], world_from_model=[wall, board], layer=[0, 1])
    )
    expected = np.full((100, 300), 5.0)
    expected[:, 100:180] = 20.0
    np.testing.assert_allclose(frame.left.disparity, expected, atol=1e-4)
    right = np.full((100, 300), 5.0)
    right[:, 80:160] = 20.0
    np.testing.assert_allclose(frame.right.disparity, right, atol=1e-4)
    # Left pixel x of the wall is at x - 5 on the right, where the board covers 80 to 159: x from 85 to 164.
    visibility = np.full((100, 300), VISIBLE)
    visibility[:, 85:100] = OCCLUDED
    visibility[:, :5] = OUTSIDE
    np.testing.assert_array_equal(frame.left.visibility, visibility)


def test_steep_planes_are_visible_in_both_views(open_renderer, square):
    camera = StereoCamera.centred(300, 100, 400.0, 0.1)
    # The plane 4 x + z = 1 m: its disparity changes by B n_x / c = 0.4 px per pixel along a row.
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] = (0.4, 0, -1.6), (0, 4, 0), (-0.2, -2, 1.8)
    frame = open_renderer([square], noise_layers(1, SIDE)).render(
        make_scene(camera, model=[0], world_from_model=[matrix], layer=[0])
    )
    row = frame.left.disparity[50]
    seen = np.isfinite(row)
    assert seen.sum() > 150
    np.testing.assert_allclose(np.diff(row[seen]), 0.4, atol=1e-4)
    x = np.arange(300)[seen] - row[seen]
    inside = (x > 0) & (x < 299)
    assert inside.sum() > 100
    assert (frame.left.visibility[50][seen][inside] == VISIBLE).all()
    other = frame.right.disparity[50]
    both = np.isfinite(other) & (np.arange(300) + np.where(np.isfinite(other), other, 0) < 299)
    assert (frame.right.visibility[50][both] == VISIBLE).all()


def test_zero_and_negative_disparities_are_invalid_never_clamped(open_renderer, square):
    camera = StereoCamera(64, 64, 100.0, 0.1, 31.5, 31.5 + 10.0, 31.5)
    renderer = open_renderer([square], noise_layers(1, SIDE))
    for depth, valid in ((0.99, True), (1.0, False), (1.01, False)):
        matrix = facing(camera, -100, -100, 300, 300, depth)
        frame = renderer.render(make_scene(camera, model=[0], world_from_model=[matrix], layer=[0]))
        assert np.isfinite(frame.left.disparity).all() == valid
        assert np.isposinf(frame.left.disparity).all() != valid
        assert valid or (frame.left.visibility == OUTSIDE).all()


def test_nothing_seen_is_invalid_and_black(open_renderer, square):
    camera = StereoCamera.centred(33, 21, 50.0, 0.1)
    renderer = open_renderer([square], noise_layers(1, SIDE))
    empty = make_scene(camera, model=[], world_from_model=np.zeros((0, 4, 4)), layer=[])
    behind = make_scene(camera, model=[0], world_from_model=[facing(camera, 0, 0, 33, 21, -2.0)], layer=[0])
    for scene in (empty, behind):
        frame = renderer.render(scene)
        assert np.isposinf(frame.left.disparity).all()
        assert np.isposinf(frame.right.disparity).all()
        assert not frame.left.image.any()
        assert (frame.right.visibility == OUTSIDE).all()


def test_a_camera_a_million_metres_away_sees_the_same(open_renderer, square):
    camera = StereoCamera.centred(200, 150, 200.0, 0.1)
    renderer = open_renderer([square], noise_layers(1, SIDE))
    matrix = facing(camera, 20, 20, 100, 90, 1.7)
    shift = np.eye(4)
    shift[:3, 3] = 1e6, -1e6, 1e6
    here = renderer.render(make_scene(camera, model=[0], world_from_model=[matrix], layer=[0]))
    there = renderer.render(
        make_scene(
            camera, model=[0], world_from_model=[shift @ matrix], layer=[0], camera_from_world=np.linalg.inv(shift)
        )
    )
    assert np.isfinite(here.left.disparity).sum() == 9000
    np.testing.assert_allclose(there.left.disparity, here.left.disparity, atol=1e-5)


def test_near_and_far_a_factor_of_a_million_apart(open_renderer, square):
    camera = StereoCamera.centred(200, 100, 200.0, 0.1)
    walls = [facing(camera, -100, -100, 400, 300, depth) for depth in (10_000.0, 9_999.0)]
    post = facing(camera, 90, 0, 20, 100, 0.05)
    # The wall in front must win, whatever the order of drawing.
    for order in ([0, 1], [1, 0]):
        frame = open_renderer([square], noise_layers(1, SIDE)).render(
            make_scene(
                camera, model=[0, 0, 0], world_from_model=[*(walls[k] for k in order), post], layer=[0] * 3, near_m=0.01
            )
        )
        np.testing.assert_allclose(frame.left.disparity[:, 90:110], 200 * 0.1 / 0.05, rtol=1e-6)
        np.testing.assert_allclose(frame.left.disparity[:, :90], 200 * 0.1 / 9_999.0, rtol=1e-6)
