"""Objects: instances that move. KITTI's map of objects and rebuilt scenes take them from one definition."""

import cv2
import pytest
from tiny_datasets import lean

from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.dataset.rebuild import RebuiltScenes
from semisynth_gl.scene.structures import SURFACE_MODELS

# Panels of the particles' own size, flat and curved, before a ground.
STRUCTURES = {"ground": 1.0, "panels": 4, "panel_size_px": [30, 60], "panel_curved": 0.5}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("objects")
    generate(lean("kitti", structures=STRUCTURES), folder, 2, 3, layout="kitti")
    return folder


def test_neither_ground_nor_panels_are_objects_in_kittis_map_and_rebuilt_scenes(dataset):
    scenes, shown = RebuiltScenes(read_index(dataset), "train"), {True: set(), False: set()}
    for index, pair in enumerate(open_dataset(dataset)):
        table, ids = pair.provenance["instances"], pair.left.instances
        objects = cv2.imread(str(dataset / f"training/obj_map/{index:06d}_10.png"), cv2.IMREAD_UNCHANGED)
        models = [scenes.models[number] for number in scenes.sampled(pair).scene.model]
        for number, (row, model) in enumerate(zip(table, models, strict=True), 1):
            assert row["model"] == model.name
            assert row["still"] == (model.name in {mesh.name for mesh in SURFACE_MODELS})
            pixels = objects[ids == number]
            assert (pixels == 0).all() if row["still"] else (pixels > 0).all()
            if pixels.size:
                shown[row["still"]].add(row["model"])
    assert len(shown[True]) > 1  # more than the background's faces
    assert shown[False]
