"""Fixtures that several test modules share."""

import logging
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import numpy as np
import pytest
from backends import backend_fault
from hypothesis import HealthCheck, seed, settings
from processes import Ended, without_announcements

from semisynth_gl.cli import main
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.render import Backend
from semisynth_gl.render.context import context_facts
from semisynth_gl.render.renderer import Renderer

# Every run tests the same examples, without deadlines: a test fails for everybody or for nobody.
settings.register_profile("fixed", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
# `make test-heavy` tests other examples for each seed, and runs each property test several times.
settings.register_profile("random", settings.get_profile("fixed"), derandomize=False, print_blob=True)
settings.load_profile("fixed")
RANDOM_ROUNDS = 5

# Shells start background jobs with SIGINT ignored, and child processes inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _cache_of_the_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Give all workers of pytest, and the programs that they start, one cache that is not the user's."""
    base = tmp_path_factory.getbasetemp()
    with pytest.MonkeyPatch.context() as patch:
        # The temporary folder of an xdist worker is inside the run's folder.
        patch.setenv(
            "SEMISYNTH_GL_CACHE", str((base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "cache")
        )
        yield


@pytest.fixture(autouse=True)
def _no_log_of_a_command() -> Iterator[None]:
    """Remove the log handler that a command leaves, since pytest closes its stream after the test."""
    yield
    for handler in [each for each in logging.root.handlers if type(each) is logging.StreamHandler]:
        logging.root.removeHandler(handler)


@pytest.fixture(scope="module")
def one_thread() -> Generator[None]:
    """Limit PyTorch to one thread: more threads are slow while other processes run tests."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Repeat property tests under the profile "random"."""
    if metafunc.config.getoption("--hypothesis-profile") == "random" and hasattr(metafunc.function, "hypothesis"):
        metafunc.fixturenames.append("round_of_examples")
        metafunc.parametrize("round_of_examples", range(RANDOM_ROUNDS))


def pytest_runtest_setup(item: pytest.Function) -> None:
    """Give each round its own seed: with `--hypothesis-seed`, Hypothesis would repeat the same examples."""
    first, params = item.config.getoption("--hypothesis-seed"), getattr(item, "callspec", None)
    if first is not None and params is not None and "round_of_examples" in params.params:
        seed(int(first) * RANDOM_ROUNDS + params.params["round_of_examples"])(item.function)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests that render, and skip long tests on OSMesa where EGL gives the same bytes (llvmpipe)."""
    for item in items:
        if "backend" in item.fixturenames:
            item.add_marker("opengl")
    if backend_fault("egl") is not None or "llvmpipe" not in context_facts("egl")["renderer"]:
        return
    out = [
        item
        for item in items
        if item.get_closest_marker("one_backend")
        and "backend" in item.fixturenames
        and item.callspec.params["backend"] == "osmesa"
    ]
    config.hook.pytest_deselected(items=out)
    items[:] = [item for item in items if item not in set(out)]


@pytest.fixture(params=["egl", "osmesa"])
def backend(request: pytest.FixtureRequest) -> Backend:
    """Run a test on each backend. A backend that fails to open skips it, or fails it where CI expects the backend."""
    fault = backend_fault(request.param)
    if fault:
        if request.param in os.environ.get("SEMISYNTH_GL_EXPECT_BACKENDS", "").split():
            pytest.fail(f"{request.param} was expected here: {fault}")
        pytest.skip(f"no {request.param} here: {fault.splitlines()[1]}")
    return request.param


@pytest.fixture
def open_renderer(backend: Backend) -> Iterator[Callable[..., Renderer]]:
    """Open renderers on the backend under test; check them for OpenGL errors and release them after the test."""
    opened: list[Renderer] = []

    def opener(models: list[Mesh], layers: np.ndarray, **options: object) -> Renderer:
        opened.append(Renderer(models, layers, backend=backend, **options))
        return opened[-1]

    yield opener
    for renderer in opened:
        # `Renderer.render` checks for OpenGL errors itself; this finds the errors of other calls.
        if renderer._free.alive:  # noqa: SLF001 - a released context has no error state
            with renderer._gl as context:  # noqa: SLF001 - only the renderer has the context
                assert context.error == "GL_NO_ERROR"
        renderer.release()


@pytest.fixture
def program(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., Ended]:
    """Run the program in this process, in the test's temporary folder."""

    def run(*arguments: object) -> Ended:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["semisynth-gl", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            main()
        out, err = capsys.readouterr()
        return Ended(stopped.value.code, out, without_announcements(err))

    return run
