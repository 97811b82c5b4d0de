"""A config in full, as YAML: every key with its value and a comment on its meaning."""

import inspect
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from semisynth_gl.config.fields import Range, written_range
from semisynth_gl.config.keys import by_form, members_of, sections_of
from semisynth_gl.config.load import load_config, packaged_configs
from semisynth_gl.config.model import Config
from semisynth_gl.config.yaml_values import write_yaml
from semisynth_gl.inputs.resources import data_root

_WIDTH = 100
_BOUNDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
# Bounds from this size on are not shown: they only keep numbers within float32's range. Nor is a share's bound of 1.
_NO_BOUND = 1e5
_ATTRIBUTE = re.compile(r"    (\w+): (.*)")


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


@dataclass(frozen=True, slots=True)
class ExplainedKey:
    """A key of a config, for a list of all keys.

    ``dotted`` is the key as ``--set`` takes it, and ``meaning`` its text in the section's docstring, or the first
    paragraph of a section's docstring. ``default`` is YAML, "required", or "" where the default is None or empty.
    """

    dotted: str
    meaning: str
    default: str = ""
    is_section: bool = False
    is_range: bool = False


def explained_keys() -> list[ExplainedKey]:
    """Return the keys outside of sections, and then each section followed by its keys, in the config's order."""
    plain, sections = list[ExplainedKey](), list[ExplainedKey]()
    for name, field in Config.model_fields.items():
        section = next(iter(sections_of(field.annotation)), None)
        if section is None:
            plain.append(_explained(name, field, _meanings(Config)))
        else:
            sections += _explained_section(name, section)
    return [*plain, *sections]


def _explained_section(dotted: str, section: type[BaseModel]) -> list[ExplainedKey]:
    """Return a section, followed by its keys, and then by the sections in it."""
    meaning = (inspect.getdoc(section) or "").partition("\n\n")[0].replace("\n", " ")
    keys, sections, meanings = list[ExplainedKey](), list[ExplainedKey](), _meanings(section)
    for key, field in section.model_fields.items():
        inner = [] if by_form(field.annotation) else sections_of(field.annotation)
        if inner:
            sections += _explained_section(f"{dotted}.{key}", inner[0])
        else:
            keys.append(_explained(f"{dotted}.{key}", field, meanings))
    return [ExplainedKey(dotted, meaning, is_section=True), *keys, *sections]


def _explained(dotted: str, field: FieldInfo, meanings: Mapping[str, str]) -> ExplainedKey:
    key = dotted.rpartition(".")[2]
    bounds = {word: getattr(each, word) for each in field.metadata for word in _BOUNDS if hasattr(each, word)}
    telling = {word: end for word, end in bounds.items() if 1 < abs(end) < _NO_BOUND or (word, end) == ("lt", 1)}
    said = " and ".join(f"{_BOUNDS[word]} {end:g}" for word, end in telling.items())
    meaning = meanings[key].rstrip(".")
    is_range = any(each is Range for each in members_of(field.annotation))
    return ExplainedKey(dotted, f"{meaning}; {said}" if said else meaning, _default(field), is_range=is_range)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if isinstance(value, BaseModel):
        value = value.model_dump(mode="json", exclude_unset=True)
    if value in (None, (), {}):
        return ""
    return write_yaml(_short(value)).strip()


def _short(value: Any) -> Any:  # noqa: ANN401 - any value of a config
    if isinstance(value, Range):
        value = written_range(value)
    if isinstance(value, list | tuple):
        return [_short(each) for each in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _section(section: BaseModel, indent: str) -> Iterator[str]:
    """Yield the lines of a section; a key without a value is commented out."""
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
            yield f"{indent}{key}: {write_yaml(value)}"
        if not indent:
            yield ""


def _recipes(recipes: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the lines of a list of recipes, with one section per line."""
    for recipe in recipes:
        head = {key: recipe[key] for key in ("recipe", "extends", "weight") if key in recipe}
        for number, (key, value) in enumerate({**head, **recipe}.items()):
            yield f"  {'  ' if number else '- '}{key}: {write_yaml(value)}"


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
