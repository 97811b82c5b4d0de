"""Monochrome cameras (``camera.colour: grey``): atlas, images, and files in both directions."""

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from hand_made_pairs import CAMERA, decode, encode, make_frame
from heavy import heavy
from PIL import Image
from planted_faults import change_file, checks
from tiny_datasets import cheap, findings

from semisynth_gl.codecs import Encodings
from semisynth_gl.codecs.jpeg import GREY_JPEG, JPEG
from semisynth_gl.codecs.png import RGB8, GreyAsRgb
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.frame import Frame, as_rgb
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.judge.charts import plot_sheet
from semisynth_gl.layouts import PairKey, find_layout, layout_names
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.textures.atlas import to_grey

# Loaders of these layouts fail on images of one channel.
THREE = {"middlebury", "eth3d"}


def grey_frame(index):
    frame = make_frame(index)
    grey = ({name: to_grey(view[name]) for name in ("image", "raw")} for view in (frame.left, frame.right))
    return Frame(CAMERA, *(frame.view(eye).with_channels(images) for eye, images in zip(EYES, grey, strict=True)))


def test_grey_is_the_stated_luminance():
    image = np.random.default_rng(0).integers(0, 256, (64, 65, 4), np.uint8)
    red, green, blue = (image[..., part].astype(int) for part in range(3))
    np.testing.assert_array_equal(to_grey(image), (19595 * red + 38470 * green + 7471 * blue + 32768) // 65536)
    np.testing.assert_array_equal(to_grey(image[..., :3]), to_grey(image))
    levels = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(to_grey(np.stack([levels] * 3, axis=1)[None])[0], levels)


@pytest.mark.parametrize("name", layout_names())
def test_every_layout_gives_one_channel_back_and_loaders_what_they_can_read(name):
    layout, frame = find_layout(name), grey_frame(3)
    encodings = (layout.encodings or Encodings()).in_grey(three=layout.three_channels)
    files = encode(layout, 3, frame=frame, encodings=encodings)
    stored = decode(layout, 3, files, encodings=encodings)
    lossy = not encodings.image.lossless
    paths = layout.files(PairKey("lab", "train", 3), encodings)
    for eye in EYES:
        image = stored.view(eye).image
        assert image.ndim == 2
        assert image.flags.c_contiguous
        assert np.abs(image.astype(int) - frame.view(eye).image).max() <= (2 if lossy else 0)
        np.testing.assert_array_equal(
            stored.view(eye).disparity, decode(layout, 3, encode(layout, 3)).view(eye).disparity
        )
        data = files[paths[eye]]
        opened = Image.open(io.BytesIO(data))
        assert opened.mode == ("RGB" if name in THREE else "L")
        # Read the file as loaders do.
        sliced = np.array(opened.convert("RGB") if name not in THREE else opened)[..., :3]
        by_opencv = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        for pixels in (sliced, by_opencv):
            np.testing.assert_array_equal(pixels, as_rgb(image))


def test_files_of_another_kind_are_refused():
    coloured = make_frame(0).left.image
    for codec, image, message in (
        (GreyAsRgb(RGB8), RGB8.encode(coloured), "of a monochrome camera, got channels that differ"),
        (GREY_JPEG, JPEG.encode(coloured), "expected .* L, got RGB"),
    ):
        with pytest.raises(ReadError, match=message):
            codec.decode(image, Path("a"))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("grey") / "set"
    generate(cheap(camera={"colour": "grey"}, antialias="ssaa2"), folder, {"train": 2}, 3)
    return folder


def test_rigs_and_cameras_report_and_verify_go_with_grey(tmp_path):
    config = cheap(
        camera={"colour": "grey", "sway_m": 0.1},
        rig={"right_roll_deg": 1, "right_y_px": 2},
        imperfections={"motion_blur": 0.5, "vignetting": 0.5, "sharpening": 1, "jpeg_quality": 60, "noise": 3}
        | {"white_balance": 0.3},
        outputs=["visibility", "correspondence"],
        antialias="edges",
    )
    generate(config, tmp_path, {"train": 1}, 1)
    stored = open_dataset(tmp_path)[0]
    assert stored.left.image.shape == stored.left.correspondence.shape[:2] == stored.right.image.shape
    assert stored.left.image.std() > 5
    sheet = plot_sheet([stored], config.wanted_histogram(), "grey", [""], [1.0])
    [shown, *_] = sheet.axes[0].get_images()
    np.testing.assert_array_equal(shown.get_array(), as_rgb(stored.left.image))
    assert findings(tmp_path, rays=100) == []
    change_file(next(tmp_path.glob("MiddEval3/trainingF/*/im1.png")), lambda image: np.roll(image, 2, axis=1))
    assert "images" in checks(tmp_path)


def test_a_dataset_is_the_luminance_of_the_coloured_one(dataset):
    with PairRenderer(cheap(antialias="ssaa2"), 3) as renderer:
        coloured = [renderer.render(index) for index in range(2)]
    for pair, stored in zip(coloured, open_dataset(dataset), strict=True):
        assert stored.left.image.shape == stored.left.disparity.shape
        for role, array in stored.arrays().items():
            if role in EYES:
                assert np.abs(array - pair.frame.arrays()[role] @ (0.299, 0.587, 0.114)).max() < 3
            elif "visibility" not in role:
                np.testing.assert_array_equal(array, pair.frame.arrays()[role], err_msg=role)
        assert stored.provenance["camera"] == pair.provenance["camera"]


@pytest.mark.heavy
def test_samples_have_one_channel(dataset):
    torch = heavy("torch")
    from semisynth_gl.torch import StereoDataset

    sample = StereoDataset(dataset)[1]
    assert sample["left"].dtype == torch.uint8
    np.testing.assert_array_equal(sample["left"].numpy(), open_dataset(dataset)[1].left.image[None])
