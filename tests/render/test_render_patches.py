"""Patches on the GPU: their smaller levels."""

import itertools

import moderngl
import numpy as np
import pytest
from scenes import noise_layers

from semisynth_gl.render.context import open_context
from semisynth_gl.render.patches import PatchTextures

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


def textures(patches):
    return patches._textures  # noqa: SLF001 - no scene shows a level alone


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


@pytest.mark.parametrize("mirrored", [False, True])
def test_levels_have_the_bytes_of_the_software_drivers_own(context, mirrored):
    if "llvmpipe" not in context.renderer:
        pytest.skip(f"{context.renderer} halves in its own way")
    for side, count in ((1, 1), (2, 3), (3, 1), (16, 5), (37, 2), (64, 1), (333, 1), (511, 1)):
        layers = noise_layers(count, side)
        driver = context.gl.texture_array((side, side, count), 4, layers)
        driver.build_mipmaps()
        [ours] = textures(PatchTextures(context, (layers,), mirrored=mirrored))
        pairs = zip(*(all_levels(context, each, side, count) for each in (ours, driver)), strict=True)
        for level, (made, wanted) in enumerate(pairs):
            np.testing.assert_array_equal(made, wanted, err_msg=f"{side}, level {level}")


def test_each_texel_is_the_mean_of_four(context):
    """In each patch of each atlas, and whatever was drawn to before."""
    atlases = noise_layers(4, 32), noise_layers(3, 8, seed=1)
    target = context.gl.simple_framebuffer((5, 5), 4)
    target.use()
    target.clear(1, 1, 1, 1)
    patches = PatchTextures(context, atlases, mirrored=True)
    assert context.gl.fbo.glo == target.glo
    assert set(target.read()) == {255}
    for layers, texture in zip(atlases, textures(patches), strict=True):
        count, side = layers.shape[:2]
        levels = all_levels(context, texture, side, count)
        np.testing.assert_array_equal(levels[0], layers)
        for finer, coarser in itertools.pairwise(levels):
            half = len(coarser[0])
            mean = finer.reshape(count, half, 2, half, 2, 4).astype(float).mean((2, 4))
            assert np.abs(coarser - mean).max() <= 1
