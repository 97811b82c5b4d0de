"""A float64 ray caster in plain numpy, for the oracle, `verify` and `bench`.

The caster shares the classes of scenes, cameras and meshes with `semisynth_gl.render`, but no rendering code. It
transforms the renderer's float32 vertices in float64. It is simple on purpose: without a hierarchy of bounding boxes,
it compares each triangle with the rays in the triangle's rows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye, StereoCamera
from semisynth_gl.geometry.mesh import Mesh, cross
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.scene import Scene, transform_vertices

# Approximate number of pairs of a ray and a bounding box that are compared at a time, to bound memory.
_COMPARISONS = 1_000_000
# Margin of the bounding boxes, so that rounding of the projection never loses a ray on an edge.
_BOX_MARGIN_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class RayHits:
    """The first surfaces that R rays hit."""

    depth_m: Floats  # (R,) planar depth in the eye's view; inf where a ray hits the sky or nothing
    instance: Ints  # (R,) index of the instance that a ray hits; -1 where it hits nothing
    triangle: Ints  # (R,) index into the triangles of the instance's model; -1 where a ray hits nothing


def cast_rays(scene: Scene, models: Sequence[Mesh], eye: Eye, x_px: Floats, y_px: Floats) -> RayHits:
    """Cast rays from one eye through R pixel positions; whole numbers are the centres of pixels.

    Among surfaces at the same depth, a ray hits the first instance and triangle. Rays pass through surfaces nearer than
    ``scene.near_of(eye)``, which the renderer clips. The sky is behind everything else. Where instances of the sky
    overlap, a ray hits the first of them.

    ``scene.model`` indexes ``models``. ``x_px`` and ``y_px`` have the R columns and rows, in any shape.
    """
    camera = scene.camera
    x, y = np.asarray(x_px, np.float64).ravel(), np.asarray(y_px, np.float64).ravel()
    rays = camera.rays_of_eye(eye, x, y)
    hits = RayHits(np.full(len(x), np.inf), np.full(len(x), -1), np.full(len(x), -1))
    by_row = np.argsort(y)
    sorted_x, sorted_y = x[by_row], y[by_row]
    for number in range(len(scene)):
        vertices, triangles = vertices_in_view(scene, models, eye, number), models[int(scene.model[number])].triangles
        sky = bool(scene.sky[number])
        # The near plane never cuts the sky.
        near_m = np.finfo(np.float64).tiny if sky else scene.near_of(eye)
        boxes = _boxes(camera, eye, vertices, triangles, near_m)
        for position, triangle in _inside(boxes, sorted_x, sorted_y):
            ray = by_row[position]
            depth_m = _depths(rays[ray], vertices[triangles[triangle]], near_m)
            order = np.flatnonzero(np.isfinite(depth_m))
            # Keep the first hit of each ray, by depth, then by triangle.
            order = order[np.lexsort((triangle[order], depth_m[order], ray[order]))]
            order = order[np.unique(ray[order], return_index=True)[1]]
            if sky:
                nearer = order[hits.instance[ray[order]] < 0]
            else:
                nearer = order[depth_m[order] < hits.depth_m[ray[order]]]
                hits.depth_m[ray[nearer]] = depth_m[nearer]
            hits.instance[ray[nearer]] = number
            hits.triangle[ray[nearer]] = triangle[nearer]
    return hits


def vertices_in_view(scene: Scene, models: Sequence[Mesh], eye: Eye, number: int) -> Floats:
    """Return the vertices (V, 3) of one instance, metres in the eye's frame."""
    turn = scene.camera.turn(eye)
    vertices = transform_vertices(models[int(scene.model[number])], scene.view_from_model(number))
    vertices[:, 0] -= scene.offset_m(eye, number)
    return vertices if turn is None else vertices @ turn.T


def _boxes(camera: StereoCamera, eye: Eye, vertices: Floats, triangles: NDArray[np.integer], near_m: float) -> Floats:
    """Return the bounding boxes (4, T), x0 x1 y0 y1, of triangles in the image.

    A triangle that crosses the near plane has an infinite box. A triangle nearer than the plane has an empty box.
    """
    depth = vertices[:, 2]
    safe = np.where(depth > 0, depth, 1.0)
    boxes = np.empty((4, len(triangles)))
    corners = triangles.T
    cx, cy, fx, fy = camera.intrinsics_px(eye)
    for axis, (focal, centre) in enumerate(((fx, cx), (fy, cy))):
        # A corner close to the camera's own plane may be projected to infinity.
        with np.errstate(over="ignore"):
            one, two, three = (focal * vertices[:, axis] / safe + centre)[corners]
        boxes[2 * axis] = np.minimum(np.minimum(one, two), three) - _BOX_MARGIN_PX
        boxes[2 * axis + 1] = np.maximum(np.maximum(one, two), three) + _BOX_MARGIN_PX
    one, two, three = (depth < near_m)[corners]
    boxes[:, one | two | three] = np.array([[-np.inf], [np.inf], [-np.inf], [np.inf]])
    boxes[:, one & two & three] = np.array([[np.inf], [-np.inf], [np.inf], [-np.inf]])
    return boxes


def _inside(boxes: Floats, x: Floats, y: Floats) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Yield all pairs of a position and a box (4, T) that contains it, as two arrays of indices.

    Each yield has the pairs of a range of boxes; ranges ascend. Positions must be sorted by y.
    """
    x0, x1, y0, y1 = boxes
    begin, end = np.searchsorted(y, y0.min()), np.searchsorted(y, y1.max(), side="right")
    near = begin + np.flatnonzero((x[begin:end] >= x0.min()) & (x[begin:end] <= x1.max()))
    if not len(near):
        return
    x, y = x[near], y[near]
    # The positions in a box's rows are contiguous, so all pairs with one box are contiguous, too.
    first = np.searchsorted(y, y0)
    count = np.maximum(np.searchsorted(y, y1, side="right") - first, 0)
    last = np.cumsum(count)
    start = last - count
    begins = np.unique(np.searchsorted(last, np.arange(0, last[-1], _COMPARISONS), side="right"))
    for part in np.split(np.arange(len(count)), begins)[1:]:
        box = np.repeat(part, count[part])
        position = np.arange(start[part[0]], start[part[0]] + len(box)) + (first - start)[box]
        within = (x[position] >= x0[box]) & (x[position] <= x1[box])
        yield near[position[within]], box[within]


def _depths(direction: Floats, corners: Floats, near_m: float) -> Floats:
    """Return the depths (N,) at which N rays hit N triangles (Moller and Trumbore 1997); inf where a ray misses.

    Directions (N, 3) have z = 1, so the ray's parameter is the planar depth.
    """
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = cross(direction, edge_2)
    determinant = _dot(edge_1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / determinant
        from_corner = -corners[:, 0]
        u = _dot(from_corner, p) * inverse
        q = cross(from_corner, edge_1)
        v = _dot(direction, q) * inverse
        depth = _dot(edge_2, q) * inverse
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth >= near_m)
    return np.where(hit, depth, np.inf)


def _dot(left: Floats, right: Floats) -> Floats:
    """Return the dot products (N,) of vectors (N, 3); numpy's sums over such short rows would be slower."""
    return left[:, 0] * right[:, 0] + left[:, 1] * right[:, 1] + left[:, 2] * right[:, 2]
