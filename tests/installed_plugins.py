"""Plug-in packages, installed into temporary folders."""

import importlib
import shutil
import sys
from pathlib import Path

from hatchling import build

from semisynth_gl import plugins
from semisynth_gl.layouts import find_layout

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "acme-stereo"
"""The package that docs/extending.md tells of."""


def build_example(folder, patch):
    """Build the example's wheel; return its path."""
    patch.chdir(shutil.copytree(EXAMPLE, folder / "acme-stereo", ignore=shutil.ignore_patterns("__pycache__")))
    return Path.cwd() / build.build_wheel(str(Path.cwd()))


def unpack(wheel, folder):
    """Install a pure Python wheel as `pip install --target` does."""
    shutil.unpack_archive(wheel, folder, "zip")


def write_package(folder, code, version="0.3"):
    """Write an installed package, other-plugins, whose module has the plug-ins in `PLUGINS`."""
    info = folder / f"other_plugins-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: other-plugins\nVersion: {version}\n")
    (info / "entry_points.txt").write_text("[semisynth_gl.plugins]\nother_plugins = other_plugins:PLUGINS\n")
    (folder / "other_plugins.py").write_text(code)


def find_anew():
    """Forget the plug-ins that were found and their modules, as in a new process."""
    importlib.invalidate_caches()
    plugins.installed_plugins.cache_clear()
    find_layout.cache_clear()
    for name in [name for name in sys.modules if name.partition(".")[0] in ("acme_stereo", "other_plugins")]:
        del sys.modules[name]
