"""What is measured on: the first pairs of a config, and which of their pixels are compared with the oracle."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl import oracle
from semisynth_gl.camera import EYES, Eye
from semisynth_gl.config import Config
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.render.variants import DEFAULT_WAY, DisparityVariants
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.sampler import SceneSampler
from semisynth_gl.scene.scene import Scene
from semisynth_gl.textures.prepare import prepare_atlas

# A jump of disparity between neighbours, or another instance beside, makes a depth edge.
_JUMP_PX = 1.0
_FROM_EDGE_PX = 2


@dataclass(frozen=True, slots=True, eq=False)
class BenchScenes:
    """The first pairs of a config.

    Attributes:
        config: where they are from.
        models: what `Scene.model` counts.
        layers: (L, P, P, 4) uint8, the patch atlas.
        scenes: one per pair.
    """

    config: Config
    models: Sequence[Mesh]
    layers: NDArray[np.uint8]
    scenes: Sequence[Scene]


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """Pixels of one eye of one pair at which the truth is known.

    Attributes:
        scene: index of the scene.
        eye: "left" or "right".
        row: (N,) int64.
        column: (N,) int64.
        disparity_px: (N,) float64, the oracle's; inf where there is none.
        dropped: pixels drawn but left out, because they are near an edge or the oracle sees another triangle.
    """

    scene: int
    eye: Eye
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    disparity_px: NDArray[np.float64]
    dropped: int


def sample_scenes(config: Config, seed: int, pairs: int) -> BenchScenes:
    """Make the first pairs of a config, its patches and models.

    Raises:
        InputError: where images, models or ranges cannot be used.
    """
    atlas = prepare_atlas(config.textures, seed)
    sampler = SceneSampler(config, seed, build_library(config.models, config.particles, seed), atlas.patches)
    scenes = [sampler.sample(index).scene for index in range(pairs)]
    return BenchScenes(config, sampler.models, atlas.layers, scenes)


def check_pixels(
    bench: BenchScenes, variants: DisparityVariants, rays: int, rng: np.random.Generator
) -> tuple[list[Checked], list[NDArray[np.bool_]]]:
    """Cast float64 rays at randomly chosen pixels of both eyes of each scene.

    Pixels within 2 px of a depth edge are left out, and those where the oracle sees another triangle: there a
    difference would tell where the rasteriser puts an edge, and not how exact a way to the disparity is.

    Args:
        bench: the scenes.
        variants: draws them.
        rays: how many per eye and scene.
        rng: chooses the pixels.

    Returns:
        The pixels, and of the same eyes the (H, W) bool masks of pixels that touch another instance.
    """
    checked, outlines = [], []
    for number, scene in enumerate(bench.scenes):
        for eye in EYES:
            instance, triangle = variants.surface(scene, eye)
            disparity = variants.disparity(scene, eye, DEFAULT_WAY)
            outline = edges(instance.astype(np.float64), 0.5)
            outlines.append(outline)
            far_from_edge = ~grown(outline | edges(disparity.astype(np.float64), _JUMP_PX), _FROM_EDGE_PX)
            row = rng.integers(0, scene.camera.height_px, rays)
            column = rng.integers(0, scene.camera.width_px, rays)
            hits = cast_rays(scene, bench.models, eye, column.astype(np.float64), row.astype(np.float64))
            kept = far_from_edge[row, column]
            kept &= (hits.instance == instance[row, column]) & (hits.triangle == triangle[row, column])
            truth = oracle.disparity_px(scene.camera, hits)
            checked.append(Checked(number, eye, row[kept], column[kept], truth[kept], int((~kept).sum())))
    return checked, outlines


def edges(image: NDArray[np.float64], jump: float) -> NDArray[np.bool_]:
    """Pixels that differ from one of their four neighbours by more than ``jump``; inf differs from all but inf."""
    found = np.zeros(image.shape, bool)
    for axis in (0, 1):
        ahead, behind = np.moveaxis(image, axis, 0)[1:], np.moveaxis(image, axis, 0)[:-1]
        with np.errstate(invalid="ignore"):
            jumps = (ahead != behind) & ~(np.abs(ahead - behind) <= jump)
        moved = np.moveaxis(found, axis, 0)
        moved[1:] |= jumps
        moved[:-1] |= jumps
    return found


def grown(mask: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    """Let a mask grow by a number of pixels in all eight directions."""
    padded = np.pad(mask, pixels)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (2 * pixels + 1, 2 * pixels + 1))
    return np.asarray(windows.any(axis=(2, 3)))
