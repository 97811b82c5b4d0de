"""The index of a dataset: its plan, its sources and its shards."""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from semisynth_gl.dataset.documents import Plan, Record
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS
from semisynth_gl.scene.sources import Sources
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.textures.image_files import relative_names
from semisynth_gl.textures.sources import describe_source

# The licence of the models and pictures that this program makes.
_OWN_LICENCE = "MIT"


def describe_dataset(plan: Plan, sources: Mapping[SplitName, Sources], records: Iterable[Record]) -> dict[str, Any]:
    """Return the content of a dataset's index, from the sources of each split and the records of all shards in order.

    It is in JSON's types; `semisynth_gl.dataset.documents.Index` reads it.
    """
    renderers: set[str] = set()
    shards = []
    for record in records:  # one at a time: together they may fill memory
        renderers.update(record.renderers)
        shards.append(record.entry)
    return plan.values() | {
        "renderers": sorted(renderers),
        "redraws": sum(shard["redraws"] for shard in shards),
        "bytes": sum(shard["bytes"] for shard in shards),
        "splits": {split: _describe_split(plan, split, split_sources) for split, split_sources in sources.items()},
        "shards": shards,
    }


def _describe_split(plan: Plan, split: SplitName, sources: Sources) -> dict[str, Any]:
    config = plan.config
    patches = [patch.described() | {"sha256": _sha256(sources.atlas.pixels(patch))} for patch in sources.atlas.patches]
    paths = {name: path for path, name in relative_names(sources.photographs).items()}
    drawn = sources.atlas.pictures
    source = describe_source(config.textures.source)
    licence = {"config": config.licences.images, "own": _OWN_LICENCE, "none": "none"}[source.licence]
    licences = source.licences()
    own_kinds = {*SIMPLE_KINDS, *COMPLEX_KINDS}
    skipped = (*sources.atlas.report.images_skipped, *sources.skipped_models)
    return {
        "pairs": plan.pairs[split],
        "photographs": [
            {
                "name": name,
                "sha256": drawn.get(name) or _file_sha256(paths.get(name)),
                "licence": licences.get(name, licence),
            }
            for name in sorted({patch.source for patch in sources.atlas.patches})
        ],
        "patches": patches,
        # Variants of a built-in kind share a name, but have different digests.
        "models": [
            {
                "name": mesh.name,
                "sha256": _sha256(mesh.positions, mesh.uv, mesh.triangles),
                # Models of users are named after files, with an ending, and those of plug-ins have a slash in the name.
                "licence": _OWN_LICENCE if mesh.name in own_kinds else config.licences.models,
            }
            for mesh in sources.models
        ],
        "left_out": [str(file) for file in skipped],
    }


def _sha256(*arrays: np.ndarray[Any, Any]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _file_sha256(path: Path | None) -> str | None:
    """Return the SHA-256 of a photograph's file; None where it has no file, or the file cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest() if path else None
    except OSError:
        return None
