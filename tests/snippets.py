"""Code blocks of README, docs and examples, and the names that the reference documents."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_FOLDERS = (ROOT / "docs", ROOT / "examples")
PAGES = {
    page.stem: page for page in (ROOT / "README.md", *(page for it in _FOLDERS for page in sorted(it.glob("*.md"))))
}

REFERENCE = sorted((ROOT / "docs" / "reference").glob("*.md"))

_MARK = re.compile(r"<!-- (runnable|runnable: heavy|not run: \S.*) -->")
_FENCE = re.compile(r"( *)```(.*)")


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced code block.

    Attributes:
        place: file and line, for messages.
        language: the word after the fence.
        mark: the comment on the line before: "runnable", "runnable: heavy", "not run: REASON", or nothing.
        text: the lines inside.
    """

    place: str
    language: str
    mark: str
    text: str

    @property
    def commands(self) -> list[list[str]]:
        """Split each command into words, without comments; in a terminal session, the lines after "$ "."""
        lines = self.text.replace("\\\n", " ").splitlines()
        if self.language == "console":
            lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        return [words for line in lines if (words := shlex.split(line, comments=True))]


def blocks(page: str) -> list[Block]:
    """Return a page's fenced blocks in order."""
    path = PAGES[page]
    lines = path.read_text("utf-8").splitlines()
    found: list[Block] = []
    start = None
    for number, line in enumerate(lines):
        fence = _FENCE.fullmatch(line)
        if fence and start is None:
            start = number
        elif fence:
            indent, language = _FENCE.fullmatch(lines[start]).groups()
            mark = _MARK.fullmatch(lines[start - 1].strip())
            text = "".join(f"{inner.removeprefix(indent)}\n" for inner in lines[start + 1 : number])
            found.append(Block(f"{path.name}:{start + 1}", language, mark[1] if mark else "", text))
            start = None
    assert start is None, f"{path.name}:{start + 1}: a block without an end"
    return found


def referenced_names() -> list[str]:
    """Return the names that the reference pages document, in order."""
    return [name for page in REFERENCE for name in re.findall(r"^::: (\S+)$", page.read_text("utf-8"), re.MULTILINE)]
