"""What a dataset's index says: what it is, what it was made of, and where each shard is."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from semisynth_gl.dataset.plan import Plan
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.scene.sources import Sources
from semisynth_gl.splits import SplitName
from semisynth_gl.textures.image_files import builtin_licences, relative_names
from semisynth_gl.textures.prepare import split_images

# Of the models that this program builds.
_OWN_LICENCE = "MIT"
_RECORDED = ("shard", "split", "first", "end", "tar", "bytes", "sha256", "redraws")


def describe_dataset(
    plan: Plan, sources: Mapping[SplitName, Sources], records: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Return a dataset's index, in JSON's types.

    Args:
        plan: what it is.
        sources: what its pairs were made of, by split.
        records: its shards' records, by number.
    """
    return plan.values() | {
        "sources": {split: each.digests() for split, each in sources.items()},
        "renderers": sorted({renderer for record in records for renderer in record["renderers"]}),
        "redraws": sum(record["redraws"] for record in records),
        "bytes": sum(record["bytes"] for record in records),
        "splits": {split: _describe_split(plan, split, each) for split, each in sources.items()},
        "shards": [{key: record[key] for key in _RECORDED if key in record} for record in records],
    }


def _describe_split(plan: Plan, split: SplitName, sources: Sources) -> dict[str, Any]:
    section = plan.config.textures
    layers = sources.atlas.layers
    patches = [
        asdict(patch) | {"sha256": _sha256(layers[patch.first_layer : patch.first_layer + patch.layer_count])}
        for patch in sources.atlas.patches
    ]
    images = split_images(section, plan.seed, plan.split(split))
    paths = {name: path for path, name in relative_names(images).items()}
    licences = builtin_licences() if section.source == "builtin" else {}
    used = sorted({patch.source for patch in sources.atlas.patches})
    skipped = (*sources.atlas.report.images_skipped, *sources.model_library.skipped)
    return {
        "pairs": plan.pairs[split],
        "photographs": [
            {
                "name": name,
                "sha256": _file_sha256(paths.get(name)),
                "licence": licences.get(Path(name).name, plan.config.licences.images if paths else "none"),
            }
            for name in used
        ],
        "patches": patches,
        "models": _describe_models(plan, sources),
        "left_out": [str(each) for each in skipped],
    }


def _describe_models(plan: Plan, sources: Sources) -> list[dict[str, str]]:
    """Name, digest and licence of each model; variants of a built-in kind have its name and a digest each."""
    return [
        {
            "name": mesh.name,
            "sha256": _mesh_sha256(mesh),
            # The user's are named by their files, which have an ending; built-in kinds have none.
            "licence": plan.config.licences.models if "." in mesh.name else _OWN_LICENCE,
        }
        for mesh in sources.model_library.models
    ]


def _mesh_sha256(mesh: Mesh) -> str:
    digest = hashlib.sha256()
    for array in (mesh.positions, mesh.uv, mesh.triangles):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _sha256(array: np.ndarray[Any, Any]) -> str:
    return hashlib.sha256(np.ascontiguousarray(array).data).hexdigest()


def _file_sha256(path: Path | None) -> str | None:
    """Digest of a photograph; None for what is no file, or is gone by now."""
    if path is None:
        return None
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
