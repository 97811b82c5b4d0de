"""A cropped rendering equals the crop of the whole pair, bit for bit."""

import pytest
from scenes import assert_equal
from tiny_datasets import lean

from semisynth_gl.config import Config
from semisynth_gl.frame.camera import Crop, StereoCamera
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs.pipeline import PairRenderer

CROPS = (Crop(0, 0, 24, 16), Crop(100, 61, 87, 64), Crop(60, 40, 1, 1), Crop(0, 0, 187, 125))
# Vignetting depends on the whole image's principal point, and JPEG's blocks on its corner.
IMPERFECTIONS = {"noise": [2, 4], "blur_px": [1, 2], "vignetting": 0.4, "sharpening": 1, "jpeg_quality": [50, 70]}


@pytest.mark.one_backend
@pytest.mark.parametrize(
    "changes",
    [
        {"outputs": ["visibility", "instances", "depth"]},
        {"truth": "left", "antialias": "ssaa2"},
        {"outputs": [], "antialias": "edges"},
        {"imperfections": IMPERFECTIONS | {"motion_blur": 1, "sub_frames": 2}},
    ],
)
def test_a_crop_has_the_pixels_of_the_whole_image(backend, changes):
    config = Config.model_validate(lean().model_dump(mode="json") | changes)
    with PairRenderer(config, 3, backend) as renderer:
        whole = [renderer.render(index).frame for index in range(2)]
        for crop in CROPS:
            for checked in (True, False):
                # Alternate two pairs, so that the framebuffers contain other pixels before each rendering.
                for index in range(2):
                    frame = renderer.render(index, crop=crop, checked=checked).frame
                    assert_equal(frame, whole[index], crop)


@pytest.mark.one_backend
def test_a_crop_of_a_later_frame_is_of_the_attempt_that_passed(backend):
    config = lean(sequence={"length": 2}, checks={"min_texture": 25.0})
    with PairRenderer(config, 3, backend) as renderer:
        pairs = [renderer.render(index) for index in range(12)]
        redrawn = [pair for pair in pairs[1::2] if "redrawn" in pair.provenance]
        assert redrawn
        for pair in redrawn:
            assert_equal(renderer.render(pair.index, crop=CROPS[1]).frame, pair.frame, CROPS[1])
            unchecked = renderer.render(pair.index, crop=CROPS[1], checked=False)
            assert "redrawn" not in unchecked.provenance
            assert (unchecked.frame.left.image != pair.frame.cropped(CROPS[1]).left.image).any()


def test_a_crop_beyond_the_image_is_refused():
    camera = StereoCamera.centred(640, 480, 500.0, 0.2)
    with pytest.raises(InputError, match="must lie within the image of 640 x 480 px"):
        camera.cropped(Crop(600, 0, 41, 1))
