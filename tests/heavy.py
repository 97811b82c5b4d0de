"""Packages which the tests of `make test` do without: those of hundreds of MB, and those that build the site."""

from types import ModuleType

import pytest


def heavy(name: str) -> ModuleType:
    """Import a package, or skip what needs it and say how to have it."""
    return pytest.importorskip(name, reason=f"{name.partition('.')[0]} is not installed: make test-heavy brings it")
