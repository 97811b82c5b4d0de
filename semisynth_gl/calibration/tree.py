"""Reads calibration files as trees: arrays and texts by name, whatever the format."""

import ast
import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from semisynth_gl.codecs import read_bytes
from semisynth_gl.inputs.errors import ReadError, abbreviate

Array = NDArray[np.float64]
Name = tuple[str, ...]
Tree = dict[Name, Array | str]
"""Values by name: ``left.K`` is ``("left", "K")``. An array is float64 of any shape, () for a number."""

EXTENSIONS = (".txt", ".yaml", ".yml", ".json", ".xml", ".npz", ".npy", ".conf", ".ini", ".cfg", ".cameramodel")
"""Extensions of the files that are found in a folder or by a glob; a file named in full may have any extension."""

# Maximum sizes of files and number of values. ruamel reads about 25 kB of YAML a second; an .npz may also have corners.
_LARGEST_BYTES, _LARGEST_YAML, _LARGEST_NUMPY, _MOST_VALUES = 1 << 20, 128 << 10, 256 << 20, 200_000
# Arrays with larger numbers, or with nan, are kept as text: no calibration has them, and squares could overflow.
_LARGEST = 1e9
# Names of values that a file does not name: of a file's only value, and of rows of numbers in a text.
_WHOLE: Name = ("values",)
UNNAMED = "numbers"
_BRACKETS = str.maketrans(dict.fromkeys("[](){},;", " "))
# OpenCV's reader needs no space after a colon, YAML does.
_NO_SPACE = re.compile(r"^([ \t]*(?:- )?[A-Za-z_][\w.-]*):(?=[^\s/])", re.MULTILINE)
_LISTED = 40


class FormatError(Exception):
    """A file breaks its format. The message does not name the file."""


def read_tree(path: Path) -> Tree:
    """Return the values of a file.

    Raises:
        ReadError: if it cannot be read, or its format is not supported.
    """
    try:
        return dict(_leaves((), _parsed(path)))
    except FormatError as error:
        raise ReadError(path, str(error)) from None
    except RecursionError:
        raise ReadError(path, "its values are nested too deeply") from None


def joined(trees: Sequence[Tree], prefixes: Sequence[str]) -> Tree:
    """Return the values of several files as one tree; names begin with the prefix of their file."""
    return {
        (*prefix.split("."), *(() if name == _WHOLE else name)): value
        for tree, prefix in zip(trees, prefixes, strict=True)
        for name, value in tree.items()
    }


def listing(tree: Mapping[Name, Array | str]) -> str:
    """Return the arrays of a tree with their shapes, as text for a message."""
    arrays = [(".".join(name), value.shape) for name, value in tree.items() if isinstance(value, np.ndarray)]
    shown = [f"{name} ({' x '.join(map(str, shape)) or 'a number'})" for name, shape in arrays]
    return abbreviate(shown, _LISTED) or "no numbers"


def _parsed(path: Path) -> Any:  # noqa: ANN401 - any nested value
    suffix = path.suffix.lower()
    data = read_bytes(path, _LARGEST_NUMPY if suffix in {".npz", ".npy"} else _LARGEST_BYTES)
    if data.startswith((b"\x93NUMPY", b"PK")):
        return _numpy(data)
    if b"\0" in data:
        raise FormatError("is binary or UTF-16 text: expected UTF-8 text, .npz or .npy")
    text = data.decode("utf-8-sig", "replace").replace("\r\n", "\n")
    with suppress(ValueError, SyntaxError, MemoryError, TypeError):
        if suffix == ".cameramodel":  # mrcal's, a literal of Python
            return ast.literal_eval(text)
        if text.lstrip().startswith("<"):
            return _element(ET.fromstring(text))  # noqa: S314 - expat limits what entities expand to
        if text.lstrip().startswith(("{", "[")):
            return json.loads(text)
    try:
        return _yaml(text) or _lines(text)
    except FormatError:
        if suffix in {".yaml", ".yml", ".json", ".xml"}:
            raise
        return _lines(text)


def _numpy(data: bytes) -> Any:  # noqa: ANN401 - an array, or arrays by name
    """Return the arrays in a .npz or .npy file. Pickled objects are skipped, since they may run code."""
    arrays = {}
    try:
        file = np.load(io.BytesIO(data), allow_pickle=False)
        if isinstance(file, np.ndarray):
            return file
        size = sum(each.file_size for each in file.zip.infolist())
        for name in file.files if size < _LARGEST_NUMPY else []:
            with suppress(ValueError):  # objects
                arrays[name] = file[name]
    except Exception as error:  # noqa: BLE001 - NumPy raises a dozen kinds for damaged files
        raise FormatError(f"is not a valid .npz or .npy file: {error}") from None
    if size >= _LARGEST_NUMPY:
        raise FormatError(f"has arrays of {size >> 20} MiB: expected less than {_LARGEST_NUMPY >> 20} MiB")
    return arrays


def _element(element: ET.Element) -> Any:  # noqa: ANN401 - any nested value
    if not len(element):
        return (element.text or "").strip()
    by_tag: dict[str, list[Any]] = {}
    for child in element:
        by_tag.setdefault(child.tag, []).append(_element(child))
    if by_tag.keys() == {"_"}:  # OpenCV's lists
        return by_tag["_"]
    return {tag: values if len(values) > 1 else values[0] for tag, values in by_tag.items()}


def _yaml(text: str) -> dict[str, Any] | None:
    """Parse text as YAML. Returns None if it is no mapping; raises FormatError if it is not YAML."""
    if len(text) > _LARGEST_YAML:
        raise FormatError(f"has more than {_LARGEST_YAML >> 10} KiB of YAML: expected only a calibration")
    # The type "base" keeps scalars as text: dates, sexagesimal numbers and tags are not wanted.
    yaml = YAML(typ="base", pure=True)
    yaml.allow_duplicate_keys = True
    # OpenCV's first line, %YAML:1.0, and tabs are not valid YAML.
    text = re.sub(r"\A\s*%YAML[^\n]*\n", "", text).replace("\t", "  ")
    try:
        documents = [each for each in yaml.load_all(_NO_SPACE.sub(r"\1: ", text)) if each]
    except (YAMLError, ValueError, AttributeError, TypeError, KeyError) as error:
        raise FormatError(f"is not valid YAML: {' '.join(str(error).split())[:300]}") from None
    if not all(isinstance(each, Mapping) for each in documents):
        return None
    if len([*islice(_nodes(documents), _MOST_VALUES)]) == _MOST_VALUES:
        raise FormatError(f"has more than {_MOST_VALUES} values: expected only a calibration")
    # `ros2 topic echo` without --once repeats a camera's message, with a new header, until it is stopped.
    distinct = [*{repr({**each, "header": None}): each for each in documents}.values()]
    return {str(n): each for n, each in enumerate(distinct, 1)} if len(distinct) > 1 else dict(*distinct)


def _lines(text: str) -> dict[str, Any]:
    """Return the values of text: sections, ``name: value``, ``name = value``, names above numbers, or only numbers.

    Rows of numbers without a name get the name `UNNAMED`; a row of a different length begins the next array.
    """
    values: dict[str, Any] = {}
    section, name, rows = values, "", list[str]()
    for line in (each.strip() for each in (*text.splitlines(), "")):
        if line.startswith(("#", "//", "%")):
            continue
        is_row = _numbers(line) is not None
        goes_on = is_row and rows and (name or len(line.split()) == len(rows[-1].split()))
        if rows and not goes_on:
            section[name or UNNAMED + "'" * len(section)] = " ".join(rows)  # a different name for each unnamed array
            rows.clear()
        if is_row:
            rows.append(line)
        elif heading := re.fullmatch(r"\[([A-Za-z_][^\]]*)\]", line):
            name, section = "", values.setdefault(heading[1], {})
        else:
            sign = re.search("[=:]", line)
            name, _, value = line.partition(sign[0] if sign else " ")
            name, value = name.strip(), value.strip("; ")
            if _numbers(value) is not None:
                rows.append(value)
            elif sign and value:
                section[name] = value
            elif not sign:
                name = line
    return values


def _nodes(node: Any) -> Iterator[Any]:  # noqa: ANN401 - any nested value
    """Yield a value and all values in it; an aliased node is repeated for each use."""
    yield node
    for child in node.values() if isinstance(node, Mapping) else node if isinstance(node, list) else ():
        yield from _nodes(child)


def _leaves(name: Name, node: Any) -> Iterator[tuple[Name, Array | str]]:  # noqa: ANN401 - any nested value
    array = _array(node)
    if array is not None:
        yield name or _WHOLE, array if (np.abs(array) <= _LARGEST).all() else str(array)[:100]
    elif isinstance(node, str | bool | np.ndarray):
        yield name or _WHOLE, str(node)[:100]
    elif isinstance(node, Mapping | list | tuple):
        for key, value in node.items() if isinstance(node, Mapping) else enumerate(node):
            yield from _leaves((*name, *(part for part in str(key).split(".") if part)), value)


def _array(node: Any) -> Array | None:  # noqa: ANN401 - any nested value
    """Return a node as an array; None if it is not numeric."""
    if isinstance(node, str):
        return _numbers(node)
    if isinstance(node, Mapping):
        return _array(node["data"]) if "data" in node else None  # OpenCV's matrices have data
    if isinstance(node, np.ndarray):
        return node.astype(np.float64) if node.dtype.kind in "iuf" and node.size < _MOST_VALUES else None
    with suppress(TypeError, ValueError, OverflowError):
        return None if isinstance(node, bool) else np.array(node, np.float64)
    return None


def _numbers(text: str) -> Array | None:
    """Parse a text of numbers, brackets, commas and semicolons as an array (N,); return None for any other text."""
    try:
        numbers = np.array(text.translate(_BRACKETS).split(), np.float64)
    except ValueError:
        return None
    return numbers if numbers.size else None
