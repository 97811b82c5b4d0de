"""A config in full, as YAML: every key with its value and a comment on its meaning."""

import textwrap
from collections.abc import Iterable, Iterator, Mapping
from inspect import cleandoc
from typing import Any

from pydantic import BaseModel

from semisynth_gl.config.fields import Range, written_range
from semisynth_gl.config.keys import section_of
from semisynth_gl.config.load import load_config, packaged_configs
from semisynth_gl.config.model import RECIPE_KEYS
from semisynth_gl.config.yaml_values import write_yaml
from semisynth_gl.inputs.resources import data_root

_WIDTH = 100


def summaries() -> dict[str, str]:
    """Return a sentence on the purpose of each packaged config, by its name: the first comment of its file."""
    texts = {}
    for name in packaged_configs():
        first, *_ = (data_root("configs") / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
        texts[name] = first.removeprefix("#").strip()
    return texts


def explain(name_or_path: str) -> str:
    """Return a config as YAML with all its keys, defaults included, and a comment on each; its digest stays the same.

    Raises InputError as `load_config` does.
    """
    return "\n".join(_section(load_config(name_or_path), "")) + "\n"


def _section(section: BaseModel, indent: str) -> Iterator[str]:
    """Yield the lines of a section; a key without a value is commented out."""
    values = section.model_dump(mode="json")
    for key, field in type(section).model_fields.items():
        inner, below = getattr(section, key), section_of(field.annotation)
        # Some keys are left out of the values where they are empty.
        value = values.get(key, written_range(inner) if isinstance(inner, Range) else inner)
        meaning = field.description or (cleandoc(below.__doc__ or "") if below else "")
        mark = f"{indent}# "
        yield from textwrap.wrap(meaning.replace("``", ""), _WIDTH, initial_indent=mark, subsequent_indent=mark)
        if value is None:
            yield f"{indent}# {key}:"
        elif key == "scenes" and value:
            yield "scenes:"
            yield from _recipes(value)
        elif isinstance(inner, BaseModel) and not indent:
            yield f"{key}:"
            yield from _section(inner, "  ")
        else:
            yield f"{indent}{key}: {write_yaml(value)}"
        if not indent:
            yield ""


def _recipes(recipes: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the lines of a list of recipes, with one section per line."""
    for recipe in recipes:
        head = {key: recipe[key] for key in RECIPE_KEYS if key in recipe}
        for number, (key, value) in enumerate((head | dict(recipe)).items()):
            yield f"  {'  ' if number else '- '}{key}: {write_yaml(value)}"
