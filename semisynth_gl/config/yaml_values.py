"""Reading YAML as plain values with the line of each key, within limits that are checked while reading; and writing it.

Mappings, lists, texts, numbers, booleans and null are all that configs and calibrations need. Tags, anchors, aliases
and merge keys are refused: aliases of aliases grow beyond any memory, and a tag may build anything. A date is text.
"""

import io
from collections.abc import Iterator
from typing import Any, NoReturn

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    DocumentStartEvent,
    Event,
    ScalarEvent,
    SequenceStartEvent,
)
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.reader import ReaderError
from ruamel.yaml.resolver import VersionedResolver

from semisynth_gl.inputs.errors import cut

# Largest numbers of bytes, values and keys of a text; a text of that many bytes takes a second to read at worst.
MOST_BYTES, MOST_VALUES, MOST_KEYS = 1 << 18, 10_000, 1_000
# Largest depth of nested lists and mappings.
DEEPEST = 20
# Largest numbers of characters.
LONGEST_NUMBER, LONGEST_KEY = 100, 200

Key = tuple[str | int, ...]

_TAG = "tag:yaml.org,2002:"
_BASES = {"0x": 16, "0o": 8, "0b": 2}


class YamlError(Exception):
    """A text is not valid YAML, or exceeds a limit; ``line`` counts from 1 and is None where it is unknown."""

    def __init__(self, line: int | None, key: Key, reason: str) -> None:
        dotted = ".".join(map(str, key))
        super().__init__(f"{dotted}: {reason}" if dotted else reason)
        self.line = line


def read_yaml(text: str) -> tuple[Any, dict[Key, int]]:
    """Return the value of a text, None where it is empty, and the line, from 1, of each key and each item of a list.

    Keys of mappings stay texts as they are written. Raises YamlError where the text is not valid, has several
    documents, or exceeds a limit of this module.
    """
    # A character takes at least a byte, so a text that is too long need not be encoded to count its bytes.
    if len(text) > MOST_BYTES or len(text.encode(errors="surrogatepass")) > MOST_BYTES:
        raise YamlError(None, (), f"has more than {MOST_BYTES} bytes, the most that YAML may have here")
    reader = _Reader(text)
    try:
        return reader.document(), reader.lines
    except YamlError:
        raise
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else None
        raise YamlError(line, (), f"not valid YAML: {error.problem or error.context}") from None
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise YamlError(line, (), f"not valid YAML: the character {chr(error.character)!r} is not allowed") from None
    except Exception as error:  # noqa: BLE001 - a parser of hostile texts raises anything
        raise YamlError(None, (), f"not valid YAML: {cut(str(error), 200)}") from None


def write_yaml(value: Any) -> str:  # noqa: ANN401 - any YAML value
    """Return plain values as YAML on one line."""
    stream, yaml = io.StringIO(), YAML()
    yaml.width = 1 << 20
    yaml.default_flow_style = True
    yaml.dump(value, stream)
    # A value that is neither a mapping nor a list is followed by the mark of a document's end.
    return stream.getvalue().removesuffix("\n").removesuffix("...").strip()


class _Reader:
    """Builds the value of a text from the events of ruamel's parser, which holds only a few events at a time."""

    def __init__(self, text: str) -> None:
        self.lines: dict[Key, int] = {}
        self._events: Iterator[Event] = YAML(typ="safe", pure=True).parse(text)
        # YAML 1.2, even where a directive names another version.
        self._resolver = VersionedResolver(version=(1, 2))
        self._values = self._keys = 0

    def document(self) -> Any:  # noqa: ANN401 - any value
        values: list[Any] = []
        for event in self._events:
            if isinstance(event, DocumentStartEvent):
                if values:
                    self._refuse(event, (), "not valid YAML: expected a single document")
                values.append(self._value(next(self._events), (), 0))
        return values[0] if values else None

    def _value(self, event: Event, key: Key, depth: int) -> Any:  # noqa: ANN401 - any value
        self._values += 1
        if self._values > MOST_VALUES:
            self._refuse(event, key, f"has more than {MOST_VALUES} values, the most that YAML may have here")
        self._check(event, key)
        if isinstance(event, ScalarEvent):
            return self._scalar(event, key)
        if depth == DEEPEST:
            self._refuse(event, key[:3], f"has more than {DEEPEST} lists and mappings inside each other")
        if isinstance(event, SequenceStartEvent):
            items: list[Any] = []
            while not isinstance(event := next(self._events), CollectionEndEvent):
                items.append(self._placed(event, event, (*key, len(items)), depth))
            return items
        mapping: dict[str, Any] = {}
        while not isinstance(event := next(self._events), CollectionEndEvent):
            name = self._name(event, key)
            if name in mapping:
                self._refuse(event, (*key, name), "not valid YAML: found duplicate key")
            mapping[name] = self._placed(event, next(self._events), (*key, name), depth)
        return mapping

    def _placed(self, at: Event, event: Event, key: Key, depth: int) -> Any:  # noqa: ANN401 - any value
        self.lines[key] = _line(at)
        return self._value(event, key, depth + 1)

    def _name(self, event: Event, key: Key) -> str:
        self._keys += 1
        if self._keys > MOST_KEYS:
            self._refuse(event, key, f"has more than {MOST_KEYS} keys, the most that YAML may have here")
        self._check(event, key)
        if not isinstance(event, ScalarEvent):
            self._refuse(event, key, "expected a text as a key, got a list or mapping")
        if event.implicit[0] and event.value == "<<":
            self._refuse(event, key, "merge keys (<<) are not accepted: write the keys out, or use extends")
        if len(event.value) > LONGEST_KEY:
            self._refuse(event, key, f"has a key of {len(event.value)} characters: expected at most {LONGEST_KEY}")
        return str(event.value)

    def _check(self, event: Event, key: Key) -> None:
        found = {
            "*": isinstance(event, AliasEvent),
            "&": getattr(event, "anchor", None),
            "!": getattr(event, "tag", None),
        }
        if marks := [mark for mark, is_there in found.items() if is_there]:
            text = "aliases (*), anchors (&) and tags (!) are not accepted: leave it out, or put quotes around"
            self._refuse(event, key, f"{text} the {marks[0]}")

    def _scalar(self, event: ScalarEvent, key: Key) -> Any:  # noqa: ANN401 - any value
        text = str(event.value)
        tag = str(self._resolver.resolve(ScalarNode, text, (True, False))) if event.implicit[0] else f"{_TAG}str"
        match tag.removeprefix(_TAG):
            case "null":
                return None
            case "bool":
                return text.lower() == "true"
            case "int" | "float" as kind:
                if len(text) > LONGEST_NUMBER:
                    fault = f"has a number of {len(text)} characters: expected at most {LONGEST_NUMBER}"
                    self._refuse(event, key, fault)
                try:
                    return _integer(text) if kind == "int" else _float(text)
                except ValueError:
                    self._refuse(event, key, f"expected a number, got {text!r}")
            case _:
                return text

    def _refuse(self, event: Event, key: Key, reason: str) -> NoReturn:
        raise YamlError(_line(event), key, reason)


def _line(event: Event) -> int:
    return int(event.start_mark.line) + 1


def _integer(text: str) -> int:
    digits = text.replace("_", "").lower()
    return int(digits, _BASES.get(digits.lstrip("+-")[:2], 10))


def _float(text: str) -> float:
    return float(text.replace("_", "").lower().replace(".inf", "inf").replace(".nan", "nan"))
