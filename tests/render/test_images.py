"""Colour: patches at one texel per pixel bit for bit, their smaller levels, and detail at grazing angles."""

import itertools
from functools import partial

import moderngl
import numpy as np
import pytest
from scene_table import wall
from scenes import SQUARE, facing, noise_layers, one_model

from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.render.context import open_context
from semisynth_gl.render.patches import PatchTextures
from semisynth_gl.scene.scene import make_scene

pytestmark = pytest.mark.one_backend
SIDE = 64


def folded(index, wrap):
    if wrap == "repeat":
        return index % SIDE
    return np.where((index // SIDE) % 2 == 1, SIDE - 1 - index % SIDE, index % SIDE)


@pytest.mark.parametrize("anisotropy", [1, 8])
@pytest.mark.parametrize("wrap", ["mirror", "repeat"])
@pytest.mark.parametrize("grey", [False, True])
def test_a_patch_at_one_texel_per_pixel_comes_out_bit_for_bit(open_renderer, wrap, anisotropy, grey):
    layers = noise_layers(3, SIDE)
    layers, shown = (layers[..., 0], layers[2, ..., 0]) if grey else (layers, layers[2, ..., :3])
    renderer, repeats = open_renderer([SQUARE], layers, wrap=wrap, anisotropy=anisotropy), 40
    for (width, height), depth in itertools.product([(256, 192), (241, 89), (1, 1), (17, 3)], (0.731, 1234.5)):
        camera = StereoCamera(width, height, 700.0, 0.05, 0.47 * width, 0.5 * width, 0.4 * height)
        y, x = np.mgrid[:height, :width]
        matrix = facing(camera, -700, -900, repeats * SIDE, repeats * SIDE, depth)
        scene = make_scene(camera, model=[0], world_from_model=[matrix], layer=[2], uv_scale=repeats)
        expected = shown[folded(y + 900, wrap), folded(x + 700, wrap)]
        np.testing.assert_array_equal(renderer.render(scene).left.image, expected, err_msg=f"{width}, at {depth} m")


@pytest.mark.parametrize("side", [1, 8192])
def test_patches_from_one_texel_to_8192(open_renderer, side):
    layers = np.full((1, side, side, 4), 255, np.uint8)
    layers[0, :, :, 0] = (np.arange(side) % 251).astype(np.uint8)
    camera = StereoCamera.centred(300, 20, 300.0, 0.1)
    # One texel per pixel, beginning in the middle of the patch.
    begin = side // 2
    matrix = facing(camera, -begin, -begin, side, side, 2.0) if side > 1 else wall(camera, 2.0)
    frame = open_renderer([SQUARE], layers).render(one_model(camera, [matrix]))
    expected = (np.arange(begin, begin + 300) % 251) if side > 1 else np.zeros(300)
    np.testing.assert_array_equal(frame.left.image[..., 0], np.broadcast_to(expected, (20, 300)))


@pytest.mark.parametrize("antialias", ["none", "edges", "ssaa2"])
def test_large_patches_are_counted_behind_the_others_and_come_out_bit_for_bit(open_renderer, antialias):
    camera = StereoCamera.centred(120, 80, 700.0, 0.05)
    layers, large = noise_layers(3, SIDE), noise_layers(2, 4 * SIDE, seed=1)
    draw = partial(open_renderer, [SQUARE], antialias=antialias)
    renderer = draw(layers, large_layers=large, large_anisotropy=4)
    whole, part = facing(camera, 0, 0, 4 * SIDE, 4 * SIDE, 5.0), facing(camera, 40, 20, SIDE, SIDE, 2.0)
    # The large patch is drawn last, though it stands first; what is nearer hides it.
    scene = make_scene(camera, model=[0, 0], world_from_model=[whole, part], layer=[4, 1])
    inside = np.ones((80, 120), bool)
    shown = large[1][:80, :120, :3].copy()
    shown[20:80, 40:104] = layers[1][:60, :, :3]
    if antialias != "none":
        inside[18:, 38:42] = inside[18:, 102:106] = inside[18:22, 38:106] = False
        behind, before = (
            draw(patches).render(make_scene(camera, model=[0], world_from_model=[pose], layer=[1])).left
            for patches, pose in ((large, whole), (layers, part))
        )
        shown = np.where(np.isfinite(before.disparity)[..., None], before.image, behind.image)
    np.testing.assert_array_equal(renderer.render(scene).left.image[inside], shown[inside])
    with pytest.raises(InputError, match="layer must be 0 to 4, got 5 to 5"):
        renderer.render(make_scene(camera, model=[0], world_from_model=[whole], layer=[5]))


def test_anisotropy_keeps_detail_at_grazing_angles(open_renderer):
    """Against a supersampled reference, more samples along the longer side come nearer to the truth."""
    camera = StereoCamera.centred(160, 120, 150.0, 0.1)
    layers = np.random.default_rng(0).integers(0, 256, (1, 32, 32, 4)).repeat(8, 1).repeat(8, 2).astype(np.uint8)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] = (8, 0, 0), (0, 1.2, -7), (-4, -0.3, 8)
    scene = make_scene(camera, model=[0], world_from_model=[matrix], layer=[0], uv_scale=[[4, 4]])

    def draw(**options):
        return open_renderer([SQUARE], layers, outputs=(), **options).render(scene).left.image.astype(float)

    reference = draw(antialias="ssaa8", anisotropy=16)
    error = [np.sqrt(np.mean((draw(anisotropy=samples) - reference) ** 2)) for samples in (1, 4, 16)]
    assert error[1] < 0.8 * error[0]
    assert error[2] < error[1]


def test_whole_disparities_shift_the_same_pixels_in_the_right_view(open_renderer):
    camera = StereoCamera.centred(200, 100, 400.0, 0.1)
    matrix = facing(camera, -500, -500, 30 * SIDE, 30 * SIDE, 400 * 0.1 / 16)
    scene = make_scene(camera, model=[0], world_from_model=[matrix], layer=[0], uv_scale=30)
    frame = open_renderer([SQUARE], noise_layers(1, SIDE)).render(scene)
    np.testing.assert_array_equal(frame.left.image[:, 16:], frame.right.image[:, :-16])
    for view in (frame.left, frame.right):
        np.testing.assert_allclose(view.disparity, 16, atol=1e-5)


# Smaller levels


COVER = """#version 450 core
void main() { gl_Position = vec4(vec2((gl_VertexID << 1) & 2, gl_VertexID & 2) * 2.0 - 1.0, 0.0, 1.0); }
"""
FETCH = """#version 450 core
layout(binding = 0) uniform sampler2DArray atlas;
uniform int layer;
out vec4 texel;
void main() { texel = texelFetch(atlas, ivec3(gl_FragCoord.xy, layer), 0); }
"""


@pytest.fixture
def context(backend):
    opened = open_context(backend)
    with opened.gl:
        yield opened
        assert opened.gl.error == "GL_NO_ERROR"
    opened.release()


def all_levels(context, texture, side, count):
    """The texels of each level, (L, S, S, 4) uint8."""
    program = context.gl.program(vertex_shader=COVER, fragment_shader=FETCH)
    draw, found = context.gl.vertex_array(program, []), []
    texture.use(0)
    for level in range(side.bit_length()):
        size = side >> level
        context.unbound.read_levels(texture.glo, level, level)
        target = context.gl.simple_framebuffer((size, size), 4)
        target.use()
        found.append(np.empty((count, size, size, 4), np.uint8))
        for number in range(count):
            program["layer"] = number
            draw.render(moderngl.TRIANGLES, 3)
            found[-1][number] = np.frombuffer(target.read(components=4), np.uint8).reshape(size, size, 4)
    return found


def test_levels_are_means_with_the_bytes_of_the_software_drivers_own(context):
    """In each patch of each atlas, and whatever was drawn to before."""
    target = context.gl.simple_framebuffer((5, 5), 4)
    target.use()
    target.clear(1, 1, 1, 1)
    for side, count in ((1, 1), (2, 3), (16, 5), (37, 2), (64, 1), (333, 1)):
        layers = noise_layers(count, side)
        patches = PatchTextures(context, (layers, noise_layers(3, 8, seed=1)), mirrored=True)
        assert context.gl.fbo.glo == target.glo
        levels = all_levels(context, patches._textures[0], side, count)  # noqa: SLF001 - no scene shows a level alone
        np.testing.assert_array_equal(levels[0], layers)
        for finer, coarser in itertools.pairwise(levels) if side in (2, 16, 64) else ():
            half = len(coarser[0])
            mean = finer.reshape(count, half, 2, half, 2, 4).astype(float).mean((2, 4))
            assert np.abs(coarser - mean).max() <= 1
        if "llvmpipe" in context.renderer:  # other drivers halve in their own ways
            driver = context.gl.texture_array((side, side, count), 4, layers)
            driver.build_mipmaps()
            for made, wanted in zip(levels, all_levels(context, driver, side, count), strict=True):
                np.testing.assert_array_equal(made, wanted, err_msg=f"{side}")
        target.use()
    assert set(target.read()) == {255}
