"""What is left out because it is hidden changes no pixel."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenes import SQUARE, assert_equal, facing, noise_layers

from semisynth_gl.frame.camera import Crop, StereoCamera
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.geometry.topology import marked_solid
from semisynth_gl.render import occlusion
from semisynth_gl.render.backends import is_software
from semisynth_gl.render.devices import context_facts
from semisynth_gl.render.model_buffers import ModelBuffers
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import make_scene

CAMERA = StereoCamera.centred(161, 113, 150.0, 0.02)
CROP = Crop(90, 41, 50, 40)


def globe(side=12):
    """A closed ball of small triangles."""
    down, around = np.meshgrid(np.linspace(0, np.pi, side), np.linspace(0, 2 * np.pi, side), indexing="ij")
    points = np.stack([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)], axis=-1)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).reshape(-1, 1)
    triangles = np.concatenate([corner + np.array(three) for three in ((0, side, 1), (1, side, side + 1))])
    uv = np.stack([down, around], axis=-1) / np.pi
    return make_mesh("globe", points.reshape(-1, 3), uv.reshape(-1, 2), triangles)


@pytest.fixture
def drawn(backend, monkeypatch):
    """Let all scenes be searched, and count the instances or runs drawn: depth alone, then the image, for each eye."""
    if not is_software(context_facts(backend).renderer):
        pytest.skip("hidden instances are left out where the processor draws")
    counts = []

    def select(self, *arguments):
        selected = original(self, *arguments)
        counts.append(sum(part.fronts + part.both_sides for part in selected))
        return selected

    original = ModelBuffers.select
    monkeypatch.setattr(ModelBuffers, "select", select)
    for name, value in {"_FEWEST_TRIANGLES": 1, "_RUN_TRIANGLES": 16, "_TILE_PX": 4}.items():
        monkeypatch.setattr(occlusion, name, value)
    return counts


def assert_unchanged(renderer, scene):
    """Compare with everything drawn, the whole image and a part of it."""
    found, part = renderer.render(scene), renderer.render(scene, CROP)
    drawing = renderer._drawing  # noqa: SLF001 - there is no option
    search, drawing._occlusion = drawing._occlusion, None  # noqa: SLF001
    expected = renderer.render(scene)
    drawing._occlusion = search  # noqa: SLF001
    assert_equal(found, expected)
    assert_equal(part, expected, CROP)


@pytest.mark.one_backend
@pytest.mark.parametrize("hiding", [0.05, 1])
@pytest.mark.parametrize(
    "options", [{"outputs": ("visibility", "instances", "normals")}, {"antialias": "ssaa2"}, {"antialias": "edges"}]
)
def test_crowds_are_as_if_everything_were_drawn(backend, drawn, monkeypatch, hiding, options):
    monkeypatch.setattr(occlusion, "_HIDING", hiding)
    rng = np.random.default_rng(7)
    models = [marked_solid(globe()), globe(5), SQUARE]
    large = noise_layers(2, 32, seed=1)
    with Renderer(models, noise_layers(3, 16), large_layers=large, backend=backend, **options) as renderer:
        for fy_over_fx in (1.0, 0.7):
            camera = replace(CAMERA, fy_over_fx=fy_over_fx)
            count = 80
            poses = np.tile(np.eye(4), (count, 1, 1))
            # Some are mirrored, flat or turned; some are cut open by the near plane.
            turn, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
            poses[:, :3, :3] = turn * rng.uniform(0.05, 0.5, (count, 1, 3))
            poses[:, 2, 3] = rng.uniform(0.5, 6, count)
            poses[:, :2, 3] = poses[:, 2:3, 3] * rng.uniform(-0.6, 0.6, (count, 2))
            poses[:2] = facing(CAMERA, 20, 10, 110, 80, 1.0)
            model, layer = rng.integers(0, 3, count), rng.integers(0, 5, count)
            model[:2] = 2  # the same place
            make = partial(make_scene, camera, model=model, world_from_model=poses, layer=layer)
            assert_unchanged(renderer, make(near_m=0.6))
    assert len(drawn) == 16 if "outputs" in options else drawn


@pytest.mark.one_backend
@pytest.mark.parametrize(
    ("far", "seen"),
    [
        ((8, 8, 40, 30, 2.0), 1),
        ((8, 8, 40, 30, 1.0004), 2),  # within the distance by which hiding depth is set back
        ((4, 4, 120, 90, 1.0), 2),  # at the same depth: the first one is seen
        ((0, 8, 40, 30, 2.0), 2),  # looks out
        ((8, 8, 40, 30, 0.99), 2),  # in front
    ],
)
def test_what_looks_out_is_drawn(backend, drawn, monkeypatch, far, seen):
    monkeypatch.setattr(occlusion, "_HIDING", 0.5)
    places = (4, 4, 120, 90, 1.0), far
    poses = np.stack([facing(CAMERA, *place) for place in places])
    scene = make_scene(CAMERA, model=[0, 0], world_from_model=poses, layer=[0, 1], near_m=0.5)
    with Renderer([SQUARE], noise_layers(2, 16), backend=backend) as renderer:
        assert_unchanged(renderer, scene)
    assert drawn[1] == seen
