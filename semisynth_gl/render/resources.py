"""What a renderer's passes share: its context, the models and patches in it, and its options."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.model_buffers import SceneBuffers
from semisynth_gl.render.options import RenderOptions
from semisynth_gl.render.patches import PatchTextures
from semisynth_gl.render.readers import PixelReader


@dataclass(frozen=True, slots=True)
class RenderResources:
    """A renderer's context with its models, patches and constants, and its options."""

    context: GraphicsContext
    models: SceneBuffers
    patches: PatchTextures
    anisotropies: tuple[int, ...]  # for each atlas, the maximum number of samples of a patch for one pixel
    constants: ConstantsBuffer
    options: RenderOptions
    read: PixelReader  # reads pixels from framebuffers
    pattern: NDArray[np.uint8] | None = None  # (H, W), the pattern of the scenes' projectors
