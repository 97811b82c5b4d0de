"""Packages of hundreds of MB, which the tests of `make test` do without."""

from types import ModuleType

import pytest


def heavy(name: str) -> ModuleType:
    """Import a package, or skip what needs it and say how to have it."""
    return pytest.importorskip(name, reason=f"{name.partition('.')[0]} is not installed: make test-heavy brings it")
