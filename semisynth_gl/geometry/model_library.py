"""The models that a dataset draws from, built or read once from (config, seed) and then found in the cache."""

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.cache.entries import Entry
from semisynth_gl.cache.lookup import all_versions, own_sources, remembered, versions
from semisynth_gl.config.model import ModelsSection, ParticlesSection
from semisynth_gl.errors import InputError, Skipped
from semisynth_gl.geometry.complex import COMPLEX_KINDS
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.models_entry import packed_meshes, packed_skipped, unpacked_meshes, unpacked_skipped
from semisynth_gl.geometry.silhouette import Silhouette, mean_silhouette
from semisynth_gl.geometry.simple import SIMPLE_KINDS
from semisynth_gl.geometry.solid import marked_solid
from semisynth_gl.interrupts import interrupts_wait
from semisynth_gl.seeds import Purpose, generator
from semisynth_gl.splits import WHOLE, Split

# What `Split.share` is told to share out, beside the numbers of the two families.
_USER = 2


@dataclass(frozen=True, slots=True, eq=False)
class ModelLibrary:
    """M models with their chances.

    Attributes:
        models: each normalised to radius 1.
        chances: (M,) float64, sum 1: each family has its weight, shared by its models as their kinds' weights say.
        silhouette: what they cover on average.
        skipped: the user's models that could not be used.
    """

    models: tuple[Mesh, ...]
    chances: NDArray[np.float64]
    silhouette: Silhouette
    skipped: tuple[Skipped, ...]


def build_library(section: ModelsSection, particles: ParticlesSection, seed: int, split: Split = WHOLE) -> ModelLibrary:
    """Build the models that a config asks for, or find those that were built of the same before.

    Args:
        section: which families, and where the user's models are.
        particles: how they are stretched, for what they cover on average.
        seed: the dataset's.
        split: whose models.

    Raises:
        InputError: where a folder is missing, holds no usable model, or there are too few to hold some out.
    """
    folders = [Path(folder).expanduser() for folder in section.folders]
    if not all(folder.is_dir() for folder in folders):  # a single file may draw on any other one beside it
        return _built(section, particles, seed, split)
    files = [sorted(path for path in folder.rglob("*") if path.is_file()) for folder in folders]

    def decided_by() -> dict[str, Any]:
        return {
            "section": section.model_dump(mode="json"),
            "stretch": particles.model_dump(mode="json", include={"stretch", "thinness"}),
            "seed": seed,
            "split": [split.name, sorted(split.held_out.items()) if split.models else []],
            "files": [[str(path.absolute()) for path in group] for group in files],
            "versions": versions("numpy", "pyrr"),
            "readers": all_versions() if folders else [],
            "program": own_sources("geometry", "seeds.py", "config/fields.py"),
        }

    flat = [path for group in files for path in group]
    return remembered(
        "models",
        decided_by,
        files=flat,
        # Which files a model draws on, only its reader knows: all count.
        make=lambda: (_built(section, particles, seed, split), flat),
        pack=_packed,
        unpack=_unpacked,
    )


def _packed(library: ModelLibrary) -> Entry | None:
    """The entry of the cache; None where a model was left out for a reason that may not hold the next time."""
    if any("MemoryError" in each.reason for each in library.skipped):
        return None
    meshes = packed_meshes(library.models)
    values = {"fill": library.silhouette.fill, "skipped": packed_skipped(library.skipped)}
    arrays = {"chances": library.chances, "heights": library.silhouette.heights}
    return Entry(meshes.values | values, meshes.arrays | arrays)


def _unpacked(entry: Entry) -> ModelLibrary:
    skipped = unpacked_skipped(entry.values["skipped"])
    silhouette = Silhouette(entry.values["fill"], entry.arrays["heights"])
    return ModelLibrary(unpacked_meshes(entry), entry.arrays["chances"], silhouette, skipped)


def _read(folders: Sequence[str]) -> tuple[Sequence[Mesh], Sequence[Skipped]]:
    if not folders:
        return (), ()
    with interrupts_wait():
        # Imported here: trimesh takes longer to load than all else together.
        from semisynth_gl.geometry.user import load_models  # noqa: PLC0415
    return load_models([Path(folder).expanduser() for folder in folders])


def _built(section: ModelsSection, particles: ParticlesSection, seed: int, split: Split) -> ModelLibrary:
    user, skipped = _read(section.folders)
    kinds_of = [list(enumerate(kinds.items())) for kinds in (SIMPLE_KINDS, COMPLEX_KINDS)]
    if split.models and split.held_out:
        user = split.share(user, seed, "models of the user's", _USER) if user else user
        kinds_of = [
            split.share(kinds, seed, "kinds of built-in models", family) for family, kinds in enumerate(kinds_of)
        ]
    seed = split.seed(seed)
    weights = _kind_weights(section)
    families: list[tuple[float, list[Mesh], list[float]]] = [(section.user, list(user), [1.0] * len(user))]
    for family, weight in enumerate((section.simple, section.complex)):
        kinds = [(kind, name, build) for kind, (name, build) in kinds_of[family] if weights[name] > 0]
        if weight == 0 or not kinds:
            continue
        meshes = [
            marked_solid(build(generator(seed, Purpose.MODELS, family, kind, variant)))
            for kind, _, build in kinds
            for variant in range(section.variants)
        ]
        of_kinds = [weights[name] for _, name, _ in kinds for _ in range(section.variants)]
        families.append((weight, meshes, of_kinds))
    if not any(weight > 0 and meshes for weight, meshes, _ in families):
        raise InputError(
            "there are no models to draw: models.simple and models.complex are 0, and of the user's there is none; "
            "give --models DIR, or raise a weight of the section models"
        )
    models = [mesh for _, meshes, _ in families for mesh in meshes]
    chances = np.concatenate([weight * np.array(of) / max(sum(of), 1e-300) for weight, _, of in families])
    chances /= chances.sum()
    rng = generator(seed, Purpose.MODELS, len(families))
    return ModelLibrary(tuple(models), chances, mean_silhouette(models, chances, particles, rng), tuple(skipped))


def _kind_weights(section: ModelsSection) -> dict[str, float]:
    known = [*SIMPLE_KINDS, *COMPLEX_KINDS]
    unknown = [kind for kind in section.kinds if kind not in known]
    if unknown:
        near = difflib.get_close_matches(unknown[0], known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"expected some of: {', '.join(sorted(known))}"
        raise InputError(f"models.kinds.{unknown[0]}: no such kind of model; {hint}")
    return dict.fromkeys(known, 1.0) | section.kinds
