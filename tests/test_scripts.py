"""Scripts beside the package fit it: whatever they import is there, and they do nothing when they are imported."""

import os
import sys
from pathlib import Path
from runpy import run_path
from unittest.mock import MagicMock

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("benchmarks", "benchmarks/peers", "docs", "examples")
SCRIPTS = sorted(path for folder in FOLDERS for path in (ROOT / folder).glob("*.py"))
# What peers draw with; it is in environments of their own.
OF_PEERS = (
    "bpy", "gpu", "mathutils", "OpenGL", "OpenGL.GL", "pygfx", "pyrender", "pyrender.renderer", "wgpu"
)  # fmt: skip
# What not every environment has.
EXTRAS = {"cv2", "matplotlib", "torch", "webdataset"}


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_script_finds_what_it_imports(monkeypatch, capfd, script):
    monkeypatch.syspath_prepend(str(script.parent))
    monkeypatch.setattr(sys, "argv", [str(script), "--no-such-option"])
    monkeypatch.setattr(os, "environ", os.environ.copy())
    for name in OF_PEERS:
        monkeypatch.setitem(sys.modules, name, MagicMock(name=name))
    try:
        run_path(str(script), run_name="imported")
    except ModuleNotFoundError as error:
        if error.name not in EXTRAS:
            raise
        pytest.skip(f"no {error.name} here")
    assert "".join(capfd.readouterr()) == ""
