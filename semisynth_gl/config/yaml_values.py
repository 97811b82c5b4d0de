"""Reads YAML as plain values with the line of each key; writes values as YAML."""

import io
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from semisynth_gl.inputs.errors import shown

MOST_BYTES = 1 << 18
"""Maximum size of a YAML file: parsing it takes a few seconds at worst."""

KeyPath = tuple[str | int, ...]

_TAG = "tag:yaml.org,2002:"
_KINDS = ("map", "seq", "null", "bool", "int", "float", "str", "timestamp")


class YamlError(Exception):
    """A text is not YAML that configs may have. ``line`` begins at 1, and is None if it is unknown."""

    def __init__(self, line: int | None, reason: str) -> None:
        super().__init__(reason)
        self.line = line


def read_yaml(text: str) -> tuple[Any, dict[KeyPath, int]]:
    """Return the value of a text (None if it is empty), and the line, from 1, of each key and list item.

    Dates and keys remain texts. Raises YamlError if the text is not valid, or has an anchor, an alias, a tag or a
    repeated key.
    """
    yaml, lines = YAML(typ="safe", pure=True), dict[KeyPath, int]()
    try:
        node = yaml.compose(text)
        return None if node is None else _value(yaml, node, (), lines), lines
    except YamlError:
        raise
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        hint = ": put quotes around a text that begins with *" if "alias" in str(error.problem) else ""
        reason = f"not valid YAML: {error.problem or error.context}{hint}"
        raise YamlError(mark.line + 1 if mark else None, reason) from None
    except Exception as error:  # noqa: BLE001 - for some texts, the parser raises RecursionError and others
        raise YamlError(None, f"not valid YAML: {str(error)[:200]}") from None


def write_yaml(value: Any) -> str:  # noqa: ANN401 - any YAML value
    """Return plain values as YAML on one line."""
    stream, yaml = io.StringIO(), YAML()
    yaml.width = 1 << 20
    yaml.default_flow_style = True
    yaml.dump(value, stream)
    # YAML puts an end mark, "...", behind a value that is neither a mapping nor a list.
    return stream.getvalue().removesuffix("\n").removesuffix("...").strip()


def _value(yaml: YAML, node: Node, key: KeyPath, lines: dict[KeyPath, int]) -> Any:  # noqa: ANN401 - any value
    """Return a node's value, and add the lines of all its keys to ``lines``."""
    kind = str(node.tag).removeprefix(_TAG)
    if node.anchor or kind not in _KINDS:
        mark = f"&{node.anchor}" if node.anchor else str(node.tag).replace(_TAG, "!!")
        raise YamlError(_line(node), f"anchors, aliases and tags are not accepted: write {mark} out, or quote the text")
    if isinstance(node, SequenceNode):
        lines |= {(*key, number): _line(item) for number, item in enumerate(node.value)}
        return [_value(yaml, item, (*key, number), lines) for number, item in enumerate(node.value)]
    if isinstance(node, MappingNode):
        mapping = dict[str, Any]()
        for name, child in node.value:
            if not isinstance(name, ScalarNode):
                raise YamlError(_line(name), f"a {name.id} is used as a key: expected a text")
            if name.value in mapping:
                raise YamlError(_line(name), f"the key {name.value} occurs twice")
            lines[*key, name.value] = _line(name)
            mapping[name.value] = _value(yaml, child, (*key, name.value), lines)
        return mapping
    try:
        return node.value if kind in ("str", "timestamp") else yaml.constructor.construct_object(node)
    except (ValueError, KeyError):
        raise YamlError(_line(node), f"expected a value of the type {kind}, got {shown(node.value)}") from None


def _line(node: Node) -> int:
    return int(node.start_mark.line) + 1
