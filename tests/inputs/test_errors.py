"""Parts of error messages: numbers with nouns, shortened values, similar names, and how to install an extra."""

import re
import tomllib
from pathlib import Path

from semisynth_gl.inputs.errors import counted, shown

ROOT = Path(__file__).resolve().parents[2]


def test_a_number_has_its_noun_in_the_right_form():
    assert [counted(number, "pair") for number in (0, 1, 2)] == ["0 pairs", "1 pair", "2 pairs"]
    assert [counted(number, "left patch") for number in (1, 3)] == ["1 left patch", "3 left patches"]


def test_a_long_value_is_cut():
    assert shown("a" * 98) == "'" + "a" * 98 + "'"
    assert shown("a" * 99) == "'" + "a" * 99 + "..."


def test_every_extra_that_a_message_names_exists():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    sources = [path.read_text("utf-8") for path in (ROOT / "semisynth_gl").rglob("*.py")]
    named = {name for text in sources for name in re.findall(r"how_to_install\(['\"](\w+)['\"]\)", text)}
    assert named
    assert named <= extras.keys()
