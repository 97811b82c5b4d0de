"""What messages have in common: cut values, near names, and how to install what an extra has."""

import re
import tomllib
from pathlib import Path

import pytest

from semisynth_gl.errors import cut, did_you_mean, how_to_install, near, shown

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
SOURCES = [path.read_text("utf-8") for path in (ROOT / "semisynth_gl").rglob("*.py")]
NAMED = sorted({name for text in SOURCES for name in re.findall(r"how_to_install\(['\"](\w+)['\"]\)", text)})


def test_a_long_value_is_cut():
    assert shown("a" * 98) == "'" + "a" * 98 + "'"
    assert shown("a" * 99) == "'" + "a" * 99 + "..."
    assert shown([1, 2, 3], 4) == "[1, ..."
    assert shown(-(10**5000)) == "a number of thousands of digits"
    assert (cut("abc", 3), cut("abcd", 3)) == ("abc", "abc...")


def test_a_name_is_near_that_differs_by_a_few_letters():
    known = ("camera", "disparity", "sequence")
    assert near("camra", known) == ["camera"]
    assert near("seed", known) == near("zzz", known) == []
    assert did_you_mean(["a", "b"]) == "did you mean a or b?"
    assert did_you_mean([], "expected c") == "expected c"


@pytest.mark.parametrize("extra", NAMED)
def test_an_extra_is_installed_from_an_index_or_by_its_packages(extra):
    wanted = " ".join(f"'{package}'" for package in EXTRAS[extra])
    assert how_to_install(extra).startswith(f"pip install 'semisynth-gl[{extra}]', or, where ")
    assert how_to_install(extra).endswith(f"pip install {wanted}")


def test_every_message_that_names_an_extra_says_both():
    assert NAMED == ["codecs", "cuda", "matching", "ray", "remote", "torch"]
    assert [text[:80] for text in SOURCES if re.search(r"semisynth-gl\[\w", text)] == []
