"""The rooms of the package, listed from top to bottom in docs/contributing.md: each imports only rooms below it."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import semisynth_gl

PACKAGE = Path(semisynth_gl.__file__).resolve().parent
PAGE = (Path(__file__).resolve().parents[2] / "docs" / "contributing.md").read_text("utf-8")
ROOMS = re.findall(r"^- `(\w+)(?:/|\.py)`: ", PAGE, re.MULTILINE)

OPENGL = ("moderngl", "glcontext", "OpenGL")
# Nothing that goes into a pair depends on the clock: these measure how long a run takes.
CLOCKS = {"cli/progress.py", "cli/report.py", "cli/verify.py", "dataset/make.py"}
# Rooms with a module that cannot be imported without OpenGL.
NEED_OPENGL = {"bench", "calibration", "dataset", "pairs", "render", "torch"}


@cache
def imports() -> dict[Path, list[str]]:
    """The full names that each file imports, anywhere in it; not read by workers that only collect these tests."""
    paths = [path for path in sorted(PACKAGE.rglob("*.py*")) if path.suffix in (".py", ".pyi")]
    return {path.relative_to(PACKAGE): list(imported_names(path.read_text("utf-8"))) for path in paths}


def imported_names(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{'.' * node.level}{node.module or ''}.{alias.name}" for alias in node.names)


def room_of(path: Path) -> str:
    return path.with_suffix("").parts[0]


def rooms_used(names: list[str]) -> list[str]:
    """The rooms of names that a file imports; __init__ for `semisynth_gl.load_config`, relative names as they are."""
    rooms = [name.split(".")[1] for name in names if name.startswith("semisynth_gl.")]
    relative = [name for name in names if name.startswith(".")]
    return relative + [room if room in ROOMS else "__init__" for room in rooms]


def importers(*packages: str) -> set[Path]:
    return {path for path, names in imports().items() if any(name.split(".")[0] in packages for name in names)}


def run_python(program: str, without: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    # None in sys.modules makes an import of that name fail, installed or not.
    block = f"import sys; sys.modules.update(dict.fromkeys({without!r}))\n"
    return subprocess.run([sys.executable, "-c", block + program], capture_output=True, text=True, check=False)


def test_the_page_lists_every_room_and_no_other() -> None:
    assert sorted(ROOMS) == sorted({room_of(path) for path in imports()})


def test_a_room_uses_only_rooms_below_it() -> None:
    upward = [
        f"{path} imports {used}"
        for path, names in imports().items()
        for used in rooms_used(names)
        if used not in ROOMS[ROOMS.index(room_of(path)) :]
    ]
    assert upward == []


def test_the_oracle_shares_no_room_with_the_renderer() -> None:
    reached, new = set(), {"oracle"}
    while new:
        reached |= new
        new = {used for path, names in imports().items() if room_of(path) in new for used in rooms_used(names)}
        new -= reached
    assert reached & {"render", "pairs", "dataset"} == set()


def test_opengl_torch_and_the_clock_are_imported_where_they_may_be() -> None:
    assert {room_of(path) for path in importers(*OPENGL)} == {"render"}
    assert {room_of(path) for path in importers("torch")} == {"torch"}
    assert {path.as_posix() for path in importers("time", "datetime") if room_of(path) != "bench"} == CLOCKS


def test_the_rooms_that_load_without_opengl() -> None:
    program = "from importlib import import_module\n"
    for path in imports():
        if path.suffix == ".py" and path.name != "__main__.py":
            module = ".".join(("semisynth_gl", *path.with_suffix("").parts)).removesuffix(".__init__")
            program += f"try: import_module({module!r})\nexcept ImportError: print({room_of(path)!r})\n"
    loading = run_python(program, without=OPENGL)
    assert loading.returncode == 0, loading.stderr
    assert set(loading.stdout.split()) == NEED_OPENGL


def test_a_command_loads_no_package_that_it_does_not_use() -> None:
    # trimesh brings scipy along; each takes about as long to load as all else together.
    large = {"trimesh", "scipy", "matplotlib", "numpy"}
    of_numpy = ((f".{name}", "['numpy']") for name in ("generate", "doctor", "verify", "report", "evaluate"))
    for module, loaded in (("", "[]"), *of_numpy):
        done = run_python(f"import semisynth_gl.cli{module}; print(sorted({large} & {{*sys.modules}}))")
        assert done.stdout.strip() == loaded, module


def test_without_torch_its_room_says_what_to_install() -> None:
    loading = run_python("import semisynth_gl.torch", without=("torch",))
    assert "ImportError: semisynth_gl.torch needs PyTorch" in loading.stderr
    assert "pip install 'semisynth-gl[torch]'" in loading.stderr
