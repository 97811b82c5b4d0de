"""The clock of passes: which passes it times, and that it leaves pictures and drivers alone."""

import time

import moderngl
import numpy as np
import pytest
from scenes import facing, noise_layers

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.render.backends import is_software
from semisynth_gl.scene.scene import make_scene, move

CAMERA = StereoCamera.centred(90, 60, 90.0, 0.1)
DRAWN = ("draw", "masks", "read")


@pytest.fixture
def scene():
    boards = facing(CAMERA, -100, -100, 300, 300, 2.0), facing(CAMERA, 30, 20, 30, 20, 1.0)
    return make_scene(CAMERA, model=[0, 0], world_from_model=boards, layer=[0, 0])


def render(renderer, scene):
    return renderer.render(scene, future=move(scene), past=move(scene)).arrays()


@pytest.mark.parametrize("queries", [True, False])
@pytest.mark.parametrize(
    ("options", "passes"),
    [
        ({}, DRAWN),
        ({"antialias": "edges"}, (*DRAWN, "edges")),
        ({"antialias": "ssaa2"}, (*DRAWN, "samples", "resolve")),
        ({"outputs": ("flow", "flow_backward")}, ("draw", "moment", "flow", "read")),
        ({"outputs": ()}, ("draw", "read")),
    ],
)
def test_the_passes_that_ran_are_timed_and_pictures_stay(open_renderer, square, scene, options, passes, queries):
    renderer = open_renderer([square], noise_layers(1, 16), **options)
    expected = render(renderer, scene)
    assert renderer.clock.queries != is_software(renderer.renderer_name)
    renderer.clock.queries = queries
    for _ in range(2):
        start = time.process_time()
        renderer.clock.start()
        found = render(renderer, scene)
        seconds = renderer.clock.stop()
        whole = time.process_time() - start
        assert seconds.keys() == {(name, eye) for name in passes for eye in EYES}
        if not queries:
            # What llvmpipe's queries say is not to be trusted.
            assert 0 < min(seconds.values()) <= sum(seconds.values()) < whole
        for role, array in expected.items():
            np.testing.assert_array_equal(found[role], array)
    assert renderer.clock.stop() == {}


def test_left_truth_alone_has_no_passes_of_the_right_eye(open_renderer, square, scene):
    renderer = open_renderer([square], noise_layers(1, 16), truth="left")
    renderer.clock.start()
    render(renderer, scene)
    assert {name for name, eye in renderer.clock.stop() if eye == "right"} == {"draw", "read"}


def test_ordinary_rendering_asks_for_no_query_and_never_waits(open_renderer, square, scene, monkeypatch):
    def asked(*_, **__):
        raise AssertionError("nobody asked for the time")

    renderer = open_renderer([square], noise_layers(1, 16), antialias="edges")
    render(renderer, scene)
    monkeypatch.setattr(moderngl.Context, "query", asked)
    monkeypatch.setattr(moderngl.Context, "finish", asked)
    render(renderer, scene)
    renderer.clock.queries = True
    renderer.clock.start()
    with pytest.raises(AssertionError, match="nobody asked"):
        render(renderer, scene)


def test_queries_are_used_again_since_none_is_ever_freed(open_renderer, square, scene, monkeypatch):
    made, query = [], moderngl.Context.query
    monkeypatch.setattr(moderngl.Context, "query", lambda *given, **named: made.append(0) or query(*given, **named))
    renderer = open_renderer([square], noise_layers(1, 16))
    renderer.clock.queries = True
    for _ in range(3):
        renderer.clock.start()
        render(renderer, scene)
        renderer.clock.stop()
        assert len(made) == 2 * len(DRAWN)
