"""Surface normals against those of the triangles that float64 rays hit."""

import numpy as np
import pytest
from tiny_datasets import lean

from semisynth_gl import oracle
from semisynth_gl.frame.camera import EYES
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.scene.raycast import cast_rays

MOST_DEG = 0.01
# How far from a pixel's centre rays must hit the same triangle: an edge that is nearer may be drawn on either side.
OFF_EDGE_PX = 1 / 16


def small(name="middlebury", **sections):
    """A config of simple models and patches: normals depend on neither."""
    sections |= {"models": {"complex": 0.0}, "textures": {"source": "procedural", "max_patches": 16}}
    config = lean(name, particles={"layers": [{"disparity_px": [2, 20], "count": 15}]}, **sections)
    return config.model_copy(update={"outputs": ("normals",)})


def off_edges(scene, models, eye, x, y):
    """Hits at pixels' centres, and where rays close around them hit the same triangle."""
    hits = cast_rays(scene, models, eye, x, y)
    same = np.ones(len(x), bool)
    for right, down in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        beside = cast_rays(scene, models, eye, x + right * OFF_EDGE_PX, y + down * OFF_EDGE_PX)
        same &= (beside.instance == hits.instance) & (beside.triangle == hits.triangle)
    return hits, same


@pytest.mark.parametrize("name", ["middlebury", "kitti"])
def test_normals_are_those_of_the_triangles_that_rays_hit(name):
    config = small(name, structures={"ground": 1.0, "panels": [1, 3]})
    with PairRenderer(config, 5) as renderer:
        frame = renderer.render(0).frame
        scene = renderer.sampler.sample(0).scene
        width, height = frame.camera.width_px, frame.camera.height_px
        row, column = np.divmod(np.random.default_rng(0).choice(width * height, 600, replace=False), width)
        for eye in EYES:
            hits, same = off_edges(scene, renderer.sampler.models, eye, column.astype(float), row.astype(float))
            expected = oracle.normals(scene, renderer.sampler.models, eye, hits)
            drawn = frame.view(eye).normals[row, column].astype(float)
            seen = same & (hits.instance >= 0)
            assert seen.mean() > 0.5
            # The chord, since the cosine of so small an angle rounds to 1.
            degrees = np.rad2deg(2 * np.arcsin(np.linalg.norm(drawn - expected, axis=1)[seen] / 2))
            assert degrees.max() < MOST_DEG
            assert np.abs(np.linalg.norm(drawn[seen], axis=1) - 1).max() < 1e-6
            assert (drawn[same & (hits.instance < 0)] == 0).all()


def test_normals_point_to_their_eye():
    with PairRenderer(small(), 3) as renderer:
        frame = renderer.render(0).frame
    row, column = np.mgrid[: frame.camera.height_px, : frame.camera.width_px].astype(float)
    for eye in EYES:
        normals = frame.view(eye).normals
        assert (np.linalg.norm(normals, axis=2) > 0.5).mean() > 0.9
        assert (normals * frame.camera.rays(eye, column, row)).sum(axis=2).max() <= 1e-6
