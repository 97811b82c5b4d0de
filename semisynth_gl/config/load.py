"""Reading a config: YAML with ``extends``, overrides, and errors that name file, line and key."""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from importlib.resources.abc import Traversable
from io import StringIO
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap

from semisynth_gl.config.dataset_sections import LAYOUTS
from semisynth_gl.config.distributions import read_histogram
from semisynth_gl.config.faults import (
    OVERRIDE,
    OVERRIDES,
    SCENES,
    TARGET,
    TARGET_FILE,
    explain_fault,
    is_override,
    named_place,
)
from semisynth_gl.config.fields import is_number
from semisynth_gl.config.image_size import recentred, scaled
from semisynth_gl.config.merge import Document, keys_of, merged
from semisynth_gl.config.model import Config
from semisynth_gl.config.yaml_values import DEEPEST, MOST_BYTES, Key, YamlError, read_yaml
from semisynth_gl.inputs.errors import InputError, counted, cut, did_you_mean, near, shown
from semisynth_gl.inputs.resources import data_root
from semisynth_gl.inputs.user_files import expanded, read_file
from semisynth_gl.plugins import find_plugin, installed_plugins

_EXTENDS = "extends"
_SCALE = "scale"

# Largest factor of ``scale``, and of its inverse.
_MOST_TIMES = 64
# Largest number of configs in a chain, each of which extends the next.
_MOST_PARENTS = 16
_FAULTS_SHOWN = 20


def packaged_configs() -> list[str]:
    """Return the names of the packaged configs, sorted."""
    return sorted(Path(entry.name).stem for entry in data_root("configs").iterdir() if entry.name.endswith(".yaml"))


Overrides = Mapping[str, Any] | Sequence[str | tuple[str, Any]]


def load_config(name_or_path: str | Path, overrides: Overrides = ()) -> Config:
    """Read a config.

    Where an override or an extending config changes ``camera.width_px`` or ``height_px``, principal points that it does
    not state itself keep their distance from the image's middle. With ``scale``, it first brings the config below it to
    another resolution.

    Args:
        name_or_path: a path, or the name of a packaged config with or without ".yaml".
        overrides: ``{"camera.width_px": 640}`` or ``{"camera": {"width_px": 640}}``, or a list of
            ``"camera.width_px=640"``, with a value in YAML, and of ``("camera.width_px", 640)``; later ones win.

    Raises:
        InputError: with a line per fault: its place (file, line), the dotted key, what was expected and what came.
    """
    if isinstance(overrides, str):  # a sequence of texts too
        raise InputError(f"overrides must be a Mapping or a list, got the text {shown(overrides)}: put it into a list")
    return _validated(_read_document(_find_config(str(name_or_path)), ()), overrides)


def parse_config(text: str, file: str) -> Config:
    """Read a config from its YAML text.

    Messages name ``file`` as the source, and relative paths in the text count from its folder; ``file`` need not exist.
    Raises InputError as `load_config` does.
    """
    return _validated(_parse_document(text, Path(file), file, ()))


def with_overrides(text: str, overrides: Overrides) -> str:
    """Return a config's YAML text with overrides written into it; comments stay where they are.

    Raises InputError as `load_config` does.
    """
    _validated(_parse_document(text, Path(), "the config", ()), overrides)
    yaml = YAML()
    yaml.width = 100
    yaml.indent(mapping=2, sequence=4, offset=2)
    tree = yaml.load(text)
    for key, value, _ in map(_key_and_value, overrides.items() if isinstance(overrides, Mapping) else overrides):
        *sections, last = key.split(".")
        node = tree
        for section in sections:
            node = node.setdefault(section, CommentedMap())
        # A new last key would stand behind the comment on the next section.
        if last in node:
            node[last] = value
        else:
            node.insert(0, last, value)
    stream = StringIO()
    yaml.dump(tree, stream)
    return stream.getvalue()


def _validated(document: Document, overrides: Overrides = ()) -> Config:
    own = Document()
    for override in overrides.items() if isinstance(overrides, Mapping) else overrides:
        _set(own, *_key_and_value(override))
    document = _over(document, own)
    _read_other_sources(document)
    try:
        config = Config.model_validate(document.values)
    except ValidationError as error:
        faults = error.errors(include_url=False)
        lines = [explain_fault(fault, document) for fault in faults[:_FAULTS_SHOWN]]
        more = [f"and {counted(len(faults) - _FAULTS_SHOWN, 'more fault')}"] if len(faults) > _FAULTS_SHOWN else []
        raise InputError("\n".join([*dict.fromkeys(lines), *more])) from None
    installed_plugins()  # refuses one that has a built-in name, which the config may mean
    used = config.used_plugins()
    if config.layout is not None and config.layout not in LAYOUTS:
        used[("layout",)] = ("layouts", config.layout)
    for key, (group, name) in used.items():
        with _blamed_on(key, document):
            find_plugin(group, name)
    return config


def _over(base: Document, own: Document) -> Document:
    """Merge the values of ``own`` over those of ``base``, scaled or recentred where ``own`` changes the images."""
    factor = own.values.pop(_SCALE, None)
    if factor is not None:
        if not (is_number(factor) and 1 / _MOST_TIMES <= factor <= _MOST_TIMES):
            expected = f"expected a number from 1/{_MOST_TIMES} to {_MOST_TIMES}"
            raise InputError(f"{named_place((_SCALE,), own)}: {expected}, got {shown(factor)}")
        _read_other_sources(base)
        base = replace(base, values=scaled(base.values, factor))
    return merged(replace(base, values=recentred(base.values, own.values)), own)


def _read_other_sources(document: Document) -> None:
    """Merge recipes over the plug-ins' recipes that they extend, and replace targets of form ``file`` by histograms."""
    recipes = document.values.get(SCENES)
    recipes = recipes if isinstance(recipes, list) else []
    for number, recipe in enumerate(recipes):
        name = recipe.get(_EXTENDS) if isinstance(recipe, dict) else None
        if isinstance(name, str):
            with _blamed_on((SCENES, number, _EXTENDS), document):
                keys = find_plugin("recipes", name).value
            # A copy in JSON's types, which a config has.
            keys = json.loads(json.dumps({"recipe": name} | keys))
            recipes[number] = merged(Document(keys), Document(recipe)).values
    _read_target_file(document, document.values, ())
    for number, recipe in enumerate(recipes):
        if isinstance(recipe, dict):
            _read_target_file(document, recipe, (SCENES, number))


@contextmanager
def _blamed_on(key: Key, document: Document) -> Iterator[None]:
    """Put the place of a key before the message of an InputError."""
    try:
        yield
    except InputError as error:
        raise type(error)(f"{named_place(key, document)}: {error}") from None


def _read_target_file(document: Document, sections: dict[str, Any], at: Key) -> None:
    disparity = sections.get(TARGET[0])
    target = disparity.get(TARGET[1]) if isinstance(disparity, dict) else None
    if not (isinstance(disparity, dict) and isinstance(target, dict) and target.get("form") == TARGET_FILE):
        return
    path, at = target.get("path"), (*at, *TARGET)
    faults = [((*at, key), "expected no key beside form and path") for key in target if key not in ("form", "path")]
    if "path" not in target:
        faults.append(((*at, "form"), "a target of form file needs a path beside it: disparity.target.path"))
    elif not isinstance(path, str):
        faults.append(((*at, "path"), f"expected the name of a file, got {shown(path)}"))
    if faults:
        raise InputError("\n".join(f"{named_place(key, document)}: {fault}" for key, fault in faults))
    # A path in a config is relative to the config's folder, a path in an override to the working folder.
    place = document.places.get((*at, "path"), OVERRIDES)
    folder = Path() if is_override(place) else Path(place.rpartition(":")[0]).parent
    with _blamed_on((*at, "path"), document):
        disparity[TARGET[1]] = read_histogram(folder / expanded(str(path)))


def _find_config(name: str) -> Path | Traversable:
    path = expanded(name)
    # Only regular files are opened later. A name that is not a valid path counts as missing.
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
        raise InputError(f"{file}: more than {_MOST_PARENTS} configs in a chain, each of which extends the next")
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
    own = Document(tree, {key: f"{file}:{line}" for key, line in lines.items()}, (file,))
    base_name = own.values.pop(_EXTENDS, None)
    if base_name is None:
        if _SCALE in own.values:
            raise InputError(f"{named_place((_SCALE,), own)}: expected {_EXTENDS} beside it, which names what to scale")
        return own
    with _blamed_on((_EXTENDS,), own):
        if not isinstance(base_name, str):
            raise InputError(f"expected the name of a config, got {shown(base_name)}")
        beside = path.parent / expanded(base_name) if isinstance(path, Path) else None
        is_beside = beside is not None and os.path.isfile(beside)  # noqa: PTH113 - see _find_config
        base_path = beside if beside is not None and is_beside else _find_config(base_name)
    return _over(_read_document(base_path, (*parents, file)), own)


def _key_and_value(override: object) -> tuple[str, Any, str]:
    """Return the dotted key of an override, its value, and its name in messages."""
    if isinstance(override, str):
        key, equals, text = override.partition("=")
        if not equals or not key:
            raise InputError(f"{OVERRIDE} {cut(override)}: expected dotted.key=value, such as camera.width_px=640")
        try:
            return key, read_yaml(text)[0], f"{OVERRIDE} {cut(key)}"
        except YamlError as error:
            raise InputError(f"{OVERRIDE} {cut(key)}: the value {shown(text)}: {error}") from None
    if isinstance(override, tuple) and len(override) == 2 and isinstance(override[0], str):
        return *override, OVERRIDES
    raise InputError(
        f"overrides: expected 'camera.width_px=640' or ('camera.width_px', 640) for each, got {shown(override)}"
    )


def _set(document: Document, dotted: str, value: Any, place: str) -> None:  # noqa: ANN401 - any YAML value
    *sections, last = key = tuple(dotted.split("."))
    named = place if place != OVERRIDES else f"{place}: {cut(dotted)}"
    if len(sections) > DEEPEST:
        raise InputError(f"{named}: expected a key of at most {DEEPEST} parts")
    node = document.values
    for section in sections:
        node = node.setdefault(section, {})
        if not isinstance(node, dict):
            raise InputError(f"{named}: {section} is not a section with keys of its own")
    for below in keys_of(node.get(last), key):
        document.places.pop(below, None)
    try:
        # A copy, so that later overrides change the document and not the caller's value.
        node[last] = deepcopy(value)
        # An override with a mapping sets all keys of the mapping.
        document.places |= dict.fromkeys(keys_of(value, key), place)
    except RecursionError:
        raise InputError(f"{named}: its value is nested too deeply") from None
