"""What a renderer has loaded into its context, and what its caller wants of it: all that its passes share."""

from dataclasses import dataclass

from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.model_buffers import ModelBuffers
from semisynth_gl.render.patches import PatchTextures
from semisynth_gl.render.readers import Reader
from semisynth_gl.render.wanted import Wanted


@dataclass(frozen=True, slots=True)
class Loaded:
    """A renderer's context with its models, patches and constants, what to draw with them, and who takes the pixels.

    For each atlas, ``anisotropies`` has the most samples of a patch for one pixel.
    """

    context: GraphicsContext
    models: ModelBuffers
    patches: PatchTextures
    anisotropies: tuple[int, ...]
    constants: ConstantsBuffer
    wanted: Wanted
    read: Reader
