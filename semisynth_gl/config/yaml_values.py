"""Reads YAML as plain values with the line of each key; writes values as YAML."""

import io
from collections.abc import Iterator
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.nodes import MappingNode, Node, SequenceNode

MOST_BYTES = 1 << 18
"""Maximum size of a YAML file: parsing it takes a few seconds at worst."""

KeyPath = tuple[str | int, ...]

_TEXT = "tag:yaml.org,2002:str"


class YamlError(Exception):
    """A text is not valid YAML, or has an anchor; ``line`` is the line of the fault, from 1, or None if unknown."""

    def __init__(self, line: int | None, reason: str) -> None:
        super().__init__(f"not valid YAML: {reason}")
        self.line = line


def read_yaml(text: str) -> tuple[Any, dict[KeyPath, int]]:
    """Return the value of a text (None if it is empty), and the line, from 1, of each key and list item.

    Dates and keys remain texts. Raises YamlError.
    """
    yaml = YAML(typ="safe", pure=True)
    try:
        node = yaml.compose(text)
        lines = {} if node is None else dict(_lines(node, ()))
        return None if node is None else yaml.constructor.construct_document(node), lines
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        hint = ": put quotes around a text that begins with *" if "alias" in str(error.problem) else ""
        raise YamlError(mark.line + 1 if mark else None, f"{error.problem or error.context}{hint}") from None
    except Exception as error:  # noqa: BLE001 - the parser also raises RecursionError, ValueError and others
        raise YamlError(None, str(error)[:200]) from None


def write_yaml(value: Any) -> str:  # noqa: ANN401 - any YAML value
    """Return plain values as YAML on one line."""
    stream, yaml = io.StringIO(), YAML()
    yaml.width = 1 << 20
    yaml.default_flow_style = True
    yaml.dump(value, stream)
    # YAML puts an end mark, "...", behind a value that is neither a mapping nor a list.
    return stream.getvalue().removesuffix("\n").removesuffix("...").strip()


def _lines(node: Node, key: KeyPath) -> Iterator[tuple[KeyPath, int]]:
    """Yield the line of each key and list item below a node, which has this key; make dates and keys texts."""
    if node.anchor:  # nested aliases would take exponential time
        raise MarkedYAMLError(problem=f"write out the anchor &{node.anchor}", problem_mark=node.start_mark)
    if str(node.tag).endswith(":timestamp"):
        node.tag = _TEXT
    children: list[tuple[str | int, Node, Node]] = []
    if isinstance(node, SequenceNode):
        children = [(number, item, item) for number, item in enumerate(node.value)]
    elif isinstance(node, MappingNode):
        children = [(str(name.value), name, child) for name, child in node.value]
    for part, begin, child in children:
        if begin is not child:
            begin.tag = _TEXT
        yield (*key, part), begin.start_mark.line + 1
        yield from _lines(child, (*key, part))
