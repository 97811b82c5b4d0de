"""Rooms import OpenGL, PyTorch and slow packages only where they use them; import-linter checks other imports."""

from pathlib import Path

from processes import run_python

import semisynth_gl

PACKAGE = Path(semisynth_gl.__file__).resolve().parent
# Rooms with a module that cannot be imported without OpenGL.
NEED_OPENGL = {"bench", "calibration", "dataset", "pairs", "render", "torch"}


def run(program, without=()):
    # None in sys.modules makes an import of that name fail, installed or not.
    return run_python("-c", f"import sys; sys.modules.update(dict.fromkeys({without!r}))\n{program}")


def test_the_rooms_that_load_without_opengl():
    program = "from importlib import import_module\n"
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.name != "__main__.py":
            names = path.relative_to(PACKAGE.parent).with_suffix("").parts
            module = ".".join(names).removesuffix(".__init__")
            program += f"try: import_module({module!r})\nexcept ImportError: print({names[1]!r})\n"
    loading = run(program, without=("moderngl", "glcontext"))
    assert loading.code == 0, loading.err
    assert set(loading.out.split()) == NEED_OPENGL


def test_a_command_loads_no_package_that_it_does_not_use():
    # trimesh imports scipy; each takes about as long to import as everything else together.
    large = {"trimesh", "scipy", "matplotlib", "numpy"}
    light = ("calibrate", "doctor", "evaluate", "generate", "preview", "report", "verify")
    for module, loaded in (("", "[]"), *((f".{name}", "['numpy']") for name in light)):
        done = run(f"import semisynth_gl.cli{module}; print(sorted({large} & {{*sys.modules}}))")
        assert done.out.strip() == loaded, module


def test_without_torch_its_room_says_what_to_install():
    loading = run("import semisynth_gl.torch", without=("torch",))
    assert "ImportError: semisynth_gl.torch needs PyTorch" in loading.err
    assert "pip install 'semisynth-gl[torch]'" in loading.err
