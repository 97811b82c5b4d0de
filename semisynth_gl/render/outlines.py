"""Finds the outlines of models: edges where a surface ends for an eye, at its border or where it turns away."""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.topology import MeshEdges, find_edges
from semisynth_gl.render.instance_transforms import InstanceTransforms

# Maximum number of instances times edges in a matrix product. For more, BLAS would start threads that do not pay off.
_MOST_AT_ONCE = 2**16


class OutlineFinder:
    """Finds the outlines in scenes of these models. ``vertex_number`` is that of `SceneBuffers`."""

    def __init__(self, models: Sequence[Mesh], vertex_number: NDArray[np.uint32]) -> None:
        self._models = models
        ends = np.cumsum([len(mesh.positions) for mesh in models])
        self._vertex_number = np.split(vertex_number, ends[:-1])
        # Edges are found when a model is first used, since libraries may have many models that no scene uses.
        self._edges: dict[int, MeshEdges] = {}
        # `MeshEdges.corners`, `below` and `border` of all these models, and the number of each model's first edge.
        self._corners = np.zeros((2, 0, 3), np.uint32)
        self._below, self._border = np.zeros((2, 0), bool), np.zeros(0, bool)
        self._first: dict[int, int] = {}

    def find(self, transforms: InstanceTransforms, eye: Eye, seen: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Find the outlines of instances that one eye may see, far instances first; ``seen`` (M,) are their numbers.

        Returns:
            (N, 4) uint32: the instance, and three vertices of the visible triangle beside the edge: the edge's start,
            its end, and the opposite corner. Vertices have the numbers of `SceneBuffers.vertices`.
        """
        scene, rows = transforms.scene, transforms.rows(eye)
        # Near outlines must cover far ones. The order is that of drawing: by the far ends of the instances.
        seen = seen[np.argsort(-(rows[seen, 2, 3] + transforms.radius_m[seen]), kind="stable")]
        eyes, model = _eyes(rows[seen]), scene.model[seen]
        self._add_edges(model)
        found = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, bool))]
        for number in np.unique(model).tolist():
            edges, of_model = self._edges[number], np.flatnonzero(model == number)
            for group in np.array_split(of_model, ceil(len(of_model) * len(edges.border) / _MOST_AT_ONCE)):
                member, edge, below = _silhouettes(edges, eyes[group])
                found.append((group[member], edge + self._first[number], below))
        index, edge, below = (np.concatenate(parts) for parts in zip(*found, strict=True))
        # Of the two triangles at an edge, the one in front is that whose plane lies between the eye and the other one.
        eye_below = below ^ (eyes[index, 3] < 0)
        first = self._border[edge] | (eye_below != self._below[0, edge])
        second = ~first & (eye_below != self._below[1, edge])
        # Of a solid, the eye sees only front faces. It sees the front of a first triangle from above that triangle's
        # plane, and that of a second one from below, since `MeshEdges` stores second triangles reversed.
        solid = transforms.solid[seen][index]
        first &= ~(solid & eye_below)
        second &= ~solid | eye_below
        chosen = np.flatnonzero(first | second)
        index, edge, side = index[chosen], edge[chosen], second[chosen]
        # NumPy sorts numbers of up to 16 bits fastest.
        order = np.argsort((2 * index + side).astype(np.min_scalar_type(2 * len(seen))), kind="stable")
        index, edge, side = index[order], edge[order], side[order]
        strips = np.empty((len(order), 4), np.uint32)
        strips[:, 0] = seen[index]
        strips[:, 1:] = self._corners[side.astype(int), edge]
        return strips

    def _add_edges(self, models: NDArray[np.int64]) -> None:
        """Find the edges of models that are used for the first time."""
        missing = set(models.tolist()) - self._edges.keys()
        for model in missing:
            edges = find_edges(self._models[model])
            self._edges[model] = replace(edges, corners=self._vertex_number[model][edges.corners])
        if missing:
            every = self._edges.values()
            self._corners = np.concatenate([edges.corners for edges in every], axis=1)
            self._below = np.concatenate([edges.below for edges in every], axis=1)
            self._border = np.concatenate([edges.border for edges in every])
            ends = np.cumsum([len(edges.border) for edges in every]).tolist()
            self._first = dict(zip(self._edges, [0, *ends], strict=False))


def _eyes(rows: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the eye's position in the units of M models, given rows (M, 3, 4) of view_from_model: (M, 4) float32.

    Positions are homogeneous, (w x, w y, w z, w), where w is the determinant of the first three columns or a positive
    multiple of it. So the singular matrices of flat models need no special case.
    """
    x, y, z, shift = (np.ascontiguousarray(column) for column in rows.transpose(2, 1, 0))
    adjugate = [_cross(y, z), _cross(z, x), _cross(x, y)]
    eyes = np.stack([-(normal * shift).sum(axis=0) for normal in adjugate] + [(x * adjugate[0]).sum(axis=0)], axis=1)
    largest = np.abs(eyes).max(axis=1, keepdims=True, initial=np.finfo(np.float64).tiny)
    return np.asarray((eyes / largest).astype(np.float32))


def _cross(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    (a, b, c), (p, q, r) = first, second
    return np.stack([b * r - c * q, c * p - a * r, a * q - b * p])


def _silhouettes(
    edges: MeshEdges, eyes: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Find the edges, of M instances of a mesh, where the surface ends or turns away from an eye; ``eyes`` is (M, 4).

    `MeshEdges` stores the second triangle reversed. So at such an edge, the eye is above both planes, or below both.

    Returns:
        The numbers of instances and of edges, (N,) int64 each, and ``below``, (N,) bool: whether the eye is below both
        planes, n . x < n . p. If the eye's w is negative, ``below`` says whether it is above them.
    """
    # w (n . p - n . x) for the eye at (w x, w).
    below = (eyes * np.array([-1, -1, -1, 1], np.float32)) @ edges.plane > 0
    chosen = np.flatnonzero(below[0] == below[1])
    member, edge = np.divmod(chosen, len(edges.border))
    return member, edge, below[0].ravel()[chosen]
