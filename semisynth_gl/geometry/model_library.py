"""The models that a dataset draws from, built or read once from (config, seed) and then found in the cache."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.cache import Entry
from semisynth_gl.config.model import ModelsSection
from semisynth_gl.errors import InputError, Skipped
from semisynth_gl.geometry.complex import COMPLEX_KINDS
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.models_entry import packed_meshes, packed_skipped, unpacked_meshes, unpacked_skipped
from semisynth_gl.geometry.simple import SIMPLE_KINDS
from semisynth_gl.geometry.solid import marked_solid
from semisynth_gl.geometry.vectors import cross, lengths
from semisynth_gl.interrupts import interrupts_wait
from semisynth_gl.remember import all_versions, own_sources, remembered, versions
from semisynth_gl.seeds import Purpose, generator
from semisynth_gl.splits import WHOLE, Split

_VIEWS = 6
_POINTS = 2000
_CELLS = 24
# What `Split.share` is told to share out, beside the numbers of the two families.
_USER = 2


@dataclass(frozen=True, slots=True, eq=False)
class ModelLibrary:
    """M models with their chances.

    Attributes:
        models: each normalised to radius 1.
        chances: (M,) float64, sum 1: each family has its weight, shared evenly by its models.
        fill: mean projected area over models and directions, in units of the bounding sphere's disc.
        skipped: the user's models that could not be used.
    """

    models: tuple[Mesh, ...]
    chances: NDArray[np.float64]
    fill: float
    skipped: tuple[Skipped, ...]


def build_library(section: ModelsSection, seed: int, split: Split = WHOLE) -> ModelLibrary:
    """Build the models that a config asks for, or find those that were built of the same before.

    Args:
        section: which families, and where the user's models are.
        seed: the dataset's.
        split: whose models.

    Raises:
        InputError: where a folder is missing, holds no usable model, or there are too few to hold some out.
    """
    folders = [Path(folder).expanduser() for folder in section.folders]
    if not all(folder.is_dir() for folder in folders):  # a single file may draw on any other one beside it
        return _built(section, seed, split)
    files = [sorted(path for path in folder.rglob("*") if path.is_file()) for folder in folders]

    def decided_by() -> dict[str, Any]:
        return {
            "section": section.model_dump(mode="json"),
            "seed": seed,
            "split": [split.name, sorted(split.held_out.items()) if split.models else []],
            "files": [[str(path.absolute()) for path in group] for group in files],
            "versions": versions("numpy", "pyrr"),
            "readers": all_versions() if folders else [],
            "program": own_sources("geometry", "seeds.py"),
        }

    flat = [path for group in files for path in group]
    return remembered(
        "models",
        decided_by,
        files=flat,
        # Which files a model draws on, only its reader knows: all count.
        make=lambda: (_built(section, seed, split), flat),
        pack=_packed,
        unpack=_unpacked,
    )


def _packed(library: ModelLibrary) -> Entry | None:
    """The entry of the cache; None where a model was left out for a reason that may not hold the next time."""
    if any("MemoryError" in each.reason for each in library.skipped):
        return None
    meshes = packed_meshes(library.models)
    values = {"fill": library.fill, "skipped": packed_skipped(library.skipped)}
    return Entry(meshes.values | values, meshes.arrays | {"chances": library.chances})


def _unpacked(entry: Entry) -> ModelLibrary:
    skipped = unpacked_skipped(entry.values["skipped"])
    return ModelLibrary(unpacked_meshes(entry), entry.arrays["chances"], entry.values["fill"], skipped)


def _read(folders: Sequence[str]) -> tuple[Sequence[Mesh], Sequence[Skipped]]:
    if not folders:
        return (), ()
    with interrupts_wait():
        # Imported here: trimesh takes longer to load than all else together.
        from semisynth_gl.geometry.user import load_models  # noqa: PLC0415
    return load_models([Path(folder).expanduser() for folder in folders])


def _built(section: ModelsSection, seed: int, split: Split) -> ModelLibrary:
    user, skipped = _read(section.folders)
    kinds_of = [list(enumerate(kinds.values())) for kinds in (SIMPLE_KINDS, COMPLEX_KINDS)]
    if split.models and split.held_out:
        user = split.share(user, seed, "models of the user's", _USER) if user else user
        kinds_of = [
            split.share(kinds, seed, "kinds of built-in models", family) for family, kinds in enumerate(kinds_of)
        ]
    seed = split.seed(seed)
    families: list[tuple[float, Sequence[Mesh]]] = [(section.user, user)]
    for family, weight in enumerate((section.simple, section.complex)):
        if weight == 0:
            continue
        meshes = [
            marked_solid(build(generator(seed, Purpose.MODELS, family, kind, variant)))
            for kind, build in kinds_of[family]
            for variant in range(section.variants)
        ]
        families.append((weight, meshes))
    if not any(weight > 0 and meshes for weight, meshes in families):
        raise InputError(
            "there are no models to draw: models.simple and models.complex are 0, and of the user's there is none; "
            "give --models DIR, or raise a weight of the section models"
        )
    models = [mesh for _, meshes in families for mesh in meshes]
    chances = np.concatenate([np.full(len(meshes), weight / max(len(meshes), 1)) for weight, meshes in families])
    chances /= chances.sum()
    rng = generator(seed, Purpose.MODELS, len(families))
    areas = np.array([projected_area(mesh, rng) for mesh in models])
    return ModelLibrary(tuple(models), chances, float((chances * areas).sum() / np.pi), tuple(skipped))


def projected_area(mesh: Mesh, rng: np.random.Generator) -> float:
    """Estimate the mean area of a mesh's silhouette over random directions, in squared model units.

    Points are thrown on the surface and the cells of a coarse grid that they reach are counted; good to about a tenth,
    which is all that choosing the number of particles needs.
    """
    corners = mesh.positions.astype(np.float64)[mesh.triangles]
    edges = corners[:, 1:] - corners[:, :1]
    area = lengths(cross(edges[:, 0], edges[:, 1]))
    triangle = rng.choice(len(area), _POINTS, p=area / area.sum())
    u, v = rng.random((2, _POINTS))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points = corners[triangle, 0] + u[:, None] * edges[triangle, 0] + v[:, None] * edges[triangle, 1]
    radius = mesh.radius
    total = 0.0
    for _ in range(_VIEWS):
        axes = np.linalg.qr(rng.normal(size=(3, 2)))[0]
        cells = ((points @ axes / radius + 1) / 2 * _CELLS).astype(np.int64).clip(0, _CELLS - 1)
        total += np.count_nonzero(np.bincount(cells[:, 0] * _CELLS + cells[:, 1])) * (2 * radius / _CELLS) ** 2
    return total / _VIEWS
