"""A glance at a scene: what each of a few hundred rays of the left view hits first, for all triangles at once.

The ray caster gives the same answer one instance after the other, which takes longer; it does those that reach
behind the near plane.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.cells import covered_cells
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.scene.background import GRID, grid_px
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import Scene, make_scene

Floats = NDArray[np.float64]


def glance(scene: Scene, models: Sequence[Mesh]) -> tuple[Floats, NDArray[np.int64]]:
    """Look at a scene on the coarse grid of `grid_px`.

    Args:
        scene: the instances and the camera.
        models: the meshes that ``scene.model`` counts.

    Returns:
        Planar depth, float64, inf where nothing is hit, and the instance, -1 there; flat, a value for each ray.
    """
    corners, owner, crossing = [], [], []
    for number in range(len(scene)):
        mesh = models[int(scene.model[number])]
        view_from_model = scene.camera_from_world @ scene.world_from_model[number]
        vertices = mesh.positions.astype(np.float64) @ view_from_model[:3, :3].T + view_from_model[:3, 3]
        nearest = vertices[:, 2].min()
        if nearest < scene.near_m:
            crossing.append(number)
        else:
            corners.append(vertices[mesh.triangles])
            owner.append(np.full(len(mesh.triangles), number))
    depth_m, instance = _cast(scene, models, np.array(crossing, np.int64))
    if corners:
        cell, hit_m, hit = _rasterise(scene, np.concatenate(corners), np.concatenate(owner))
        nearer = hit_m < depth_m[cell]
        depth_m[cell[nearer]], instance[cell[nearer]] = hit_m[nearer], hit[nearer]
    return depth_m, instance


def _cast(scene: Scene, models: Sequence[Mesh], numbers: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    part = make_scene(
        scene.camera,
        model=scene.model[numbers],
        world_from_model=scene.world_from_model[numbers],
        layer=scene.layer[numbers],
        camera_from_world=scene.camera_from_world,
        near_m=scene.near_m,
    )
    hits = cast_rays(part, models, "left", *grid_px(scene.camera))
    return hits.depth_m, np.append(numbers, -1)[hits.instance]


def _rasterise(
    scene: Scene, corners: Floats, owner: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Floats, NDArray[np.int64]]:
    """Return the rays that hit triangles (T, 3, 3), the depths of their first hits and the owners of what they hit."""
    camera, (columns, rows) = scene.camera, GRID
    inverse = 1 / corners[..., 2]
    scale = np.array([columns / camera.width_px, rows / camera.height_px])
    middle = np.array([camera.cx_left_px, camera.cy_px]) + 0.5
    grid = (corners[..., :2] * inverse[..., None] * camera.focal_px + middle) * scale - 0.5
    triangle, cell, u, v = covered_cells(grid, columns, rows)
    # 1 / Z is linear on the screen.
    own = inverse[triangle]
    depth_m = 1 / (own[:, 0] + u * (own[:, 1] - own[:, 0]) + v * (own[:, 2] - own[:, 0]))
    order = np.lexsort((depth_m, cell))
    first_of_cell = order[np.unique(cell[order], return_index=True)[1]]
    return cell[first_of_cell], depth_m[first_of_cell], owner[triangle[first_of_cell]]
