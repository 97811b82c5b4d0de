"""Finds what the left view shows at the points of a coarse grid.

All triangles are projected at once. The ray caster finds the same hits instance by instance, which takes longer.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.relief import covered_cells
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.instances import Instances, to_scene
from semisynth_gl.scene.scene import Scene, transform_vertices

# Columns and rows of the coarse grid over the view; see `grid_px`.
GRID = (48, 32)
# Share of a surface's rays that are ignored at each end of its range of UV. Otherwise the few rays near the horizon
# would decide the range of a ground.
_IGNORED = 0.05


class LeftViewHits(NamedTuple):
    """The first surfaces that R rays of the left view hit."""

    depth_m: Floats  # (R,) planar depth; inf where a ray hits the sky or nothing
    instance: Ints  # (R,) index of the instance that a ray hits; -1 where it hits nothing
    uv: Floats  # (R, 2) the model's UV where the ray hits it; 0 where a ray hits nothing


def grid_px(camera: StereoCamera) -> tuple[Floats, Floats]:
    """Return the columns and the rows, (R,) px each, of the points of a coarse `GRID` over the view, row by row."""
    sizes = zip(GRID, (camera.width_px, camera.height_px), strict=True)
    columns, rows = np.meshgrid(*((np.arange(count) + 0.5) / count * size - 0.5 for count, size in sizes))
    return columns.ravel(), rows.ravel()


def measure_left_view(
    table: Instances, camera: StereoCamera, near_m: float, models: Sequence[Mesh], fixed: int = 0
) -> Floats:
    """Set each static instance's range of UV that the left view shows, and its median depth there.

    Hidden instances, the sky and the first ``fixed`` instances keep their ``depth_m``. Returns the disparities (R,) of
    the view at the points of `grid_px`.
    """
    seen = left_view_hits(to_scene(table, camera, near_m), models)
    for number in np.unique(seen.instance[seen.instance >= 0]).tolist():
        rays = seen.instance == number
        if number >= fixed and not table["sky"][number]:
            table["depth_m"][number] = np.median(seen.depth_m[rays])
        uv = np.sort(seen.uv[rays], axis=0)
        ignored = int(_IGNORED * len(uv))
        table["uv_low"][number], table["uv_high"][number] = uv[ignored], uv[-1 - ignored]
    return camera.disparity_px(seen.depth_m)


def left_view_hits(scene: Scene, models: Sequence[Mesh]) -> LeftViewHits:
    """Return the first hits of the left view's rays through the points of `grid_px`.

    ``scene.model`` holds indices into ``models``.
    """
    # Points (V, 5), x y z u v; the numbers of each triangle's corners; and each triangle's instance.
    parts, triangles, owners, count = [np.empty((0, 5))], [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)], 0
    for number in range(len(scene)):
        mesh = models[int(scene.model[number])]
        vertices = transform_vertices(mesh, scene.view_from_model(number))
        if vertices[:, 2].max() < scene.near_m:
            continue
        vertices, shown = np.concatenate([vertices, mesh.uv], axis=1), mesh.triangles
        if vertices[:, 2].min() < scene.near_m:
            vertices = _clip(vertices[mesh.triangles], scene.near_m).reshape(-1, 5)
            shown = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
        parts.append(vertices)
        triangles.append(shown + np.int64(count))
        owners.append(np.full(len(shown), number))
        count += len(vertices)
    points, owner = np.concatenate(parts), np.concatenate(owners)
    corners = np.ascontiguousarray(np.concatenate(triangles).T)
    camera, inverse = scene.camera, 1 / points[:, 2]
    cx, cy, fx, fy = camera.intrinsics_px("left")
    sides = (0, camera.width_px, fx, cx), (1, camera.height_px, fy, cy)
    x, y = (
        (points[:, axis] * inverse * focal_px + (middle_px + 0.5)) * (GRID[axis] / size_px) - 0.5
        for axis, size_px, focal_px, middle_px in sides
    )
    triangle, cell, u, v = covered_cells(x, y, corners, *GRID)
    # 1 / Z is linear over the image.
    one, two, three = inverse[corners[:, triangle]]
    depth_m = 1 / (one + u * (two - one) + v * (three - one))
    shown_m = np.where(scene.sky[owner[triangle]], np.inf, depth_m)
    order = np.lexsort((shown_m, cell))
    hit, first_of_cell = np.unique(cell[order], return_index=True)
    first = order[first_of_cell]
    # UV / Z is linear over the image, too.
    weight = np.stack([(1 - u - v) * one, u * two, v * three], axis=1)[first] * depth_m[first, None]
    rays = GRID[0] * GRID[1]
    seen = LeftViewHits(np.full(rays, np.inf), np.full(rays, -1), np.zeros((rays, 2)))
    seen.depth_m[hit], seen.instance[hit] = shown_m[first], owner[triangle[first]]
    seen.uv[hit] = (weight[..., None] * points[corners[:, triangle[first]].T, 3:]).sum(axis=1)
    return seen


def _clip(corners: Floats, near_m: float) -> Floats:
    """Return the parts of triangles (T, 3, 5), x y z u v, beyond the near plane, as triangles (U, 3, 5)."""
    beyond = corners[..., 2] >= near_m
    count = np.count_nonzero(beyond, axis=1)
    crossing = np.flatnonzero((count == 1) | (count == 2))
    one, beyond = count[crossing] == 1, beyond[crossing]
    # Rotate the corners so that the one alone on its side of the plane comes first.
    odd = np.where(one, beyond.argmax(axis=1), beyond.argmin(axis=1))
    first, second, third = (corners[crossing, (odd + k) % 3] for k in range(3))

    def on_plane(other: Floats) -> Floats:
        return np.asarray(first + (near_m - first[:, 2:3]) / (other[:, 2:3] - first[:, 2:3]) * (other - first))

    to_second, to_third = on_plane(second), on_plane(third)
    return np.concatenate(
        [
            corners[count == 3],
            np.stack([first, to_second, to_third], axis=1)[one],
            np.stack([to_second, second, third], axis=1)[~one],
            np.stack([to_second, third, to_third], axis=1)[~one],
        ]
    )
