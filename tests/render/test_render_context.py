"""Backends, limits, and what the renderer refuses."""

import ctypes
import hashlib
import os
import subprocess
import sys
from contextlib import suppress
from unittest.mock import Mock

import moderngl
import numpy as np
import pytest
from backends import backend_fault
from scenes import facing, noise_layers, one_model, posed
from tiny_datasets import cheap

from semisynth_gl.dataset.generate import generate
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.channels import DRAWN_OUTPUTS, FLOW_OUTPUTS
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render import devices, pair_targets
from semisynth_gl.render.context import open_context
from semisynth_gl.render.devices import context_facts, egl_devices
from semisynth_gl.render.model_buffers import ModelBuffers
from semisynth_gl.render.pair_targets import ImageTargets, PairTargets
from semisynth_gl.render.programs import shader_source
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene import sources
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import make_scene

# Those that need no motion.
STILL = tuple(output for output in DRAWN_OUTPUTS if output not in FLOW_OUTPUTS)


def frame_bytes(frame):
    return b"".join(array.tobytes() for array in frame.arrays().values())


def busy_scene(camera, count=60):
    rng = np.random.default_rng(5)
    matrices = np.tile(np.eye(4), (count, 1, 1))
    matrices[:, :3, :3] = rng.normal(size=(count, 3, 3))
    matrices[:, :3, 3] = rng.normal(size=(count, 3)) * [2, 1.5, 1] + [0, 0, 6]
    return make_scene(
        camera,
        model=rng.integers(0, 2, count),
        world_from_model=matrices,
        layer=rng.integers(0, 3, count),
        uv_scale=rng.uniform(0.5, 4, (count, 2)),
        uv_offset=rng.random((count, 2)),
    )


def triangle():
    return make_mesh("triangle", [[0, 0, 0], [1, 0, 0.2], [0, 1, 0.1]], [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])


def test_both_software_backends_give_the_same_bytes(square):
    for name in ("egl", "osmesa"):
        if backend_fault(name):
            pytest.skip(f"no {name} here")
        if "llvmpipe" not in context_facts(name).renderer:
            pytest.skip(f"{name} is {context_facts(name).renderer} here, not software")
    camera = StereoCamera.centred(321, 205, 250.0, 0.3)
    for antialias in ("none", "edges"):
        digests, options = set(), {"antialias": antialias, "outputs": STILL}
        for name in ("egl", "osmesa"):
            with Renderer([square, triangle()], noise_layers(3, 32), backend=name, **options) as renderer:
                digests.add(hashlib.sha256(frame_bytes(renderer.render(busy_scene(camera)))).hexdigest())
        assert len(digests) == 1


def test_a_scene_gives_the_same_bytes_whatever_was_drawn_before(open_renderer, square):
    camera = StereoCamera.centred(200, 100, 150.0, 0.2)
    other = StereoCamera.centred(97, 301, 90.0, 0.2)
    renderer = open_renderer([square, triangle()], noise_layers(3, 32), outputs=STILL)
    first = frame_bytes(renderer.render(busy_scene(camera)))
    renderer.render(busy_scene(other, 700))
    assert frame_bytes(renderer.render(busy_scene(camera))) == first


def test_two_renderers_draw_in_turn_and_outlive_each_other(backend, square):
    """Each makes its own context current; object ids of one mean others in the other."""
    camera = StereoCamera.centred(40, 30, 40.0, 0.1)
    scene = one_model(camera, [facing(camera, 0, 0, 40, 30, 2.0)])
    dark, light = (np.full((1, 8, 8, 4), level, np.uint8) for level in (40, 200))
    with Renderer([square], dark, backend=backend) as one:
        alone = frame_bytes(one.render(scene))
        with Renderer([square], light, backend=backend) as two:
            assert set(np.unique(two.render(scene).left.image)) == {200}
            assert frame_bytes(one.render(scene)) == alone
            assert set(np.unique(two.render(scene).left.image)) == {200}
        assert frame_bytes(one.render(scene)) == alone
        one.render(make_scene(StereoCamera.centred(9, 9, 9.0, 0.1), model=[], world_from_model=[], layer=[]))


@pytest.mark.parametrize("antialias", ["none", "edges", "ssaa2"])
def test_targets_are_made_once_for_pairs_and_once_for_denser_images(open_renderer, square, antialias, monkeypatch):
    made = []
    for kind in (ImageTargets, PairTargets):
        monkeypatch.setattr(
            pair_targets, kind.__name__, Mock(side_effect=lambda *a, kind=kind, **k: made.append(kind) or kind(*a, **k))
        )
    camera, denser = StereoCamera.centred(60, 40, 40.0, 0.1), StereoCamera.centred(90, 60, 60.0, 0.1)
    scene, dense = busy_scene(camera), busy_scene(denser)
    renderer = open_renderer([square, triangle()], noise_layers(3, 32), antialias=antialias)
    alone = [renderer.render(each) for each in (dense, scene)]
    assert made == [PairTargets, PairTargets]
    renderer.render_images(scene)
    images = renderer.render_images(dense)
    objects = renderer.count_objects()
    for _ in range(3):
        assert frame_bytes(renderer.render(scene)) == frame_bytes(alone[1])
        again = renderer.render_images(dense)
        for eye in EYES:
            np.testing.assert_array_equal(again[eye], images[eye])
            np.testing.assert_array_equal(again[eye], alone[0].view(eye).image)
            np.testing.assert_array_equal(renderer.render_images(scene)[eye], alone[1].view(eye).image)
    assert made == [PairTargets, PairTargets, ImageTargets]
    assert renderer.count_objects() == objects
    # One size for each eye, and no more.
    others = [busy_scene(StereoCamera.centred(60 + k, 40, 40.0, 0.1)) for k in range(1, 6)]
    for each in others[:2]:
        renderer.render_images(each)
    objects = renderer.count_objects()
    for each in others:
        renderer.render_images(each)
        renderer.render_images(others[0] if each is others[1] else each)
        assert renderer.count_objects() == objects
    assert frame_bytes(renderer.render(dense)) == frame_bytes(alone[0])


@pytest.mark.parametrize("antialias", ["none", "edges", "ssaa2"])
def test_a_refused_size_leaves_the_renderer_as_it_was(open_renderer, square, antialias):
    renderer = open_renderer([square], noise_layers(1, 16), antialias=antialias)
    camera = StereoCamera.centred(60, 40, 40.0, 0.1)
    scene = one_model(camera, [facing(camera, 0, 0, 60, 40, 2.0)])
    before = frame_bytes(renderer.render(scene))
    side = context_facts(renderer.backend).limits["largest image side, px"]
    large = StereoCamera.centred(side // 2 + 8 if antialias == "ssaa2" else side + 8, 4, 40.0, 0.1)
    said = r" x 4 px was asked for, .* goes up to \d+ px a side"
    if antialias == "ssaa2":
        said = r"antialias ssaa2 draws \d+ x 8 px, .* goes up to \d+: lower"
    for draw in (renderer.render, renderer.render_images):
        with pytest.raises(BackendError, match=said):
            draw(one_model(large, [np.eye(4)]))
    assert frame_bytes(renderer.render(scene)) == before


def test_models_that_only_reach_into_the_view_are_drawn(open_renderer, square):
    """Instances around the image's border, each drawn alone and all together: culling may drop none that shows."""
    camera = StereoCamera(120, 90, 100.0, 0.1, 55.0, 62.0, 40.0)
    rng = np.random.default_rng(4)
    matrices = []
    for _ in range(300):
        matrix = np.eye(4)
        matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.uniform(0.05, 0.6, 3)
        border = rng.choice([-1, 1]) * np.array([0.6, 0.45]) * rng.uniform(0.8, 1.3)
        matrix[:3, 3] = [
            *(border * [1, rng.uniform(-1, 1)] if rng.random() < 0.5 else border * [rng.uniform(-1, 1), 1]),
            1,
        ]
        matrix[:3, 3] *= rng.uniform(1, 3)
        matrices.append(matrix)
    wall = facing(camera, -400, -400, 1600, 1600, 9.0)
    scene = one_model(camera, [wall, *matrices], near_m=0.2)
    frame = open_renderer([square], noise_layers(1, 16), outputs=["instances"]).render(scene)
    y, x = (values.ravel().astype(float) for values in np.mgrid[:90, :120])
    for eye in ("left", "right"):
        hits = cast_rays(scene, [square], eye, x, y)
        seen = frame.view(eye).instances.ravel()
        shown = np.bincount(hits.instance + 1, minlength=302)
        reaching = np.flatnonzero(shown > 12)
        assert len(reaching) > 40
        for instance in reaching:
            assert (seen == instance).sum() > 0.5 * shown[instance]
        assert (seen == hits.instance + 1).mean() > 0.998


@pytest.mark.parametrize("side", [(-1, 0), (1, 0), (0, -1), (0, 1)])
def test_a_tip_that_reaches_into_the_view_is_drawn(open_renderer, side):
    """The model's origin lies outside by 0.95 of its radius, so only culling by the whole radius keeps its tip."""
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


def test_instances_without_end_are_drawn(open_renderer, square):
    camera = StereoCamera.centred(64, 64, 64.0, 0.1)
    count = 100_000
    matrices = np.tile(facing(camera, 10, 10, 4, 4, 2.0), (count, 1, 1))
    matrices[-1] = facing(camera, 30, 30, 4, 4, 1.0)
    frame = open_renderer([square], noise_layers(1, 16)).render(one_model(camera, matrices))
    np.testing.assert_allclose(frame.left.disparity[30:34, 30:34], 6.4, rtol=1e-6)
    assert np.isfinite(frame.left.disparity).sum() == 32


def test_outputs_are_made_only_when_asked_for(open_renderer, square):
    camera = StereoCamera.centred(40, 30, 40.0, 0.1)
    matrices = [facing(camera, 0, 0, 40, 30, 2.0), facing(camera, 10, 5, 8, 9, 1.0)]
    scene = one_model(camera, matrices)
    bare = open_renderer([square], noise_layers(1, 16), outputs=()).render(scene)
    full = open_renderer([square], noise_layers(1, 16), outputs=STILL).render(scene)
    for eye in ("left", "right"):
        assert set(bare.view(eye)) == {"image", "disparity"}
        assert set(full.view(eye)) == {"image", "disparity", *STILL}
        np.testing.assert_array_equal(bare.view(eye).disparity, full.view(eye).disparity)
        np.testing.assert_array_equal(bare.view(eye).image, full.view(eye).image)
    for name in STILL:
        alone = open_renderer([square], noise_layers(1, 16), outputs=(name,)).render(scene)
        assert set(alone.left) == set(alone.right) == {"image", "disparity", name}
        np.testing.assert_array_equal(alone.right[name], full.right[name])
    expected = np.ones((30, 40), np.uint16)
    expected[5:14, 10:18] = 2
    np.testing.assert_array_equal(full.left.instances, expected)
    np.testing.assert_allclose(full.left.depth, np.where(expected == 2, 1.0, 2.0), rtol=1e-6)


def test_what_a_renderer_cannot_make_is_refused(square):
    with pytest.raises(InputError, match=r"outputs: .*got 'valid'"):
        Renderer([square], noise_layers(1, 16), outputs=("valid",))


def test_more_instances_than_ids_are_refused(open_renderer, square):
    camera = StereoCamera.centred(8, 8, 8.0, 0.1)
    many = one_model(camera, np.tile(np.eye(4), (65_536, 1, 1)))
    with pytest.raises(InputError, match="16-bit ids"):
        open_renderer([square], noise_layers(1, 16), outputs=["instances"]).render(many)


@pytest.mark.parametrize("mode", ["edges", "ssaa2", "ssaa3"])
def test_antialiasing_changes_colour_at_edges_only_and_truth_nowhere(open_renderer, square, mode):
    camera = StereoCamera.centred(200, 150, 200.0, 0.1)
    flat = np.zeros((2, 16, 16, 4), np.uint8)
    flat[1] = 200
    turned = posed([[0.8, -0.3, 0], [0.3, 0.8, 0], [0, 0, 1]], (-0.3, -0.4, 1.5))
    scene = make_scene(
        camera, model=[0, 0], world_from_model=[facing(camera, -50, -50, 300, 250, 3.0), turned], layer=[0, 1]
    )
    plain = open_renderer([square], flat, outputs=STILL).render(scene)
    smooth = open_renderer([square], flat, outputs=STILL, antialias=mode).render(scene)
    assert set(plain.arrays()) == set(smooth.arrays())
    for role, array in plain.arrays().items():
        if role not in EYES:
            np.testing.assert_array_equal(smooth.arrays()[role], array)
    for eye in ("left", "right"):
        before, after = plain.view(eye).image[..., 0], smooth.view(eye).image[..., 0]
        changed = before != after
        assert changed.any()
        shades = np.unique(after)
        assert set(np.unique(before)) == {0, 200}
        assert ((shades > 0) & (shades < 200)).sum() >= 3
        # Only within one pixel of the edge.
        near = np.zeros_like(changed)
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                near |= np.roll(before, (dy, dx), (0, 1)) != before
        assert not (changed & ~near).any()
        # The mean brightness stays: no shift of the edge.
        assert abs(float(after.mean()) - float(before.mean())) < 0.3


def test_antialiasing_that_does_not_exist_is_refused(open_renderer, square):
    for text in ("msaa4", "ssaa", "ssaa1", "ssaa9"):
        with pytest.raises(InputError, match="antialias: expected none"):
            open_renderer([square], noise_layers(1, 16), antialias=text)


def test_indices_out_of_range_are_refused(open_renderer, square):
    camera = StereoCamera.centred(8, 8, 8.0, 0.1)
    renderer = open_renderer([square], noise_layers(2, 16))
    for model, layer, word in (([1], [0], "model must be 0 to 0, got 1"), ([0], [-1], "layer must be 0 to 1, got -1")):
        with pytest.raises(InputError, match=word):
            renderer.render(make_scene(camera, model=model, world_from_model=[np.eye(4)], layer=layer))


def test_atlases_of_a_wrong_shape_are_refused(square):
    for layers in (np.zeros((1, 4, 4, 3), np.uint8), np.zeros((1, 4, 5, 4), np.uint8), np.zeros((1, 4, 4, 4))):
        with pytest.raises(InputError, match="layers must be"):
            Renderer([square], layers)
    with pytest.raises(InputError, match="atlas is empty"):
        Renderer([square], np.zeros((0, 4, 4, 4), np.uint8))
    with pytest.raises(InputError, match="anisotropy must be"):
        Renderer([square], np.zeros((1, 4, 4, 4), np.uint8), anisotropy=17)
    with pytest.raises(InputError, match="at least one model"):
        Renderer([], np.zeros((1, 4, 4, 4), np.uint8))


def test_an_error_of_its_opening_is_told_of_no_pair(backend, square, monkeypatch):
    loaded = ModelBuffers.__init__

    def faulty(self, gl, *given, **options):
        loaded(self, gl, *given, **options)
        gl.depth_func = "<="
        with suppress(moderngl.Error):
            gl.buffer(reserve=16).bind_to_uniform_block(1 << 20)

    monkeypatch.setattr(ModelBuffers, "__init__", faulty)
    with pytest.raises(BackendError, match=r"reported GL_INVALID_VALUE while models and patches were loaded"):
        Renderer([square], noise_layers(1, 8), backend=backend)


def test_an_error_of_asking_for_limits_is_told_of_no_renderer(backend, square, monkeypatch):
    create = moderngl.create_context

    def faulty(**options):
        gl = create(**options)
        with suppress(moderngl.Error):
            gl.buffer(reserve=16).bind_to_uniform_block(1 << 20)
        return gl

    monkeypatch.setattr(moderngl, "create_context", faulty)
    with Renderer([square], noise_layers(1, 8), backend=backend) as renderer:
        camera = StereoCamera.centred(16, 12, 20.0, 0.1)
        assert renderer.render(make_scene(camera, model=[], world_from_model=np.zeros((0, 4, 4)), layer=[])) is not None


def test_a_context_is_current_only_while_it_draws(square):
    """A driver keeps all that a context holds while it is current, released or not."""
    if backend_fault("egl"):
        pytest.skip("no egl here")
    current = ctypes.CDLL("libEGL.so.1").eglGetCurrentContext
    current.restype = ctypes.c_void_p
    context = open_context("egl")
    assert current() is not None
    context.release()
    with Renderer([square], noise_layers(1, 8), backend="egl"):
        assert current() is None


@pytest.mark.parametrize("start", [PairRenderer, lambda *given: generate(given[0], "out", 1, backend=given[2])])
@pytest.mark.parametrize("backend", ["auto", "egl", "osmesa"])
def test_missing_libraries_are_told_before_anything_is_made(monkeypatch, tmp_path, start, backend):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(devices, "_loads", lambda _: False)
    monkeypatch.setattr(devices, "open_context", Mock(side_effect=BackendError("none could be opened")))
    monkeypatch.setattr(sources, "prepare_atlas", Mock(side_effect=AssertionError("it was begun")))
    with pytest.raises(BackendError, match="none could be opened"):
        start(cheap(), 0, backend)
    devices.open_context.assert_called_once_with(backend)


@pytest.mark.parametrize(
    ("backend", "there", "enough"),
    [
        ("auto", {"libOSMesa.so.8"}, True),
        ("auto", {"libEGL.so.1", "libGL.so.1"}, True),
        ("egl", {"libEGL.so.1", "libOSMesa.so.8"}, False),
        ("osmesa", {"libEGL.so.1", "libGL.so.1"}, False),
        ("osmesa", {"libOSMesa.so.6"}, True),
    ],
)
def test_the_libraries_of_one_backend_are_enough(monkeypatch, backend, there, enough):
    monkeypatch.setattr(devices, "_loads", there.__contains__)
    monkeypatch.setattr(devices, "open_context", opened := Mock())
    devices.check_libraries(backend)
    assert opened.called != enough


def test_a_device_that_does_not_exist_is_refused():
    if backend_fault("egl"):
        pytest.skip("no egl here")
    assert len(egl_devices()) < 99
    with pytest.raises(BackendError, match="device 99"):
        open_context("egl", device_index=99)


def opened(name, **environment):
    """Open a backend in a new process: Mesa reads its variables once."""
    script = f"from semisynth_gl.render.context import open_context; print(open_context({name!r}).backend)"
    if backend_fault(name):
        pytest.skip(f"no {name} here")
    return subprocess.run(
        [sys.executable, "-c", script], env=os.environ | environment, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("name", ["egl", "osmesa"])
def test_too_old_opengl_is_told(name):
    # Mesa can be made to pretend an older version.
    done = opened(name, MESA_GL_VERSION_OVERRIDE="3.3")
    assert done.returncode == 1
    assert "BackendError: no OpenGL context could be opened" in done.stderr
    assert "3.3" in done.stderr or "4.5" in done.stderr


def test_glcontext_variables_override_nothing():
    """GLCONTEXT_DEVICE_INDEX silently wins over arguments in glcontext's own front end."""
    done = opened("egl", GLCONTEXT_DEVICE_INDEX="99", GLCONTEXT_LINUX_LIBGL="libNothing.so")
    assert (done.returncode, done.stdout.strip()) == (0, "egl"), done.stderr


def test_shaders_resolve_their_includes(tmp_path, monkeypatch):
    assert "float disparity_at(" in shader_source("flow.comp")
    assert "#include" not in shader_source("visibility.comp")
    assert shader_source("visibility.comp", {"STEP": 1}).splitlines()[:2] == ["#version 450 core", "#define STEP 1"]
    with pytest.raises(ValueError, match="does not know SETP"):
        shader_source("visibility.comp", {"SETP": 1})
    monkeypatch.setattr("semisynth_gl.render.programs.data_root", lambda _: tmp_path)
    (tmp_path / "a.glsl").write_text('#include "b.glsl"\n')
    (tmp_path / "b.glsl").write_text('#include "a.glsl"\n')
    (tmp_path / "c.glsl").write_text('#include "missing.glsl"\n')
    with pytest.raises(ValueError, match=r"a\.glsl -> b\.glsl -> a\.glsl"):
        shader_source("a.glsl")
    with pytest.raises(FileNotFoundError, match=r"missing\.glsl \(included from c\.glsl\)"):
        shader_source("c.glsl")
