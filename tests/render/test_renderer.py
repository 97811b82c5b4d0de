"""Backends, contexts, limits, and refused arguments of the renderer."""

import ctypes
import hashlib
from contextlib import suppress
from unittest.mock import Mock

import moderngl
import numpy as np
import pytest
from backends import backend_fault, count_objects
from processes import run_python
from scene_table import CASES, models
from scenes import SQUARE, facing, noise_layers, one_model, posed
from scipy.ndimage import maximum_filter, minimum_filter
from tiny_datasets import cheap

from semisynth_gl.dataset.generate import generate
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.channels import MOTION_OUTPUTS, RENDERED_OUTPUTS
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render import context, osmesa
from semisynth_gl.render.context import check_libraries, context_facts, open_context
from semisynth_gl.render.model_buffers import SceneBuffers
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene import sources
from semisynth_gl.scene.scene import make_scene, move

STILL = tuple(output for output in RENDERED_OUTPUTS if output not in MOTION_OUTPUTS)
CAMERA = StereoCamera.centred(60, 40, 40.0, 0.1)
SIMPLE = one_model(CAMERA, [facing(CAMERA, 0, 0, 60, 40, 2.0), facing(CAMERA, 10, 5, 8.5, 9, 1.0)])


def frame_bytes(frame):
    return b"".join(array.tobytes() for array in frame.arrays().values())


def test_both_software_backends_give_the_same_bytes():
    for name in ("egl", "osmesa"):
        if backend_fault(name) or "llvmpipe" not in context_facts(name)["renderer"]:
            pytest.skip(f"no {name} of llvmpipe's here")
    case = CASES["sky, signed"]()
    for antialias in ("none", "edges", "ssaa2"):
        digests, options = set(), {"antialias": antialias, "outputs": RENDERED_OUTPUTS, "signed": True}
        for name in ("egl", "osmesa"):
            with Renderer(models(), noise_layers(4, 32), backend=name, **options) as renderer:
                frame = renderer.render(case.scene, future=case.future, past=case.past)
                digests.add(hashlib.sha256(frame_bytes(frame)).hexdigest())
        assert len(digests) == 1


def test_two_renderers_draw_in_turn_and_outlive_each_other(backend):
    """Each renderer must make its context current, since both use the same object ids."""
    dark, light = (np.full((1, 8, 8, 4), level, np.uint8) for level in (40, 200))
    with Renderer([SQUARE], dark, backend=backend) as one:
        alone = frame_bytes(one.render(SIMPLE))
        with Renderer([SQUARE], light, backend=backend) as two:
            for _ in range(2):
                assert set(np.unique(two.render(SIMPLE).left.image)) == {200}
                assert frame_bytes(one.render(SIMPLE)) == alone
        assert frame_bytes(one.render(SIMPLE)) == alone
    with pytest.raises(BackendError, match="was released"):
        one.render(SIMPLE)


@pytest.mark.one_backend
@pytest.mark.parametrize("antialias", ["none", "edges", "ssaa2"])
def test_pairs_and_images_of_many_sizes_are_drawn_in_turn_and_leave_nothing_behind(open_renderer, antialias):
    renderer = open_renderer([SQUARE], noise_layers(1, 32), antialias=antialias, outputs=RENDERED_OUTPUTS)

    def render(width, count):
        # Some calls need more instances than the initial buffers hold.
        camera = StereoCamera.centred(width, 40, 60.0, 0.1)
        scene = one_model(camera, [facing(camera, k % 50, k % 30, 12.3, 9.4, 1 + k / 100) for k in range(count)])
        motion = move(scene, camera_from_world=posed(np.eye(3), (0.02, 0, 0)))
        frame = renderer.render_rig(scene, [scene.camera] * 2, future=motion, past=motion)[1]
        for eye, image in renderer.render_images(scene).items():
            np.testing.assert_array_equal(image, frame.view(eye).image)
        return frame_bytes(frame)

    first, counts = render(60, 5), []
    # The renderer caches targets of three sizes.
    for widths in ((90, 61, 60), (80, 62, 33), (77, 63, 60)):
        last = [render(width, 300 if width > 75 else 5) for width in widths * 2][-1]
        counts.append(count_objects(renderer))
    assert counts == counts[:1] * 3
    assert last == first


@pytest.mark.one_backend
@pytest.mark.parametrize("antialias", ["none", "edges", "ssaa2"])
def test_a_refused_size_leaves_the_renderer_as_it_was(open_renderer, antialias):
    renderer = open_renderer([SQUARE], noise_layers(1, 16), antialias=antialias)
    before = frame_bytes(renderer.render(SIMPLE))
    side = renderer._gl.info["GL_MAX_TEXTURE_SIZE"]  # noqa: SLF001 - the renderer does not publish it
    large = StereoCamera.centred(side // 2 + 8 if antialias == "ssaa2" else side + 8, 4, 40.0, 0.1)
    for render in (renderer.render, renderer.render_images):
        with pytest.raises(BackendError, match=r"goes up to \d+"):
            render(one_model(large, [np.eye(4)]))
    assert frame_bytes(renderer.render(SIMPLE)) == before


@pytest.mark.one_backend
def test_instances_without_end_are_drawn_but_ids_end(open_renderer):
    poses = np.tile(facing(CAMERA, 10, 10, 4, 4, 2.0), (100_000, 1, 1))
    poses[-1] = facing(CAMERA, 30, 30, 4, 4, 1.0)
    many = one_model(CAMERA, poses)
    frame = open_renderer([SQUARE], noise_layers(1, 16)).render(many)
    np.testing.assert_allclose(frame.left.disparity[30:34, 30:34], 4.0, rtol=1e-6)
    assert np.isfinite(frame.left.disparity).sum() == 32
    with pytest.raises(InputError, match="16-bit ids"):
        open_renderer([SQUARE], noise_layers(1, 16), outputs=["instances"]).render(many)


@pytest.mark.one_backend
def test_outputs_are_made_only_when_asked_for(open_renderer):
    motions = dict.fromkeys(("future", "past"), move(SIMPLE, camera_from_world=posed(np.eye(3), (0.02, 0, 0))))
    full = open_renderer([SQUARE], noise_layers(1, 16), outputs=RENDERED_OUTPUTS).render(SIMPLE, **motions)
    for names in ((), *((name,) for name in RENDERED_OUTPUTS)):
        for truth in ("both", "left"):
            alone = open_renderer([SQUARE], noise_layers(1, 16), outputs=names, truth=truth).render(SIMPLE, **motions)
            channels = {"disparity", *names, *(f"{name}_visibility" for name in names if name.startswith("flow"))}
            assert set(alone.left) == {"image", *channels}
            assert set(alone.right) == {"image", *(channels if truth == "both" else ())}
            for role, array in alone.arrays().items():
                np.testing.assert_array_equal(array, full.arrays()[role])


@pytest.mark.one_backend
@pytest.mark.parametrize("mode", ["edges", "ssaa2", "ssaa3"])
def test_antialiasing_changes_colour_at_edges_only_and_truth_nowhere(open_renderer, mode):
    camera, flat = StereoCamera.centred(200, 150, 200.0, 0.1), np.zeros((2, 16, 16, 4), np.uint8)
    flat[1] = 200
    poses = (
        facing(camera, -50, -50, 300, 250, 3.0),
        posed([[0.8, -0.3, 0], [0.3, 0.8, 0], [0, 0, 1]], (-0.3, -0.4, 1.5)),
    )
    scene = make_scene(camera, model=[0, 0], world_from_model=poses, layer=[0, 1])
    plain, smooth = (
        open_renderer([SQUARE], flat, outputs=STILL, antialias=each).render(scene).arrays() for each in ("none", mode)
    )
    assert set(plain) == set(smooth)
    for role, array in plain.items():
        if role not in EYES:
            np.testing.assert_array_equal(smooth[role], array)
            continue
        before, after = array[..., 0], smooth[role][..., 0]
        assert len(np.unique(after)) >= 5
        # Edges can be just outside the image.
        beside_edge = maximum_filter(before, 3, mode="constant", cval=255) != minimum_filter(before, 3)
        assert not ((before != after) & ~beside_edge).any()
        # A shifted edge would change the mean brightness.
        assert abs(float(after.mean()) - float(before.mean())) < 0.3


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"outputs": ("valid",)}, r"outputs: .*got 'valid'"),
        *(
            ({"antialias": text}, "antialias: must be one of none, edges, ssaa2")
            for text in ("msaa4", "ssaa", "ssaa1", "ssaa9")
        ),
        ({"layers": np.zeros((1, 4, 4, 3), np.uint8)}, "layers must be"),
        ({"layers": np.zeros((1, 4, 5, 4), np.uint8)}, "layers must be"),
        ({"layers": np.zeros((1, 4, 4, 4))}, "layers must be"),
        ({"layers": np.zeros((0, 4, 4, 4), np.uint8)}, "atlas is empty"),
        ({"large_layers": np.zeros((1, 4, 4), np.uint8)}, "both be RGBA or both be grey"),
        ({"anisotropy": 17}, "anisotropy must be"),
        ({"models": []}, "at least one model"),
    ],
)
def test_what_a_renderer_cannot_make_is_refused(options, said):
    with pytest.raises(InputError, match=said):
        Renderer(**{"models": [SQUARE], "layers": noise_layers(1, 16)} | options)


@pytest.mark.one_backend
def test_indices_out_of_range_are_refused(open_renderer):
    renderer = open_renderer([SQUARE], noise_layers(2, 16))
    for model, layer, said in (([1], [0], "model must be 0 to 0, got 1"), ([0], [-1], "layer must be 0 to 1, got -1")):
        with pytest.raises(InputError, match=said):
            renderer.render(make_scene(CAMERA, model=model, world_from_model=[np.eye(4)], layer=layer))


@pytest.mark.one_backend
def test_an_error_of_its_opening_is_told_of_no_pair(backend, monkeypatch):
    loaded = SceneBuffers.__init__

    def faulty(self, gl, *given, **options):
        loaded(self, gl, *given, **options)
        with suppress(moderngl.Error):
            gl.buffer(reserve=16).bind_to_uniform_block(1 << 20)

    monkeypatch.setattr(SceneBuffers, "__init__", faulty)
    with pytest.raises(BackendError, match=r"reported GL_INVALID_VALUE while models and patches were loaded"):
        Renderer([SQUARE], noise_layers(1, 8), backend=backend)


def test_a_context_is_current_only_while_it_draws():
    """Drivers free a released context's objects only when it is no longer current."""
    if backend_fault("egl"):
        pytest.skip("no egl here")
    current = ctypes.CDLL("libEGL.so.1").eglGetCurrentContext
    current.restype = ctypes.c_void_p
    context = open_context("egl")
    assert current() is not None
    context.release()
    with Renderer([SQUARE], noise_layers(1, 8), backend="egl"):
        assert current() is None


@pytest.mark.parametrize("start", [PairRenderer, lambda *given: generate(given[0], "out", 1, backend=given[2])])
@pytest.mark.parametrize("backend", ["auto", "egl", "osmesa"])
def test_missing_libraries_are_told_before_anything_is_made(monkeypatch, tmp_path, start, backend):
    monkeypatch.chdir(tmp_path)
    # EGL needs two libraries, of which one exists; OSMesa needs one of several names.
    libraries = {"egl": [["libc.so.6"], ["libNone.so"]], "osmesa": [["libNone.so"]]}
    monkeypatch.setattr(context, "_LIBRARIES", libraries)
    monkeypatch.setattr(context, "open_context", Mock(side_effect=BackendError("none could be opened")))
    monkeypatch.setattr(sources, "prepare_atlas", Mock(side_effect=AssertionError("it was begun")))
    with pytest.raises(BackendError, match="none could be opened"):
        start(cheap(), 0, backend)
    context.open_context.assert_called_once_with(backend)
    # The libraries of one backend are enough for "auto", but not for the other backend.
    monkeypatch.setitem(libraries, "osmesa", [["libNone.so", "libc.so.6"]])
    monkeypatch.setattr(context, "open_context", opened := Mock())
    check_libraries(backend)
    assert opened.called == (backend == "egl")


def test_an_osmesa_of_old_mesa_is_told(monkeypatch):
    monkeypatch.setattr(osmesa, "_load_library", object)  # object lacks the function, as an old library does
    with pytest.raises(BackendError, match="osmesa: OSMesa is older than Mesa 12"):
        open_context("osmesa")


def test_an_osmesa_context_that_cannot_be_current_is_destroyed(monkeypatch):
    library = Mock(OSMesaCreateContextAttribs=Mock(return_value=7), OSMesaMakeCurrent=Mock(return_value=0))
    monkeypatch.setattr(osmesa, "_load_library", lambda: library)
    with pytest.raises(BackendError, match="osmesa: OSMesa could not make its context current"):
        open_context("osmesa")
    library.OSMesaDestroyContext.assert_called_once_with(7)


def opened(name, **environment):
    """Open a backend in a new process, since Mesa reads its environment variables only once."""
    if backend_fault(name):
        pytest.skip(f"no {name} here")
    script = f"from semisynth_gl.render.context import open_context; print(open_context({name!r}).backend)"
    return run_python("-c", script, **environment)


@pytest.mark.parametrize("name", ["egl", "osmesa"])
def test_too_old_opengl_and_devices_that_do_not_exist_are_told(name):
    # Mesa can pretend to be an older version.
    done = opened(name, MESA_GL_VERSION_OVERRIDE="3.3")
    assert done.code == 1
    assert "BackendError: no OpenGL context could be opened" in done.err
    assert "4.5 is needed" in done.err
    if name == "egl":
        with pytest.raises(BackendError, match="device 99"):
            open_context("egl", device_index=99)


def test_glcontext_variables_override_nothing():
    """In glcontext's own front end, GLCONTEXT_DEVICE_INDEX silently overrides arguments."""
    done = opened("egl", GLCONTEXT_DEVICE_INDEX="99", GLCONTEXT_LINUX_LIBGL="libNothing.so")
    assert (done.code, done.out.strip()) == (0, "egl"), done.err
