"""Motion blur: what is drawn, when, and how it is averaged."""

import numpy as np
import pytest
from tiny_datasets import cheap

from semisynth_gl.frame.camera import EYES
from semisynth_gl.pairs.cameras import moments
from semisynth_gl.pairs.pipeline import PairRenderer


def moving(**sections):
    return cheap(**{"camera": {"sway_m": 0.03}, "sequence": {"length": 3, "frame_s": 0.1}} | sections)


@pytest.mark.parametrize(("count", "colour"), [(2, "rgb"), (7, "grey")])
def test_an_exposure_is_the_mean_of_its_moments_rounded_once(count, colour):
    camera = {"sway_m": 0.03, "colour": colour}
    section = {"motion_blur": [0.4, 1], "sub_frames": count}
    sharp_config, config = moving(camera=camera), moving(camera=camera, imperfections=section)
    with PairRenderer(sharp_config, 0) as before, PairRenderer(config, 0) as after:
        for index in (1, 3):
            sharp, blurred = before.render(index), after.render(index)
            drawn = blurred.provenance["imperfections"]
            assert drawn["left"] == drawn["right"]
            share = drawn["left"]["motion_blur"]
            assert 0.4 <= share <= 1
            sampled = before.sampler.sample(index)
            frames = [before.renderer.render(sampled.moment(time)) for time in moments(share, count)]
            for eye in EYES:
                mean = np.mean([frame.view(eye).image for frame in frames], axis=0)
                image = blurred.frame.view(eye).image
                np.testing.assert_array_equal(image, np.rint(mean))
                assert not np.array_equal(image, sharp.frame.view(eye).image)
                for name in sharp.frame.view(eye).keys() - {"image"}:
                    np.testing.assert_array_equal(blurred.frame.view(eye)[name], sharp.frame.view(eye)[name])
            np.testing.assert_array_equal(after.render(index).frame.left.image, blurred.frame.left.image)
