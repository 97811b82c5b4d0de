"""The models of a dataset: built or read once for a config and a seed, then loaded from the cache."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.cache import CacheEntry, cached
from semisynth_gl.config.scene_sections import ModelsSection, ParticlesSection
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS, kind_weights
from semisynth_gl.geometry.mesh import Floats, Mesh
from semisynth_gl.geometry.model_units import make_model
from semisynth_gl.geometry.relief import MeanModelRelief, mean_relief
from semisynth_gl.geometry.topology import marked_solid
from semisynth_gl.inputs.errors import InputError, SkippedFile
from semisynth_gl.inputs.user_files import expanded, files_below
from semisynth_gl.plugins import find_plugin
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.seeds.splits import Split

# If the user's models are fewer than this, the weight of their family is reduced in proportion.
_FULL_FAMILY = 25
# The ``purpose`` in `Split.select` for the user's models and for plug-ins' models; the built-in families have 0 and 1.
_USER, _PLUGIN = 2, 3
_ARRAYS = ("positions", "uv", "triangles")


@dataclass(frozen=True, slots=True, eq=False)
class ModelLibrary:
    """Models, and the chances with which they are sampled.

    Attributes:
        models: the models of all recipes, normalised.
        sampled: (M,) int64, indices of the models that this recipe samples.
        chances: (M,) float64, sum 1, the chance of each sampled model. The weight of a family is divided among its
            models in proportion to the weights of their kinds.
        relief: how much of its sphere's disc a sampled model covers, and how far its surface comes towards the viewer,
            both on average.
        skipped: the user's files that have no usable model, with reasons.
        user_count: number of the user's models, which are first in ``sampled``.
    """

    models: tuple[Mesh, ...]
    sampled: NDArray[np.int64]
    chances: Floats
    relief: MeanModelRelief
    skipped: tuple[SkippedFile, ...]
    user_count: int


def build_library(section: ModelsSection, particles: ParticlesSection, split: Split) -> ModelLibrary:
    """Build the models of one recipe in a split, or load them from the cache.

    ``particles`` states how models are stretched, which changes ``relief``. Raises InputError if a folder does not
    exist, the folders have no usable model, no model has a weight, a plug-in cannot be used, or there are too few
    models for all splits.
    """
    key = {
        "section": section.model_dump(mode="json"),
        "stretch": particles.model_dump(mode="json", include={"stretch", "thinness"}),
        "seed": split.dataset_seed,
        "split": [split.name, sorted(split.held_out.items()) if split.models else []],
        # All files, since a model's file may refer to any of them.
        "files": [sorted(files_below(expanded(folder))) for folder in section.folders],
    }
    entry = cached("models", key, lambda: _packed(_build(section, particles, split)), announce="making models")
    return _unpacked(entry)


def build_libraries(
    recipes: Sequence[tuple[ModelsSection, ParticlesSection]], split: Split
) -> tuple[ModelLibrary, ...]:
    """Build the library of each recipe from the recipe's sections; see `build_library`.

    All libraries have the same ``models``; a model that several recipes share occurs once. A recipe samples the same
    models with the same chances as if it were the only recipe.
    """
    settings = [(section, particles.stretch, particles.thinness) for section, particles in recipes]
    first_equal = [settings.index(each) for each in settings]
    built = {first: build_library(*recipes[first], split) for first in dict.fromkeys(first_equal)}
    models, keys = dict[object, Mesh](), dict[int, list[object]]()
    for first, library in built.items():
        seen, keys[first] = Counter[object](), []
        for mesh in library.models:
            content = (mesh.name, *(getattr(mesh, name).tobytes() for name in _ARRAYS))
            # One library may have several equal models, which stay separate.
            seen[content] += 1
            keys[first].append((content, seen[content]))
        models |= zip(keys[first], library.models, strict=True)
    numbers = {key: number for number, key in enumerate(models)}
    sampled = {first: np.array([numbers[key] for key in keys[first]], np.int64) for first in built}
    return tuple(replace(built[first], models=tuple(models.values()), sampled=sampled[first]) for first in first_equal)


def build_family(name: str, variants: int, split: Split) -> list[Mesh]:
    """Build the models of a plug-in's family for a split; `make_model` normalises them.

    If models are held out, the splits divide ``variants`` models, made from the dataset's seed. Otherwise each split
    has ``variants`` models, made from its own seed. Raises InputError if no plug-in has the name, or there are too few
    models for all splits.
    """
    build = find_plugin("models", name).value
    seed, numbers = split.seed, list(range(variants))
    if split.models:
        what, names = f"models of the family {name} (models.variants)", [f"{name}/{number}" for number in numbers]
        seed, numbers = split.dataset_seed, split.select(numbers, what, _PLUGIN, names)
    meshes = [build(generator(seed, Purpose.MODELS, "models", name, number)) for number in numbers]
    return [make_model(f"{name}/{mesh.name}", mesh.positions, mesh.triangles, mesh.uv) for mesh in meshes]


def _packed(library: ModelLibrary) -> CacheEntry:
    """Return the library as a cache entry with the concatenated arrays of all models."""
    values = {
        "rows": {name: [len(getattr(mesh, name)) for mesh in library.models] for name in _ARRAYS},
        "models": [[mesh.name, mesh.solid] for mesh in library.models],
        "fill": library.relief.fill,
        "skipped": [[str(skipped.path), skipped.reason] for skipped in library.skipped],
        "user_count": library.user_count,
    }
    arrays = {name: np.concatenate([getattr(mesh, name) for mesh in library.models]) for name in _ARRAYS}
    return CacheEntry(values, arrays | {"chances": library.chances, "heights": library.relief.heights})


def _unpacked(entry: CacheEntry) -> ModelLibrary:
    values, arrays = entry.values, entry.arrays
    parts = [np.split(arrays[name], np.cumsum(values["rows"][name])[:-1]) for name in _ARRAYS]
    meshes = zip(values["models"], *parts, strict=True)
    return ModelLibrary(
        tuple(Mesh(name, positions, uv, triangles, solid) for (name, solid), positions, uv, triangles in meshes),
        np.arange(len(values["models"])),
        arrays["chances"],
        MeanModelRelief(values["fill"], arrays["heights"]),
        tuple(SkippedFile(Path(path), reason) for path, reason in values["skipped"]),
        values["user_count"],
    )


def _build(section: ModelsSection, particles: ParticlesSection, split: Split) -> ModelLibrary:
    user, skipped = list[Mesh](), list[SkippedFile]()
    if section.folders:
        from semisynth_gl.geometry.model_files import load_models  # noqa: PLC0415 - trimesh is slow to load

        user, skipped = load_models([expanded(folder) for folder in section.folders])
    # The weight is computed before the splits divide the models, so that it is the same in all splits.
    user_weight = section.user * min(1.0, len(user) / _FULL_FAMILY)
    if split.models and user:
        user = split.select(user, "models of the user", _USER)
    weights = kind_weights(section.kinds)
    families = [(user_weight, user, [1.0] * len(user))]
    for purpose, (builders, weight) in enumerate(((SIMPLE_KINDS, section.simple), (COMPLEX_KINDS, section.complex))):
        names = list(builders)
        if split.models:
            names = split.select(names, "kinds of built-in models", purpose, names)
        variants = [
            (name, number) for name in names if weight * weights[name] > 0 for number in range(section.variants)
        ]
        if variants:
            # The generator depends on the kind's name, not on its position, so that a new kind changes no other models.
            models = [builders[name](generator(split.seed, Purpose.MODELS, name, number)) for name, number in variants]
            families.append((weight, list(map(marked_solid, models)), [weights[name] for name, _ in variants]))
    for name, weight in section.families.items():
        if weight > 0:
            models = build_family(name, section.variants, split)
            families.append((weight, models, [1.0] * len(models)))
    if not any(weight > 0 and models for weight, models, _ in families):
        raise InputError(
            "there are no models to sample: no family with a weight above 0 has any; name a folder with models in "
            "models.folders, or raise a weight of the section models"
        )
    library = [mesh for _, models, _ in families for mesh in models]
    chances = np.concatenate([weight * np.array(shares) / max(sum(shares), 1e-300) for weight, _, shares in families])
    chances /= chances.sum()
    rng = generator(split.seed, Purpose.MODELS, len(families))
    relief = mean_relief(library, chances, particles, rng)
    return ModelLibrary(tuple(library), np.arange(len(library)), chances, relief, tuple(skipped), len(user))
