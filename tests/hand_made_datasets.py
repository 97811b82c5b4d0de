"""Whole datasets of pairs made by hand, with plan, records and index, as the program writes them; no OpenGL."""

import numpy as np
from hand_made_pairs import CAMERA, make_frame, make_provenance

from semisynth_gl.config import Config
from semisynth_gl.dataset.begun import complete_record
from semisynth_gl.dataset.card import encode_card
from semisynth_gl.dataset.files import DatasetFiles
from semisynth_gl.dataset.index import describe_dataset
from semisynth_gl.dataset.places import open_place
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.sample import encode_pair
from semisynth_gl.dataset.shard import ShardWriter
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.geometry.silhouette import Silhouette
from semisynth_gl.scene.sources import Sources
from semisynth_gl.textures.atlas import atlas_from_arrays

SEED = 3


def sources_of(plan, level=0):
    """One model, and two patches of one grey level."""
    mesh = make_mesh("solid", np.eye(3, dtype=np.float32), np.zeros((3, 2), np.float32), np.array([[0, 1, 2]]))
    atlas = atlas_from_arrays([np.full((4, 4, 3), level, np.uint8)] * 2, ["a.png", "b.png"])
    library = ModelLibrary((mesh,), np.arange(1), np.ones(1), Silhouette(0.5, np.zeros(16)), (), 0)
    return {split: Sources(atlas, (library,)) for split in plan.splits}


def config_of(**values):
    """The config that `CAMERA` and `make_frame` go with."""
    camera = {"width_px": CAMERA.width_px, "height_px": CAMERA.height_px, "focal_px": CAMERA.focal_px}
    camera |= {"baseline_m": CAMERA.baseline_m, "doffs_px": CAMERA.doffs_px}
    base = {"name": "lab", "camera": camera, "disparity": {"min_px": 1, "max_px": 200}, "outputs": ["visibility"]}
    return Config.model_validate(base | values)


def write_dataset(out, layout, pairs, shard_pairs, config=None, *, overwrite=False, level=0):
    """Write a dataset of `make_frame`'s pairs, or what it lacks, whose patches have a grey level; return its plan."""
    plan = make_plan(config or config_of(), SEED, layout, pairs, shard_pairs)
    place, encodings = open_place(out), plan.layout.encodings_for(plan.config)
    sources = sources_of(plan, level)
    files = DatasetFiles(place, plan, overwrite=overwrite)
    if files.complete:
        return plan
    files.open({split: split_sources.digests() for split, split_sources in sources.items()})
    for shard in plan.shards:
        with ShardWriter(place, shard, packed=plan.layout.packed, folder=plan.folder(shard.split)) as writer:
            if writer.complete:
                continue
            for number in range(shard.first + len(writer.samples), shard.end):
                key, facts = plan.key(shard.split, number), {"redrawn": [], "share_beyond": 0.0, "renderer": "none"}
                made = {name: plan.values()[name] for name in ("version", "config", "config_sha256", "seed")}
                provenance = make_provenance(number) | made | {"split": shard.split}
                frame = make_frame(number, plan.config.outputs)
                encoded = encode_pair(plan.layout, key, frame, provenance, 200, encodings)
                writer.add(encoded.files, facts | {"seconds": 0.1})
            split = {"split": shard.split, "first": shard.first, "end": shard.end}
            writer.finish(split | {"redraws": 0, "renderers": ["none"]}, {"seconds": 0.1})
    index = describe_dataset(plan, sources, [complete_record(place, shard) for shard in plan.shards])
    files.finish(index, encode_card(index))
    files.close()
    return plan
