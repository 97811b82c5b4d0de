"""Scripts beside the package fit it: whatever they import is there, and they do nothing when they are imported."""

import os
import sys
from pathlib import Path
from runpy import run_path
from unittest.mock import MagicMock

import pytest
from heavy import heavy

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("benchmarks", "benchmarks/peers", "benchmarks/training", "docs", "examples")
SCRIPTS = sorted(path for folder in FOLDERS for path in (ROOT / folder).glob("*.py"))
# What peers draw with; it is in environments of their own.
OF_PEERS = (
    "bpy", "gpu", "mathutils", "OpenGL", "OpenGL.GL", "pygfx", "pyrender", "pyrender.renderer", "wgpu"
)  # fmt: skip
# What the benchmark of patch networks learns with; it is in an environment beside this one, too.
OF_PATCHES = (
    "h5py", "mc_cnn", "mc_cnn.dataset_generator", "mc_cnn.dataset_generator.middlebury_generator", "mc_cnn.model",
    "mc_cnn.model.mc_cnn_fast", "mc_cnn.weights"
)  # fmt: skip
# They import PyTorch.
WITH_TORCH = (
    "benchmarks/stream.py",
    "benchmarks/training/compare_sets.py",
    "benchmarks/training/compare_patches.py",
    "benchmarks/training/matching_network.py",
    "benchmarks/training/patch_network.py",
    "benchmarks/training/trainer.py",
    "examples/network_data.py",
    "examples/network_form.py",
    "examples/network_losses.py",
    "examples/network_training.py",
    "examples/predict.py",
    "examples/public_networks.py",
    "examples/stereo_network.py",
    "examples/train_network.py",
)


def cases():
    for script in SCRIPTS:
        name = script.relative_to(ROOT).as_posix()
        yield pytest.param(script, id=name, marks=[pytest.mark.heavy] if name in WITH_TORCH else [])


@pytest.mark.parametrize("script", list(cases()))
def test_a_script_finds_what_it_imports(monkeypatch, capfd, script):
    if script.relative_to(ROOT).as_posix() in WITH_TORCH:
        heavy("torch")
    monkeypatch.syspath_prepend(str(script.parent))
    monkeypatch.setattr(sys, "argv", [str(script), "--no-such-option"])
    monkeypatch.setattr(os, "environ", os.environ.copy())
    for name in (*OF_PEERS, *OF_PATCHES):
        monkeypatch.setitem(sys.modules, name, MagicMock(name=name))
    run_path(str(script), run_name="imported")
    assert "".join(capfd.readouterr()) == ""
