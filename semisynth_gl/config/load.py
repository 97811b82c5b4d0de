"""Reading a config: YAML with ``extends``, overrides, and errors that name file, line and key."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources.abc import Traversable
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

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
_TARGET = ("disparity", "target")
_TARGET_FILE = "file"
_FILE_KEYS = ("form", "path")
_OVERRIDE = "--set"

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
    return _config(_read(_find(str(name_or_path)), ()), overrides)


def parse_config(text: str, shown: str) -> Config:
    """Read a config from its YAML.

    Args:
        text: the YAML; files that it names without a folder are sought beside ``shown``.
        shown: the file that faults are said to be in.

    Raises:
        InputError: see `load_config`.
    """
    return _config(_parse(text, Path(shown), shown, ()))


def _config(document: _Document, overrides: Mapping[str, Any] | Sequence[str] = ()) -> Config:
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
    disparity = document.values.get(_TARGET[0])
    target = disparity.get(_TARGET[1]) if isinstance(disparity, dict) else None
    if not (isinstance(disparity, dict) and isinstance(target, dict) and target.get("form") == _TARGET_FILE):
        return
    path = target.get("path")
    faults = [((*_TARGET, name), "expected none beside form and path") for name in target if name not in _FILE_KEYS]
    if "path" not in target:
        faults.append(((*_TARGET, "form"), "a target of form file needs a path beside it: disparity.target.path"))
    elif not isinstance(path, str):
        faults.append(((*_TARGET, "path"), f"expected the name of a file, got {path!r}"))
    if faults:
        raise InputError("\n".join(f"{_prefix(key, document)}: {fault}" for key, fault in faults))
    # A path is meant from where it was written: beside the config, or from where the command runs.
    place = document.places.get((*_TARGET, "path"), _OVERRIDE)
    written_in = Path() if place.startswith(_OVERRIDE) else Path(place.rpartition(":")[0]).parent
    disparity[_TARGET[1]] = histogram_of_file(written_in / Path(str(path)).expanduser())


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
        text = path.read_text(encoding="utf-8")
    except (UnicodeDecodeError, OSError) as error:
        raise InputError(f"{shown}: cannot be read as YAML: {error}") from None
    return _parse(text, path, shown, parents)


def _parse(text: str, path: Path | Traversable, shown: str, parents: tuple[str, ...]) -> _Document:
    try:
        tree = YAML(typ="rt", pure=True).load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark else ""
        raise InputError(f"{shown}{line}: not valid YAML: {error.problem or error.context}") from None
    except YAMLError as error:
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
    # Of what is replaced, nobody shall be sent to where it once was set.
    places = dict(base.places)

    def forget(key: Key) -> None:
        for other in _at_or_below(key, places):
            del places[other]
        # A key that was set through one below it has that one's place.
        through = _at_or_below(key, own.places)
        if through:
            places[key] = own.places[through[0]]

    def merged(below: dict[str, Any], above: dict[str, Any], at: Key) -> dict[str, Any]:
        result = {}
        for name, value in below.items():
            if _is_replaced(name, above):
                forget((*at, name))
            else:
                result[name] = value
        for name, value in above.items():
            # A form comes with all its keys: those of another form do not belong to it.
            if isinstance(value, dict) and isinstance(below.get(name), dict) and "form" not in value:
                result[name] = merged(below[name], value, (*at, name))
            else:
                forget((*at, name))
                result[name] = value
        return result

    values = merged(base.values, own.values, ())
    return _Document(values, places | own.places)


def _at_or_below(key: Key, places: Mapping[Key, str]) -> list[Key]:
    return [other for other in places if other[: len(key)] == key]


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
    key = (*sections, last)
    for other in _at_or_below(key, document.places):
        del document.places[other]
    node[last] = value
    # All that a mapping holds was set here too.
    document.places |= dict.fromkeys(_keys(value, key), f"{_OVERRIDE} {dotted}")


def _keys(value: Any, key: Key) -> list[Key]:  # noqa: ANN401 - any YAML value
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [key, *(below for part, child in parts for below in _keys(child, (*key, part)))]


def _explain(fault: ErrorDetails, document: _Document) -> str:
    key, section = _located(fault["loc"])
    kind = fault["type"]
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _explain_form((*key, "form"), fault, document)
    prefix = _prefix(key, document)
    if kind == "extra_forbidden":
        known = sorted(section.model_fields)
        near = difflib.get_close_matches(str(key[-1]), known, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}?" if near else f"expected one of: {', '.join(known)}"
        return f"{prefix}: unknown key; {hint}"
    if kind == "missing":
        return f"{prefix}: missing; this key has no default"
    message = fault["msg"].removeprefix("Value error, ")
    came = "" if isinstance(fault["input"], (dict, BaseModel)) else f", got {fault['input']!r}"
    return f"{prefix}: {message[0].lower()}{message[1:]}{came}"


def _explain_form(key: Key, fault: ErrorDetails, document: _Document) -> str:
    """Say which forms there are where none is named, or one that is none."""
    forms = list(_forms_at(fault["loc"]))
    whole = key[:-1] == _TARGET
    if whole:
        forms.append(_TARGET_FILE)
    prefix, listed = _prefix(key, document), f"expected one of: {', '.join(forms)}"
    if fault["type"] == "union_tag_not_found":
        return f"{prefix}: missing; {listed}"
    form = fault["ctx"]["tag"]
    if form == _TARGET_FILE and not whole:
        return f"{prefix}: a part of a mixture takes no file, only a whole target does; {listed}"
    near = difflib.get_close_matches(form, forms, n=1, cutoff=0.5)
    return f"{prefix}: unknown form {form}; {f'did you mean {near[0]}? ' if near else ''}{listed}"


def _prefix(key: Key, document: _Document) -> str:
    """Return where a key was set, as far as that is known, and the key."""
    above = next((key[:n] for n in range(len(key), 0, -1) if key[:n] in document.places), None)
    place = "" if above is None else document.places[above]
    dotted = ".".join(str(part) for part in key) or "config"
    return place if place == f"{_OVERRIDE} {dotted}" else ": ".join(part for part in (place, dotted) if part)


def _located(location: tuple[int | str, ...]) -> tuple[Key, type[BaseModel]]:
    """Return the key that a location of pydantic's stands for, and the section that holds it.

    Pydantic adds names of forms, of other union members and of validators; users know the document's keys alone.
    """
    key: Key = ()
    section: type[BaseModel] = Config
    kind: Any = Config
    for part in location:
        kind = _bare(kind)
        forms = _forms(kind)
        if forms:
            kind = forms.get(str(part))
        elif isinstance(kind, type) and issubclass(kind, BaseModel):
            section, key = kind, (*key, part)
            known = kind.model_fields.get(str(part))
            kind = None if known is None else known.annotation
        elif get_origin(kind) in (tuple, dict):
            key = (*key, part)
            kind = get_args(kind)[0 if get_origin(kind) is tuple else 1]
    return key, section


def _forms_at(location: tuple[int | str, ...]) -> dict[str, type[BaseModel]]:
    """Return the forms of the target at a location, by name."""
    key, section = _located(location)
    return _forms(_bare(section.model_fields[str(key[-1])].annotation))


def _bare(annotation: Any) -> Any:  # noqa: ANN401 - any annotation
    """Return an annotation without its notes, and without the None that a key may be."""
    while True:
        if get_origin(annotation) is Annotated:
            annotation = get_args(annotation)[0]
            continue
        members = [member for member in _members(annotation) if member is not type(None)]
        if len(members) != 1:
            return annotation
        annotation = members[0]


def _members(annotation: Any) -> tuple[Any, ...]:  # noqa: ANN401 - any annotation
    return get_args(annotation) if get_origin(annotation) in (Union, UnionType) else ()


def _forms(annotation: Any) -> dict[str, type[BaseModel]]:  # noqa: ANN401 - any annotation
    """Return the sections of a union that their key ``form`` tells apart, by its value."""
    members = _members(annotation)
    if not all(isinstance(member, type) and issubclass(member, BaseModel) for member in members):
        return {}
    return {get_args(member.model_fields["form"].annotation)[0]: member for member in members}
