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

# Maximum number of edges of instances that are tested at once. Up to it, BLAS uses one thread; further threads would
# spin without use.
_MOST_AT_ONCE = 2**16


class OutlineFinder:
    """Finds the outlines in scenes that are made of these models.

    ``vertex_number`` is that of `SceneBuffers`; results use its numbers.
    """

    def __init__(self, models: Sequence[Mesh], vertex_number: NDArray[np.uint32]) -> None:
        self._models = models
        ends = np.cumsum([len(mesh.positions) for mesh in models])
        self._vertex_number = np.split(vertex_number, ends[:-1])
        # Edges are found when a model is first used, since libraries may have many models that no scene uses.
        self._edges: dict[int, MeshEdges] = {}
        # These edges as arrays, one model after the other, and the number of each model's first edge.
        self._corners = np.zeros((2, 0, 3), np.uint32)
        self._below, self._border = np.zeros((2, 0), bool), np.zeros(0, bool)
        self._first: dict[int, int] = {}

    def find(self, transforms: InstanceTransforms, eye: Eye, seen: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Find the outlines of instances that one eye may see, far instances first.

        Args:
            transforms: the scene's instances.
            eye: the eye.
            seen: (M,) the instances' numbers.

        Returns:
            (N, 4) uint32: the instance, and three vertices of the visible triangle beside the edge: the edge's start,
            its end, and the opposite corner.
        """
        scene, rows = transforms.scene, transforms.rows(eye)
        # Near outlines must cover far outlines. Instances are ordered by their far ends, as in the drawing.
        seen = seen[np.argsort(-(rows[seen, 2, 3] + transforms.radius_m[seen]), kind="stable")]
        eyes, model = _eyes(rows[seen]), scene.model[seen]
        self._add_edges(model)
        places, edges, belows = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0, bool)]
        for shown in np.unique(model).tolist():
            alike, of_model = np.flatnonzero(model == shown), self._edges[shown]
            for own in np.array_split(alike, ceil(len(alike) * len(of_model.border) / _MOST_AT_ONCE)):
                place, edge, below = _alike_sides(of_model, eyes[own])
                places.append(own[place])
                edges.append(edge + self._first[shown])
                belows.append(below)
        place, edge, below = np.concatenate(places), np.concatenate(edges), np.concatenate(belows)
        eye_below, only_fronts = below ^ (eyes[place, 3] < 0), transforms.solid[seen][place]
        # A triangle is in front of the edge's other triangle if its plane separates the eye from that triangle.
        first = self._border[edge] | (eye_below != self._below[0, edge])
        second = ~first & (eye_below != self._below[1, edge])
        first &= ~(only_fronts & below)
        second &= ~only_fronts | below
        chosen = np.flatnonzero(first | second)
        place, edge, side = place[chosen], edge[chosen], second[chosen]
        order = np.argsort((2 * place + side).astype(np.min_scalar_type(2 * len(seen))), kind="stable")
        place, edge, side = place[order], edge[order], side[order]
        strips = np.empty((len(order), 4), np.uint32)
        strips[:, 0] = seen[place]
        strips[:, 1:] = self._corners.reshape(-1, 3)[edge + side * len(self._border)]
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

    Positions are homogeneous: three coordinates times w, and w. So singular matrices of flat models need no special
    case.
    """
    x, y, z, shift = (np.ascontiguousarray(column) for column in rows.transpose(2, 1, 0))
    adjugate = [_cross(y, z), _cross(z, x), _cross(x, y)]
    eyes = np.stack([-(normal * shift).sum(axis=0) for normal in adjugate] + [(x * adjugate[0]).sum(axis=0)], axis=1)
    largest = np.abs(eyes).max(axis=1, keepdims=True, initial=np.finfo(np.float64).tiny)
    return np.asarray((eyes / largest).astype(np.float32))


def _cross(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    (a, b, c), (p, q, r) = first, second
    return np.stack([b * r - c * q, c * p - a * r, a * q - b * p])


def _alike_sides(
    edges: MeshEdges, eyes: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Choose the edges, of M instances of a mesh, at which the surface ends or turns away from an eye.

    The eye is on the same side of both planes of such an edge, since `MeshEdges` turns the second plane round.
    ``eyes`` (M, 4) comes from `_eyes`.

    Returns:
        The numbers of instances and of edges, (N,) int64 each, and whether the eye is behind the planes of both
        triangles, (N,) bool; if w is negative, whether it is in front of them.
    """
    below = (eyes * np.array([-1, -1, -1, 1], np.float32)) @ edges.plane > 0
    chosen = np.flatnonzero(below[0] == below[1])
    place, edge = np.divmod(chosen, len(edges.border))
    return place, edge, below[0].ravel()[chosen]
