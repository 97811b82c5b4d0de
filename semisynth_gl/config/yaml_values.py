"""Reading YAML as plain values with the line of each key; and writing it."""

import io
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from semisynth_gl.inputs.errors import shown

MOST_BYTES = 1 << 18
"""Largest size of a file that is read as YAML; parsing that much takes a few seconds at worst."""

Key = tuple[str | int, ...]

_TAG = "tag:yaml.org,2002:"
_KINDS = ("map", "seq", "null", "bool", "int", "float", "str", "timestamp")


class YamlError(Exception):
    """A text is not the YAML that configs are made of; ``line`` counts from 1 and is None where it is unknown."""

    def __init__(self, line: int | None, reason: str) -> None:
        super().__init__(reason)
        self.line = line


def read_yaml(text: str) -> tuple[Any, dict[Key, int]]:
    """Return the value of a text, None where it is empty, and the line, from 1, of each key and each item of a list.

    Keys of mappings and dates stay texts as they are written. Raises YamlError where the text is not valid, or has an
    anchor, an alias, a tag or a key twice.
    """
    yaml, lines = YAML(typ="safe", pure=True), dict[Key, int]()
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
    except Exception as error:  # noqa: BLE001 - a parser of any text raises anything, RecursionError too
        raise YamlError(None, f"not valid YAML: {str(error)[:200]}") from None


def write_yaml(value: Any) -> str:  # noqa: ANN401 - any YAML value
    """Return plain values as YAML on one line."""
    stream, yaml = io.StringIO(), YAML()
    yaml.width = 1 << 20
    yaml.default_flow_style = True
    yaml.dump(value, stream)
    # A value that is neither a mapping nor a list is followed by the mark of a document's end.
    return stream.getvalue().removesuffix("\n").removesuffix("...").strip()


def _value(yaml: YAML, node: Node, key: Key, lines: dict[Key, int]) -> Any:  # noqa: ANN401 - any value
    """Return a node's value, and add the lines of all keys in it."""
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
            if not isinstance(name, ScalarNode) or name.value in mapping:
                raise YamlError(_line(name), "a key is not a text, or is there twice: each key may be there once")
            lines[*key, name.value] = _line(name)
            mapping[name.value] = _value(yaml, child, (*key, name.value), lines)
        return mapping
    try:
        return node.value if kind in ("str", "timestamp") else yaml.constructor.construct_object(node)
    except (ValueError, KeyError):
        raise YamlError(_line(node), f"expected a value of the type {kind}, got {shown(node.value)}") from None


def _line(node: Node) -> int:
    return int(node.start_mark.line) + 1
