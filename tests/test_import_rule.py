"""Only render/ knows OpenGL, and no draw depends on anything but the generator that was handed in."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import semisynth_gl

PACKAGE = Path(semisynth_gl.__file__).resolve().parent
OPENGL = ("moderngl", "glcontext", "OpenGL")

# What a machine without OpenGL must be able to load: everything but what draws and what leads to it.
ROOMS_WITHOUT_OPENGL = (
    "cache",
    "calibration",
    "camera",
    "config",
    "dataset",
    "engines",
    "errors",
    "frame",
    "geometry",
    "interrupts",
    "layouts",
    "listener",
    "metrics",
    "oracle",
    "read",
    "report",
    "resources",
    "scene",
    "seeds",
    "splits",
    "textures",
    "verify",
    "write",
)

# Rooms whose results pair i is made of: their numbers and names come from (config, seed, i) alone.
ROOMS_WITHOUT_CLOCK = (
    "scene",
    "geometry",
    "textures",
    "render",
    "write",
    "camera",
    "config",
    "dataset",
    "frame",
    "layouts",
    "pairs",
    "seeds",
    "splits",
    "torch",
)

GENERATORS = {"Generator", "default_rng", "SeedSequence", "PCG64", "BitGenerator"}
CHANCE_OR_CLOCK = {"random", "uuid", "secrets", "time", "datetime"}


def modules_of(rooms: tuple[str, ...]) -> list[str]:
    """Names of all modules in the rooms named, rooms being modules or packages."""
    paths = [path for path in PACKAGE.rglob("*.py") if path.relative_to(PACKAGE).with_suffix("").parts[0] in rooms]
    names = [".".join(("semisynth_gl", *path.relative_to(PACKAGE).with_suffix("").parts)) for path in sorted(paths)]
    return [name.removesuffix(".__init__") for name in names]


def python_without_opengl(program: str) -> subprocess.CompletedProcess[str]:
    # None in sys.modules makes an import of that name fail, installed or not.
    block = f"import sys; sys.modules.update(dict.fromkeys({OPENGL!r}))\n"
    return subprocess.run([sys.executable, "-c", block + program], capture_output=True, text=True, check=False)


def source_files() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def named(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def imported_modules(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and full name of whatever a file imports, wherever in the file it does."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, name.name) for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.lineno, node.module
            yield from ((node.lineno, f"{node.module}.{name.name}") for name in node.names)


def dotted_names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of every a.b.c in a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            text = ast.unparse(node)
            if all(part.isidentifier() for part in text.split(".")):
                yield node.lineno, text


def opengl_imports(tree: ast.AST) -> list[str]:
    return [f"line {line}: {name}" for line, name in imported_modules(tree) if name.split(".")[0] in OPENGL]


def global_chance(tree: ast.AST) -> list[str]:
    """Uses of the standard library's randomness, and of numpy's beyond its generators."""
    found = []
    for line, name in (*imported_modules(tree), *dotted_names(tree)):
        parts = name.split(".")
        if parts[:2] in (["np", "random"], ["numpy", "random"]) and parts[2:] and parts[2] not in GENERATORS:
            found.append(f"line {line}: {name}")
    return found + [
        f"line {line}: {name}"
        for line, name in imported_modules(tree)
        if name.split(".")[0] in ("random", "uuid", "secrets")
    ]


def chance_or_clock(tree: ast.AST) -> list[str]:
    return [f"line {line}: {name}" for line, name in imported_modules(tree) if name.split(".")[0] in CHANCE_OR_CLOCK]


def test_the_package_and_its_sampler_load_without_opengl() -> None:
    loaded = python_without_opengl("import semisynth_gl, semisynth_gl.scene.sampler")
    assert loaded.returncode == 0, loaded.stderr


def test_a_command_loads_no_package_that_it_does_not_use() -> None:
    # trimesh brings scipy along; each takes about as long to load as all else together.
    large = {"trimesh", "scipy", "matplotlib", "numpy"}
    of_numpy = ((f".{name}", "['numpy']") for name in ("generate", "doctor", "verify", "report", "evaluate"))
    for module, loaded in (("", "[]"), *of_numpy):
        show = f"import sys, semisynth_gl.cli{module}; print(sorted({large} & {{*sys.modules}}))"
        done = subprocess.run([sys.executable, "-c", show], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == loaded, module


def test_every_room_that_does_not_draw_loads_without_opengl() -> None:
    modules = modules_of(ROOMS_WITHOUT_OPENGL)
    assert len(modules) > len(ROOMS_WITHOUT_OPENGL)
    loaded = python_without_opengl(
        "from importlib import import_module\n" + "\n".join(f"import_module({module!r})" for module in modules)
    )
    assert loaded.returncode == 0, loaded.stderr


def test_without_opengl_what_draws_does_not_load() -> None:
    # The block works: else the tests above say nothing.
    assert "ModuleNotFoundError" in python_without_opengl("import semisynth_gl.render.context").stderr


@pytest.mark.parametrize("path", [path for path in source_files() if room_of(path) != "render"], ids=named)
def test_only_render_imports_opengl(path: Path) -> None:
    assert opengl_imports(ast.parse(path.read_text("utf-8"))) == []


@pytest.mark.parametrize("path", [path for path in source_files() if room_of(path) != "torch"], ids=named)
def test_only_its_own_room_imports_torch(path: Path) -> None:
    modules = {name for _, name in imported_modules(ast.parse(path.read_text("utf-8")))}
    assert [name for name in sorted(modules) if f"{name}.".startswith(("torch.", "semisynth_gl.torch."))] == []


def test_without_torch_its_room_says_what_to_install() -> None:
    program = "import sys; sys.modules['torch'] = None; import semisynth_gl.torch"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert "ImportError: semisynth_gl.torch needs PyTorch" in done.stderr
    assert "pip install 'semisynth-gl[torch]'" in done.stderr


@pytest.mark.parametrize("path", [path for path in source_files() if room_of(path) != "seeds"], ids=named)
def test_randomness_arrives_as_a_generator(path: Path) -> None:
    assert global_chance(ast.parse(path.read_text("utf-8"))) == []


# Locks wait for their turn by the clock.
@pytest.mark.parametrize(
    "path",
    [path for path in source_files() if room_of(path) in ROOMS_WITHOUT_CLOCK and path.name != "locks.py"],
    ids=named,
)
def test_what_pairs_are_made_of_knows_no_chance_and_no_clock(path: Path) -> None:
    assert chance_or_clock(ast.parse(path.read_text("utf-8"))) == []


@pytest.mark.parametrize(
    ("source", "checks"),
    [
        ("import moderngl", [opengl_imports]),
        ("def f():\n    from moderngl import Context", [opengl_imports]),
        ("from glcontext import egl", [opengl_imports]),
        ("import random", [global_chance, chance_or_clock]),
        ("from uuid import uuid4", [global_chance, chance_or_clock]),
        ("import time\ntime.time()", [chance_or_clock]),
        ("from time import perf_counter", [chance_or_clock]),
        ("np.random.seed(0)", [global_chance]),
        ("noise = numpy.random.rand(3)", [global_chance]),
        ("from numpy.random import shuffle", [global_chance]),
        ("from numpy import random\nrandom.shuffle(x)", []),
    ],
)
def test_the_walk_finds_what_it_looks_for(source: str, checks: list[object]) -> None:
    tree = ast.parse(source)
    assert [check for check in (opengl_imports, global_chance, chance_or_clock) if check(tree)] == checks


def test_generators_are_no_global_chance() -> None:
    tree = ast.parse("rng: np.random.Generator = np.random.default_rng(np.random.SeedSequence(1))")
    assert global_chance(tree) == []
