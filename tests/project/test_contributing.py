"""docs/contributing.md: its lists name files and names that exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "contributing.md").read_text(encoding="utf-8")
ITEM = re.compile(r"^- (?P<item>`.*?)(?=^- |^\*\*|^\n|\Z)", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"`([^`]+)`")
FILE = re.compile(r"[\w./-]+\.(py|glsl|frag|yaml|toml|md)|Makefile")


def items():
    tasks = PAGE[PAGE.index("## Eleven tasks") :]
    return [match["item"] for match in ITEM.finditer(tasks)]


def found(name, folder=None):
    """Return the files of a name, in which NAME and * stand for any; a bare name is in the folder of the one before."""
    pattern = name.replace("NAME", "*")
    bases = [ROOT / "semisynth_gl", ROOT, *([folder] if folder else [])]
    return [path for base in bases for path in base.glob(pattern)]


@pytest.mark.parametrize("item", items())
def test_each_item_names_files_and_what_they_hold(item):
    text, folder = "", None
    names, held = CODE.findall(item), []
    for name in names:
        if FILE.fullmatch(name.replace("*", "x")):
            paths = found(name, folder)
            assert paths, f"docs/contributing.md names {name}, which is not there"
            folder = paths[0].parent
            text += "".join(path.read_text(encoding="utf-8") for path in paths)
        elif re.fullmatch(r"[A-Za-z_]\w*(\.\w+)?", name):
            held.append(name.split(".")[-1])
    for name in held:
        assert re.search(rf"\b{name}\b", text), f"docs/contributing.md: no file of this item has {name}: {item}"


def test_there_are_as_many_tasks_as_the_heading_says():
    tasks = PAGE[PAGE.index("## Eleven tasks") :]
    assert len(items()) > 20
    assert len(re.findall(r"^\*\*[^*]+\*\*", tasks, re.MULTILINE)) == 11
