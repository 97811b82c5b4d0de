"""A config in full, as YAML: every key with its value and, as a comment, what it is for."""

import inspect
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from semisynth_gl.config.fields import Range, written_range
from semisynth_gl.config.load import load_config, packaged_configs
from semisynth_gl.config.model import Config
from semisynth_gl.config.yaml_values import write_yaml
from semisynth_gl.inputs.resources import data_root

_WIDTH = 100
_ATTRIBUTE = re.compile(r"    (\w+): (.*)")


def summaries() -> dict[str, str]:
    """Return what each packaged config is for, in a sentence, by its name: the first comment of its file."""
    texts = {}
    for name in packaged_configs():
        first, *_ = (data_root("configs") / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
        texts[name] = first.removeprefix("#").strip()
    return texts


def explain(name_or_path: str) -> str:
    """Return a config with all of its keys, defaults included, and a comment on each.

    The text is a config itself, of the same digest.

    Raises:
        InputError: see `load_config`.
    """
    return "\n".join(_section(load_config(name_or_path), "")) + "\n"


def _section(section: BaseModel, indent: str) -> Iterator[str]:
    """Yield the lines of a section; keys that have no value are comments too."""
    meanings, values = _meanings(type(section)), section.model_dump(mode="json")
    for key in type(section).model_fields:
        inner = getattr(section, key)
        # Some keys are left out of the values where they are empty.
        value = values.get(key, written_range(inner) if isinstance(inner, Range) else inner)
        meaning = meanings.get(key, inspect.getdoc(type(inner)) if isinstance(inner, BaseModel) else "") or ""
        comment = meaning.partition("\n\n")[0].replace("``", "")
        mark = f"{indent}# "
        yield from textwrap.wrap(comment, _WIDTH, initial_indent=mark, subsequent_indent=mark)
        if value is None:
            yield f"{indent}# {key}:"
        elif key == "scenes" and value:
            yield "scenes:"
            yield from _recipes(value)
        elif isinstance(inner, BaseModel) and type(section) is Config and key != "target":
            yield f"{indent}{key}:"
            yield from _section(inner, f"{indent}  ")
        else:
            yield f"{indent}{key}: {write_yaml(value, flow=True)}"
        if not indent:
            yield ""


def _recipes(recipes: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the lines of a list of recipes, a section on each."""
    for recipe in recipes:
        head = {key: recipe[key] for key in ("recipe", "extends", "weight") if key in recipe}
        for number, (key, value) in enumerate({**head, **recipe}.items()):
            yield f"  {'  ' if number else '- '}{key}: {write_yaml(value, flow=True)}"


def _meanings(section: type[BaseModel]) -> dict[str, str]:
    """Return the texts of a docstring's attributes by their names."""
    meanings: dict[str, str] = {}
    name = ""
    for line in (inspect.getdoc(section) or "").partition("Attributes:\n")[2].splitlines():
        attribute = _ATTRIBUTE.fullmatch(line)
        if attribute:
            name, text = attribute.groups()
            meanings[name] = text
        elif name:
            meanings[name] += f" {line.strip()}"
    return meanings
