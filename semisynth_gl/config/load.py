"""Reading a config: layers of YAML and overrides, merged and then checked once."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import reduce
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from semisynth_gl.config.dataset_sections import LAYOUTS
from semisynth_gl.config.distributions import read_histogram
from semisynth_gl.config.errors import explained
from semisynth_gl.config.fields import is_number
from semisynth_gl.config.image_size import recentred, scaled
from semisynth_gl.config.layers import OVERRIDE, Layer, Values, merged
from semisynth_gl.config.model import Config
from semisynth_gl.config.yaml_values import DEEPEST, MOST_BYTES, Key, YamlError, read_yaml
from semisynth_gl.inputs.errors import InputError, cut, did_you_mean, near, shown
from semisynth_gl.inputs.resources import data_root
from semisynth_gl.inputs.user_files import expanded, read_file
from semisynth_gl.plugins import find_plugin, installed_plugins

# Largest factor of ``scale``, and of its inverse.
_MOST_TIMES = 64
# Largest number of configs in a chain, each of which extends the next.
_MOST_PARENTS = 16

Overrides = Mapping[str, Any] | Sequence[str | tuple[str, Any]]


def packaged_configs() -> list[str]:
    """Return the names of the packaged configs, sorted."""
    return sorted(Path(entry.name).stem for entry in data_root("configs").iterdir() if entry.name.endswith(".yaml"))


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
    return _validated(_over(_read(_find_config(str(name_or_path)), ()), _override_layer(overrides)))


def parse_values(values: Values, file: str, overrides: Overrides = ()) -> Config:
    """Return the config of values as YAML has them, and of overrides; messages name ``file`` as the values' source.

    Raises InputError as `load_config` does.
    """
    return _validated(_over(Layer(values, {(): file}), _override_layer(overrides)))


def overridden(values: Values, overrides: Overrides) -> Values:
    """Return a config's values with overrides merged over them, as `load_config` merges them; raises InputError."""
    return _over(Layer(values), _override_layer(overrides)).values


def _validated(layer: Layer) -> Config:
    layer = _with_histograms(_with_plugin_recipes(layer))
    try:
        config = Config.model_validate(layer.values)
    except ValidationError as error:
        raise InputError(explained(error, layer)) from None
    for recipe, fault in config.target_faults():
        keys = [tuple(key.split(".")) for key in fault.keys]
        raise InputError(layer.said(str(fault), keys, () if recipe is None else ("scenes", recipe)))
    installed_plugins()  # refuses one that has a built-in name, which the config may mean
    used = config.used_plugins()
    if config.layout is not None and config.layout not in LAYOUTS:
        used[("layout",)] = ("layouts", config.layout)
    for key, (group, name) in used.items():
        with _about(layer, key):
            find_plugin(group, name)
    return config


@contextmanager
def _about(layer: Layer, *keys: Key) -> Iterator[None]:
    """Put the place of keys in front of the message of an InputError."""
    try:
        yield
    except InputError as error:
        raise type(error)(layer.said(str(error), keys)) from None


# Reading layers


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


def _read(path: Path | Traversable, parents: tuple[str, ...]) -> Layer:
    """Read a file, with the configs below it that it extends; ``parents`` are the files that extend it."""
    file = str(path) if isinstance(path, Path) else path.name
    if file in parents:
        raise InputError(f"{file}: configs extend each other in a circle: {' -> '.join((*parents, file))}")
    if len(parents) > _MOST_PARENTS:
        raise InputError(f"{file}: more than {_MOST_PARENTS} configs in a chain, each of which extends the next")
    try:
        data = read_file(path, MOST_BYTES) if isinstance(path, Path) else path.read_bytes()
        text = data.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{file}: cannot be read as YAML: {reason}") from None
    return _parse(text, path, file, parents)


def _parse(text: str, path: Path | Traversable, file: str, parents: tuple[str, ...]) -> Layer:
    try:
        values, lines = read_yaml(text)
    except YamlError as error:
        place = file if error.line is None else f"{file}:{error.line}"
        raise InputError(f"{place}: {error}") from None
    if not isinstance(values, dict):
        raise InputError(f"{file}:1: expected sections such as camera: and disparity:, got {shown(values)}")
    layer = Layer(values, {(): file} | {key: f"{file}:{line}" for key, line in lines.items()})
    base_name = values.get("extends")
    if base_name is None:
        if "scale" in values:
            raise InputError(layer.said("expected extends beside it, which names what to scale", [("scale",)]))
        return layer
    with _about(layer, ("extends",)):
        if not isinstance(base_name, str):
            raise InputError(f"expected the name of a config, got {shown(base_name)}")
        beside = path.parent / expanded(base_name) if isinstance(path, Path) else None
        is_beside = beside is not None and os.path.isfile(beside)  # noqa: PTH113 - see _find_config
        base_path = beside if beside is not None and is_beside else _find_config(base_name)
    return _over(_read(base_path, (*parents, file)), layer)


def _override_layer(overrides: Overrides) -> Layer:
    layers = map(_parse_override, overrides.items() if isinstance(overrides, Mapping) else overrides)
    # Overrides stand beside each other: two of one property contradict each other.
    return reduce(lambda below, own: own.over(below, replacing=False), layers, Layer())


def _parse_override(override: object) -> Layer:
    name, value = _key_and_value(override)
    key = tuple(name.split("."))
    if len(key) > DEEPEST:
        raise InputError(f"{OVERRIDE} {cut(name)}: expected a key of at most {DEEPEST} parts")
    try:
        places = {key[:n]: OVERRIDE for n in range(1, len(key))} | dict.fromkeys(_keys_of(value, key), OVERRIDE)
    except RecursionError:
        raise InputError(f"{OVERRIDE} {name}: its value is nested too deeply") from None
    return Layer(reduce(lambda below, part: {part: below}, reversed(key), value), places)


def _key_and_value(override: object) -> tuple[str, Any]:
    """Return the dotted key of an override, and its value."""
    if isinstance(override, str):
        key, equals, text = override.partition("=")
        if not equals or not key:
            raise InputError(f"{OVERRIDE} {cut(override)}: expected dotted.key=value, such as camera.width_px=640")
        try:
            return key, read_yaml(text)[0]
        except YamlError as error:
            raise InputError(f"{OVERRIDE} {cut(key)}: the value {shown(text)}: {error}") from None
    if isinstance(override, tuple) and len(override) == 2 and isinstance(override[0], str):
        return override
    raise InputError(
        f"overrides: expected 'camera.width_px=640' or ('camera.width_px', 640) for each, got {shown(override)}"
    )


def _keys_of(value: Any, key: Key) -> list[Key]:  # noqa: ANN401 - any YAML value
    """Return ``key``, whose value is ``value``, and the keys of all values inside that value."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [key, *(below for part, child in parts for below in _keys_of(child, (*key, part)))]


def _over(below: Layer, layer: Layer) -> Layer:
    """Merge a layer over another, which is scaled or recentred where the layer changes the images."""
    factor = layer.values.get("scale")
    if factor is not None:
        if not (is_number(factor) and 1 / _MOST_TIMES <= factor <= _MOST_TIMES):
            expected = f"expected a number from 1/{_MOST_TIMES} to {_MOST_TIMES}"
            raise InputError(layer.said(f"{expected}, got {shown(factor)}", [("scale",)]))
        below = _with_histograms(below)
        below = replace(below, values=scaled(below.values, factor))
    own = {key: value for key, value in layer.values.items() if key not in ("extends", "scale")}
    return replace(layer, values=own).over(replace(below, values=recentred(below.values, own)))


# What is read from elsewhere


def _with_plugin_recipes(layer: Layer) -> Layer:
    """Merge each recipe over the plug-in's recipe that it extends."""
    recipes = layer.values.get("scenes")
    if not isinstance(recipes, list):
        return layer
    whole = []
    for number, recipe in enumerate(recipes):
        name = recipe.get("extends") if isinstance(recipe, dict) else None
        if isinstance(name, str):
            with _about(layer, ("scenes", number, "extends")):
                plugin = find_plugin("recipes", name)
            whole.append(merged({"recipe": name} | plugin.value, recipe))
        else:
            whole.append(recipe)
    return replace(layer, values=layer.values | {"scenes": whole})


def _with_histograms(layer: Layer) -> Layer:
    """Replace targets of form ``file`` by histograms."""
    recipes = layer.values.get("scenes")
    values = _with_histogram(layer, layer.values, ())
    if isinstance(recipes, list):
        values |= {"scenes": [_with_histogram(layer, each, ("scenes", k)) for k, each in enumerate(recipes)]}
    return replace(layer, values=values)


def _with_histogram(layer: Layer, sections: Any, at: Key) -> Any:  # noqa: ANN401 - any YAML value
    match sections:
        case {"disparity": {"target": {"form": "file"} as target}}:
            pass
        case _:
            return sections
    key, path = (*at, "disparity", "target"), target.get("path")
    if foreign := [name for name in target if name not in ("form", "path")]:
        raise InputError(layer.said("expected no key beside form and path", [(*key, foreign[0])]))
    if not isinstance(path, str):
        raise InputError(layer.said(f"expected the name of a file, got {shown(path)}", [(*key, "path")]))
    # A path in a config is relative to the config's folder, a path in an override to the working folder.
    _, place = layer.place((*key, "path"))
    folder = Path() if place in ("", OVERRIDE) else Path(place.rpartition(":")[0]).parent
    with _about(layer, (*key, "path")):
        histogram = read_histogram(folder / expanded(path))
    return sections | {"disparity": sections["disparity"] | {"target": histogram}}
