"""The built wheel: its files, and running it outside the checkout."""

import os
import sys
import tarfile
import zipfile
from pathlib import Path, PurePosixPath

import pytest
from processes import run_python

CHECKOUT = Path(__file__).resolve().parents[2]
DATA_FOLDERS = ("shaders", "configs", "assets")

# Folders of a checkout that the wheel must not contain.
JUNK = {"out", "build", "dist", "__pycache__", ".git", ".venv", ".pytest_cache", ".mypy_cache", ".ruff_cache"}


def run(*arguments, cwd, **environment):
    done = run_python(*arguments, cwd=cwd, **environment)
    assert done.code == 0, (arguments, done)
    return done.out


def build(what, out):
    run("-m", "build", "--no-isolation", *what, "--outdir", out, CHECKOUT, cwd=out.parent)
    return sorted(out.iterdir())


def data_files():
    """Return all data files of the package, relative to the checkout."""
    paths = (path for folder in DATA_FOLDERS for path in (CHECKOUT / folder).rglob("*") if path.is_file())
    return {path.relative_to(CHECKOUT).as_posix() for path in paths}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    [built] = build(["--wheel"], tmp_path_factory.mktemp("from-checkout") / "dist")
    return built


@pytest.fixture(scope="module")
def target(wheel, tmp_path_factory):
    """Install the wheel into an empty folder."""
    folder = tmp_path_factory.mktemp("installed")
    options = ["--quiet", "--no-index", "--no-deps", "--disable-pip-version-check", "--no-compile"]
    run("-m", "pip", "install", *options, "--target", folder, wheel, cwd=folder)
    return folder


def packages():
    """Return the folders of installed packages."""
    return [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]


def test_the_wheel_holds_the_package_with_its_data_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    modules = {path.relative_to(CHECKOUT).as_posix() for path in (CHECKOUT / "semisynth_gl").rglob("*.py")}
    assert {f"semisynth_gl/{name}" for name in data_files()} | modules | {"semisynth_gl/py.typed"} <= names
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)
    for path in map(PurePosixPath, names):
        assert path.parts[0] == "semisynth_gl" or path.parts[0].endswith(".dist-info"), path
        assert not JUNK & {*path.parts}, path
        assert path.suffix not in (".pyc", ".png", ".pfm"), path


def test_the_sdist_carries_what_a_wheel_and_the_tests_need(tmp_path):
    [sdist] = build(["--sdist"], tmp_path / "dist")
    with tarfile.open(sdist) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames()}
    assert {"pyproject.toml", "README.md", "tests/project/test_packaging.py"} | data_files() <= names
    assert [name for name in names if JUNK & {*PurePosixPath(name).parts}] == []


# One backend is enough to test that the wheel finds all its files, including the photographs that assets/ lists.
@pytest.mark.parametrize("backend", ["egl"], indirect=True)
def test_the_installed_wheel_renders(target, backend, tmp_path):
    # -S ignores .pth files, which an editable install uses to import the checkout.
    elsewhere = {"cwd": tmp_path, "PYTHONPATH": os.pathsep.join([str(target), *packages()])}
    show = "import semisynth_gl; print(semisynth_gl.__file__)"
    assert Path(run("-S", "-c", show, **elsewhere)).is_relative_to(target)
    values = ("camera.width_px=128", "camera.height_px=64", "models.complex=0", "models.variants=1")
    small = [f"--set={value}" for value in (*values, "textures.source=photographs", "textures.max_patches=32")]
    for command, *arguments in (
        ("generate", "--config", "eth3d", "--backend", backend, *small, "--pairs", "1", "--out", "set"),
        ("verify", "set"),
        ("report", "set", "--out", "set.html"),
        ("preview", "--config", "eth3d", "--pairs", "1", *small, "--out", "sheet.png", "--backend", backend),
    ):
        run("-S", target / "bin" / "semisynth-gl", command, *arguments, **elsewhere)
    assert {"set", "set.html", "sheet.png"} == {path.name for path in tmp_path.iterdir()}
