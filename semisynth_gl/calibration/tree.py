"""Files of calibrations as trees: every number and word in them under its name, whatever the file's format."""

import io
import json
import math
import re
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
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
_MOST_VALUES, _MOST_NUMBERS, _DEEPEST = 20_000, 200_000, 40
_LARGEST_NUMBER = 1e300
# Name of the only value of a file.
_WHOLE: Name = ("values",)
# Axes of a translation, of quaternions, and of a pose.
_VECTORS = [tuple(axes.split()) for axes in ("x y z", "qx qy qz qw", "x y z w", "px py pz qx qy qz qw")]
# At most one way to match each text: without alternatives to try, a text that does not match fails fast.
_NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_NUMBERS = re.compile(rf"[\[({{]*\s*{_NUMBER}(?:[\s,;\[\](){{}}]+{_NUMBER})*[\s,;\])}}]*")
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
        _add(tree, (), _parsed(path), 0)
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
    numpy_file = path.suffix.lower() in {".npz", ".npy"}
    data = read_bytes(path, _LARGEST_NUMPY if numpy_file else _LARGEST_BYTES)
    if data.startswith(b"\x93NUMPY"):
        return _array(data)
    if data.startswith(b"PK"):
        return _npz(data)
    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise FormatError("is neither text nor NumPy's .npz or .npy") from None
    start = text.lstrip()[:1]
    if start == "<":
        return _xml(text)
    if start in {"{", "["} and (value := _json(text)) is not None:
        return value
    documents, fault = _yaml(text) if len(text) <= _LARGEST_YAML else ([], "")
    if documents:
        return documents[0] if len(documents) == 1 else {str(n): each for n, each in enumerate(documents, 1)}
    if path.suffix.lower() in {".yaml", ".yml", ".json"} and len(text) > _LARGEST_YAML:
        raise FormatError(f"has more than {_LARGEST_YAML >> 10} KiB of YAML: expected a calibration alone")
    if path.suffix.lower() in {".yaml", ".yml", ".json"} and fault:
        raise FormatError(f"is no YAML: {fault}")
    return _lines(text)


def _array(data: bytes) -> Any:  # noqa: ANN401 - any array
    try:
        return np.load(io.BytesIO(data), allow_pickle=False)
    # NumPy evaluates an array's header, and a damaged one raises whatever that finds wrong.
    except (ValueError, EOFError, OSError, SyntaxError, TokenError, TypeError, MemoryError, OverflowError):
        return None  # or pickled objects, which may run code


def _npz(data: bytes) -> dict[str, Any]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(each.file_size for each in archive.infolist()) > _LARGEST_NUMPY:
                raise FormatError(f"expected arrays of at most {_LARGEST_NUMPY >> 20} MiB in total")
            return {each.removesuffix(".npy"): _array(archive.read(each)) for each in archive.namelist()}
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, RuntimeError) as error:
        raise FormatError(f"is no .npz: {error}") from None


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


def _json(text: str) -> Any:  # noqa: ANN401 - any nested value
    try:
        return json.loads(text)
    except ValueError:
        return None


def _yaml(text: str) -> tuple[list[Mapping[str, Any]], str]:
    """Return the distinct documents where all are mappings, else none; and what YAML says is wrong."""
    # Scalars stay text: dates, sexagesimal numbers and tags mean nothing here.
    yaml = YAML(typ="base", pure=True)
    yaml.allow_duplicate_keys = True
    # OpenCV's first line, %YAML:1.0, and tabs are not valid YAML. In flow mappings a colon needs a space as well.
    text = re.sub(r"\A\s*%YAML[^\n]*\n", "", text).replace("\t", "  ")
    try:
        documents = [each for each in yaml.load_all(_NO_SPACE.sub(r"\1: ", text)) if each]
    except (YAMLError, ValueError, AttributeError, TypeError, KeyError) as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error)
        return [], f"line {mark.line + 1}: {problem}" if mark else problem
    if not all(isinstance(each, Mapping) for each in documents):
        return [], ""
    # `ros2 topic echo` without --once prints a camera's message again and again until it is stopped.
    untimed = [{key: value for key, value in each.items() if key != "header"} for each in documents]
    return [each for number, each in enumerate(documents) if untimed[number] not in untimed[:number]], ""


def _lines(text: str) -> dict[str, Any]:
    """Return the values of text with ``name: value``, ``name = value``, names above numbers, sections, or only numbers.

    Numbers without a name are called ``rows 1``, ``rows 2``: rows of one length that follow each other are a matrix.
    """
    values: dict[str, Any] = {}
    section = values
    name, rows = "", list[str]()

    def close() -> None:
        nonlocal rows
        if rows:
            section[name or f"rows {len(values) + 1}"] = "; ".join(rows)
        rows = []

    for line in (each.strip() for each in text.splitlines()):
        if not line or line.startswith(("#", "//", "%")):
            close()
            name = name if line else ""
        elif _NUMBERS.fullmatch(line):
            if not name and rows and len(rows[-1].split()) != len(line.split()):
                close()
            rows.append(line)
        elif found := _SECTION.fullmatch(line):
            close()
            name, section = "", values.setdefault(found[1], {})
        else:
            close()
            name, value = _keyed(line)
            if _NUMBERS.fullmatch(value):
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
    return (name, value.strip()) if _NUMBERS.fullmatch(value.strip()) else (line, "")


def _add(tree: Tree, name: Name, node: Any, depth: int) -> None:  # noqa: ANN401 - any nested value
    if len(tree) > _MOST_VALUES or depth > _DEEPEST:
        raise FormatError(f"has more than {_MOST_VALUES} values, or deeper ones than a calibration")
    if isinstance(node, np.ndarray) and node.dtype.kind == "U" and node.size == 1:
        node = str(node.item())
    array = _numbers(node)
    if array is not None:
        tree[name or _WHOLE] = array
    elif isinstance(node, str):
        tree[name or _WHOLE] = node
    elif isinstance(node, Mapping):
        for key, value in node.items():
            _add(tree, (*name, *([part for part in str(key).split(".") if part] or [str(key)])), value, depth + 1)
    elif isinstance(node, list | tuple):
        for number, value in enumerate(node):
            _add(tree, (*name, str(number)), value, depth + 1)


def _numbers(node: Any) -> Array | None:  # noqa: ANN401 - any nested value
    """Return the array that a node stands for; None for a node of names or words."""
    array: Array | None = None
    match node:
        case bool():
            pass
        case int() | float() if abs(node) < _LARGEST_NUMBER:
            array = np.array(float(node))
        case np.ndarray() if node.dtype.kind in "iuf" and node.size < _MOST_NUMBERS:
            array = node.astype(np.float64)
        case str():
            array = _text_numbers(node)
        case Mapping():
            array = _mapping_numbers(node)
        case list() | tuple():
            array = _list_numbers(node)
    return array


def _list_numbers(node: Sequence[Any]) -> Array | None:
    try:
        return np.array(list(_rows(node, [0])), np.float64)
    except (TypeError, ValueError, OverflowError):
        return None


def _rows(node: Sequence[Any], count: list[int]) -> Iterator[Any]:
    """Yield the numbers of a list, and lists of them; raises TypeError for anything else."""
    for each in node:
        count[0] += 1
        if count[0] > _MOST_NUMBERS:
            raise FormatError(f"has a list of more than {_MOST_NUMBERS} numbers")
        if isinstance(each, list | tuple):
            yield list(_rows(each, count))
        elif isinstance(each, bool | Mapping) or each is None:
            raise TypeError
        else:
            yield float(each)


def _text_numbers(text: str) -> Array | None:
    text = text.strip()
    try:
        return np.array(float(text))
    except ValueError:
        pass
    if not _NUMBERS.fullmatch(text):
        return None
    rows = [re.findall(_NUMBER, row) for row in text.split(";")]
    rows = [row for row in rows if row]
    if len({len(row) for row in rows}) == 1 and len(rows) > 1:
        return np.array(rows, np.float64)
    return np.array([number for row in rows for number in row], np.float64)


def _mapping_numbers(node: Mapping[Any, Any]) -> Array | None:
    """Return the array of a mapping that is one: a matrix of OpenCV's, a vector, quaternion or pose by its axes."""
    if "data" in node:
        data, *sides = (_numbers(node.get(key)) for key in ("data", "rows", "cols"))
        if data is None:
            return None
        # A shape that does not fit is no shape.
        shape = [int(each) for each in sides if each is not None and each.ndim == 0 and each >= 1]
        return data.reshape(shape) if len(shape) == 2 and math.prod(shape) == data.size else data.ravel()
    vector = next((axes for axes in _VECTORS if node.keys() == set(axes)), ())
    numbers = _numbers([node[axis] for axis in vector])
    if numbers is None or not vector or numbers.ndim != 1:
        return None
    if len(vector) == 3:
        return numbers
    turn = _turn(numbers[-4:])
    if len(vector) == 4:
        return turn
    return np.vstack([np.column_stack([turn, numbers[:3]]), [0, 0, 0, 1]])


def _turn(quaternion: Array) -> Array:
    """Return the rotation (3, 3) of a quaternion x y z w of any length; nan where it has none."""
    length = np.linalg.norm(quaternion)
    unit = quaternion / length if length else np.full(4, np.nan)
    turn: Array = rotation_from_quaternion(unit[None])[0]
    return turn
