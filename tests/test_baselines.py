"""Several baselines of one scene: pairs that share a left view, in the renderer, in sequences, in files."""

import numpy as np
import pytest
from tiny_datasets import cheap

from semisynth_gl.camera import Crop
from semisynth_gl.frame import OUTPUTS
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.renderer import Renderer

SEVERAL = {"baselines": [0.4, 1.0, 0.7]}
MOVING = {"length": 2, "frame_s": 0.1}


def several(camera=SEVERAL, **changes):
    values = cheap().model_dump(mode="json")
    values["camera"] |= {"sway_m": 0.02, "sway_deg": 1.0} | camera
    if "baselines" in camera and isinstance(camera["baselines"], list):
        del values["camera"]["baseline_m"]
    return type(cheap()).model_validate(values | changes)


def assert_same(frame, expected, message=""):
    assert frame.camera == expected.camera
    assert frame.arrays().keys() == expected.arrays().keys()
    for role, array in frame.arrays().items():
        np.testing.assert_array_equal(array, expected.arrays()[role], err_msg=f"{role} {message}", strict=True)


@pytest.mark.parametrize("antialias", ["none", "edges", "ssaa2"])
def test_each_pair_is_that_of_a_rig_of_its_baseline_alone_bit_for_bit(backend, antialias):
    """All outputs of both views, whole and cropped, asked for in any order."""
    config = several(sequence=MOVING, outputs=list(OUTPUTS), antialias=antialias)
    crop = Crop(9, 7, 30, 21)
    with PairRenderer(config, 3, backend) as pairs:
        atlas = pairs.sources.atlas.layers
        with Renderer(pairs.sampler.models, atlas, outputs=OUTPUTS, antialias=antialias, backend=backend) as alone:
            for index, part in ((4, None), (3, None), (0, None), (5, crop), (3, crop), (1, crop), (2, None)):
                frame = pairs.render(index, crop=part).frame
                sampled = pairs.sampler.sample(index)
                motions = {"future": pairs.sampler.motion(sampled, 1), "past": pairs.sampler.motion(sampled, -1)}
                assert sampled.scene.camera.baseline_m == SEVERAL["baselines"][index % 3]
                assert_same(frame, alone.render(sampled.scene, part, **motions), f"of pair {index}")
