"""Objects: instances that move. KITTI's map of objects and rebuilt scenes take them from one definition."""

import json

import cv2
import numpy as np
import pytest
from backends import backend_fault
from tiny_datasets import lean

from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.dataset.rebuild import RebuiltScenes
from semisynth_gl.scene.structures import SURFACE_MODELS

# Panels of the particles' own size, flat and curved, before a ground.
STRUCTURES = {"ground": 1.0, "panels": 4, "panel_size_px": [30, 60], "panel_curved": 0.5}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    folder = tmp_path_factory.mktemp("objects")
    generate(lean("kitti", structures=STRUCTURES), folder, 2, 3, layout="kitti")
    return folder


def test_neither_ground_nor_panels_are_objects_in_kittis_map(dataset):
    still_models = {mesh.name for mesh in SURFACE_MODELS}
    shown = {True: set(), False: set()}
    for index in range(2):
        name = f"{index:06d}"
        table = json.loads((dataset / "pairs" / f"{name}.json").read_text())["instances"]
        objects = cv2.imread(str(dataset / "training/obj_map" / f"{name}_10.png"), cv2.IMREAD_UNCHANGED)
        ids = cv2.imread(str(dataset / "training/instances_0" / f"{name}_10.png"), cv2.IMREAD_UNCHANGED)
        for number, row in enumerate(table, 1):
            assert row["still"] == (row["model"] in still_models)
            pixels = objects[ids == number]
            assert (pixels == 0).all() if row["still"] else (pixels > 0).all()
            if pixels.size:
                shown[row["still"]].add(row["model"])
    assert len(shown[True]) > 1  # more than the background's faces
    assert shown[False]


def test_rebuilt_scenes_have_the_same_objects(dataset):
    index, pairs = read_index(dataset), open_dataset(dataset)
    scenes = RebuiltScenes(index, "train")
    for pair in pairs:
        rebuilt = scenes.sampled(pair)
        table = pair.provenance["instances"]
        np.testing.assert_array_equal(rebuilt.scene.model < len(SURFACE_MODELS), [row["still"] for row in table])
