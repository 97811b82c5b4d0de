"""Patches on the GPU: one texture array, an atlas, for each patch size. Patch numbers run on from atlas to atlas."""

from collections.abc import Sequence

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.inputs.errors import BackendError, counted
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.programs import link_program

_UNIT = 0  # texture unit of the sampler in mesh.frag


class PatchTextures:
    """The patch atlases of a renderer on the GPU.

    Args:
        context: the context.
        atlases: A arrays, all (L, P, P, 4) uint8 RGBA or all (L, P, P) uint8 grey; row 0 is the top.
        mirrored: whether a patch is mirrored beyond its border; else it repeats.

    Attributes:
        grey: whether the atlases are grey; shaders then read the grey values from the first component.
        ends: (A,) int64, number of patches in each atlas and all atlases before it, by which `Scene.layer` is split.
        sides_px: (A,) int64, side of each atlas's patches.

    Raises:
        BackendError: where the driver cannot hold an atlas.
    """

    def __init__(self, context: GraphicsContext, atlases: Sequence[NDArray[np.uint8]], *, mirrored: bool) -> None:
        self._textures = [_upload(context, layers, mirrored=mirrored) for layers in atlases]
        self.grey = atlases[0].ndim == 3
        self.ends = np.cumsum([len(layers) for layers in atlases])
        self.sides_px = np.array([layers.shape[1] for layers in atlases])

    def __len__(self) -> int:
        return int(self.ends[-1])

    def use(self, atlas: int, unit: int = _UNIT) -> None:
        """Bind an atlas to a texture unit, by default the one that mesh.frag samples."""
        self._textures[atlas].use(unit)


def _upload(context: GraphicsContext, layers: NDArray[np.uint8], *, mirrored: bool) -> moderngl.TextureArray:
    count, side = layers.shape[:2]
    most = int(context.gl.info["GL_MAX_ARRAY_TEXTURE_LAYERS"])
    widest = int(context.gl.info["GL_MAX_TEXTURE_SIZE"])
    if count > most or side > widest:
        raise BackendError(
            f"the patch atlas has {counted(count, 'patch')} of {side} px, but {context.renderer} holds {most} of up to "
            f"{widest} px: lower textures.max_patches, textures.patch_px or textures.large_px"
        )
    # moderngl only creates the texture object. We allocate its storage, since moderngl's has no mipmap levels.
    atlas = context.gl.texture_array((1, 1, 1), 4)
    context.functions.store_layers(
        atlas.glo, side.bit_length(), np.ascontiguousarray(layers), software=context.software
    )
    _draw_levels(context, atlas, side, count)
    atlas.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    if mirrored:
        context.functions.mirror_beyond_border(atlas.glo)
    return atlas


def _draw_levels(context: GraphicsContext, atlas: moderngl.TextureArray, side: int, count: int) -> None:
    """Draw the smaller levels of an atlas, each from the next larger level.

    The bytes equal those of llvmpipe's own mipmaps. But llvmpipe compiles its mipmap code again in each context, which
    dominates the time to open a renderer. It caches our shaders instead.
    """
    gl, functions = context.gl, context.functions
    in_use = gl.fbo
    program = link_program(context, "level.vert", "level.frag", {}, "level.geom")
    draw = gl.vertex_array(program, [])
    # Nothing is drawn to this image; moderngl only derives the framebuffer's size from it.
    whole = gl.renderbuffer((side, side), 4)
    framebuffer = gl.framebuffer([whole])
    framebuffer.use()
    gl.enable_only(moderngl.NOTHING)
    atlas.filter = (moderngl.LINEAR, moderngl.LINEAR)
    atlas.use(_UNIT)
    for level in range(1, side.bit_length()):
        functions.read_levels(atlas.glo, level - 1, level - 1)
        functions.draw_to_level(framebuffer.glo, atlas.glo, level)
        framebuffer.viewport = (0, 0, side >> level, side >> level)
        draw.render(moderngl.TRIANGLE_FAN, 4, instances=count)
    functions.read_levels(atlas.glo, 0, side.bit_length() - 1)
    in_use.use()
    for resource in (framebuffer, whole, draw, program):
        resource.release()
