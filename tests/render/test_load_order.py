"""Packages that bundle LLVM do not crash Mesa's driver, whichever loads first."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from glcontext import egl
from heavy import heavy
from processes import run_python

from semisynth_gl.render.context import context_facts

pytestmark = pytest.mark.one_backend
STEPS = {
    "context": "from semisynth_gl.render.context import open_context; context = open_context({backend!r})",
    "torch": "import torch",
    "triton": "import triton",
    "devices": "from semisynth_gl.render.devices import egl_devices; egl_devices()",
    "training": """
import torch
network = torch.nn.Linear(3, 1)
optimiser = torch.optim.Adam(network.parameters())
network(torch.ones(2, 3)).sum().backward()
optimiser.step()
""",
}


def run(backend, steps, folder=None, **environment):
    program = "\n".join(STEPS.get(step, step).format(backend=backend) for step in steps)
    paths = os.pathsep.join(filter(None, (folder and str(folder), os.environ.get("PYTHONPATH"))))
    done = run_python("-c", program, **{"PYTHONPATH": paths} | environment)
    assert done.code == 0, f"exit code {done.code}\n{done.err}"
    return done.out


@pytest.mark.heavy
@pytest.mark.parametrize("order", ["triton context torch", "torch context triton", "context training"])
def test_no_order_of_imports_crashes(order, backend):
    for step in order.split():
        if step != "context":
            heavy("torch" if step == "training" else step)
    run(backend, order.split())


@pytest.fixture
def stand_in(tmp_path):
    """Make a package triton that cannot be imported; its library is a copy of glcontext's."""
    library = tmp_path / "triton" / "_C" / "libtriton.so"
    library.parent.mkdir(parents=True)
    (library.parents[1] / "__init__.py").write_text("raise SystemExit('triton was imported')")
    shutil.copy(egl.__file__, library)
    return library


@pytest.mark.parametrize("first", ["context", "devices"])
def test_the_library_is_loaded_before_any_driver_and_lends_its_symbols_to_no_other(stand_in, backend, tmp_path, first):
    assert b"PyInit_egl" in stand_in.read_bytes()
    shown = "import ctypes; print(hasattr(ctypes.CDLL(None), 'PyInit_egl'))"
    log = {"LD_DEBUG": "files", "LD_DEBUG_OUTPUT": str(tmp_path / "loaded")}
    assert run(backend, [first, "context", shown], tmp_path, **log) == "False\n"
    # Read glibc's log of loaded libraries.
    [log] = tmp_path.glob("loaded.*")
    names = re.findall(r"file=(\S+) \[0\];  generating link map", log.read_text())
    assert names.count(str(stand_in)) == 1
    drivers = [name for name in names if re.match(r"lib(EGL|GL|OSMesa)\b", name)]
    assert names.index(str(stand_in)) < names.index(drivers[0])


@pytest.mark.parametrize("fault", ["broken library", "no specification"])
def test_a_triton_without_a_sound_library_keeps_no_context_from_opening(stand_in, backend, tmp_path, fault):
    stand_in.write_bytes(b"no library")
    without = ["import sys, types; sys.modules['triton'] = types.ModuleType('triton')"]
    run(backend, [*(without if fault == "no specification" else []), "context"], tmp_path)


@pytest.mark.heavy
def test_drawing_passes_its_tests_on_narrow_vectors(backend, tmp_path):
    """llvmpipe uses 128-bit vectors on ARM and on x86 without AVX, and 256-bit vectors otherwise."""
    if "llvmpipe" not in context_facts(backend)["renderer"]:
        pytest.skip(f"{backend} does not draw with llvmpipe here")
    # The new pytest must not act as an xdist worker. Mesa's shader cache does not distinguish vector widths.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment |= {"LP_NATIVE_VECTOR_WIDTH": "128", "MESA_SHADER_CACHE_DIR": str(tmp_path / "shaders")}
    command = "-m", "pytest", "--quiet", "-p", "no:cacheprovider", "--basetemp", str(tmp_path / "run")
    chosen = f"{backend} and (sky or analytic or texel or near_to_many or crowds)"
    folder = Path(__file__).parent
    files = "test_truth.py", "test_exactness.py", "test_images.py", "test_antialias_edges.py", "test_occlusion.py"
    command = [sys.executable, *command, "-k", chosen, *files]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
