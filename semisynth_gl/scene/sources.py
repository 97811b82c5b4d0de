"""Prepares the sources of a split's pairs: the patch atlas, the model libraries, and a projector's pattern."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from isal.isal_zlib import crc32
from numpy.typing import NDArray

from semisynth_gl.config import Config
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_library import ModelLibrary, build_libraries
from semisynth_gl.inputs.errors import SkippedFile
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.projector import find_pattern
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.atlas import Atlas
from semisynth_gl.textures.prepare import prepare_atlas, split_images

# Before values are hashed, they are rounded to these steps: _LENGTH for lengths (in radii of a model), shares and
# chances; _LEVELS for mean levels of pixels.
_LENGTH = 1e-5
_LEVELS = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class SceneSources:
    """The patches and the models of a split's pairs, and a projector's pattern."""

    atlas: Atlas  # in grey if the config's cameras are monochrome
    libraries: tuple[ModelLibrary, ...]  # one per recipe; they share `models`, with different chances
    photographs: tuple[Path, ...] = ()  # the files that patches may come from; empty if all patches are procedural
    pattern: NDArray[np.uint8] | None = None  # (H, W), of the projector
    pattern_is_read: bool = False  # whether the pattern comes from a file; a painted pattern needs no checksum

    @property
    def models(self) -> tuple[Mesh, ...]:
        """The models of all recipes."""
        return self.libraries[0].models

    @property
    def skipped_models(self) -> tuple[SkippedFile, ...]:
        """The user's models that could not be used, with the reasons."""
        return tuple(dict.fromkeys(skipped for library in self.libraries for skipped in library.skipped))

    def without_pixels(self) -> "SceneSources":
        """Return the sources without the patches' pixels, which take hundreds of MB in a full atlas."""
        atlas = self.atlas
        empty, large = (np.zeros((0, *layers.shape[1:]), np.uint8) for layers in (atlas.layers, atlas.large_layers))
        return replace(self, atlas=replace(atlas, layers=empty, large_layers=large))

    def digests(self) -> dict[str, str]:
        """Return the checksums "patches" and "models", and "pattern" if the pattern comes from a file, hexadecimal.

        Processors differ in the last bits of sines and of matrix products. Rounded values rarely differ: lengths are
        rounded to 1e-5 of a model's radius, and the means of 4 x 4 parts of a patch to half a level.
        """
        patches = models = 0
        for patch in self.atlas.patches:
            known = patch.as_json()
            del known["texture"]  # follows from the pixels
            patches = crc32(json.dumps(known).encode(), patches)
        for layers in (self.atlas.layers, self.atlas.large_layers):
            patches = crc32(_rounded(_means(layers), _LEVELS), patches)
        for mesh in self.models:
            models = crc32(np.ascontiguousarray(mesh.triangles), models)
            for lengths in (mesh.positions, mesh.uv):
                models = crc32(_rounded(lengths, _LENGTH), models)
        # The mean relief of the models decides how many particles a scene has.
        for library in self.libraries:
            relief = library.relief
            for numbers in (np.array([relief.fill]), relief.heights, library.chances):
                models = crc32(_rounded(numbers, _LENGTH), models)
        digests = {"patches": patches, "models": models}
        if self.pattern is not None and self.pattern_is_read:
            digests["pattern"] = crc32(np.ascontiguousarray(self.pattern))
        return {name: f"{digest:08x}" for name, digest in digests.items()}


def _rounded(values: NDArray[Any], step: float) -> Ints:
    """Round values to whole steps, so that values that differ only in their last bits are likely to become equal."""
    # The shift keeps frequent values, such as 0 and round numbers, away from the ends of steps.
    return np.floor(np.ascontiguousarray(values, np.float64) / step + 0.317).astype(np.int64)


def _means(layers: NDArray[np.uint8]) -> Floats:
    """Return the mean of each component over 4 x 4 parts of each layer, from every eighth row: (L, 4, 4[, C])."""
    some = layers[:, ::8]
    rows, columns = (np.unique(np.arange(4) * extent // 4) for extent in some.shape[1:3])
    sums = np.add.reduceat(np.add.reduceat(some, rows, axis=1, dtype=np.uint32), columns, axis=2)
    pixels = np.multiply.outer(np.diff(rows, append=some.shape[1]), np.diff(columns, append=some.shape[2]))
    means: Floats = sums / pixels.reshape(*pixels.shape, *(1,) * (some.ndim - 3))
    return means


def prepare_sources(config: Config, split: Split) -> SceneSources:
    """Cut the patches and build the models of a split, or load them from the cache.

    Raises:
        InputError: where a projector's pattern, images or models cannot be used, or there are too few images or models
            for the splits.
    """
    projector = config.projector
    pattern = None if projector is None else find_pattern(projector)
    # Look for photographs first: models take seconds to build, and missing photographs are then reported at once.
    photographs = split_images(config.textures, split)
    libraries = recipe_libraries(config, split)
    atlas = prepare_atlas(config.textures, split, photographs)
    return SceneSources(
        atlas.in_grey() if config.camera.colour == "grey" else atlas,
        libraries,
        tuple(photographs),
        pattern,
        projector is not None and not projector.painted,
    )


def recipe_libraries(config: Config, split: Split) -> tuple[ModelLibrary, ...]:
    """Build the models of each of a config's recipes; see `build_libraries`."""
    configs = [recipe.config for recipe in config.recipes()]
    return build_libraries([(each.models, each.particles) for each in configs], split)
