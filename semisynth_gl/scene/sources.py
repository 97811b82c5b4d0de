"""The sources of a split's pairs: the patch atlas and the model library."""

import json
from dataclasses import asdict, dataclass

import numpy as np
from isal.isal_zlib import crc32

from semisynth_gl.config import Config
from semisynth_gl.geometry.model_library import ModelLibrary, build_library
from semisynth_gl.splits import WHOLE, Split
from semisynth_gl.textures.atlas import Atlas
from semisynth_gl.textures.prepare import prepare_atlas


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """The patches and the models of a split's pairs."""

    atlas: Atlas
    model_library: ModelLibrary

    def digests(self) -> dict[str, str]:
        """Return a checksum of the patches' pixels and one of the models' vertices, in JSON's types."""
        patches = json.dumps([asdict(patch) for patch in self.atlas.patches]).encode()
        models = 0
        for mesh in self.model_library.models:
            for array in (mesh.positions, mesh.uv, mesh.triangles):
                models = crc32(np.ascontiguousarray(array), models)
        # The number of particles depends on the silhouette.
        silhouette = self.model_library.silhouette
        for numbers in (np.array(silhouette.fill), silhouette.heights, self.model_library.chances):
            models = crc32(numbers.tobytes(), models)
        pixels = crc32(np.ascontiguousarray(self.atlas.layers), crc32(patches))
        return {"patches": f"{pixels:08x}", "models": f"{models:08x}"}


def prepare_sources(config: Config, seed: int, split: Split = WHOLE) -> Sources:
    """Cut the patches and build the models of a split, or take them from the cache.

    Raises:
        InputError: where images or models cannot be used, or are too few to hold some out.
    """
    library = build_library(config.models, config.particles, seed, split)
    return Sources(prepare_atlas(config.textures, seed, split), library)
