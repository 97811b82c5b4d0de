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


def test_the_left_eye_exposes_once_for_all_right_ones():
    motion = {"motion_blur": [0.4, 1], "sub_frames": 3}
    section = motion | {"noise": 2, "white_balance": [-0.2, 0.2], "vignetting": [0.1, 0.4], "jpeg_quality": [60, 95]}

    def opened(**imperfections):
        camera = {"sway_m": 0.03, "baselines": 2, "baseline_m": [0.5, 1.0]}
        return PairRenderer(moving(camera=camera, imperfections=imperfections), 0)

    with opened() as before, opened(**motion) as blurred, opened(**section) as after, opened(**section) as again:
        for scene in (0, 4):
            pairs = [after.render(2 * scene + view) for view in (0, 1)]
            np.testing.assert_array_equal(pairs[0].frame.left.image, pairs[1].frame.left.image)
            first, second = (pair.provenance["imperfections"] for pair in pairs)
            assert first["left"] == second["left"]
            assert first["right"]["motion_blur"] == second["right"]["motion_blur"]
            assert all(first["right"][key] != second["right"][key] for key in ("white_balance", "vignetting"))
            # In another order each is the same; so is its truth where the image alone is drawn in between.
            for view in (1, 0):
                index = 2 * scene + view
                other, sharp, soft = (renderer.render(index).frame for renderer in (again, before, blurred))
                for eye in EYES:
                    np.testing.assert_array_equal(other.view(eye).image, pairs[view].frame.view(eye).image)
                    assert not np.array_equal(soft.view(eye).image, sharp.view(eye).image)
                    for name in sharp.view(eye).keys() - {"image"}:
                        np.testing.assert_array_equal(soft.view(eye)[name], sharp.view(eye)[name])
