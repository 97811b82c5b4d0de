"""Occlusion culling: in scenes of many triangles, finds hidden ones that a software driver need not draw.

Occluders, near instances that cover much of the image with few triangles, are first drawn into the depth buffer only.
Instances and clusters of triangles whose bounding boxes lie behind this depth are left out. The images are the same
without culling, bit for bit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.model_buffers import DrawRange
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.targets import EyeView

# Culling pays off only in views of at least this many triangles.
_FEWEST_TRIANGLES = 150_000
# Occluders have at most this share of a view's triangles.
_OCCLUDERS_SHARE = 0.05
_CLUSTER_TRIANGLES = 128
TILE_PX = 16
"""Side of the tiles of the image for which the smallest depth is known."""
# Margins for rounding: of a box's borders, px, and of its depth, relative.
_BORDER_PX = 1
_ROUNDING = 1e-3
# Polygon offset of occluders, in units of 2^-23 of the largest power of two that a triangle's depth reaches. It lowers
# their depth, near / Z, by 1/2048 to 1/1024, so everything at an occluder's true depth later passes the depth test.
_OCCLUDER_OFFSET = -8192.0
# Strips along outlines have at most this many times the depth, near / Z, of their surface: in edges.geom,
# (1 + ROUNDING + STEEPEST) (1 + MARGIN).
_STRIP_NEARER = 1.032


@dataclass(frozen=True, slots=True)
class _TriangleClusters:
    """The triangles of all M models in K clusters of about 128 successive triangles, model by model."""

    corners: NDArray[np.float64]  # (K, 8, 3) corners of the clusters' bounding boxes, in model units
    first_triangle: NDArray[np.int64]  # (K,) first triangle of each cluster, as its number in the model
    triangles: NDArray[np.int64]  # (K,) number of triangles of each cluster
    first: NDArray[np.int64]  # (M,) the first cluster of each model
    count: NDArray[np.int64]  # (M,) number of clusters of each model


class OcclusionCuller:
    """Finds instances and triangles that are hidden behind occluders."""

    def __init__(self, resources: RenderResources) -> None:
        context, models = resources.context, resources.models.meshes
        self._gl, self._functions, self._models = context.gl, context.functions, resources.models
        self._triangles = np.array([len(mesh.triangles) for mesh in models])
        low = np.stack([mesh.positions.min(axis=0) for mesh in models])
        high = np.stack([mesh.positions.max(axis=0) for mesh in models])
        self._corners = _corners(low, high)
        self._program = link_program(context, "mesh.vert", "mesh.frag", {})

    @cached_property
    def _clusters(self) -> _TriangleClusters:
        corners, first_triangle, triangles = [], [], []
        for mesh in self._models.meshes:
            begin = np.arange(0, max(1, len(mesh.triangles) - _CLUSTER_TRIANGLES // 2), _CLUSTER_TRIANGLES)
            positions = mesh.positions[mesh.triangles]
            low = np.minimum.reduceat(positions.min(axis=1), begin, axis=0)
            high = np.maximum.reduceat(positions.max(axis=1), begin, axis=0)
            corners.append(_corners(low, high))
            first_triangle.append(begin)
            triangles.append(np.diff(begin, append=len(mesh.triangles)))
        count = np.array([len(begin) for begin in first_triangle])
        parts = np.concatenate(corners), np.concatenate(first_triangle), np.concatenate(triangles)
        return _TriangleClusters(*parts, np.cumsum(count) - count, count)

    def pays_off(self, transforms: InstanceTransforms) -> bool:
        """Return whether the uploaded instances have enough triangles for `cull` to save time."""
        models = transforms.scene.model[self._models.uploaded]
        return bool(self._triangles[models].sum() >= _FEWEST_TRIANGLES)

    def cull(self, view: EyeView, ranges: Sequence[DrawRange]) -> Sequence[DrawRange]:
        """Draw the depth of occluders into a view's targets, and replace the draw commands by those of what is visible.

        The constants of the view's drawing pass must be written. ``ranges`` is the result of `SceneBuffers.upload`.

        Returns:
            The ranges of the new commands. Draw them without clearing the depth.
        """
        scene, uploaded = view.transforms.scene, self._models.uploaded
        model, sky, rows = scene.model[uploaded], scene.sky[uploaded], view.transforms.rows(view.eye)[uploaded]
        boxes = _boxes(view, rows, self._corners[model])
        occluders = _choose_occluders(boxes, view.size, self._triangles[model]) & ~sky
        self._draw_depth(view, self._models.select(ranges, np.flatnonzero(occluders)))
        depth_table = _make_depth_table(view.targets.read_depth(view.part))
        visible = np.flatnonzero(~_are_hidden(depth_table, view.size, boxes) | sky)
        # One entry for each cluster of each visible instance.
        clusters, own_model = self._clusters, model[visible]
        count = clusters.count[own_model]
        number = visible.repeat(count)
        cluster = np.arange(count.sum()) + (clusters.first[own_model] - (np.cumsum(count) - count)).repeat(count)
        boxes = _boxes(view, rows[number], clusters.corners[cluster])
        seen = ~_are_hidden(depth_table, view.size, boxes) | sky[number]
        number, cluster = number[seen], cluster[seen]
        # One command draws successive clusters of an instance.
        begin = np.flatnonzero(np.diff(number, prepend=-1).astype(bool) | (np.diff(cluster, prepend=-1) != 1))
        triangles = np.add.reduceat(clusters.triangles[cluster], begin) if len(begin) else clusters.triangles[:0]
        return self._models.select(ranges, number[begin], clusters.first_triangle[cluster[begin]], triangles)

    def cull_outlines(
        self, view: EyeView, instances: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Drop instances, (N,) numbers, whose outlines lie behind everything that was drawn to a view's targets.

        Returns:
            The numbers that remain, and the result of `_make_depth_table` for the drawn depth.
        """
        depth_table = _make_depth_table(view.targets.read_depth(view.part))
        rows = view.transforms.rows(view.eye)[instances]
        boxes = _boxes(view, rows, self._corners[view.transforms.scene.model[instances]])
        boxes[4] *= _STRIP_NEARER
        return instances[~_are_hidden(depth_table, view.size, boxes)], depth_table

    def _draw_depth(self, view: EyeView, ranges: Sequence[DrawRange]) -> None:
        view.targets.use_depth(view.part)
        self._functions.clear_depth(0.0)
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.depth_func = ">"
        self._gl.polygon_offset = 0.0, _OCCLUDER_OFFSET
        for occluders in ranges:
            self._models.draw(self._program, occluders)
        self._gl.polygon_offset = 0.0, 0.0


def _corners(low: NDArray[np.float32], high: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the corners of N boxes, (N, 8, 3), from their lowest and highest coordinates, (N, 3) each."""
    ends = np.stack([low, high], axis=1).astype(np.float64)
    which_end = np.indices((2, 2, 2)).reshape(3, 8).T
    return ends[:, which_end, np.arange(3)]


def _boxes(view: EyeView, rows: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the bounds in a view of N boxes with ``corners`` (N, 8, 3) in model units.

    ``rows`` are the boxes' view_from_model, (N, 3, 4).

    Returns:
        (5, N): left, top, right and bottom, px of the part, and the largest depth (near / Z). The depth is infinite if
        the near plane cuts a box.
    """
    scene, eye = view.transforms.scene, view.eye
    camera = scene.camera if view.part is None else scene.camera.cropped(view.part)
    x, y, z = (np.matmul(corners, rows[:, :, :3].transpose(0, 2, 1)) + rows[:, None, :, 3]).transpose(2, 0, 1)
    nearest = z.min(axis=1)
    (cx, cy, fx, fy), near_m = camera.intrinsics_px(eye), scene.near_of(eye)
    before_eye = np.maximum(z, near_m)
    column = fx * x / before_eye + cx
    row = fy * y / before_eye + cy
    depth = np.where(nearest > near_m, near_m / np.maximum(nearest, near_m), np.inf)
    return np.stack([column.min(axis=1), row.min(axis=1), column.max(axis=1), row.max(axis=1), depth])


def _choose_occluders(
    boxes: NDArray[np.float64], size: tuple[int, int], triangles: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Choose near instances whose boxes cover much of the image, with a limited share of the triangles.

    ``boxes`` (5, N) come from `_boxes`, ``size`` is that of the view, and ``triangles`` (N,) are counts.
    """
    left, right = boxes[[0, 2]].clip(0, size[0])
    top, bottom = boxes[[1, 3]].clip(0, size[1])
    # An instance that the near plane cuts may surround all others, as walls do, so it is no occluder.
    depth = np.where(np.isfinite(boxes[4]), boxes[4], 0.0)
    order = np.argsort(-depth * (right - left) * (bottom - top) / triangles, kind="stable")
    chosen = np.zeros(len(triangles), bool)
    chosen[order] = np.cumsum(triangles[order]) <= _OCCLUDERS_SHARE * triangles.sum()
    return chosen & (depth > 0)


def _make_depth_table(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the smallest depth (near / Z), that of the farthest surface, of blocks of tiles, as a sparse table.

    Entry [a, b, y, x] is for the block of 2^a rows and 2^b columns of tiles that begins at tile row y and column x.
    """
    height, width = depth.shape
    # Reduce rows of pixels first: NumPy does it with vector instructions.
    strips = np.stack([depth[row : row + TILE_PX].min(axis=0) for row in range(0, height, TILE_PX)])
    tiles = np.minimum.reduceat(strips, np.arange(0, width, TILE_PX), axis=1)
    rows, columns = tiles.shape
    table = np.zeros((rows.bit_length(), columns.bit_length(), rows, columns), np.float32)
    table[0, 0] = tiles
    for a in range(1, len(table)):
        half = 1 << a - 1
        table[a, 0, :-half] = np.minimum(table[a - 1, 0, :-half], table[a - 1, 0, half:])
    for b in range(1, table.shape[1]):
        half = 1 << b - 1
        table[:, b, :, :-half] = np.minimum(table[:, b - 1, :, :-half], table[:, b - 1, :, half:])
    return table


def _are_hidden(
    depth_table: NDArray[np.float32], size: tuple[int, int], boxes: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which boxes lie outside the image, or behind everything in the tiles that they overlap: (N,) bool.

    ``depth_table`` comes from `_make_depth_table`, ``boxes`` (5, N) from `_boxes`; ``size`` is that of the view.
    """
    left, top = np.floor(boxes[:2]) - _BORDER_PX
    right, bottom = np.ceil(boxes[2:4]) + _BORDER_PX
    depth = boxes[4]
    a, first_rows = _two_blocks(top, bottom, size[1])
    b, first_columns = _two_blocks(left, right, size[0])
    behind = np.ones(len(depth), bool)
    for row in first_rows:
        for column in first_columns:
            behind &= depth * (1 + _ROUNDING) < depth_table[a, b, row, column]
    outside = (right < 0) | (bottom < 0) | (left >= size[0]) | (top >= size[1])
    hidden: NDArray[np.bool_] = np.isfinite(depth) & (behind | outside)
    return hidden


def _two_blocks(
    low_px: NDArray[np.float64], high_px: NDArray[np.float64], length_px: int
) -> tuple[NDArray[np.int64], tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Cover the tiles between two pixels by two (overlapping) blocks of 2^a tiles; return a and the first tiles."""
    first, last = ((edge.clip(0, length_px - 1) // TILE_PX).astype(np.int64) for edge in (low_px, high_px))
    exponent = (np.frexp(last - first + 1)[1] - 1).astype(np.int64)
    return exponent, (first, last + 1 - (1 << exponent))
