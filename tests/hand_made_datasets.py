"""Datasets of hand-made pairs, written without OpenGL: plan, records, index and files."""

import numpy as np
from hand_made_pairs import CAMERA, make_frame, make_provenance

from semisynth_gl.config import Config
from semisynth_gl.dataset.folder import begin, finish, locked, missing
from semisynth_gl.dataset.make import write_shard
from semisynth_gl.dataset.pair_files import encode_pair
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.root import open_root
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.geometry.relief import MeanModelRelief
from semisynth_gl.scene.sources import SceneSources
from semisynth_gl.textures.atlas import atlas_from_arrays

SEED = 3


def sources_of(plan, level=0):
    """Return sources of one model and two patches of the grey level ``level``."""
    mesh = make_mesh("solid", np.eye(3, dtype=np.float32), np.zeros((3, 2), np.float32), np.array([[0, 1, 2]]))
    atlas = atlas_from_arrays([np.full((4, 4, 3), level, np.uint8)] * 2, ["a.png", "b.png"])
    library = ModelLibrary((mesh,), np.arange(1), np.ones(1), MeanModelRelief(0.5, np.zeros(16)), (), 0)
    return {split: SceneSources(atlas, (library,)) for split in plan.splits}


def config_of(**values):
    """Return a config with the camera and outputs of `make_frame`."""
    camera = {"width_px": CAMERA.width_px, "height_px": CAMERA.height_px, "focal_px": CAMERA.focal_px}
    camera |= {"baseline_m": CAMERA.baseline_m, "doffs_px": CAMERA.doffs_px}
    base = {"name": "lab", "camera": camera, "disparity": {"min_px": 1, "max_px": 200}, "outputs": ["visibility"]}
    return Config.model_validate(base | values)


def pairs_of(plan, shard):
    """Yield a shard's pairs, encoded."""
    for number in range(shard.first, shard.end):
        made = {name: plan.values()[name] for name in ("version", "config", "config_sha256", "seed")}
        provenance = make_provenance(number) | made | {"split": shard.split}
        frame = make_frame(number, plan.config.outputs)
        key = plan.key(shard.split, number)
        yield encode_pair(plan.layout, key, frame, provenance, 200, plan.encodings)


def plan_of(layout, pairs, shard_pairs, config=None, level=0, seed=SEED):
    """Return the plan and the sources of a dataset of `make_frame`'s pairs."""
    plan = make_plan(config or config_of(), seed, layout, pairs, shard_pairs)
    sources = sources_of(plan, level)
    digests = {split: dict(split_sources.digests()) for split, split_sources in sources.items()}
    return plan.model_copy(update={"sources": digests}), sources


def write_dataset(out, layout, pairs, shard_pairs, config=None, *, overwrite=False, **options):
    """Write the missing shards of a dataset of `make_frame`'s pairs; return their numbers."""
    plan, sources = plan_of(layout, pairs, shard_pairs, config, **options)
    root = open_root(out)
    with locked(root):
        begin(root, plan, overwrite=overwrite)
        lacking = missing(root, plan)
        for shard in lacking:
            write_shard(root, plan, shard, pairs_of(plan, shard))
        finish(root, plan, sources)
    return [shard.number for shard in lacking]
