"""The sources of a split's pairs: the patch atlas and the model library."""

import json
from dataclasses import dataclass

import numpy as np
from isal.isal_zlib import crc32

from semisynth_gl.config import Config
from semisynth_gl.errors import Skipped
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_library import ModelLibrary, build_libraries
from semisynth_gl.splits import WHOLE, Split
from semisynth_gl.textures.atlas import Atlas
from semisynth_gl.textures.prepare import prepare_atlas, split_images


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """The patches and the models of a split's pairs.

    Attributes:
        atlas: the patches, as the config's cameras see them: grey ones where these are monochrome.
        libraries: the models of each recipe, all with the same ``models``; at least one.
    """

    atlas: Atlas
    libraries: tuple[ModelLibrary, ...]

    @property
    def models(self) -> tuple[Mesh, ...]:
        """The models of all recipes."""
        return self.libraries[0].models

    @property
    def skipped_models(self) -> tuple[Skipped, ...]:
        """The user's models that could not be used."""
        return tuple(dict.fromkeys(skipped for library in self.libraries for skipped in library.skipped))

    def digests(self) -> dict[str, str]:
        """Return a checksum of the patches' pixels and one of the models' vertices, in JSON's types."""
        patches = json.dumps([patch.described() for patch in self.atlas.patches]).encode()
        models = 0
        for mesh in self.models:
            for array in (mesh.positions, mesh.uv, mesh.triangles):
                models = crc32(np.ascontiguousarray(array), models)
        # The number of particles depends on the silhouette.
        for library in self.libraries:
            silhouette = library.silhouette
            for numbers in (np.array(silhouette.fill), silhouette.heights, library.chances):
                models = crc32(numbers.tobytes(), models)
        pixels = crc32(np.ascontiguousarray(self.atlas.layers), crc32(patches))
        pixels = crc32(np.ascontiguousarray(self.atlas.large_layers), pixels)
        return {"patches": f"{pixels:08x}", "models": f"{models:08x}"}


def prepare_sources(config: Config, seed: int, split: Split = WHOLE) -> Sources:
    """Cut the patches and build the models of a split, or take them from the cache.

    Raises:
        InputError: where images or models cannot be used, or are too few to hold some out.
    """
    # Models take seconds to build, and that there is no photograph is known at once.
    split_images(config.textures, seed, split)
    libraries = recipe_libraries(config, seed, split)
    atlas = prepare_atlas(config.textures, seed, split)
    return Sources(atlas.in_grey() if config.camera.colour == "grey" else atlas, libraries)


def recipe_libraries(config: Config, seed: int, split: Split = WHOLE) -> tuple[ModelLibrary, ...]:
    """Build the models of each of a config's recipes; see `build_libraries`."""
    configs = [recipe.config for recipe in config.recipes()]
    return build_libraries([(each.models, each.particles) for each in configs], seed, split)
