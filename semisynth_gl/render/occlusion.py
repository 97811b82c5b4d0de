"""Finds hidden triangles, so that a software driver need not draw them in scenes of many triangles.

First, near instances that cover much of the image with few triangles are drawn, only into the depth buffer. Instances,
and runs of their triangles, whose bounding boxes certainly lie behind this depth are not visible in any pixel: the
images are the same without them, bit for bit. Everything else is drawn in the usual order.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Crop, Eye
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.model_buffers import InstanceRange
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.targets import EyeTargets, window

# Minimum number of triangles in view: with fewer triangles, the search for hidden triangles does not pay.
_FEWEST_TRIANGLES = 150_000
# Maximum share of the triangles in view that is drawn first to hide others.
_HIDING = 0.05
# Number of triangles in a run, and side of a tile.
_RUN_TRIANGLES = 128
TILE_PX = 16
# Margins for rounding: of positions in the image, and of depth, as a share.
_BORDER_PX = 1
_ROUNDING = 1e-3
# Polygon offset of the instances that are drawn first: they move away by 1 / 1024 to 1 / 2048 of a triangle's largest
# depth.
_BEHIND_ULP = -8192.0
# Maximum factor by which strips along outlines are nearer than their surface; see edges.geom.
_STRIPS_NEARER = 1.032
_WHICH_END = np.indices((2, 2, 2)).reshape(3, 8).T


@dataclass(frozen=True, slots=True)
class _TriangleRuns:
    """The triangles of all M models in R runs of about 128, model by model."""

    corners: NDArray[np.float64]  # (R, 8, 3) corners of the runs' bounding boxes, in model units
    first_triangle: NDArray[np.int64]  # (R,) first triangle of each run, as its number in the model
    triangles: NDArray[np.int64]  # (R,) number of triangles of each run
    first: NDArray[np.int64]  # (M,) the first run of each model
    count: NDArray[np.int64]  # (M,) number of runs of each model


class OcclusionCuller:
    """Finds hidden instances and triangles."""

    def __init__(self, resources: RenderResources) -> None:
        context, models = resources.context, resources.models.meshes
        self._gl, self._functions, self._models = context.gl, context.functions, resources.models
        self._triangles = np.array([len(mesh.triangles) for mesh in models])
        self._corners = np.stack([_corners(mesh.positions.min(axis=0), mesh.positions.max(axis=0)) for mesh in models])
        self._program = link_program(context, "mesh.vert", "mesh.frag", {})

    @cached_property
    def _runs(self) -> _TriangleRuns:
        corners, first_triangle, triangles = [], [], []
        for mesh in self._models.meshes:
            begin = np.arange(0, max(1, len(mesh.triangles) - _RUN_TRIANGLES // 2), _RUN_TRIANGLES)
            positions = mesh.positions[mesh.triangles]
            low, high = (
                end.reduceat(reached, begin, axis=0)
                for end, reached in ((np.minimum, positions.min(axis=1)), (np.maximum, positions.max(axis=1)))
            )
            corners.append(_corners(low, high))
            first_triangle.append(begin)
            triangles.append(np.diff(begin, append=len(mesh.triangles)))
        count = np.array([len(begin) for begin in first_triangle])
        parts = np.concatenate(corners), np.concatenate(first_triangle), np.concatenate(triangles)
        return _TriangleRuns(*parts, np.cumsum(count) - count, count)

    def without_hidden(
        self,
        transforms: InstanceTransforms,
        eye: Eye,
        part: Crop | None,
        targets: EyeTargets,
        filled: Sequence[InstanceRange],
    ) -> Sequence[InstanceRange]:
        """Return runs to draw instead of ``filled``, the result of `SceneBuffers.fill`, without what is hidden.

        The constants of the eye's drawing pass must be bound. With few triangles, ``filled`` itself is returned; else
        the depth of the eye's targets is overwritten.
        """
        shown = self._models.filled
        model = transforms.scene.model[shown]
        triangles = self._triangles[model]
        if triangles.sum() < _FEWEST_TRIANGLES:
            return filled
        rows = transforms.rows(eye)[shown]
        boxes = _boxes(transforms, eye, part, rows, self._corners[model])
        sky = transforms.scene.sky[shown]
        size = window(part, targets.framebuffer.size)[2:]
        hiding = _most_area(boxes, size, triangles) & ~sky
        every = np.arange(len(shown))
        self._draw_depth(targets, part, self._models.select(filled, every[hiding]))
        farthest = _farthest(targets.read_depth(part))
        visible = np.flatnonzero(~_hidden(farthest, size, boxes) | sky)
        runs, own = self._runs, model[visible]
        count = runs.count[own]
        number = visible.repeat(count)
        run = np.arange(count.sum()) + (runs.first[own] - (np.cumsum(count) - count)).repeat(count)
        boxes = _boxes(transforms, eye, part, rows[number], runs.corners[run])
        seen = ~_hidden(farthest, size, boxes) | sky[number]
        number, run = number[seen], run[seen]
        # Merge successive runs into one.
        begin = np.flatnonzero(np.diff(number, prepend=-1).astype(bool) | (np.diff(run, prepend=-1) != 1))
        drawn = np.add.reduceat(runs.triangles[run], begin) if len(begin) else runs.triangles[:0]
        return self._models.select(filled, number[begin], runs.first_triangle[run[begin]], drawn)

    def farthest(
        self, transforms: InstanceTransforms, eye: Eye, part: Crop | None, targets: EyeTargets, seen: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Drop instances whose outlines lie behind everything that was drawn to the targets.

        Args:
            transforms: the scene's instances.
            eye: the eye.
            part: the part of the image that is antialiased; None for all of it.
            targets: the drawn targets.
            seen: (N,) numbers of instances.

        Returns:
            The remaining numbers of ``seen``, and the result of `_farthest` for the drawn depth.
        """
        farthest = _farthest(targets.read_depth(part))
        corners = self._corners[transforms.scene.model[seen]]
        boxes = _boxes(transforms, eye, part, transforms.rows(eye)[seen], corners)
        boxes[4] *= _STRIPS_NEARER
        return seen[~_hidden(farthest, window(part, targets.framebuffer.size)[2:], boxes)], farthest

    def _draw_depth(self, targets: EyeTargets, part: Crop | None, filled: Sequence[InstanceRange]) -> None:
        targets.use_depth(part)
        self._functions.clear_depth(0.0)
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.depth_func = ">"
        # Everything that is drawn later must pass the depth test, even these surfaces and surfaces at the same depth.
        self._gl.polygon_offset = 0.0, _BEHIND_ULP
        for own in filled:
            self._models.draw(self._program, own)
        self._gl.polygon_offset = 0.0, 0.0


def _corners(low: NDArray[np.float32], high: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the corners of boxes, (..., 8, 3), from their lowest and highest coordinates, (..., 3)."""
    ends = np.stack([low, high], axis=-2).astype(np.float64)
    return ends[..., _WHICH_END, np.arange(3)]


def _boxes(
    transforms: InstanceTransforms, eye: Eye, part: Crop | None, rows: NDArray[np.float64], corners: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return bounds of N boxes in an eye's image.

    Args:
        transforms: the scene's instances.
        eye: the eye.
        part: the part of the image that is drawn; None for all of it.
        rows: (N, 3, 4) rows of view_from_model.
        corners: (N, 8, 3) corners of the boxes, in model units.

    Returns:
        (5, N): left, top, right and bottom, px of the part, and the largest depth (near / Z). The depth is infinite if
        the near plane cuts a box.
    """
    scene = transforms.scene
    camera = scene.camera if part is None else scene.camera.cropped(part)
    x, y, z = (np.matmul(corners, rows[:, :, :3].transpose(0, 2, 1)) + rows[:, None, :, 3]).transpose(2, 0, 1)
    nearest = z.min(axis=1)
    (cx, cy, fx, fy), near_m = camera.intrinsics_px(eye), scene.near_of(eye)
    before_eye = np.maximum(z, near_m)
    column = fx * x / before_eye + cx
    row = fy * y / before_eye + cy
    depth = np.where(nearest > near_m, near_m / np.maximum(nearest, near_m), np.inf)
    return np.stack([column.min(axis=1), row.min(axis=1), column.max(axis=1), row.max(axis=1), depth])


def _most_area(boxes: NDArray[np.float64], size: tuple[int, int], triangles: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Choose near instances whose boxes cover much of the image, with a limited share of the triangles."""
    (left, right), (top, bottom) = (boxes[[0, 2]].clip(0, size[0]), boxes[[1, 3]].clip(0, size[1]))
    # An instance that the near plane cuts may surround all others, as walls do, so it hides nothing.
    depth = np.where(np.isfinite(boxes[4]), boxes[4], 0.0)
    order = np.argsort(-depth * (right - left) * (bottom - top) / triangles, kind="stable")
    chosen = np.zeros(len(triangles), bool)
    chosen[order] = np.cumsum(triangles[order]) <= _HIDING * triangles.sum()
    return chosen & (depth > 0)


def _farthest(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the smallest depth (near / Z) of each block of 2 ** a x 2 ** b tiles, indexed by [a, b] and first tile."""
    height, width = depth.shape
    # Reduce rows first, which the processor does for eight pixels at a time.
    strips = np.stack([depth[row : row + TILE_PX].min(axis=0) for row in range(0, height, TILE_PX)])
    tiles = np.minimum.reduceat(strips, np.arange(0, width, TILE_PX), axis=1)
    rows, columns = tiles.shape
    farthest = np.zeros((rows.bit_length(), columns.bit_length(), rows, columns), np.float32)
    farthest[0, 0] = tiles
    for a in range(1, len(farthest)):
        half = 1 << a - 1
        farthest[a, 0, :-half] = np.minimum(farthest[a - 1, 0, :-half], farthest[a - 1, 0, half:])
    for b in range(1, farthest.shape[1]):
        half = 1 << b - 1
        farthest[:, b, :, :-half] = np.minimum(farthest[:, b - 1, :, :-half], farthest[:, b - 1, :, half:])
    return farthest


def _hidden(farthest: NDArray[np.float32], size: tuple[int, int], boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which boxes lie behind everything in the tiles that they overlap, or outside the image: (N,) bool.

    ``farthest`` comes from `_farthest`, and ``boxes`` (5, N) from `_boxes`; ``size`` is the part's width and height.
    """
    left, top = np.floor(boxes[:2]) - _BORDER_PX
    right, bottom = np.ceil(boxes[2:4]) + _BORDER_PX
    hidden: NDArray[np.bool_] = np.isfinite(boxes[4])
    behind = boxes[4] * (1 + _ROUNDING)
    ends, level = [], []
    for low, high, length in ((top, bottom, size[1]), (left, right, size[0])):
        begin, last = ((edge.clip(0, length - 1) // TILE_PX).astype(np.int64) for edge in (low, high))
        # Two spans of the same power of two cover all tiles from the first to the last.
        doubled = np.frexp(last - begin + 1)[1] - 1
        level.append(doubled)
        ends.append((begin, last + 1 - (1 << doubled)))
    for row in ends[0]:
        for column in ends[1]:
            hidden &= behind < farthest[level[0], level[1], row, column]
    beside = (right < 0) | (bottom < 0) | (left >= size[0]) | (top >= size[1])
    hidden |= beside & np.isfinite(boxes[4])
    return hidden
