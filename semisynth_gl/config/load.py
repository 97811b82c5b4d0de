"""Reading a config: YAML with ``extends``, overrides, and errors that name file, line and key."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from semisynth_gl.config.model import Config
from semisynth_gl.config.target_file import histogram_of_file
from semisynth_gl.errors import InputError
from semisynth_gl.resources import data_root

_EXTENDS = "extends"

# Two ways to say the same thing: setting one in a later place takes back the other.
_REPLACES = {
    "focal_px": ("focal_mm", "sensor_width_mm"),
    "focal_mm": ("focal_px",),
    "doffs_px": ("cx_right_px",),
    "cx_right_px": ("doffs_px",),
}

Key = tuple[str | int, ...]


@dataclass(slots=True)
class _Document:
    """Plain values of one or more merged files, and where each key was set."""

    values: dict[str, Any] = field(default_factory=dict)
    places: dict[Key, str] = field(default_factory=dict)


def packaged_configs() -> list[str]:
    """Names of the configs that come with the package, sorted."""
    return sorted(Path(entry.name).stem for entry in data_root("configs").iterdir() if entry.name.endswith(".yaml"))


def load_config(name_or_path: str | Path, overrides: Mapping[str, Any] | Sequence[str] = ()) -> Config:
    """Read a config.

    Args:
        name_or_path: a path, or the name of a packaged config with or without ".yaml".
        overrides: ``{"camera.width_px": 640}`` or ``["camera.width_px=640"]``, values of the latter in YAML.

    Raises:
        InputError: with a line per fault: where it is (file, line), the dotted key, what was expected and what came.
    """
    document = _read(_find(str(name_or_path)), ())
    own = _Document()
    for key, value in _parsed_overrides(overrides):
        _set(own, key, value)
    document = _merge(document, own)
    _read_target(document)
    try:
        return Config.model_validate(document.values)
    except ValidationError as error:
        lines = [_explain(fault, document) for fault in error.errors(include_url=False)]
        raise InputError("\n".join(dict.fromkeys(lines))) from None


def _read_target(document: _Document) -> None:
    """Put the histogram in the place of the file that a target names."""
    disparity = document.values.get("disparity")
    target = disparity.get("target") if isinstance(disparity, dict) else None
    if not (isinstance(disparity, dict) and isinstance(target, dict) and target.get("form") == "file"):
        return
    key = ("disparity", "target", "path")
    place = document.places.get(key, "")
    path = target.get("path")
    if not isinstance(path, str) or set(target) != {"form", "path"}:
        raise InputError(f"{place}: disparity.target: a target of form file has a path and nothing else, got {target}")
    # A path is meant from where it was written: beside the config, or from where the command runs.
    written_in = Path(place.rpartition(":")[0]) if place and not place.startswith("--set") else Path()
    disparity["target"] = histogram_of_file(written_in.parent / Path(path).expanduser())


def _find(name: str) -> Path | Traversable:
    path = Path(name).expanduser()
    if path.is_file():
        return path
    if path.parent == Path():
        packaged = data_root("configs") / f"{path.name.removesuffix('.yaml')}.yaml"
        if packaged.is_file():
            return packaged
    names = packaged_configs()
    near = difflib.get_close_matches(path.name.removesuffix(".yaml"), names, n=1)
    hint = f" Did you mean {near[0]}?" if near else ""
    raise InputError(f"no such config: {name}.{hint} Expected a YAML file, or one of: {', '.join(names)}")


def _read(path: Path | Traversable, parents: tuple[str, ...]) -> _Document:
    shown = str(path) if isinstance(path, Path) else path.name
    if shown in parents:
        raise InputError(f"{shown}: configs extend each other in a circle: {' -> '.join((*parents, shown))}")
    try:
        tree = YAML(typ="rt", pure=True).load(path.read_text(encoding="utf-8"))
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark else ""
        raise InputError(f"{shown}{line}: not valid YAML: {error.problem or error.context}") from None
    except (YAMLError, UnicodeDecodeError, OSError) as error:
        raise InputError(f"{shown}: cannot be read as YAML: {error}") from None
    if not isinstance(tree, CommentedMap):
        raise InputError(f"{shown}:1: expected sections such as camera: and disparity:, got {tree!r}")
    own = _Document()
    own.values = _plain(tree, (), shown, own.places)
    base_name = own.values.pop(_EXTENDS, None)
    if base_name is None:
        return own
    if not isinstance(base_name, str):
        raise InputError(f"{own.places[(_EXTENDS,)]}: {_EXTENDS}: expected the name of a config, got {base_name!r}")
    beside = path.parent / base_name if isinstance(path, Path) else None
    try:
        base_path = beside if beside is not None and beside.is_file() else _find(base_name)
    except InputError as error:
        raise InputError(f"{own.places[(_EXTENDS,)]}: {_EXTENDS}: {error}") from None
    return _merge(_read(base_path, (*parents, shown)), own)


def _plain(node: Any, key: Key, shown: str, places: dict[Key, str]) -> Any:  # noqa: ANN401 - any YAML value
    if isinstance(node, CommentedMap):
        result = {}
        for name, child in node.items():
            places[(*key, str(name))] = f"{shown}:{node.lc.key(name)[0] + 1}"
            result[str(name)] = _plain(child, (*key, str(name)), shown, places)
        return result
    if isinstance(node, CommentedSeq):
        for i in range(len(node)):
            places[(*key, i)] = f"{shown}:{node.lc.item(i)[0] + 1}"
        return [_plain(child, (*key, i), shown, places) for i, child in enumerate(node)]
    # The round-trip loader wraps scalars to remember how they were written.
    for plain in (bool, int, float, str):
        if isinstance(node, plain):
            return plain(node)
    return node


def _merge(base: _Document, own: _Document) -> _Document:
    def merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
        result = {name: value for name, value in below.items() if not _is_replaced(name, above)}
        for name, value in above.items():
            # A form comes with all its keys: those of another form do not belong to it.
            both = isinstance(value, dict) and isinstance(below.get(name), dict) and "form" not in value
            result[name] = merged(below[name], value) if both else value
        return result

    return _Document(merged(base.values, own.values), base.places | own.places)


def _is_replaced(name: str, above: dict[str, Any]) -> bool:
    return name not in above and any(name in _REPLACES.get(other, ()) for other in above)


def _parsed_overrides(overrides: Mapping[str, Any] | Sequence[str]) -> list[tuple[str, Any]]:
    if isinstance(overrides, Mapping):
        return list(overrides.items())
    result = []
    for text in overrides:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise InputError(f"--set {text}: expected dotted.key=value, such as camera.width_px=640")
        try:
            result.append((key, YAML(typ="safe", pure=True).load(value)))
        except YAMLError:
            raise InputError(f"--set {text}: the value {value!r} is not valid YAML") from None
    return result


def _set(document: _Document, dotted: str, value: Any) -> None:  # noqa: ANN401 - any YAML value
    *sections, last = dotted.split(".")
    node = document.values
    for section in sections:
        child = node.setdefault(section, {})
        if not isinstance(child, dict):
            raise InputError(f"--set {dotted}: {section} is no section with keys of its own")
        node = child
    node[last] = value
    document.places[(*sections, last)] = f"--set {dotted}"


def _explain(fault: ErrorDetails, document: _Document) -> str:
    # Pydantic adds names of union members and validators to a location; keys of the document are what users know.
    key: Key = ()
    node: Any = document.values
    for part in fault["loc"]:
        if isinstance(node, dict) and part in node:
            node = node[str(part)]
        elif isinstance(node, list) and isinstance(part, int) and part < len(node):
            node = node[part]
        elif fault["type"] != "missing" or not isinstance(part, str):
            continue
        key = (*key, part)
    place = next((document.places[key[:n]] for n in range(len(key), 0, -1) if key[:n] in document.places), "")
    dotted = ".".join(str(part) for part in key)
    prefix = place if place.startswith("--set") else ": ".join(part for part in (place, dotted or "config") if part)
    if fault["type"] == "extra_forbidden":
        known = _known_keys(key[:-1])
        near = difflib.get_close_matches(str(key[-1]), known, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}?" if near else f"expected one of: {', '.join(known)}"
        return f"{prefix}: unknown key; {hint}"
    if fault["type"] == "missing":
        return f"{prefix}: missing; this key has no default"
    message = fault["msg"].removeprefix("Value error, ")
    came = "" if isinstance(fault["input"], (dict, BaseModel)) else f", got {fault['input']!r}"
    return f"{prefix}: {message[0].lower()}{message[1:]}{came}"


def _known_keys(key: Key) -> list[str]:
    """Keys of the section at ``key``."""
    model: Any = Config
    for part in key:
        if isinstance(part, int):
            continue
        annotation = model.model_fields[part].annotation
        while not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            annotation = next(a for a in get_args(annotation) if a is not type(None) and a is not Ellipsis)
        model = annotation
    return sorted(model.model_fields)
