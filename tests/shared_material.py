"""Test files outside the repository; CI has them."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[1].parent / "shared" / "data"

needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="test material ../shared/data is absent")
"""Mark of a test that reads some of it."""
