"""Reading a config: YAML with ``extends``, overrides, and errors that name file, line and key."""

import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import deepcopy
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from semisynth_gl.arguments import check_type
from semisynth_gl.config.dataset_sections import LAYOUTS
from semisynth_gl.config.distributions import read_histogram
from semisynth_gl.config.fields import is_number, reason_of
from semisynth_gl.config.image_size import recentred, scaled
from semisynth_gl.config.keys import by_form, config_keys, members_of
from semisynth_gl.config.merge import Document, keys_of, merged
from semisynth_gl.config.model import Config
from semisynth_gl.config.plugin_recipes import plugin_recipe
from semisynth_gl.config.scene_sections import TEXTURE_SOURCES
from semisynth_gl.config.yaml_values import DEEPEST, MOST_BYTES, Key, YamlError, read_yaml
from semisynth_gl.errors import InputError, counted, cut, did_you_mean, near, shown
from semisynth_gl.plugins import Group, find_plugin
from semisynth_gl.resources import data_root
from semisynth_gl.user_files import expanded, read_file

_EXTENDS = "extends"
_TARGET = ("disparity", "target")
_TARGET_FILE = "file"
_SCENES = "scenes"
_SCALE = "scale"
_OVERRIDE, _OVERRIDES = "--set", "overrides"

_BUILT_IN: Mapping[Group, Sequence[str]] = {"layouts": LAYOUTS, "textures": TEXTURE_SOURCES}

_MOST_TIMES = 64
# Configs that extend each other, one the next.
_MOST_PARENTS = 16
_FAULTS_SHOWN = 20
# Keys of one name that a message suggests, and how alike keys are that differ by a letter or two.
_KEYS_SHOWN, _BY_A_LETTER = 3, 0.9


def packaged_configs() -> list[str]:
    """Return the names of the packaged configs, sorted."""
    return sorted(Path(entry.name).stem for entry in data_root("configs").iterdir() if entry.name.endswith(".yaml"))


Overrides = Mapping[str, Any] | Sequence[str | tuple[str, Any]]


def load_config(name_or_path: str | Path, overrides: Overrides = ()) -> Config:
    """Read a config.

    A principal point follows where ``camera.width_px`` or ``height_px`` of an override or an extending config is
    another, and with a ``scale``, what they go over is brought to another resolution.

    Args:
        name_or_path: a path, or the name of a packaged config with or without ".yaml".
        overrides: ``{"camera.width_px": 640}`` or ``{"camera": {"width_px": 640}}``, or a list of
            ``"camera.width_px=640"``, with a value in YAML, and of ``("camera.width_px", 640)``; later ones win.

    Raises:
        InputError: with a line per fault: its place (file, line), the dotted key, what was expected and what came.
    """
    check_type("config", name_or_path, str | Path)
    if isinstance(overrides, str):  # a sequence of texts too
        raise InputError(f"overrides must be a Mapping or a list, got the text {shown(overrides)}: put it into a list")
    check_type("overrides", overrides, Mapping | Sequence)
    return _validated(_read_document(_find_config(str(name_or_path)), ()), overrides)


def parse_config(text: str, file: str) -> Config:
    """Read a config from its YAML.

    Args:
        text: the YAML. A file that it names without a folder is sought beside ``file``.
        file: the file that messages name.

    Raises:
        InputError: see `load_config`.
    """
    return _validated(_parse_document(text, Path(file), file, ()))


def _validated(document: Document, overrides: Overrides = ()) -> Config:
    own = Document()
    for override in overrides.items() if isinstance(overrides, Mapping) else overrides:
        _set(own, *_key_and_value(override))
    document = _over(document, own)
    _read_plugin_recipes(document)
    _read_target_files(document)
    try:
        config = Config.model_validate(document.values)
    except ValidationError as error:
        faults = error.errors(include_url=False)
        lines = [_explain(fault, document) for fault in faults[:_FAULTS_SHOWN]]
        more = [f"and {counted(len(faults) - _FAULTS_SHOWN, 'more fault')}"] if len(faults) > _FAULTS_SHOWN else []
        raise InputError("\n".join([*dict.fromkeys(lines), *more])) from None
    used = config.used_plugins()
    if config.layout is not None and config.layout not in LAYOUTS:
        used[("layout",)] = ("layouts", config.layout)
    for key, (group, name) in used.items():
        try:
            find_plugin(group, name, _BUILT_IN.get(group, ()))
        except InputError as error:
            raise type(error)(f"{_prefix(key, document)}: {error}") from None
    return config


def _over(base: Document, own: Document) -> Document:
    """Return a document's values over those of another, which follow where these change the size of the images."""
    factor = own.values.pop(_SCALE, None)
    if factor is not None:
        if not (is_number(factor) and 1 / _MOST_TIMES <= factor <= _MOST_TIMES):
            expected = f"expected a number from 1/{_MOST_TIMES} to {_MOST_TIMES}"
            raise InputError(f"{_prefix((_SCALE,), own)}: {expected}, got {shown(factor)}")
        _read_plugin_recipes(base)
        _read_target_files(base)
        base = Document(scaled(base.values, factor), base.places)
    return merged(Document(recentred(base.values, own.values), base.places), own)


def _read_plugin_recipes(document: Document) -> None:
    """Put the keys of plug-ins' recipes below those of the recipes that extend them."""
    recipes = document.values.get(_SCENES)
    if not isinstance(recipes, list):
        return
    for number, recipe in enumerate(recipes):
        name = recipe.get(_EXTENDS) if isinstance(recipe, dict) else None
        if isinstance(name, str):
            try:
                keys = plugin_recipe(name)
            except InputError as error:
                raise type(error)(f"{_prefix((_SCENES, number, _EXTENDS), document)}: {error}") from None
            recipes[number] = merged(Document({"recipe": name} | keys), Document(recipe)).values


def _read_target_files(document: Document) -> None:
    """Put histograms in the places of the files that targets name: the config's target, and those of recipes."""
    recipes = document.values.get(_SCENES)
    _read_target_file(document, document.values, ())
    for number, recipe in enumerate(recipes if isinstance(recipes, list) else ()):
        if isinstance(recipe, dict):
            _read_target_file(document, recipe, (_SCENES, number))


def _read_target_file(document: Document, sections: dict[str, Any], at: Key) -> None:
    disparity = sections.get(_TARGET[0])
    target = disparity.get(_TARGET[1]) if isinstance(disparity, dict) else None
    if not (isinstance(disparity, dict) and isinstance(target, dict) and target.get("form") == _TARGET_FILE):
        return
    path, at = target.get("path"), (*at, *_TARGET)
    faults = [((*at, key), "expected none beside form and path") for key in target if key not in ("form", "path")]
    if "path" not in target:
        faults.append(((*at, "form"), "a target of form file needs a path beside it: disparity.target.path"))
    elif not isinstance(path, str):
        faults.append(((*at, "path"), f"expected the name of a file, got {shown(path)}"))
    if faults:
        raise InputError("\n".join(f"{_prefix(key, document)}: {fault}" for key, fault in faults))
    # A path in a config counts from the folder of the config, a path in an override from the working folder.
    place = document.places.get((*at, "path"), _OVERRIDES)
    folder = Path() if _is_override(place) else Path(place.rpartition(":")[0]).parent
    try:
        disparity[_TARGET[1]] = read_histogram(folder / expanded(str(path)))
    except InputError as error:
        raise InputError(f"{_prefix((*at, 'path'), document)}: {error}") from None


def _find_config(name: str) -> Path | Traversable:
    path = expanded(name)
    # What is no file of a disk is refused when it is opened; a name that no file can have is none.
    if os.path.exists(path) and not os.path.isdir(path):  # noqa: PTH110, PTH112 - those raise at such names
        return path
    stem, names = path.name.removesuffix(".yaml"), packaged_configs()
    if path.parent == Path() and stem in names:
        return data_root("configs") / f"{stem}.yaml"
    hint = did_you_mean(near(stem, names))
    raise InputError(
        f"no such config: {cut(name)}; {hint}{' ' if hint else ''}expected a YAML file, or one of: {', '.join(names)}"
    )


def _read_document(path: Path | Traversable, parents: tuple[str, ...]) -> Document:
    file = str(path) if isinstance(path, Path) else path.name
    if file in parents:
        raise InputError(f"{file}: configs extend each other in a circle: {' -> '.join((*parents, file))}")
    if len(parents) > _MOST_PARENTS:
        raise InputError(f"{file}: more than {_MOST_PARENTS} configs extend each other, one the next")
    try:
        data = read_file(path, MOST_BYTES) if isinstance(path, Path) else path.read_bytes()
        text = data.decode("utf-8")
    except OSError as error:
        raise InputError(f"{file}: cannot be read as YAML: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: cannot be read as YAML: {error}") from None
    return _parse_document(text, path, file, parents)


def _parse_document(text: str, path: Path | Traversable, file: str, parents: tuple[str, ...]) -> Document:
    try:
        tree, lines = read_yaml(text)
    except YamlError as error:
        place = file if error.line is None else f"{file}:{error.line}"
        raise InputError(f"{place}: {error}") from None
    if not isinstance(tree, dict):
        raise InputError(f"{file}:1: expected sections such as camera: and disparity:, got {shown(tree)}")
    own = Document(tree, {key: f"{file}:{line}" for key, line in lines.items()})
    base_name = own.values.pop(_EXTENDS, None)
    if base_name is None:
        if _SCALE in own.values:
            raise InputError(f"{own.places[(_SCALE,)]}: {_SCALE}: expected {_EXTENDS} beside it: it scales that config")
        return own
    place = own.places[(_EXTENDS,)]
    if not isinstance(base_name, str):
        raise InputError(f"{place}: {_EXTENDS}: expected the name of a config, got {shown(base_name)}")
    try:
        beside = path.parent / expanded(base_name) if isinstance(path, Path) else None
        is_beside = beside is not None and os.path.isfile(beside)  # noqa: PTH113 - see _find_config
        base_path = beside if beside is not None and is_beside else _find_config(base_name)
    except InputError as error:
        raise InputError(f"{place}: {_EXTENDS}: {error}") from None
    return _over(_read_document(base_path, (*parents, file)), own)


def _key_and_value(override: object) -> tuple[str, Any, str]:
    """Return the dotted key and the value of an override, and what messages call it."""
    if isinstance(override, str):
        key, value = _parsed_override(override)
        return key, value, f"{_OVERRIDE} {cut(key)}"
    if isinstance(override, tuple) and len(override) == 2 and isinstance(override[0], str):
        return *override, _OVERRIDES
    raise InputError(
        f"overrides: expected 'camera.width_px=640' or ('camera.width_px', 640) of each, got {shown(override)}"
    )


def _parsed_override(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise InputError(f"{_OVERRIDE} {cut(text)}: expected dotted.key=value, such as camera.width_px=640")
    try:
        return key, read_yaml(value)[0]
    except YamlError as error:
        raise InputError(f"{_OVERRIDE} {cut(key)}: the value {shown(value)}: {error}") from None


def _set(document: Document, dotted: str, value: Any, place: str) -> None:  # noqa: ANN401 - any YAML value
    *sections, last = key = tuple(dotted.split("."))
    named = place if place != _OVERRIDES else f"{place}: {cut(dotted)}"
    if len(sections) > DEEPEST:
        raise InputError(f"{named}: expected a key of at most {DEEPEST} parts")
    node = document.values
    for section in sections:
        node = node.setdefault(section, {})
        if not isinstance(node, dict):
            raise InputError(f"{named}: {section} is no section with keys of its own")
    for below in keys_of(node.get(last), key):
        document.places.pop(below, None)
    try:
        # What overrides it goes into it, and not into the caller's.
        node[last] = deepcopy(value)
        # The override sets all keys of a mapping too.
        document.places |= dict.fromkeys(keys_of(value, key), place)
    except RecursionError:
        raise InputError(f"{named}: its value is nested too deeply") from None


def _explain(fault: ErrorDetails, document: Document) -> str:
    key, section = _locate(fault["loc"])
    kind = fault["type"]
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _explain_form((*key, "form"), by_form(section.model_fields[str(key[-1])].annotation), fault, document)
    prefix = _prefix(key, document)
    if kind == "extra_forbidden" and key[0] == _SCENES:
        known_key = next((each for each in config_keys() if each.parts == key[2:] and not each.of_form), None)
        if known_key is not None and known_key.parts != (_SCENES,):
            hint = f"set {known_key.dotted} beside {_SCENES}"
            return f"{prefix}: a recipe cannot change it, which holds for all pairs: {hint}"
    if kind == "extra_forbidden":
        known = sorted(section.model_fields)
        hint = did_you_mean(_meant_keys(key, known, fault["input"]), f"expected one of: {', '.join(known)}")
        return f"{prefix}: unknown key; {hint}"
    if kind == "missing":
        return f"{prefix}: missing; this key has no default"
    if kind in ("model_type", "model_attributes_type"):
        return f"{prefix}: expected a section with keys of its own, got {shown(fault['input'])}"
    value = "" if isinstance(fault["input"], (dict, BaseModel)) else f", got {shown(fault['input'])}"
    reason = reason_of(fault)
    return f"{prefix}: {reason}{value}{_set_elsewhere(key, reason, document)}"


def _set_elsewhere(key: Key, reason: str, document: Document) -> str:
    """Return where keys that a reason names were set, if by an override or in another file than the fault's key."""
    own = _place(key, document)
    found = {}
    for word in re.findall(r"\b[a-z]\w*(?:\.\w+)*", reason):
        parts = tuple(word.split("."))
        for whole in (parts, (*key, *parts)):
            place = document.places.get(whole, "")
            in_other_file = _is_override(place) or place.rpartition(":")[0] != own.rpartition(":")[0]
            # A word alone may be any, but for one that names a key of this section.
            if place and place != own and in_other_file and len(whole) > 1:
                found[".".join(map(str, whole))] = place
    said = [place if place.startswith(_OVERRIDE) else f"{dotted} of {place}" for dotted, place in found.items()]
    return f" (with {', '.join(dict.fromkeys(said[:_KEYS_SHOWN]))})" if said else ""


def _explain_form(key: Key, names: Iterable[str], fault: ErrorDetails, document: Document) -> str:
    """Say which forms a target may have, where the key ``form`` is missing or wrong."""
    is_part = key[-3:-1] != _TARGET
    names = [*names, *(() if is_part else (_TARGET_FILE,))]
    prefix, listed = _prefix(key, document), f"expected one of: {', '.join(names)}"
    if fault["type"] == "union_tag_not_found":
        return f"{prefix}: missing; {listed}"
    form = cut(fault["ctx"]["tag"])
    if form == _TARGET_FILE and is_part:
        return f"{prefix}: a part of a mixture takes no file, only a whole target does; {listed}"
    hint = did_you_mean(near(form, names))
    return f"{prefix}: unknown form {form}; {hint}{' ' if hint else ''}{listed}"


def _meant_keys(key: Key, siblings: Collection[str], value: object) -> list[str]:
    """Return the dotted keys that an unknown one may have been meant for.

    Args:
        key: the unknown key.
        siblings: the keys of its section.
        value: its value; of a misspelt section, the keys in it.
    """
    *above, last = map(str, key)
    inner: list[str] = []
    while isinstance(value, Mapping) and len(value) == 1:
        ((name, value),) = value.items()
        inner.append(str(name))
    whole, known = ".".join([*above, last, *inner]), [each.dotted for each in config_keys()]
    alike = [".".join([*above, name]) for name in near(last, siblings)]
    if key[0] == _SCENES:  # a recipe has sections of its own
        return alike
    if inner:
        alike = near(whole, known) or alike
    # The same key of another section, unless a sibling differs from it by a letter or two.
    leaf = whole.rpartition(".")[2]
    elsewhere = [name for name in known if name.rpartition(".")[2] == leaf and name != whole][:_KEYS_SHOWN]
    if not elsewhere:
        return alike
    return list(dict.fromkeys([*near(whole, alike, least_ratio=_BY_A_LETTER), *elsewhere]))


def _prefix(key: Key, document: Document) -> str:
    """Return the place where a key was set, as far as it is known, and the key."""
    place = _place(key, document)
    dotted = ".".join(str(part) for part in key) or "config"
    return place if place == f"{_OVERRIDE} {dotted}" else ": ".join(part for part in (place, dotted) if part)


def _place(key: Key, document: Document) -> str:
    """Return where a key, or the nearest one above it that is known, was set; "" where none is known."""
    return next((document.places[key[:n]] for n in range(len(key), 0, -1) if key[:n] in document.places), "")


def _is_override(place: str) -> bool:
    return place == _OVERRIDES or place.startswith(f"{_OVERRIDE} ")


def _locate(location: tuple[int | str, ...]) -> tuple[Key, type[BaseModel]]:
    """Return the key in the document for a location of pydantic's, and the section of the key.

    Pydantic's locations also have the names of forms, of other members of unions and of validators.
    """
    key: Key = ()
    section: type[BaseModel] = Config
    annotation: Any = Config
    for part in location:
        forms, members = by_form(annotation), members_of(annotation)
        kind = members[0] if len(members) == 1 else None
        if forms:
            annotation = forms.get(str(part))
        elif isinstance(kind, type) and issubclass(kind, BaseModel):
            section, key = kind, (*key, part)
            known = kind.model_fields.get(str(part))
            annotation = None if known is None else known.annotation
        elif get_origin(kind) in (tuple, dict):
            key = (*key, part)
            annotation = get_args(kind)[0 if get_origin(kind) is tuple else 1]
    return key, section
