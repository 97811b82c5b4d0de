"""For numbers of any magnitude, float32 rendering agrees with rays, or the numbers are refused."""

import warnings

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scenes import noise_layers, one_model, posed

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.channels import RENDERED_OUTPUTS
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.geometry.model_units import make_model
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import move

# A slanted wall of 4 x 4 m, 2 m away, and a caller's numbers. The pose cancels the model's scale.
CORNERS = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.2], [1.0, 1.0, 0.4], [-1.0, 1.0, 0.2]])
TRIANGLES = [[0, 1, 2], [0, 2, 3]]
WIDTH, HEIGHT = 24, 16
ORDINARY = {
    "focal_px": 20.0,
    "baseline_m": 0.1,
    "cx_left_px": 11.0,
    "cx_right_px": 12.5,
    "cy_px": 7.0,
    "near_m": 0.1,
    "model_scale": 1.0,
    "model_at": 0.0,
    "instance_scale": 2.0,
    "instance_at": 0.0,
    "depth_m": 2.0,
    "world_at": 0.0,
    "uv_of_model": 1.0,
    "uv_at": 0.0,
    "uv_scale": 2.0,
    "uv_offset": 0.25,
    "moved_m": 0.01,
}
LENGTHS = ("baseline_m", "near_m", "instance_scale", "depth_m", "moved_m")


def rendered(antialias="none", **numbers):
    """Render the wall; return frame, scene and mesh."""
    n = ORDINARY | numbers
    camera = StereoCamera(WIDTH, HEIGHT, n["focal_px"], n["baseline_m"], n["cx_left_px"], n["cx_right_px"], n["cy_px"])
    # Python's floats overflow to inf without a warning.
    scale, at = n["model_scale"], n["model_at"]
    positions = [[x * scale + at for x in corner] for corner in CORNERS.tolist()]
    uv = [[x * n["uv_of_model"] + n["uv_at"] for x in corner[:2]] for corner in CORNERS.tolist()]
    wall = make_mesh("wall", positions, uv, TRIANGLES)
    size = n["instance_scale"] / scale
    shift = [n["instance_at"] - at * size + n["world_at"], -at * size, n["depth_m"] - at * size]
    pose = [[size, 0, 0, shift[0]], [0, size, 0, shift[1]], [0, 0, size, shift[2]], [0, 0, 0, 1.0]]
    back = posed(np.eye(3), [-n["world_at"], 0, 0])
    patch = {"uv_scale": n["uv_scale"], "uv_offset": n["uv_offset"]}
    scene = one_model(camera, [pose], camera_from_world=back, near_m=n["near_m"], **patch)
    then = np.array(pose)
    then[0, 3] += n["moved_m"]
    motion = move(scene, world_from_model=[then])
    with Renderer([wall], noise_layers(1, 16), outputs=RENDERED_OUTPUTS, signed=True, antialias=antialias) as renderer:
        return renderer.render(scene, future=motion, past=motion), scene, wall


def check(numbers, antialias="none"):
    """Render and compare with rays; return False if the numbers are refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            frame, scene, wall = rendered(antialias, **numbers)
        except InputError as error:
            assert str(error)  # noqa: PT017 - any message is fine
            return False
    camera = scene.camera
    y, x = (each.ravel() for each in np.mgrid[:HEIGHT, :WIDTH].astype(float))
    turn, shift = scene.view_from_model(0)[:3, :3].T, scene.view_from_model(0)[:3, 3]
    corners = wall.positions.astype(float) @ turn + shift
    size_m = np.ptp(corners, axis=0).max()
    # Far from the model's origin, large numbers cancel in float32.
    reach_m = (np.abs(wall.positions) @ np.abs(turn)).max()
    for eye in EYES:
        view = frame.view(eye)
        for name, array in view.items():
            assert not np.isnan(array).any(), name
            assert array.dtype.kind != "f" or (array != -np.inf).all(), name
        # Rasterisers round vertices to 1/256 px, after float32 rounded their image positions.
        nearest_m = np.maximum(np.abs(corners[:, 2]).min(), scene.near_m)
        across_px = camera.focal_px * (np.abs(corners[:, :2]).max() + camera.baseline_m + 2 * reach_m) / nearest_m
        aside = 1 / 16 + 2.0**-22 * (abs(camera.intrinsics_px(eye)[0]) + abs(camera.cy_px) + across_px)
        around = []
        # Use nearby rays too: a wall narrower than a pixel can be between the farther ones.
        away = [far for near in (1 / 1024, 1 / 256, 1 / 64, aside) for far in (near, -near)]
        for right, down in ((0, 0), *((far, 0) for far in away), *((0, far) for far in away)):
            hits = cast_rays(scene, [wall], eye, x + right, y + down)
            around.append(np.where(hits.instance >= 0, camera.disparity_px(hits.depth_m), np.inf))
        expected, found = np.array(around), view.disparity.ravel().astype(float)
        finite, known = np.isfinite(found), np.isfinite(expected)
        assert known[:, finite].any(axis=0).all()
        assert (~known[:, ~finite]).any(axis=0).all()
        low = np.where(known, expected, np.inf).min(axis=0)[finite]
        high = np.where(known, expected, -np.inf).max(axis=0)[finite]
        parallax = np.maximum(np.abs(low), np.abs(high)) + 2 * abs(camera.doffs_px)
        away_m = camera.focal_baseline / np.maximum(np.abs(low + camera.doffs_px), 1e-300)
        # The allowed error grows with the wall's size relative to its distance, and with the spread of the rays.
        allowed = 2.0**-24 * (16 + 4 * (size_m + reach_m) / away_m) * parallax + (high - low).max(initial=0)
        assert (found[finite] >= low - allowed).all()
        assert (found[finite] <= high + allowed).all()
    return True


def any_size(low=-320.0, high=308.0):
    return st.builds(lambda sign, power: sign * 10.0**power, st.sampled_from([1, 1, 1, -1]), st.floats(low, high))


SCALED = st.builds(
    lambda scale, model: {name: ORDINARY[name] * scale for name in LENGTHS} | model,
    any_size(-11, 11),
    st.dictionaries(st.sampled_from(["model_scale", "model_at", "world_at"]), any_size(-12, 12), max_size=2),
)
SINGLE = st.dictionaries(st.sampled_from(sorted(ORDINARY)), any_size(), min_size=1, max_size=1)
SEVERAL = st.dictionaries(st.sampled_from(sorted(ORDINARY)), any_size(-10, 10), min_size=1, max_size=3)


@pytest.fixture(scope="module", autouse=True)
def _drawing_works():
    try:
        assert check({})
        assert check({}, "edges")
    except BackendError as error:
        pytest.skip(str(error))


@settings(max_examples=60)
@given(st.one_of(SINGLE, SEVERAL, SCALED), st.sampled_from(["none", "edges"]))
@example({"instance_scale": 7.6e-315}, "none")
@example({"uv_offset": 1e300}, "none")
@example({"instance_at": 0.001, "instance_scale": 0.001, "model_at": 31.622776601683793}, "none")
@example({"instance_at": 0.01, "model_scale": 31.622776601683793, "instance_scale": 0.01}, "none")
def test_numbers_of_any_magnitude_are_drawn_as_rays_say_or_refused(numbers, antialias):
    check(numbers, antialias)


@pytest.mark.parametrize("scale", [1e-8, 1e-4, 1e4, 1e8])
def test_scenes_of_any_unit_that_float32_holds_are_drawn(scale):
    assert check({name: ORDINARY[name] * scale for name in LENGTHS})


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ({"focal_px": 1e30}, "focal_px: must be from 1e-09 to 1e\\+06, got 1e\\+30"),
        ({"instance_scale": 1e300}, "scene: world_from_model: must be at most"),
        ({"instance_scale": 1e-30}, "instance 0 is smaller, .*e-30 m: float32 cannot hold"),
        ({"depth_m": 9.99e8, "instance_scale": 9e8}, "instance 0 reaches farther from the camera"),
        ({"uv_scale": 1e18}, "scene: uv_scale: must be at most"),
        ({"model_scale": 1e18}, "mesh wall: positions: must be at most"),
        ({"model_scale": 1e-30, "instance_scale": 1e-30}, "mesh wall: must reach 1e-09 to 1e\\+09 from its origin"),
        ({"model_scale": 1e-6, "instance_scale": 1e-6, "model_at": 1e7}, "mesh wall: positions are farther from 0"),
    ],
    ids=str,
)
def test_what_float32_cannot_hold_is_refused_with_what_came(numbers, said):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=said):
            rendered(**numbers)


@pytest.mark.parametrize("size", [1e-300, 1e-30, 1e8])
def test_models_of_any_size_are_made(size):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, expected = (
            make_model("wall", CORNERS * scale, TRIANGLES, CORNERS[:, :2] * scale) for scale in (size, 1.0)
        )
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-6)
    # The area of a smaller UV map underflows float64, so the program ignores the map.
    if size > 1e-100:
        np.testing.assert_allclose(found.uv, expected.uv, atol=1e-6)
