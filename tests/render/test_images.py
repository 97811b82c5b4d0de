"""Colour: exact texels at one texel per pixel, mipmaps, and detail at grazing angles."""

import itertools
from functools import partial

import numpy as np
import pytest
from scene_table import wall
from scenes import SQUARE, facing, noise_layers, one_model

from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.render import patches
from semisynth_gl.scene.scene import make_scene

pytestmark = pytest.mark.one_backend
SIDE, ODD = 64, 37


def folded(index, wrap):
    if wrap == "repeat":
        return index % ODD
    return np.where((index // ODD) % 2 == 1, ODD - 1 - index % ODD, index % ODD)


@pytest.mark.parametrize("anisotropy", [1, 8])
@pytest.mark.parametrize("wrap", ["mirror", "repeat"])
@pytest.mark.parametrize("grey", [False, True])
def test_a_patch_at_one_texel_per_pixel_comes_out_bit_for_bit(open_renderer, wrap, anisotropy, grey):
    layers = noise_layers(3, ODD)
    layers, shown = (layers[..., 0], layers[2, ..., 0]) if grey else (layers, layers[2, ..., :3])
    renderer, repeats = open_renderer([SQUARE], layers, wrap=wrap, anisotropy=anisotropy), 40
    for (width, height), depth in itertools.product([(256, 192), (241, 89), (1, 1), (17, 3)], (0.731, 1234.5)):
        camera = StereoCamera(width, height, 700.0, 0.05, 0.47 * width, 0.5 * width, 0.4 * height)
        y, x = np.mgrid[:height, :width]
        matrix = facing(camera, -700, -900, repeats * ODD, repeats * ODD, depth)
        scene = make_scene(camera, model=[0], world_from_model=[matrix], layer=[2], uv_scale=repeats)
        expected = shown[folded(y + 900, wrap), folded(x + 700, wrap)]
        np.testing.assert_array_equal(renderer.render(scene).left.image, expected, err_msg=f"{width}, at {depth} m")


@pytest.mark.parametrize("side", [1, 8192])
def test_patches_from_one_texel_to_8192(open_renderer, side):
    layers = np.full((1, side, side, 4), 255, np.uint8)
    layers[0, :, :, 0] = (np.arange(side) % 251).astype(np.uint8)
    camera = StereoCamera.centred(300, 20, 300.0, 0.1)
    # One texel per pixel, from the middle of the patch on.
    begin = side // 2
    matrix = facing(camera, -begin, -begin, side, side, 2.0) if side > 1 else wall(camera, 2.0)
    frame = open_renderer([SQUARE], layers).render(one_model(camera, [matrix]))
    expected = (np.arange(begin, begin + 300) % 251) if side > 1 else np.zeros(300)
    np.testing.assert_array_equal(frame.left.image[..., 0], np.broadcast_to(expected, (20, 300)))


@pytest.mark.parametrize("antialias", ["none", "edges", "ssaa2"])
def test_large_patches_are_counted_behind_the_others_and_come_out_bit_for_bit(open_renderer, antialias):
    camera = StereoCamera.centred(120, 80, 700.0, 0.05)
    layers, large = noise_layers(3, SIDE), noise_layers(2, 4 * SIDE, seed=1)
    make_renderer = partial(open_renderer, [SQUARE], antialias=antialias)
    renderer = make_renderer(layers, large_layers=large, large_anisotropy=4)
    whole, part = facing(camera, 0, 0, 4 * SIDE, 4 * SIDE, 5.0), facing(camera, 40, 20, SIDE, SIDE, 2.0)
    # The renderer draws the large patch last, although it is the first instance; the nearer square hides it.
    scene = make_scene(camera, model=[0, 0], world_from_model=[whole, part], layer=[4, 1])
    inside = np.ones((80, 120), bool)
    shown = large[1][:80, :120, :3].copy()
    shown[20:80, 40:104] = layers[1][:60, :, :3]
    if antialias != "none":
        inside[18:, 38:42] = inside[18:, 102:106] = inside[18:22, 38:106] = False
        behind, before = (
            make_renderer(patches).render(make_scene(camera, model=[0], world_from_model=[pose], layer=[1])).left
            for patches, pose in ((large, whole), (layers, part))
        )
        shown = np.where(np.isfinite(before.disparity)[..., None], before.image, behind.image)
    np.testing.assert_array_equal(renderer.render(scene).left.image[inside], shown[inside])
    with pytest.raises(InputError, match="layer must be 0 to 4, got 5 to 5"):
        renderer.render(make_scene(camera, model=[0], world_from_model=[whole], layer=[5]))


def test_anisotropy_keeps_detail_at_grazing_angles(open_renderer):
    """More anisotropic samples reduce the error against a supersampled reference."""
    camera = StereoCamera.centred(160, 120, 150.0, 0.1)
    layers = np.random.default_rng(0).integers(0, 256, (1, 32, 32, 4)).repeat(8, 1).repeat(8, 2).astype(np.uint8)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] = (8, 0, 0), (0, 1.2, -7), (-4, -0.3, 8)
    scene = make_scene(camera, model=[0], world_from_model=[matrix], layer=[0], uv_scale=[[4, 4]])

    def render(**options):
        return open_renderer([SQUARE], layers, outputs=(), **options).render(scene).left.image.astype(float)

    reference = render(antialias="ssaa8", anisotropy=16)
    error = [np.sqrt(np.mean((render(anisotropy=samples) - reference) ** 2)) for samples in (1, 4, 16)]
    assert error[1] < 0.8 * error[0]
    assert error[2] < error[1]


@pytest.mark.parametrize("grey", [False, True])
def test_smaller_levels_are_means(open_renderer, grey):
    """If a patch is 2, 4, ... 64 times smaller in the image, a pixel shows one texel of that mipmap level."""
    layers = noise_layers(3, SIDE)
    renderer = open_renderer([SQUARE], layers[..., 0] if grey else layers)
    camera, mean = StereoCamera.centred(SIDE, SIDE, 100.0, 0.1), layers[2, ..., :3].astype(float)
    for level in range(1, SIDE.bit_length()):
        side = SIDE >> level
        mean = mean.reshape(side, 2, side, 2, 3).mean((1, 3))
        scene = make_scene(camera, model=[0], world_from_model=[facing(camera, 0, 0, side, side, 2.0)], layer=[2])
        image = renderer.render(scene).left.image[:side, :side]
        assert np.abs(image - (mean[..., 0] if grey else mean)).max() <= level


def test_levels_of_any_side_have_the_bytes_of_the_software_drivers_own(open_renderer, monkeypatch):
    camera, original = StereoCamera.centred(60, 40, 100.0, 0.1), patches._draw_levels  # noqa: SLF001
    for side in (2, 37, 333):
        images = []
        for levels in (original, lambda _context, atlas, *_: atlas.build_mipmaps()):
            monkeypatch.setattr(patches, "_draw_levels", levels)
            renderer = open_renderer([SQUARE], noise_layers(2, side))
            if "llvmpipe" not in renderer.renderer_name:
                pytest.skip("other drivers halve in their own ways")
            tilted = facing(camera, 0, 0, 60, 40, 2.0)
            tilted[2, :2] = 0.5, 0.7
            scene = make_scene(camera, model=[0], world_from_model=[tilted], layer=[1], uv_scale=[[20, 9]])
            images.append(renderer.render(scene).left.image)
        np.testing.assert_array_equal(*images)
