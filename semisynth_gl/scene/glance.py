"""A glance at a scene: what each of a few hundred rays of the left view hits first, for all triangles at once.

The ray caster gives the same answer one instance after the other, which takes longer.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.cells import covered_cells
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.scene.background import GRID
from semisynth_gl.scene.scene import Scene

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """What R rays of the left view hit first.

    Attributes:
        depth_m: (R,) float64, planar depth; inf where nothing is hit.
        instance: (R,) int64; -1 where nothing is hit.
        uv: (R, 2) float64, the model's UV there.
    """

    depth_m: Floats
    instance: NDArray[np.int64]
    uv: Floats


def glance(scene: Scene, models: Sequence[Mesh]) -> Glance:
    """Look at a scene on the coarse grid of `grid_px`.

    Args:
        scene: the instances and the camera.
        models: the meshes that ``scene.model`` counts.
    """
    # Corners of triangles, with their UV.
    parts, owners = [np.empty((0, 3, 5))], [np.empty(0, np.int64)]
    for number in range(len(scene)):
        mesh = models[int(scene.model[number])]
        view_from_model = scene.camera_from_world @ scene.world_from_model[number]
        vertices = mesh.positions.astype(np.float64) @ view_from_model[:3, :3].T + view_from_model[:3, 3]
        if vertices[:, 2].max() < scene.near_m:
            continue
        corners = np.c_[vertices, mesh.uv][mesh.triangles]
        parts.append(corners if vertices[:, 2].min() >= scene.near_m else _cut(corners, scene.near_m))
        owners.append(np.full(len(parts[-1]), number))
    rays = GRID[0] * GRID[1]
    depth_m, instance, uv = np.full(rays, np.inf), np.full(rays, -1), np.zeros((rays, 2))
    cell, *hit = _rasterise(scene, np.concatenate(parts), np.concatenate(owners))
    depth_m[cell], instance[cell], uv[cell] = hit
    return Glance(depth_m, instance, uv)


def _cut(corners: Floats, near_m: float) -> Floats:
    """Return the parts of triangles (T, 3, 5) beyond the near plane, as triangles (U, 3, 5)."""
    beyond = corners[..., 2] >= near_m
    count = beyond.sum(axis=1)
    # The corner that lies on another side than the two others comes first.
    odd = np.where(count == 1, beyond.argmax(axis=1), beyond.argmin(axis=1))
    order = (odd[:, None] + np.arange(3)) % 3
    first, second, third = np.moveaxis(np.take_along_axis(corners, order[..., None], axis=1), 1, 0)

    def cut(other: Floats) -> Floats:
        return np.asarray(first + (near_m - first[:, 2:3]) / (other[:, 2:3] - first[:, 2:3]) * (other - first))

    # Triangles on one side of the plane, which are not taken from here, may divide by 0.
    with np.errstate(divide="ignore", invalid="ignore"):
        on_second, on_third = cut(second), cut(third)
    one, two = count == 1, count == 2
    return np.concatenate(
        [
            corners[count == 3],
            np.stack([first, on_second, on_third], axis=1)[one],
            np.stack([on_second, second, third], axis=1)[two],
            np.stack([on_second, third, on_third], axis=1)[two],
        ]
    )


def _rasterise(
    scene: Scene, corners: Floats, owner: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Floats, NDArray[np.int64], Floats]:
    """Return the rays that hit triangles (T, 3, 5), and of their first hits depth, owner and UV."""
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
    # So is UV over Z.
    share = np.stack([1 - u - v, u, v], axis=1)[first_of_cell] * own[first_of_cell] * depth_m[first_of_cell, None]
    uv = (share[..., None] * corners[triangle[first_of_cell], :, 3:]).sum(axis=1)
    return cell[first_of_cell], depth_m[first_of_cell], owner[triangle[first_of_cell]], uv
