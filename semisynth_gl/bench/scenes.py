"""The scenes of a config's first pairs, with their true disparity at random pixels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from semisynth_gl import oracle
from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.frame import Frame
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.pairs.pipeline import renderer_options
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.mix import MixSampler
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import Scene
from semisynth_gl.scene.sources import Sources, prepare_sources
from semisynth_gl.seeds.splits import Split

# A pixel is at a depth edge where its disparity jumps by more than this to a neighbour, or its neighbour shows another
# instance.
_JUMP_PX = 1.0
_FROM_EDGE_PX = 2
# The rasteriser rounds vertices to 1/256 px, so near an edge between two triangles it may draw the wrong one.
_FROM_CREASE_PX = 1 / 16


@dataclass(frozen=True, slots=True, eq=False)
class BenchScenes:
    """The scenes of a config's first pairs, with their models and the sources of their patches."""

    config: Config
    sources: Sources
    models: Sequence[Mesh]
    scenes: Sequence[Scene]

    def open_renderer(self, backend: Backend, **options: Any) -> Renderer:  # noqa: ANN401 - options of a renderer
        """Open a renderer of these models and patches; ``options`` of `Renderer` replace the config's."""
        atlas = self.sources.atlas
        large = atlas.large_layers if len(atlas.large_layers) else None
        options = renderer_options(self.config) | {"pattern": self.sources.pattern} | options
        return Renderer(self.models, atlas.layers, large_layers=large, backend=backend, **options)


@dataclass(frozen=True, slots=True, eq=False)
class SampledTruth:
    """The oracle's disparity at N pixels of one eye of a scene of `BenchScenes`; inf where no surface is hit.

    ``dropped`` counts the chosen pixels that are left out.
    """

    scene: int
    eye: Eye
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    disparity_px: NDArray[np.float64]
    dropped: int


def sample_scenes(config: Config, seed: int, pairs: int) -> BenchScenes:
    """Make the scenes of a config's first pairs; raises InputError where images, models or ranges cannot be used."""
    sources = prepare_sources(config, Split(seed))
    sampler = MixSampler(config, seed, sources.libraries, sources.atlas.patches)
    return BenchScenes(config, sources, sampler.models, [sampler.sample(index).scene for index in range(pairs)])


def cast_truth(
    bench: BenchScenes, frames: Sequence[Frame], rays: int, rng: np.random.Generator
) -> tuple[list[SampledTruth], list[NDArray[np.bool_]]]:
    """Cast float64 rays at random pixels of both eyes of each scene.

    Pixels are left out within 2 px of a depth edge, with another triangle within 1/16 px, and where ray and renderer
    see different instances: an error there would show where the rasteriser puts an edge.

    ``frames`` have both disparities and the output "instances". ``rays`` pixels are chosen in each view, before any is
    left out.

    Returns:
        Two lists with an entry for the left eye and then one for the right eye of each scene, in the scenes' order: the
        truth, and the (H, W) mask of pixels that touch another instance.
    """
    truths, outlines = [], []
    for number, (scene, frame) in enumerate(zip(bench.scenes, frames, strict=True)):
        for eye in EYES:
            instance = frame.view(eye).instances.astype(np.int64) - 1
            disparity = frame.view(eye).disparity
            outline = edges(instance.astype(np.float64), 0.5)
            outlines.append(outline)
            far_from_edge = ~grown(outline | edges(disparity.astype(np.float64), _JUMP_PX), _FROM_EDGE_PX)
            row = rng.integers(0, scene.camera.height_px, rays)
            column = rng.integers(0, scene.camera.width_px, rays)
            x, y = column.astype(np.float64), row.astype(np.float64)
            hits = cast_rays(scene, bench.models, eye, x, y)
            kept = far_from_edge[row, column] & (hits.instance == instance[row, column])
            # All four corners in one cast, since the cost of a cast depends mostly on the number of instances.
            seen = np.flatnonzero(kept)
            right, down = np.meshgrid(*[(-_FROM_CREASE_PX, _FROM_CREASE_PX)] * 2)
            around_x, around_y = np.add.outer(right.ravel(), x[seen]), np.add.outer(down.ravel(), y[seen])
            around = cast_rays(scene, bench.models, eye, around_x.ravel(), around_y.ravel())
            for there, here in ((around.instance, hits.instance), (around.triangle, hits.triangle)):
                kept[seen] &= (there.reshape(4, -1) == here[seen]).all(axis=0)
            way = oracle.correspondence_px(scene.camera, eye, x, y, hits, signed=bench.config.disparity.signed)
            truth = oracle.disparity_of(eye, way)
            truths.append(SampledTruth(number, eye, row[kept], column[kept], truth[kept], int((~kept).sum())))
    return truths, outlines


def edges(image: NDArray[np.float64], jump: float) -> NDArray[np.bool_]:
    """Return the (H, W) mask of pixels that differ by more than ``jump`` from one of their four neighbours.

    Two infinite values are equal; an infinite value differs from every finite one.
    """
    cross = ndimage.generate_binary_structure(2, 1)
    with np.errstate(invalid="ignore"):
        above = ndimage.maximum_filter(image, footprint=cross) - image > jump
        return np.asarray(above | (image - ndimage.minimum_filter(image, footprint=cross) > jump))


def grown(mask: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    """Return an (H, W) mask grown by a number of pixels in all eight directions."""
    return np.asarray(ndimage.maximum_filter(mask, 2 * pixels + 1))
