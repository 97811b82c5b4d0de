"""Patches on the GPU: one texture array for each size of patch, and their numbers across all of them."""

from collections.abc import Sequence

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import BackendError
from semisynth_gl.render.context import GraphicsContext

_UNIT = 0  # of the sampler in mesh.frag


class PatchTextures:
    """The patch atlas of a renderer.

    Args:
        context: the open context.
        atlases: (L, P, P, 4) uint8 RGBA each; row 0 is the top.
        mirrored: whether a patch's mirror image lies beyond its border; else the patch again.

    Attributes:
        ends: (A,) int64, number of the patches in an atlas and all before it: `Scene.layer` counts through.

    Raises:
        BackendError: where the driver cannot hold an atlas.
    """

    def __init__(self, context: GraphicsContext, atlases: Sequence[NDArray[np.uint8]], *, mirrored: bool) -> None:
        self._textures = [_upload(context, layers, mirrored=mirrored) for layers in atlases]
        self.ends = np.cumsum([len(layers) for layers in atlases])

    def __len__(self) -> int:
        return int(self.ends[-1])

    def use(self, atlas: int) -> None:
        """Let shaders sample an atlas."""
        self._textures[atlas].use(_UNIT)


def _upload(context: GraphicsContext, layers: NDArray[np.uint8], *, mirrored: bool) -> moderngl.TextureArray:
    count, side = layers.shape[:2]
    most = int(context.gl.info["GL_MAX_ARRAY_TEXTURE_LAYERS"])
    widest = int(context.gl.info["GL_MAX_TEXTURE_SIZE"])
    if count > most or side > widest:
        raise BackendError(
            f"the patch atlas has {count} patches of {side} px, but {context.renderer} holds {most} of up to "
            f"{widest} px: lower textures.max_patches, textures.patch_px or textures.large_px"
        )
    atlas = context.gl.texture_array((side, side, count), 4, np.ascontiguousarray(layers))
    atlas.build_mipmaps()
    atlas.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    if mirrored:
        context.unbound.mirror_beyond_border(atlas.glo)
    return atlas
