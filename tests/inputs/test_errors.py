"""What messages have in common: numbers with nouns, cut values, near names, and how to install an extra."""

import ast
import re
import tomllib
from itertools import pairwise
from pathlib import Path

import pytest

from semisynth_gl.inputs.errors import counted, cut, did_you_mean, how_to_install, near, shown

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
SOURCES = [path.read_text("utf-8") for path in (ROOT / "semisynth_gl").rglob("*.py")]
LEFT_OUT = {".venv", "build", "results", "made", "tests"}
NAMED = sorted({name for text in SOURCES for name in re.findall(r"how_to_install\(['\"](\w+)['\"]\)", text)})


# Nouns that messages count most.
COUNTED = re.compile(
    r" (?:more |left |other )?(pairs|photographs|images|shards|files|maps|patches|crops|measures|findings)\b"
)
NUMBER = re.compile(r"^(len|sum|max)\(|count|total|number|pairs|missing|kept|found|shards")


def test_a_number_has_its_noun_in_the_right_form():
    assert [counted(number, "pair") for number in (0, 1, 2)] == ["0 pairs", "1 pair", "2 pairs"]
    assert [counted(number, "left patch") for number in (1, 3)] == ["1 left patch", "3 left patches"]
    assert [counted(number, "kind of model") for number in (1, 2)] == ["1 kind of model", "2 kinds of model"]


def test_messages_count_by_the_one_function():
    """No "1 pairs": a text with a number before a plural takes it from `counted`."""
    uncounted = [
        f"{path.name}:{text.lineno}: {ast.unparse(value)}{plural[0]}"
        for path in (ROOT / "semisynth_gl").rglob("*.py")
        for text in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(text, ast.JoinedStr)
        for value, after in pairwise(text.values)
        if isinstance(value, ast.FormattedValue)
        and NUMBER.search(ast.unparse(value.value))
        and isinstance(after, ast.Constant)
        and (plural := COUNTED.match(str(after.value)))
    ]
    assert uncounted == []


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
    assert NAMED == ["cuda", "opencv", "ray", "remote", "torch"]
    assert [text[:80] for text in SOURCES if re.search(r"semisynth-gl\[\w", text)] == []


def test_every_extra_that_a_page_or_script_installs_exists():
    """`semisynth-gl[NAME]` and `.[NAME]`, wherever the project's texts have them."""
    endings = {".md", ".ipynb", ".py", ".sh", ".yml", ".toml"}
    texts = [
        path for path in ROOT.rglob("*") if path.suffix in endings and not LEFT_OUT & {*path.relative_to(ROOT).parts}
    ]
    texts += [ROOT / "Makefile", ROOT / "Containerfile", ROOT / ".ci" / "run", *(ROOT / ".github").rglob("*.yml")]
    named = {
        (str(path.relative_to(ROOT)), extra.strip())
        for path in texts
        for extras in re.findall(r"(?:semisynth-gl|[\s'\"]\.)\[(\w[\w, -]*)\]", path.read_text("utf-8"))
        for extra in extras.split(",")
    }
    assert {extra for _, extra in named} > {"dev", "docs", "heavy", "opencv", "ray", "remote", "torch"}
    assert {(page, extra) for page, extra in named if extra not in EXTRAS} == set()
