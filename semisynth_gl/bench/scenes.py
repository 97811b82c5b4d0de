"""The scenes of a config's first pairs, with their true disparity at random pixels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl import oracle
from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.pairs.pipeline import renderer_options
from semisynth_gl.render import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.mix import RecipeMixSampler
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import Scene
from semisynth_gl.scene.sources import SceneSources, prepare_sources
from semisynth_gl.seeds.splits import Split

# Pixels nearer than this to an edge are not compared: rasterisers round vertices, at best to 1/256 px, so the renderer
# may show the triangle on the other side of the edge.
_FROM_EDGE_PX = 1 / 16


@dataclass(frozen=True, slots=True, eq=False)
class ConfigScenes:
    """The scenes of a config's first pairs, with their models and the sources of their patches."""

    config: Config
    sources: SceneSources
    models: Sequence[Mesh]
    scenes: Sequence[Scene]

    def open_renderer(self, backend: Backend, **options: Any) -> Renderer:  # noqa: ANN401 - options of a renderer
        """Open a `Renderer` for these models and patches; ``options`` override the options that the config sets."""
        atlas = self.sources.atlas
        large = atlas.large_layers if len(atlas.large_layers) else None
        options = renderer_options(self.config) | {"pattern": self.sources.pattern} | options
        return Renderer(self.models, atlas.layers, large_layers=large, backend=backend, **options)


@dataclass(frozen=True, slots=True, eq=False)
class TruthAtPixels:
    """The disparity at N pixels of one eye of a scene, by rays; inf if the ray hits nothing.

    ``scene`` is the scene's index in `ConfigScenes`. ``left_out`` is the number of sampled pixels that are not
    compared.
    """

    scene: int
    eye: Eye
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    disparity_px: NDArray[np.float64]
    left_out: int


def sample_scenes(config: Config, seed: int, pairs: int) -> ConfigScenes:
    """Sample the scenes of a config's first pairs; raises InputError if images, models or ranges cannot be used."""
    sources = prepare_sources(config, Split(seed))
    sampler = RecipeMixSampler(config, seed, sources.libraries, sources.atlas.patches)
    return ConfigScenes(config, sources, sampler.models, [sampler.sample(index).scene for index in range(pairs)])


def cast_truth(bench: ConfigScenes, rays: int, rng: np.random.Generator) -> list[TruthAtPixels]:
    """Cast ``rays`` rays through random pixels of each eye of each scene, and return the disparities of their hits.

    Pixels within 1/16 px of a different triangle are left out. Four more rays per pixel decide that, not the rendered
    pair: surfaces that the renderer loses or misplaces count as errors.
    """
    truths = []
    right, down = (side.ravel() for side in np.meshgrid(*[(-_FROM_EDGE_PX, _FROM_EDGE_PX)] * 2))
    for number, scene in enumerate(bench.scenes):
        for eye in EYES:
            row = rng.integers(0, scene.camera.height_px, rays)
            column = rng.integers(0, scene.camera.width_px, rays)
            x, y = column.astype(np.float64), row.astype(np.float64)
            hits = cast_rays(scene, bench.models, eye, x, y)
            # One cast for all four rays around each pixel: its time depends mostly on the number of instances.
            around = cast_rays(scene, bench.models, eye, np.add.outer(right, x).ravel(), np.add.outer(down, y).ravel())
            kept = np.ones(rays, bool)
            for of_corners, of_centres in ((around.instance, hits.instance), (around.triangle, hits.triangle)):
                kept &= (of_corners.reshape(4, rays) == of_centres).all(axis=0)
            signed = bench.config.disparity.signed
            truth = oracle.disparity_of(eye, oracle.correspondence_px(scene.camera, eye, x, y, hits, signed=signed))
            truths.append(TruthAtPixels(number, eye, row[kept], column[kept], truth[kept], int((~kept).sum())))
    return truths
