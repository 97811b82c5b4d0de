"""Patches on the GPU: an atlas, which is a texture array, for each patch size."""

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

    ``atlases`` are A arrays, all (L, P, P, 4) uint8 RGBA or all (L, P, P) uint8 grey; row 0 is the top. Beyond its
    border, a patch repeats, or is ``mirrored``. Raises BackendError where the driver cannot hold an atlas.

    Attributes:
        grey: whether the atlases are grey: textures of one component.
        ends: (A,) int64, cumulative number of patches: atlas k has the layers ends[k - 1] to ends[k] - 1 of a scene.
        sides_px: (A,) int64, side of each atlas's patches.
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
    max_layers = int(context.gl.info["GL_MAX_ARRAY_TEXTURE_LAYERS"])
    max_px = int(context.gl.info["GL_MAX_TEXTURE_SIZE"])
    if count > max_layers or side > max_px:
        raise BackendError(
            f"the patch atlas has {counted(count, 'patch')} of {side} px, but {context.renderer} holds "
            f"{max_layers} of up to {max_px} px: lower textures.max_patches, textures.patch_px or textures.large_px"
        )
    # moderngl creates the texture; `store_layers` replaces its storage, which has no mipmap levels.
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

    glGenerateMipmap makes the same bytes on llvmpipe, but compiles its code anew in every context, which takes most of
    the time to open a renderer. llvmpipe caches the programs of these shaders.
    """
    gl, functions = context.gl, context.functions
    in_use = gl.fbo
    program = link_program(context, "level.vert", "level.frag", {}, "level.geom")
    draw = gl.vertex_array(program, [])
    # moderngl takes the framebuffer's size from this image, which is then replaced by the levels.
    placeholder = gl.renderbuffer((side, side), 4)
    framebuffer = gl.framebuffer([placeholder])
    framebuffer.use()
    gl.enable_only(moderngl.NOTHING)
    atlas.filter = (moderngl.LINEAR, moderngl.LINEAR)
    atlas.use(_UNIT)
    for level in range(1, side.bit_length()):
        functions.limit_levels(atlas.glo, level - 1, level - 1)
        functions.attach_level(framebuffer.glo, atlas.glo, level)
        framebuffer.viewport = (0, 0, side >> level, side >> level)
        draw.render(moderngl.TRIANGLE_FAN, 4, instances=count)
    functions.limit_levels(atlas.glo, 0, side.bit_length() - 1)
    in_use.use()
    for resource in (framebuffer, placeholder, draw, program):
        resource.release()
