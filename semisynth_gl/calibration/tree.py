"""Files of calibrations as trees: every number and word in them under its name, whatever the file's format."""

import io
import json
import re
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from tokenize import TokenError
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from semisynth_gl.codecs import read_bytes
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.scene.rig import rotation_from_quaternion

Array = NDArray[np.float64]
Name = tuple[str, ...]
Tree = dict[Name, Array | str]
"""Values by name: ``left.K`` is ``("left", "K")``. An array is float64 of any shape, () for a number."""

EXTENSIONS = (".txt", ".yaml", ".yml", ".json", ".xml", ".npz", ".npy", ".conf", ".ini", ".cfg", ".cameramodel")
"""Extensions of the files that a folder or a glob finds; a file named in full may have any."""

_LARGEST_BYTES = 1 << 20
# YAML is read at about 25 kB a second.
_LARGEST_YAML = 128 << 10
# An .npz may hold the corners of all photographs of a board beside the calibration.
_LARGEST_NUMPY = 256 << 20
_MOST_VALUES, _MOST_NUMBERS = 20_000, 200_000
# What NumPy raises for a damaged file, or for pickled objects, which may run code and are not opened.
_NO_ARRAY = (
    *(ValueError, EOFError, OSError, SyntaxError, TokenError, TypeError, MemoryError, OverflowError, RuntimeError),
    *(KeyError, zipfile.BadZipFile, zlib.error),
)
# Name of the only value of a file.
_WHOLE: Name = ("values",)
# Axes of a translation, of quaternions, and of a pose.
_VECTORS = [tuple(axes.split()) for axes in ("x y z", "qx qy qz qw", "x y z w", "px py pz qx qy qz qw")]
_BRACKETS = str.maketrans(dict.fromkeys("[](){},", " "))
_SECTION = re.compile(r"\[([A-Za-z_][^\]]*)\]")
# OpenCV's reader needs no space after a colon, YAML does.
_NO_SPACE = re.compile(r"^([ \t]*(?:- )?[A-Za-z_][\w.-]*):(?=[^\s/])", re.MULTILINE)


class FormatError(Exception):
    """A file breaks its format, as the message says without naming the file."""


def read_tree(path: Path) -> Tree:
    """Return the values of a file.

    Raises:
        ReadError: where it cannot be read, or has no format that holds names and numbers.
    """
    tree: Tree = {}
    try:
        _add(tree, (), _parsed(path))
    except FormatError as error:
        raise ReadError(path, str(error)) from None
    except RecursionError:
        raise ReadError(path, "its values are nested too deeply") from None
    return tree


def joined(trees: Sequence[Tree], prefixes: Sequence[Name]) -> Tree:
    """Return the values of several files as one tree, in which each file's names begin with its prefix."""
    return {
        (*prefix, *(() if name == _WHOLE else name)): value
        for tree, prefix in zip(trees, prefixes, strict=True)
        for name, value in tree.items()
    }


def prefixes_of(paths: Sequence[Path]) -> list[Name]:
    """Return as much of each path as tells several files apart."""
    stems = [path.stem for path in paths]
    if len(set(stems)) == len(stems):
        return [(stem,) for stem in stems]
    return [(path.absolute().parent.name, path.stem) for path in paths]


def text_of(name: Name) -> str:
    """Return a name as messages and users write it."""
    return ".".join(name)


def _parsed(path: Path) -> Any:  # noqa: ANN401 - any nested value
    suffix = path.suffix.lower()
    data = read_bytes(path, _LARGEST_NUMPY if suffix in {".npz", ".npy"} else _LARGEST_BYTES)
    if data.startswith((b"\x93NUMPY", b"PK")):
        return _numpy(data)
    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise FormatError("is neither text nor NumPy's .npz or .npy") from None
    start = text.lstrip()[:1]
    if start == "<":
        return _xml(text)
    if start in {"{", "["}:
        with suppress(ValueError):
            return json.loads(text)
    try:
        return _yaml(text) or _lines(text)
    except FormatError:
        if suffix in {".yaml", ".yml", ".json"}:
            raise
        return _lines(text)


def _numpy(data: bytes) -> Any:  # noqa: ANN401 - an array, or arrays by name
    try:
        file = np.load(io.BytesIO(data), allow_pickle=False)
        if isinstance(file, np.ndarray):
            return file
        too_large = sum(each.file_size for each in file.zip.infolist()) > _LARGEST_NUMPY
    except _NO_ARRAY as error:
        raise FormatError(f"is no .npz or .npy without objects: {error}") from None
    if too_large:
        raise FormatError(f"expected arrays of at most {_LARGEST_NUMPY >> 20} MiB in total")
    arrays = {}
    for name in file.files:
        with suppress(*_NO_ARRAY):
            arrays[name] = file[name]
    return arrays


def _xml(text: str) -> Any:  # noqa: ANN401 - any nested value
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise FormatError("expected XML without a document type")
    try:
        return _element(ET.fromstring(text))  # noqa: S314 - without a document type nothing expands
    except ET.ParseError as error:
        raise FormatError(f"is no XML: {error}") from None


def _element(element: ET.Element) -> Any:  # noqa: ANN401 - any nested value
    if not len(element):
        return (element.text or "").strip()
    values: dict[str, list[Any]] = {}
    for child in element:
        values.setdefault(child.tag, []).append(_element(child))
    return {tag: each[0] if len(each) == 1 else each for tag, each in values.items()}


def _yaml(text: str) -> dict[str, Any] | None:
    """Return the values of YAML's mappings; None for other YAML, FormatError for none."""
    if len(text) > _LARGEST_YAML:
        raise FormatError(f"has more than {_LARGEST_YAML >> 10} KiB of YAML: expected a calibration alone")
    # Scalars stay text: dates, sexagesimal numbers and tags mean nothing here.
    yaml = YAML(typ="base", pure=True)
    yaml.allow_duplicate_keys = True
    # OpenCV's first line, %YAML:1.0, and tabs are not valid YAML.
    text = re.sub(r"\A\s*%YAML[^\n]*\n", "", text).replace("\t", "  ")
    try:
        documents = [each for each in yaml.load_all(_NO_SPACE.sub(r"\1: ", text)) if each]
    except (YAMLError, ValueError, AttributeError, TypeError, KeyError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark else ""
        raise FormatError(f"is no YAML: {where}{getattr(error, 'problem', None) or error}") from None
    if not all(isinstance(each, Mapping) for each in documents):
        return None
    if _expanded(documents, {}) > _MOST_NUMBERS:
        raise FormatError(f"has more than {_MOST_NUMBERS} values")
    # `ros2 topic echo` without --once prints a camera's message again and again until it is stopped.
    distinct: list[Mapping[str, Any]] = []
    for each in documents:
        untimed = {key: value for key, value in each.items() if key != "header"}
        if untimed not in distinct:
            distinct.append(untimed)
    return dict(distinct[0]) if len(distinct) == 1 else {str(n): each for n, each in enumerate(distinct, 1)}


def _expanded(node: Any, known: dict[int, int]) -> int:  # noqa: ANN401 - any nested value
    """Return the number of values in a node, counting what an alias repeats as often as it is repeated."""
    if not isinstance(node, Mapping | list):
        return 1
    if id(node) not in known:
        known[id(node)] = 1  # for a node that contains itself
        children = node.values() if isinstance(node, Mapping) else node
        known[id(node)] = 1 + sum(_expanded(each, known) for each in children)
    return known[id(node)]


def _lines(text: str) -> dict[str, Any]:
    """Return the values of text with ``name: value``, ``name = value``, names above numbers, sections, or only numbers.

    Numbers without a name are called ``rows 1``, ``rows 2``: rows of one length that follow each other are a matrix.
    """
    values: dict[str, Any] = {}
    section = values
    name, rows = "", list[str]()

    def close() -> None:
        if rows:
            section[name or f"rows {len(values) + 1}"] = "; ".join(rows)
        rows.clear()

    for line in (each.strip() for each in text.splitlines()):
        if not line or line.startswith(("#", "//", "%")):
            close()
            name = name if line else ""
        elif _text_array(line) is not None:
            if not name and rows and len(rows[-1].split()) != len(line.split()):
                close()
            rows.append(line)
        elif found := _SECTION.fullmatch(line):
            close()
            name, section = "", values.setdefault(found[1], {})
        else:
            close()
            name, value = _keyed(line)
            if _text_array(value) is not None:
                rows.append(value)
            elif value:
                section[name] = value
    close()
    return values


def _keyed(line: str) -> tuple[str, str]:
    """Return the name and the value of a line; a value without = or : before it is numbers."""
    found = re.search("[=:]", line)
    if found is not None:
        return line[: found.start()].strip(), line[found.end() :].strip().rstrip("; ")
    name, _, value = line.partition(" ")
    return (line, "") if _text_array(value) is None else (name, value.strip())


def _add(tree: Tree, name: Name, node: Any) -> None:  # noqa: ANN401 - any nested value
    if len(tree) > _MOST_VALUES:
        raise FormatError(f"has more than {_MOST_VALUES} values: expected a calibration alone")
    if isinstance(node, np.ndarray) and node.dtype.kind == "U" and node.size == 1:
        node = str(node.item())
    if isinstance(node, bool):  # JSON's; YAML's are text already
        node = str(node).lower()
    array = _array(node)
    if array is not None:
        tree[name or _WHOLE] = array
    elif isinstance(node, str):
        tree[name or _WHOLE] = node
    elif isinstance(node, Mapping | list):
        for key, value in node.items() if isinstance(node, Mapping) else enumerate(node):
            parts = [part for part in str(key).split(".") if part] or [str(key)]
            _add(tree, (*name, *parts), value)


def _array(node: Any) -> Array | None:  # noqa: ANN401 - any nested value
    """Return the array that a node stands for; None for a node of names or words."""
    match node:
        case str():
            return _text_array(node)
        case Mapping():
            return _mapping_array(node)
        case np.ndarray() if node.dtype.kind in "iuf" and node.size < _MOST_NUMBERS:
            return node.astype(np.float64)
        case int() | float() | list() if not isinstance(node, bool):
            with suppress(TypeError, ValueError, OverflowError):
                return np.array(node, np.float64)
    return None


def _text_array(text: str) -> Array | None:
    """Return the array of a text of numbers, in which semicolons end the rows of a matrix."""
    try:
        rows = [np.array(row.split(), np.float64) for row in text.translate(_BRACKETS).split(";") if row.strip()]
    except ValueError:
        return None
    if len(rows) > 1 and len({row.size for row in rows}) == 1:
        return np.array(rows)
    return np.concatenate(rows) if rows else None


def _mapping_array(node: Mapping[Any, Any]) -> Array | None:
    """Return the array of a mapping that is one: a matrix of OpenCV's, a vector, quaternion or pose by its axes."""
    if "data" in node:
        data = _array(node["data"])
        with suppress(KeyError, TypeError, ValueError, OverflowError):
            return None if data is None else data.reshape([int(node[side]) for side in ("rows", "cols")])
        return None if data is None else data.ravel()
    axes = next((axes for axes in _VECTORS if node.keys() == set(axes)), ())
    numbers = _array([node[axis] for axis in axes])
    if numbers is None or len(axes) == 0 or numbers.ndim != 1:
        return None
    if len(axes) == 3:
        return numbers
    with np.errstate(all="ignore"):  # a quaternion of no length has no rotation but nan
        quaternion = numbers[-4:] / np.linalg.norm(numbers[-4:])
    turn: Array = rotation_from_quaternion(quaternion[None])[0]
    return turn if len(axes) == 4 else np.vstack([np.column_stack([turn, numbers[:3]]), [0, 0, 0, 1]])
