"""What the rooms load: OpenGL, PyTorch and slow packages only where they are used; import-linter has the rest."""

import subprocess
import sys
from pathlib import Path

import semisynth_gl

PACKAGE = Path(semisynth_gl.__file__).resolve().parent
# Rooms with a module that cannot be imported without OpenGL.
NEED_OPENGL = {"bench", "calibration", "dataset", "pairs", "render", "torch"}


# Modules of commands that need no larger package than NumPy.
NEED_NUMPY = ("calibrate", "doctor", "evaluate", "generate", "preview", "report", "verify")


def run_python(program: str, without: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    # None in sys.modules makes an import of that name fail, installed or not.
    block = f"import sys; sys.modules.update(dict.fromkeys({without!r}))\n"
    return subprocess.run([sys.executable, "-c", block + program], capture_output=True, text=True, check=False)


def test_the_rooms_that_load_without_opengl() -> None:
    program = "from importlib import import_module\n"
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.name != "__main__.py":
            names = path.relative_to(PACKAGE.parent).with_suffix("").parts
            module = ".".join(names).removesuffix(".__init__")
            program += f"try: import_module({module!r})\nexcept ImportError: print({names[1]!r})\n"
    loading = run_python(program, without=("moderngl", "glcontext"))
    assert loading.returncode == 0, loading.stderr
    assert set(loading.stdout.split()) == NEED_OPENGL


def test_a_command_loads_no_package_that_it_does_not_use() -> None:
    # trimesh brings scipy along; each takes about as long to load as all else together.
    large = {"trimesh", "scipy", "matplotlib", "numpy"}
    of_numpy = ((f".{name}", "['numpy']") for name in NEED_NUMPY)
    for module, loaded in (("", "[]"), *of_numpy):
        done = run_python(f"import semisynth_gl.cli{module}; print(sorted({large} & {{*sys.modules}}))")
        assert done.stdout.strip() == loaded, module


def test_without_torch_its_room_says_what_to_install() -> None:
    loading = run_python("import semisynth_gl.torch", without=("torch",))
    assert "ImportError: semisynth_gl.torch needs PyTorch" in loading.stderr
    assert "pip install 'semisynth-gl[torch]'" in loading.stderr
