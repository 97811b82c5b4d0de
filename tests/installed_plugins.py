"""Plug-in packages for the tests, installed in folders of their own."""

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
    """Build the wheel of the example by its own pyproject.toml; return the wheel's path."""
    patch.chdir(shutil.copytree(EXAMPLE, folder / "acme-stereo", ignore=shutil.ignore_patterns("__pycache__")))
    return Path.cwd() / build.build_wheel(str(Path.cwd()))


def unpack(wheel, folder):
    """Install a wheel of Python modules alone: pip --target unpacks it likewise."""
    shutil.unpack_archive(wheel, folder, "zip")


def write_package(folder, code, version="0.3"):
    """Write the installed package other-plugins with one module, whose `PLUGINS` has its plug-ins."""
    info = folder / f"other_plugins-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: other-plugins\nVersion: {version}\n")
    (info / "entry_points.txt").write_text("[semisynth_gl.plugins]\nother_plugins = other_plugins:PLUGINS\n")
    (folder / "other_plugins.py").write_text(code)


def find_anew():
    """Forget which plug-ins there are, and their modules, as a new process would."""
    importlib.invalidate_caches()
    plugins.installed_plugins.cache_clear()
    find_layout.cache_clear()
    for name in [name for name in sys.modules if name.partition(".")[0] in ("acme_stereo", "other_plugins")]:
        del sys.modules[name]
