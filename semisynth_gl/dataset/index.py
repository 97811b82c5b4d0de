"""The index of a dataset, and its card for Hugging Face's hub: a README.md with front matter, from card.md.jinja."""

import hashlib
import re
from collections.abc import Iterable, Mapping
from os.path import commonprefix
from typing import Any

import numpy as np

from semisynth_gl.dataset.documents import DatasetPlan, ShardRecord
from semisynth_gl.frame.channels import MOTION_OUTPUTS
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS
from semisynth_gl.inputs.templates import template_environment
from semisynth_gl.scene.sources import SceneSources
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.textures.image_files import relative_names
from semisynth_gl.textures.sources import describe_source

# Licence of the models and pictures that this program makes.
_OWN_LICENCE = "MIT"
# Licences that the hub knows. In the card, any different licence is "other", with its name in a second key.
_LICENCES = re.compile(
    r"unknown|other|mit|apache-2\.0|bsd-[23]-clause|[al]?gpl-3\.0|cc0-1\.0|cc-by(-nc)?(-nd|-sa)?-4\.0|cc-by(-sa)?-3\.0"
    r"|odbl|odc-by|pddl"
)
# The hub's names of powers of ten from a thousand on.
_SIZES = ("1K", "10K", "100K", "1M", "10M", "100M", "1B")


def index_values(
    plan: DatasetPlan, sources: Mapping[SplitName, SceneSources], records: Iterable[ShardRecord]
) -> dict[str, Any]:
    """Return the content of an index, from the sources of each split and the records of all shards in order."""
    renderers: set[str] = set()
    shards = []
    for record in records:  # one at a time: all together might fill memory
        renderers.update(record.renderers)
        shards.append(record.entry)
    return plan.values() | {
        "renderers": sorted(renderers),
        "redraws": sum(shard["redraws"] for shard in shards),
        "bytes": sum(shard["bytes"] for shard in shards),
        "splits": {split: _describe_split(plan, split, split_sources) for split, split_sources in sources.items()},
        "shards": shards,
    }


def _describe_split(plan: DatasetPlan, split: SplitName, sources: SceneSources) -> dict[str, Any]:
    config = plan.config
    patches = [patch.as_json() | {"sha256": _sha256(sources.atlas.pixels(patch))} for patch in sources.atlas.patches]
    names = {patch.source for patch in sources.atlas.patches}
    files = {name: path for path, name in relative_names(sources.photographs).items() if name in names}
    digests = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    digests |= sources.atlas.pictures  # painted pictures have no files
    source = describe_source(config.textures.source)
    licence = {"config": config.licences.images, "own": _OWN_LICENCE, "none": "none"}[source.licence]
    licences = source.licences()
    own_kinds = {*SIMPLE_KINDS, *COMPLEX_KINDS}
    skipped = (*sources.atlas.report.images_skipped, *sources.skipped_models)
    return {
        "pairs": plan.pairs[split],
        "photographs": [
            {"name": name, "sha256": digests.get(name), "licence": licences.get(name, licence)}
            for name in sorted(names)
        ],
        "patches": patches,
        # Variants of a built-in kind have the same name, but different digests.
        "models": [
            {
                "name": mesh.name,
                "sha256": _sha256(mesh.positions, mesh.uv, mesh.triangles),
                # Only built-in models have these names: names of user models and plug-ins have a dot or a slash.
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


def encode_card(plan: DatasetPlan, index: Mapping[str, Any]) -> bytes:
    """Encode a dataset's README.md from its plan and what `index_values` returned."""
    licence = plan.config.licences.dataset.lower()
    known = _LICENCES.fullmatch(licence)
    digits = len(str(sum(plan.pairs.values())))
    template = template_environment().get_template("card.md.jinja")
    card = template.render(
        plan=plan,
        index=index,
        licence=licence if known else "other",
        licence_name="" if known else re.sub(r"[^a-z0-9.]+", "-", licence).strip("-."),
        size_category=f"{_SIZES[digits - 4]}<n<{_SIZES[digits - 3]}" if digits > 3 else "n<1K",
        has_flow=not MOTION_OUTPUTS.isdisjoint(plan.config.outputs),
        configs=_configs(plan),
    )
    return card.encode()


def _configs(plan: DatasetPlan) -> list[dict[str, Any]]:
    """Return the card's configs, which tell the hub what to load: all tars, or one config for each role of images."""
    if plan.layout.packed:
        tars = {shard.split: f"{shard.tar.rpartition('-')[0]}-*.tar" for shard in plan.shards}
        files = [{"split": split, "path": tars[split]} for split in plan.splits]
        return [{"config_name": "default", "data_files": files}]
    patterns = {split: file_patterns(plan, split) for split in plan.splits}
    return [
        {
            "config_name": role,
            "default": role == "left",
            "data_files": [{"split": split, "path": patterns[split][role]} for split in plan.splits],
            "drop_labels": True,  # else the folders' names would become classes
        }
        for role, pattern in patterns[plan.splits[0]].items()
        # The hub reads only the high bytes of 16-bit RGB, so flow in it is left out.
        if pattern.endswith((".png", ".jpg")) and plan.layout.role(role).codec(plan.encodings) != plan.encodings.flow
    ]


def file_patterns(plan: DatasetPlan, split: SplitName) -> dict[str, str]:
    """Return a glob by role for the files of all pairs of a split, below the dataset's folder or inside a tar."""
    # Compare pairs that differ in view, frame, sequence and SceneFlow's folder (a new one each 3000 sequences).
    pairs_in_sequence = plan.config.sequence_pairs
    numbers = (0, 1, 3, plan.views, pairs_in_sequence, 3 * pairs_in_sequence, 3000 * pairs_in_sequence)
    pairs = [plan.files(split, number) for number in numbers]
    return {role: _pattern([files[role] for files in pairs]) for role in pairs[0]}


def _pattern(paths: list[str]) -> str:
    """Return one glob for the paths, with a star where names differ; digits beside the star belong to it."""
    parts = []
    for names in zip(*(path.split("/") for path in paths), strict=True):
        begin, end = commonprefix(names), commonprefix([name[::-1] for name in names])[::-1]  # noqa: RUF071 - names
        parts.append(names[0] if len(set(names)) == 1 else f"{begin.rstrip('0123456789')}*{end}")
    return "/".join(parts)
