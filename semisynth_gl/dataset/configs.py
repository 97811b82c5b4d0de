"""The config that a dataset was made with, as this version of the program reads it."""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from semisynth_gl.config import Config
from semisynth_gl.dataset.reader import Index
from semisynth_gl.inputs.errors import InputError


def read_config(index: Index) -> Config:
    """Return a dataset's config; raises InputError where this version does not know the config in the index."""
    try:
        return Config.model_validate(index.config.values)
    except ValidationError as error:
        reason = "; ".join(str(error).splitlines()[:3])
        raise InputError(f"the config in the index is not a config of this version: {reason}") from None


def recipe_values(index: Index) -> list[Mapping[str, Any]]:
    """Return the config of each recipe in JSON's types; without recipes, or from another version, the config itself."""
    try:
        return [recipe.config.model_dump(mode="json") for recipe in read_config(index).recipes()]
    except InputError:  # a config of another version
        return [index.config.values]


def pairs_per_scene(index: Index) -> int:
    """Return the number of pairs that show one scene and share its left image; 1 for a config of another version."""
    try:
        return read_config(index).views
    except InputError:
        return 1
