"""The rooms of the package keep to docs/rooms.toml; each test walks all files and lists every offender."""

import ast
import runpy
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

import semisynth_gl

PACKAGE = Path(semisynth_gl.__file__).resolve().parent
DOCS = Path(__file__).resolve().parents[2] / "docs"
sys.path.insert(0, str(DOCS))  # make_rooms.py imports a module that lies beside it
ROOMS = {room["name"]: room for room in tomllib.loads((DOCS / "rooms.toml").read_text("utf-8"))["room"]}

OPENGL = ("moderngl", "glcontext", "OpenGL")
GENERATORS = {"Generator", "default_rng", "SeedSequence", "PCG64", "BitGenerator"}

Finder = Callable[[ast.AST], Iterable[str]]


@cache
def sources() -> dict[Path, ast.Module]:
    """The package's files; not read by workers that only collect these tests."""
    return {path.relative_to(PACKAGE): ast.parse(path.read_text("utf-8")) for path in sorted(PACKAGE.rglob("*.py*"))
            if path.suffix in (".py", ".pyi")}  # fmt: skip


def room_of(path: Path) -> str:
    return path.with_suffix("").parts[0]


def flagged(flag: str) -> set[str]:
    return {name for name, room in ROOMS.items() if room.get(flag)}


def imports(tree: ast.AST) -> Iterator[str]:
    """The full names that a file imports, anywhere in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{'.' * node.level}{node.module or ''}.{alias.name}" for alias in node.names)


def dotted_names(tree: ast.AST) -> Iterator[str]:
    """The text of every a.b.c in a file."""
    texts = (ast.unparse(node) for node in ast.walk(tree) if isinstance(node, ast.Attribute))
    return (text for text in texts if all(part.isidentifier() for part in text.split(".")))


def imports_from(tree: ast.AST, *packages: str) -> list[str]:
    return [name for name in imports(tree) if name.split(".")[0] in packages]


def opengl(tree: ast.AST) -> list[str]:
    return imports_from(tree, *OPENGL)


def torch(tree: ast.AST) -> list[str]:
    return imports_from(tree, "torch")


def clock(tree: ast.AST) -> list[str]:
    return imports_from(tree, "time", "datetime")


def global_randomness(tree: ast.AST) -> list[str]:
    """Uses of the standard library's randomness, and of numpy's beyond its generators."""
    split = ((name, name.split(".")) for name in (*imports(tree), *dotted_names(tree)))
    numpys = [
        name
        for name, parts in split
        if parts[0] in ("np", "numpy") and parts[1:2] == ["random"] and parts[2:] and parts[2] not in GENERATORS
    ]
    return imports_from(tree, "random", "uuid", "secrets") + numpys


def rooms_used(tree: ast.AST) -> Iterator[str]:
    """The names in the package that a file imports: scene.raycast.cast_rays, or __init__.X for `semisynth_gl.X`."""
    for name in imports(tree):
        if name.startswith("."):
            yield name
        elif name.split(".")[0] == "semisynth_gl":
            inner = name.removeprefix("semisynth_gl").removeprefix(".")
            yield inner if inner.split(".")[0] in ROOMS else f"__init__.{inner}"


def offenders(finder: Finder, allowed: Callable[[Path], bool]) -> list[str]:
    """Every finding in a file where it is not allowed."""
    return [
        f"{path.as_posix()}: {finding}"
        for path, tree in sources().items()
        if not allowed(path)
        for finding in finder(tree)
    ]


def python_without(packages: tuple[str, ...], program: str) -> subprocess.CompletedProcess[str]:
    # None in sys.modules makes an import of that name fail, installed or not.
    block = f"import sys; sys.modules.update(dict.fromkeys({packages!r}))\n"
    return subprocess.run([sys.executable, "-c", block + program], capture_output=True, text=True, check=False)


def test_the_list_has_every_room_and_no_other() -> None:
    assert set(ROOMS) == {room_of(path) for path in sources()}


def test_a_room_uses_only_rooms_below_it() -> None:
    order = list(ROOMS)
    upward = [
        f"{name} uses {use}"
        for name, room in ROOMS.items()
        for use in room["uses"]
        if use.split(".")[0] not in order[order.index(name) + 1 :]
    ]
    assert upward == []


def test_a_room_uses_what_its_list_says_and_no_more() -> None:
    unlisted, used = [], set()
    for path, tree in sources().items():
        room = room_of(path)
        for name in rooms_used(tree):
            uses = [(room, use) for use in (room, *ROOMS[room]["uses"]) if f"{name}.".startswith(f"{use}.")]
            used.update(uses)
            if not uses:
                unlisted.append(f"{path.as_posix()}: {name}")
    assert unlisted == []
    assert [f"{name}: {use}" for name, room in ROOMS.items() for use in room["uses"] if (name, use) not in used] == []


def test_only_the_rooms_that_may_import_opengl_or_torch() -> None:
    for flag, finder in (("opengl", opengl), ("torch", torch)):
        assert offenders(finder, lambda path, flag=flag: room_of(path) in flagged(flag)) == []
        assert {room_of(path) for path, tree in sources().items() if finder(tree)} == flagged(flag)


def test_randomness_arrives_as_a_generator() -> None:
    assert offenders(global_randomness, lambda _: False) == []


def test_only_the_modules_that_may_read_the_clock() -> None:
    def allowed(path: Path) -> bool:
        return any(path.match(f"{room_of(path)}/{pattern}") for pattern in ROOMS[room_of(path)].get("clock", ()))

    assert offenders(clock, allowed) == []
    patterns = {(name, pattern) for name in flagged("clock") for pattern in ROOMS[name]["clock"]}
    readers = [path for path, tree in sources().items() if clock(tree)]
    assert [
        f"{name}/{pattern} reads no clock"
        for name, pattern in sorted(patterns)
        if not any(path.match(f"{name}/{pattern}") for path in readers)
    ] == []


def test_the_rooms_that_load_without_opengl() -> None:
    modules = {
        path: ".".join(("semisynth_gl", *path.with_suffix("").parts)).removesuffix(".__init__") for path in sources()
    }
    program = "from importlib import import_module\n"
    for path, module in modules.items():
        if path.suffix == ".py" and path.name != "__main__.py":
            program += f"try: import_module({module!r})\nexcept ImportError: print({room_of(path)!r})\n"
    loading = python_without(OPENGL, program)
    assert loading.returncode == 0, loading.stderr
    # Rooms that draw do not load: the block works, else this test would say nothing of the other rooms.
    assert set(loading.stdout.split()) == flagged("needs_opengl")


def test_a_command_loads_no_package_that_it_does_not_use() -> None:
    # trimesh brings scipy along; each takes about as long to load as all else together.
    large = {"trimesh", "scipy", "matplotlib", "numpy"}
    of_numpy = ((f".{name}", "['numpy']") for name in ("generate", "doctor", "verify", "report", "evaluate"))
    for module, loaded in (("", "[]"), *of_numpy):
        show = f"import sys, semisynth_gl.cli{module}; print(sorted({large} & {{*sys.modules}}))"
        done = subprocess.run([sys.executable, "-c", show], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == loaded, module


def test_without_torch_its_room_says_what_to_install() -> None:
    loading = python_without(("torch",), "import semisynth_gl.torch")
    assert "ImportError: semisynth_gl.torch needs PyTorch" in loading.stderr
    assert "pip install 'semisynth-gl[torch]'" in loading.stderr


def test_each_folder_of_tests_is_named_after_what_it_tests() -> None:
    tests = Path(__file__).parents[1]
    folders = {path.parent for path in tests.rglob("test_*.py")}
    # A folder called torch would be imported where PyTorch is missing.
    others = {"project", "benchmarks", "examples", "pytorch"}
    assert tests not in folders
    assert {folder.name for folder in folders} - others <= ROOMS.keys()


def test_tests_import_neither_each_other_nor_conftest() -> None:
    shared = [
        f"{path.name}: {name}"
        for path in sorted(Path(__file__).parents[1].rglob("*.py"))
        for name in imports(ast.parse(path.read_text("utf-8")))
        if name.removeprefix("tests.").startswith(("test_", "conftest"))
    ]
    assert shared == []


def test_the_page_has_the_table_of_the_rooms() -> None:
    page = (DOCS / "contributing.md").read_text("utf-8")
    assert page == runpy.run_path(str(DOCS / "make_rooms.py"))["page_with_rooms"](page), "run docs/make_rooms.py"


@pytest.mark.parametrize(
    ("source", "finders"),
    [
        ("import moderngl", [opengl]),
        ("def f():\n    from moderngl import Context", [opengl]),
        ("from glcontext import egl", [opengl]),
        ("from torch.utils import data", [torch]),
        ("import random", [global_randomness]),
        ("from uuid import uuid4", [global_randomness]),
        ("np.random.seed(0)", [global_randomness]),
        ("noise = numpy.random.rand(3)", [global_randomness]),
        ("from numpy.random import shuffle", [global_randomness]),
        ("from numpy import random\nrandom.shuffle(x)", []),
        ("rng: np.random.Generator = np.random.default_rng(np.random.SeedSequence(1))", []),
        ("import time\ntime.time()", [clock]),
        ("from time import perf_counter", [clock]),
    ],
)
def test_the_walk_finds_what_it_looks_for(source: str, finders: list[Finder]) -> None:
    tree = ast.parse(source)
    assert [finder for finder in (opengl, torch, global_randomness, clock) if finder(tree)] == finders


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("import semisynth_gl", ["__init__."]),
        ("from semisynth_gl import load_config", ["__init__.load_config"]),
        ("from semisynth_gl import cli", ["cli"]),
        ("def f():\n    from semisynth_gl.scene.scene import Scene", ["scene.scene.Scene"]),
        ("import semisynth_gl.render.context", ["render.context"]),
        ("from . import scene", ["..scene"]),
        ("import numpy, semisynth_glue", []),
    ],
)
def test_the_walk_names_the_rooms_that_a_file_uses(source: str, names: list[str]) -> None:
    assert list(rooms_used(ast.parse(source))) == names
