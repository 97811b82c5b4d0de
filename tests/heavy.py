"""Packages of hundreds of MB that `make test` does not install."""

from types import ModuleType

import pytest


def heavy(name: str) -> ModuleType:
    """Import a package, or skip the test with a hint how to install it."""
    return pytest.importorskip(name, reason=f"{name.partition('.')[0]} is not installed: make test-heavy brings it")
