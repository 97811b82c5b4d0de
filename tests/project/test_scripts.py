"""The names that scripts outside the package import from it exist."""

import ast
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = [path for folder in ("benchmarks", "docs", "examples") for path in sorted((ROOT / folder).rglob("*.py"))]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_script_finds_what_it_imports_of_the_package(script):
    imports = [node for node in ast.walk(ast.parse(script.read_text("utf-8"))) if isinstance(node, ast.ImportFrom)]
    for node in imports:
        # semisynth_gl.torch needs PyTorch, which this test does without.
        if node.module.startswith("semisynth_gl") and not node.module.startswith("semisynth_gl.torch"):
            module = import_module(node.module)
            missing = [each.name for each in node.names if not hasattr(module, each.name)]
            assert [name for name in missing if find_spec(f"{node.module}.{name}") is None] == [], node.lineno
