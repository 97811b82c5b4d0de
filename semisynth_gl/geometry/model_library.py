"""The models that a dataset draws from: built or read once for a config and a seed, then loaded from the cache."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.cache import CacheEntry, cached, file_states
from semisynth_gl.config.scene_sections import ModelsSection, ParticlesSection
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS, kind_weights
from semisynth_gl.geometry.mesh import Floats, Mesh
from semisynth_gl.geometry.model_units import make_model
from semisynth_gl.geometry.relief import MeanRelief, mean_relief
from semisynth_gl.geometry.topology import marked_solid
from semisynth_gl.inputs.errors import InputError, Skipped
from semisynth_gl.inputs.user_files import expanded, files_below
from semisynth_gl.plugins import find_plugin
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.seeds.splits import Split

FULL_FAMILY = 25
"""Number of the user's models from which on their family has its full weight; fewer have a proportional part of it. It
lies between the numbers of kinds of the two built-in families."""

# `Split.select`'s purposes for the user's models and for a plug-in's; the two families of kinds have 0 and 1.
_USER, _PLUGIN = 2, 3
_ARRAYS = ("positions", "uv", "triangles")


@dataclass(frozen=True, slots=True, eq=False)
class ModelLibrary:
    """Models, and the chances by which they are sampled.

    Attributes:
        models: all models, each normalised to radius 1.
        sampled: (M,) int64, the models that are sampled, as indices into ``models``; other recipes may sample the rest.
        chances: (M,) float64, sum 1, the chance of each sampled model; a family's models share its weight in proportion
            to the weights of their kinds.
        relief: the mean relief of the sampled models.
        skipped: the user's files that have no usable model, and why.
        user_count: number of the user's models; they come first among the chosen models.
    """

    models: tuple[Mesh, ...]
    sampled: NDArray[np.int64]
    chances: Floats
    relief: MeanRelief
    skipped: tuple[Skipped, ...]
    user_count: int


def build_library(section: ModelsSection, particles: ParticlesSection, split: Split) -> ModelLibrary:
    """Build the models that a config asks for in a split, or load them from the cache.

    ``particles`` tells how models are stretched, on which their mean relief depends. All models of the library are
    sampled. Raises InputError where a folder does not exist, the folders have no usable model, no model has a weight, a
    plug-in cannot be used, or models are too few for all splits.
    """
    files = [sorted(files_below(expanded(folder))) for folder in section.folders]

    def key() -> dict[str, Any]:
        return {
            "section": section.model_dump(mode="json"),
            "stretch": particles.model_dump(mode="json", include={"stretch", "thinness"}),
            "seed": split.dataset_seed,
            "split": [split.name, sorted(split.held_out.items()) if split.models else []],
            # Only the reader of a model knows which files it opens, so all count.
            "files": [[[str(path.absolute()) for path in group], file_states(group)] for group in files],
        }

    return cached(
        "models",
        key,
        work="making models",
        build=lambda: _build(section, particles, split),
        pack=_packed,
        unpack=_unpacked,
    )


def build_libraries(
    recipes: Sequence[tuple[ModelsSection, ParticlesSection]], split: Split
) -> tuple[ModelLibrary, ...]:
    """Build the library of each recipe, see `build_library`; recipes are given by their sections.

    The libraries share their ``models``, which hold every model that any recipe draws, once. Each recipe draws the same
    models by the same chances as without the other recipes.
    """
    likes = [(section, particles.stretch, particles.thinness) for section, particles in recipes]
    first_like = [likes.index(like) for like in likes]
    built = {first: build_library(*recipes[first], split) for first in dict.fromkeys(first_like)}
    numbers, models = dict[tuple[object, ...], int](), list[Mesh]()
    sampled = dict[int, list[int]]()
    for first, library in built.items():
        seen, sampled[first] = Counter[tuple[object, ...]](), []
        for mesh in library.models:
            content = (mesh.name, *(getattr(mesh, name).tobytes() for name in _ARRAYS))
            # A library may have several equal models, each with its own chance.
            key = (*content, seen[content])
            seen[content] += 1
            if key not in numbers:
                numbers[key] = len(models)
                models.append(mesh)
            sampled[first].append(numbers[key])
    return tuple(
        replace(built[first], models=tuple(models), sampled=np.array(sampled[first], np.int64)) for first in first_like
    )


def build_family(name: str, variants: int, split: Split) -> list[Mesh]:
    """Build ``variants`` models of a plug-in's family, or a split's share of them.

    Where models are held out, ``variants`` models of the dataset's seed are shared out among the splits; else each
    split makes ``variants`` models from its seed. The models are normalised, as by `make_model`.

    Raises InputError where no plug-in has the name, or the models are too few for all splits.
    """
    build = find_plugin("models", name).value
    seed, numbers = split.seed, list(range(variants))
    if split.models and split.held_out:
        what, names = f"models of the family {name} (models.variants)", [f"{name}/{number}" for number in numbers]
        seed, numbers = split.dataset_seed, split.select(numbers, what, _PLUGIN, names)
    meshes = [build(generator(seed, Purpose.MODELS, "models", name, number)) for number in numbers]
    return [make_model(f"{name}/{mesh.name}", mesh.positions, mesh.triangles, mesh.uv) for mesh in meshes]


def _packed(library: ModelLibrary) -> CacheEntry:
    """Return the library as an entry, in whose arrays the models follow one another."""
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
        MeanRelief(values["fill"], arrays["heights"]),
        tuple(Skipped(Path(path), reason) for path, reason in values["skipped"]),
        values["user_count"],
    )


def _build(section: ModelsSection, particles: ParticlesSection, split: Split) -> ModelLibrary:
    user, skipped = list[Mesh](), list[Skipped]()
    if section.folders:
        from semisynth_gl.geometry.model_files import load_models  # noqa: PLC0415 - trimesh is slow to load

        user, skipped = load_models([expanded(folder) for folder in section.folders])
    # The weight counts the models of all splits, so that held-out models are as frequent as the rest.
    user_weight = section.user * min(1.0, len(user) / FULL_FAMILY)
    held_out = split.models and bool(split.held_out)
    if held_out and user:
        user = split.select(user, "models of the user's", _USER)
    weights = kind_weights(section.kinds)
    families = [(user_weight, user, [1.0] * len(user))]
    for purpose, (builders, weight) in enumerate(((SIMPLE_KINDS, section.simple), (COMPLEX_KINDS, section.complex))):
        names = list(builders)
        if held_out:
            names = split.select(names, "kinds of built-in models", purpose, names)
        variants = [
            (name, number) for name in names if weight * weights[name] > 0 for number in range(section.variants)
        ]
        if variants:
            # The key has the kind's name, not its position: a further kind changes no model of other kinds.
            models = [builders[name](generator(split.seed, Purpose.MODELS, name, number)) for name, number in variants]
            families.append((weight, list(map(marked_solid, models)), [weights[name] for name, _ in variants]))
    for name, weight in section.families.items():
        if weight > 0:
            models = build_family(name, section.variants, split)
            families.append((weight, models, [1.0] * len(models)))
    if not any(weight > 0 and models for weight, models, _ in families):
        raise InputError(
            "there are no models to draw: no family of models with a weight above 0 has any; name a folder with models "
            "in models.folders, or raise a weight of the section models"
        )
    library = [mesh for _, models, _ in families for mesh in models]
    chances = np.concatenate([weight * np.array(shares) / max(sum(shares), 1e-300) for weight, _, shares in families])
    chances /= chances.sum()
    rng = generator(split.seed, Purpose.MODELS, len(families))
    relief = mean_relief(library, chances, particles, rng)
    return ModelLibrary(tuple(library), np.arange(len(library)), chances, relief, tuple(skipped), len(user))
