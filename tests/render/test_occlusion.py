"""Occlusion culling changes no pixel, and keeps instances that reach into the view."""

from dataclasses import replace

import numpy as np
import pytest
from scene_table import BALL, models, rotation
from scenes import SQUARE, assert_equal, facing, noise_layers, one_model, posed

from semisynth_gl.frame.camera import Crop, StereoCamera
from semisynth_gl.geometry.kinds import SIMPLE_KINDS
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.geometry.topology import marked_solid
from semisynth_gl.render import is_software, occlusion
from semisynth_gl.render.context import context_facts
from semisynth_gl.render.model_buffers import SceneBuffers
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import make_scene

pytestmark = pytest.mark.one_backend
CAMERA = StereoCamera.centred(161, 113, 150.0, 0.02)
CROP = Crop(90, 41, 50, 40)


@pytest.fixture
def drawn(backend, monkeypatch):
    """Cull even small scenes; record the number of instances or runs drawn in each eye's depth and image passes."""
    if not is_software(context_facts(backend)["renderer"]):
        pytest.skip("hidden instances are left out where the processor draws")
    counts = []

    def select(self, *arguments):
        selected = original(self, *arguments)
        counts.append(sum(part.fronts + part.both_sides for part in selected))
        return selected

    original = SceneBuffers.select
    monkeypatch.setattr(SceneBuffers, "select", select)
    for name, value in {"_FEWEST_TRIANGLES": 1, "_CLUSTER_TRIANGLES": 16, "TILE_PX": 4}.items():
        monkeypatch.setattr(occlusion, name, value)
    return counts


def assert_unchanged(renderer, scene):
    """Compare the whole image and a crop with renderings without culling."""
    found, part = renderer.render(scene), renderer.render(scene, CROP)
    drawing = renderer._drawing  # noqa: SLF001 - no option turns culling off
    searching = [owner for owner in (drawing, drawing._edges) if owner is not None]  # noqa: SLF001
    search = drawing._culler  # noqa: SLF001
    for owner in searching:
        owner._culler = None  # noqa: SLF001
    expected = renderer.render(scene)
    if drawing._edges is not None:  # noqa: SLF001
        # The only tile covers the image, since pixels outside a texture are undefined.
        with renderer._gl:  # noqa: SLF001
            assert drawing._edges._programs[0]["tile_px"].value == CAMERA.width_px  # noqa: SLF001
    for owner in searching:
        owner._culler = search  # noqa: SLF001
    assert_equal(found, expected)
    assert_equal(part, expected, CROP)


@pytest.mark.parametrize("hiding", [0.05, 1])
@pytest.mark.parametrize(
    "options", [{"outputs": ("visibility", "instances", "normals")}, {"antialias": "ssaa2"}, {"antialias": "edges"}]
)
def test_crowds_are_as_if_everything_were_drawn(backend, drawn, monkeypatch, hiding, options):
    monkeypatch.setattr(occlusion, "_OCCLUDERS_SHARE", hiding)
    rng, count = np.random.default_rng(7), 80
    solid, open_mesh = (SIMPLE_KINDS[name](rng) for name in ("sphere", "torus"))
    meshes, large = [marked_solid(solid), open_mesh, SQUARE], noise_layers(2, 32, seed=1)
    with Renderer(meshes, noise_layers(3, 16), large_layers=large, backend=backend, **options) as renderer:
        for fy_over_fx in (1.0, 0.7):
            poses = np.tile(np.eye(4), (count, 1, 1))
            # Some are mirrored, flat or rotated; the near plane cuts some open.
            turn, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
            poses[:, :3, :3] = turn * rng.uniform(0.05, 0.5, (count, 1, 3))
            poses[:, 2, 3] = rng.uniform(0.5, 6, count)
            poses[:, :2, 3] = poses[:, 2:3, 3] * rng.uniform(-0.6, 0.6, (count, 2))
            poses[:2] = facing(CAMERA, 20, 10, 110, 80, 1.0)
            model, layer = rng.integers(0, 3, count), rng.integers(0, 5, count)
            model[:2] = 2  # two instances at the same pose
            camera = replace(CAMERA, fy_over_fx=fy_over_fx)
            scene = make_scene(camera, model=model, world_from_model=poses, layer=layer, near_m=0.6)
            assert_unchanged(renderer, scene)
    assert len(drawn) == 16 if "outputs" in options else drawn


@pytest.mark.parametrize(
    ("far", "seen"),
    [
        ((8, 8, 40, 30, 2.0), 1),
        ((8, 8, 40, 30, 1.0004), 2),  # behind the occluder by less than the culling margin
        ((4, 4, 120, 90, 1.0), 2),  # at the same depth
        ((0, 8, 40, 30, 2.0), 2),  # partly beside the occluder
        ((8, 8, 40, 30, 0.99), 2),  # in front
    ],
)
def test_what_looks_out_is_drawn(backend, drawn, monkeypatch, far, seen):
    monkeypatch.setattr(occlusion, "_OCCLUDERS_SHARE", 0.5)
    poses = np.stack([facing(CAMERA, *place) for place in ((4, 4, 120, 90, 1.0), far)])
    scene = make_scene(CAMERA, model=[0, 0], world_from_model=poses, layer=[0, 1], near_m=0.5)
    with Renderer([SQUARE], noise_layers(2, 16), backend=backend) as renderer:
        assert_unchanged(renderer, scene)
    assert drawn[1] == seen


def test_balls_behind_a_wall_are_as_if_everything_were_drawn(open_renderer):
    """The balls have enough triangles (100k) for culling with its default limits."""
    poses = [facing(CAMERA, 10, 10, 90, 90, 1.0), *(posed(rotation(k) * 0.3, (0.3 * k - 0.4, 0, 2)) for k in range(3))]
    scene = make_scene(CAMERA, model=[0, BALL, BALL, BALL], world_from_model=poses, layer=[0] * 4)
    assert_unchanged(open_renderer(models(), noise_layers(1, 16), outputs=("instances",)), scene)


@pytest.mark.parametrize("side", [(-1, 0), (1, 0), (0, -1), (0, 1)])
def test_a_tip_that_reaches_into_the_view_is_drawn(open_renderer, side):
    """The origin is outside by 0.95 of the radius, so that culling must use the whole radius to keep the tip."""
    camera = StereoCamera.centred(200, 160, 100.0, 0.0)
    tip = make_mesh("tip", [[0, -0.9, 0], [0, 0.9, 0], [1, 0, 0]], np.zeros((3, 2)), [[0, 1, 2]])
    assert tip.radius == 1
    half = np.array([200, 160]) @ np.abs(side) / 2
    outward = np.array([*np.multiply(side, 100.0), -half])
    outward /= np.linalg.norm(outward)  # normal of the frustum's plane
    along = np.array([abs(side[1]), abs(side[0]), 0.0])
    turn = np.column_stack([-outward, along, np.cross(-outward, along)])
    at = np.array([*np.multiply(side, half / 100), 1.0]) * 4 + outward * 0.95 * 2
    scene = one_model(camera, [posed(turn * 2, at)])
    frame = open_renderer([tip], noise_layers(1, 16), outputs=["instances"]).render(scene)
    y, x = (values.ravel().astype(float) for values in np.mgrid[:160, :200])
    shown = (cast_rays(scene, [tip], "left", x, y).instance == 0).sum()
    assert shown >= 2
    assert abs(int((frame.left.instances == 1).sum()) - shown) <= 1
