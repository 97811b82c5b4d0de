"""Visibility masks along the edges of surfaces whose triangles are smaller than a pixel."""

import numpy as np
import pytest
from scenes import SQUARE, board, facing, noise_layers

from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, VISIBLE
from semisynth_gl.geometry.mesh import make_mesh, mesh_grid
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import make_scene


@pytest.mark.parametrize("begin", np.linspace(20.05, 20.95, 7))
def test_an_edge_of_many_small_triangles_hides_from_where_it_lies(begin):
    # An odd number of rows keeps edges off the line on which the surface is traced.
    u, v, triangles = mesh_grid(201, 200)
    fine = make_mesh("fine", np.stack([u, v, 0 * u], axis=1), np.stack([u, v], axis=1), triangles)
    # In an image of one row, no surface above or below the point decides.
    camera = StereoCamera.centred(96, 1, 100.0, 1.0)
    far_px, near_px, end = 5.3, 20.0, 41.0
    wall = facing(camera, -200, -200, 600, 500, 100.0 / far_px)
    poses = [wall, board(camera, begin, end, near_px)]
    scene = make_scene(camera, model=[0, 1], world_from_model=poses, layer=[0, 0], near_m=1.0)
    with Renderer([SQUARE, fine], noise_layers(1, 8), outputs=("visibility", "instances")) as renderer:
        left = renderer.render(scene).left
    target = np.arange(96) - far_px
    hidden = (target > begin) & (target < end)
    shown = (left.instances == 1) & (target >= 0) & (np.minimum(abs(target - begin), abs(target - end)) > 1e-3)
    assert (hidden & shown).any()
    expected = np.broadcast_to(np.where(hidden, OCCLUDED, VISIBLE), shown.shape)
    np.testing.assert_array_equal(left.visibility[shown], expected[shown])
