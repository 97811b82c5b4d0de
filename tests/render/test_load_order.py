"""Packages with an LLVM of their own beside Mesa's driver: in whatever order they come, nothing crashes."""

import os
import re
import shutil
import subprocess
import sys
from itertools import permutations

import pytest
from glcontext import egl
from heavy import heavy

from semisynth_gl.render.devices import LIBRARIES

STEPS = {
    "context": "context = open_context({backend!r})",
    "torch": "import torch",
    "triton": "import triton",
    "devices": "missing_libraries(), egl_devices()",
    "training": """
import torch
network = torch.nn.Linear(3, 1)
optimiser = torch.optim.Adam(network.parameters())
network(torch.ones(2, 3)).sum().backward()
optimiser.step()
""",
}
ORDERS = [*permutations(["context", "torch", "triton"]), ("context", "training"), ("devices", "context", "triton")]


def run(backend, steps, folder=None, **environment):
    program = [
        "import sys",
        "from semisynth_gl.render.context import open_context",
        "from semisynth_gl.render.devices import egl_devices, missing_libraries",
        *(STEPS.get(step, step).format(backend=backend) for step in steps),
        "print(context.gl.info['GL_RENDERER'])",
    ]
    paths = filter(None, (folder and str(folder), os.environ.get("PYTHONPATH")))
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(program)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)} | environment,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"exit code {done.returncode}\n{done.stderr}"
    return done.stdout.splitlines()


@pytest.mark.heavy
@pytest.mark.one_backend
@pytest.mark.parametrize("order", ORDERS, ids=" ".join)
def test_no_order_of_imports_crashes(order, backend):
    for step in order:
        if step in ("torch", "triton", "training"):
            heavy("torch" if step == "training" else step)
    assert run(backend, order)


@pytest.fixture
def stand_in(tmp_path):
    """A package called triton whose library is one of OpenGL's own, and which nobody may import."""
    library = tmp_path / "triton" / "_C" / "libtriton.so"
    library.parent.mkdir(parents=True)
    (library.parents[1] / "__init__.py").write_text("raise SystemExit('triton was imported')")
    shutil.copy(egl.__file__, library)
    return library


def loaded(folder):
    """The libraries that a process loaded, in order, by glibc's account of it."""
    [log] = folder.glob("loaded.*")
    return re.findall(r"file=(\S+) \[0\];  generating link map", log.read_text())


@pytest.mark.parametrize("first", ["context", "devices"])
def test_the_library_is_loaded_before_any_driver(stand_in, backend, tmp_path, first):
    run(backend, [first, "context"], tmp_path, LD_DEBUG="files", LD_DEBUG_OUTPUT=str(tmp_path / "loaded"))
    names = loaded(tmp_path)
    of_opengl = [names.index(name) for name in LIBRARIES if name in names]
    assert names.count(str(stand_in)) == 1
    assert names.index(str(stand_in)) < min(of_opengl)


@pytest.mark.one_backend
def test_the_library_lends_its_symbols_to_no_other(stand_in, backend, tmp_path):
    assert b"PyInit_egl" in stand_in.read_bytes()
    shown = "import ctypes; print(hasattr(ctypes.CDLL(None), 'PyInit_egl'))"
    assert run(backend, ["context", shown], tmp_path)[0] == "False"


@pytest.mark.one_backend
@pytest.mark.parametrize("fault", ["no library", "broken library", "not a package", "no specification"])
def test_a_triton_without_a_sound_library_keeps_no_context_from_opening(stand_in, backend, tmp_path, fault):
    steps = ["context"]
    match fault:
        case "no library":
            stand_in.unlink()
        case "broken library":
            stand_in.write_bytes(b"no library")
        case "not a package":
            shutil.rmtree(stand_in.parents[1])
            (tmp_path / "triton.py").write_text("raise SystemExit('triton was imported')")
        case "no specification":
            steps = ["import types; sys.modules['triton'] = types.ModuleType('triton')", "context"]
    assert run(backend, steps, tmp_path)
