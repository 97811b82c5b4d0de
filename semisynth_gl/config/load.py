"""Reads a config: layers of YAML and overrides are merged, and then checked once."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from semisynth_gl.config.errors import fault_lines
from semisynth_gl.config.fields import LARGEST, SMALLEST, is_number
from semisynth_gl.config.image_size import recentred, scaled
from semisynth_gl.config.layers import OVERRIDE, ConfigLayer, Values, merged
from semisynth_gl.config.model import Config
from semisynth_gl.config.yaml_values import MOST_BYTES, KeyPath, YamlError, read_yaml
from semisynth_gl.inputs.errors import InputError, cut, did_you_mean, most_similar, shown
from semisynth_gl.inputs.resources import data_root
from semisynth_gl.inputs.user_files import expanded, read_file
from semisynth_gl.plugins import BUILT_IN, find_plugin, installed_plugins

Overrides = Mapping[str, Any] | Sequence[str | tuple[str, Any]]


def packaged_configs() -> list[str]:
    """Return the names of the packaged configs, sorted."""
    return sorted(Path(entry.name).stem for entry in data_root("configs").iterdir() if entry.name.endswith(".yaml"))


def summaries() -> dict[str, str]:
    """Return a sentence on the purpose of each packaged config, by its name: the first comment of its file."""
    texts = {name: data_root("configs").joinpath(f"{name}.yaml").read_text("utf-8") for name in packaged_configs()}
    return {name: text.partition("\n")[0].removeprefix("#").strip() for name, text in texts.items()}


def load_config(name_or_path: str | Path, overrides: Overrides = ()) -> Config:
    """Read a config.

    If an override or an extending config changes ``camera.width_px`` or ``height_px``, but states no principal points,
    these keep their distance from the image's middle. A key ``scale`` of a file changes the resolution of the config
    that the file extends; an override of ``scale`` changes the resolution of the whole file.

    Args:
        name_or_path: a path, or the name of a packaged config with or without ".yaml".
        overrides: ``{"camera.width_px": 640}`` or ``{"camera": {"width_px": 640}}``, or a list of
            ``"camera.width_px=640"``, with a value in YAML, and of ``("camera.width_px", 640)``; later ones win.

    Raises:
        InputError: if the config is wrong; each fault has a line with file, line, key, expected and found value.
    """
    return _validated(_over(_read(_find_config(str(name_or_path)), ()), _override_layer(overrides)))


def parse_values(values: Values, file: str) -> Config:
    """Return the config that has these values, as read from YAML; messages name ``file`` as their source.

    Raises InputError as `load_config` does.
    """
    return _validated(ConfigLayer(values, {(): file}))


def _validated(layer: ConfigLayer) -> Config:
    layer = _with_plugin_recipes(layer)
    try:
        config = Config.model_validate(layer.values)
    except ValidationError as error:
        raise InputError(fault_lines(error, layer)) from None
    installed_plugins()  # raises if two plug-ins, or a plug-in and a built-in layout or texture source, share a name
    used = config.used_plugins()
    if config.layout is not None and config.layout not in BUILT_IN["layouts"]:
        used["layout",] = ("layouts", config.layout)
    for key, (group, name) in used.items():
        with _errors_at(layer, key):
            find_plugin(group, name)
    return config


@contextmanager
def _errors_at(layer: ConfigLayer, key: KeyPath) -> Iterator[None]:
    """Put a key and its place in front of the message of an InputError of the block."""
    try:
        yield
    except InputError as error:
        raise type(error)(layer.message(str(error), [key])) from None


def _find_config(name: str) -> Path:
    path = expanded(name)
    # os.path returns False for texts that cannot be paths, such as very long ones.
    if os.path.exists(path) and not os.path.isdir(path):  # noqa: PTH110, PTH112 - pathlib raises
        return path
    stem, names = path.name.removesuffix(".yaml"), packaged_configs()
    if path.parent == Path() and stem in names:
        return Path(str(data_root("configs"))) / f"{stem}.yaml"
    hint = did_you_mean(most_similar(stem, names), f"expected a YAML file, or one of: {', '.join(names)}")
    raise InputError(f"no such config: {cut(name)}; {hint}")


def _read(path: Path, above: tuple[str, ...]) -> ConfigLayer:
    """Read a file and the configs that it extends; ``above`` are the files that extend this file."""
    file = str(path)
    if file in above:
        raise InputError(f"{file}: configs extend each other in a circle: {' -> '.join((*above, file))}")
    try:
        values, lines = read_yaml(read_file(path, MOST_BYTES).decode("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", "it is not text")
        raise InputError(f"{file}: cannot be read as a config: {reason}") from None
    except YamlError as error:
        raise InputError(f"{file}{'' if error.line is None else f':{error.line}'}: {error}") from None
    if not isinstance(values, dict):
        found = "the file is empty" if values is None else f"got {shown(values)}"
        raise InputError(f"{file}:1: expected sections such as camera: and disparity:, {found}")
    layer = ConfigLayer(values, {(): file} | {key: f"{file}:{line}" for key, line in lines.items()})
    base_name = values.get("extends")
    if base_name is None:
        if "scale" in values:
            raise InputError(layer.message("expected a key extends, which names the config to scale", [("scale",)]))
        return layer
    with _errors_at(layer, ("extends",)):
        if not isinstance(base_name, str):
            raise InputError(f"expected the name of a config, got {shown(base_name)}")
        beside = Path(os.path.normpath(path.parent / expanded(base_name)))
        base_path = beside if os.path.isfile(beside) else _find_config(base_name)  # noqa: PTH113 - as in _find_config
    return _over(_read(base_path, (*above, file)), layer)


def _override_layer(overrides: Overrides) -> ConfigLayer:
    if isinstance(overrides, str):  # a text is a sequence of texts
        raise InputError(f"overrides must be a Mapping or a list, got the text {shown(overrides)}: put it into a list")
    layer = ConfigLayer({}, {})
    for override in overrides.items() if isinstance(overrides, Mapping) else overrides:
        layer = _parse_override(override).over(layer)
    return layer


def _parse_override(override: str | tuple[str, Any]) -> ConfigLayer:
    if isinstance(override, str):
        name, equals, text = override.partition("=")
        if not equals or not name:
            raise InputError(f"{OVERRIDE} {cut(override)}: expected dotted.key=value, such as camera.width_px=640")
        try:
            value, _ = read_yaml(text)
        except YamlError as error:
            raise InputError(f"{OVERRIDE} {cut(name)}: the value {shown(text)}: {error}") from None
    else:
        name, value = override
    key = tuple(name.split("."))
    if name == "extends" or any(part.isdigit() for part in key):
        reason = "only a file can have this key" if name == "extends" else "lists are set whole, without numbers"
        raise InputError(f"{OVERRIDE} {cut(name)}: {reason}")
    values = reduce(lambda below, part: {part: below}, reversed(key), value)
    return ConfigLayer(values, dict.fromkeys(_keys_of(value, key), OVERRIDE))


def _keys_of(value: Any, key: KeyPath) -> list[KeyPath]:  # noqa: ANN401 - any YAML value
    """Return ``key`` and the keys of all values inside its ``value``."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [key, *(below for part, child in parts for below in _keys_of(child, (*key, part)))]


def _over(below: ConfigLayer, layer: ConfigLayer) -> ConfigLayer:
    """Merge ``layer`` over ``below``, which is scaled or recentred if ``layer`` changes the image size."""
    values, factor = below.values, layer.values.get("scale")
    if factor is not None:
        if not (is_number(factor) and factor >= SMALLEST):
            raise InputError(layer.message(f"expected {SMALLEST:g} to {LARGEST:g}, got {shown(factor)}", [("scale",)]))
        values = scaled(values, factor)
    keys = {key: value for key, value in layer.values.items() if key not in ("extends", "scale")}
    return replace(layer, values=keys).over(replace(below, values=recentred(values, keys)))


def _with_plugin_recipes(layer: ConfigLayer) -> ConfigLayer:
    """Merge each recipe over the plug-in's recipe that it extends, if any."""
    recipes = layer.values.get("scenes")
    if not isinstance(recipes, list):
        return layer
    recipes = [*recipes]
    for number, recipe in enumerate(recipes):
        name = recipe.get("extends") if isinstance(recipe, dict) else None
        if isinstance(name, str):
            with _errors_at(layer, ("scenes", number, "extends")):
                recipes[number] = merged({"recipe": name} | find_plugin("recipes", name).value, recipe)
    return replace(layer, values=layer.values | {"scenes": recipes})
