"""The outlines of models: edges where a surface ends for an eye, at its borders or where it turns away."""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.geometry.edges import MeshEdges, find_edges
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.render.instance_transforms import InstanceTransforms

# Largest number of edges of instances that are tested at once, to bound memory.
_MOST_AT_ONCE = 2**22


class Outlines:
    """Finds the outlines in scenes that are made of these models.

    ``vertex_number`` (V,) uint32 has the number that results use for each vertex, where all models' vertices are
    counted through.
    """

    def __init__(self, models: Sequence[Mesh], vertex_number: NDArray[np.uint32]) -> None:
        self._models = models
        ends = np.cumsum([len(mesh.positions) for mesh in models])
        self._vertex_number = np.split(vertex_number, ends[:-1])
        # Edges are found at a model's first use, since many libraries have models that no scene uses.
        self._edges: dict[int, MeshEdges] = {}

    def find(self, transforms: InstanceTransforms, eye: Eye) -> NDArray[np.uint32]:
        """Find the outlines that one eye may see, far instances first.

        Returns:
            (N, 4) uint32: the instance, and three vertices of the triangle in front of the edge: the edge's begin, its
            end, and the opposite corner.
        """
        scene, rows = transforms.scene, transforms.rows(eye)
        # The sky has no outlines: there is nothing beyond it.
        seen = np.flatnonzero(transforms.in_view(eye) & ~scene.sky)
        # Outlines in front must cover outlines behind. The order, as in the drawing, follows the far ends of instances.
        seen = seen[np.argsort(-(rows[seen, 2, 3] + transforms.radius_m[seen]), kind="stable")]
        eyes, solid, model = _eyes(rows[seen]), transforms.solid[seen], scene.model[seen]
        parts, places = [np.zeros((0, 4), np.uint32)], [np.zeros(0, np.int64)]
        for shown in np.unique(model):
            alike, edges = np.flatnonzero(model == shown), self._edges_of(int(shown))
            for own in np.array_split(alike, ceil(len(alike) * len(edges.border) / _MOST_AT_ONCE)):
                for corners, (number, edge) in zip(edges.corners, _shown(edges, eyes[own], solid[own]), strict=True):
                    place = own[number]
                    parts.append(np.column_stack([seen[place].astype(np.uint32), corners[edge]]))
                    places.append(place)
        return np.concatenate(parts)[np.argsort(np.concatenate(places), kind="stable")]

    def _edges_of(self, model: int) -> MeshEdges:
        if model not in self._edges:
            edges = find_edges(self._models[model])
            self._edges[model] = replace(edges, corners=self._vertex_number[model][edges.corners])
        return self._edges[model]


_Chosen = tuple[NDArray[np.int64], NDArray[np.int64]]


def _eyes(rows: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the eye's place in M models' units, from rows (M, 3, 4) of view_from_model: (M, 4) float32, homogeneous.

    The first three columns are the place times w, the last is w. A matrix that flattens a flat model needs no special
    case in this form.
    """
    x, y, z, shift = (np.ascontiguousarray(column) for column in rows.transpose(2, 1, 0))
    adjugate = [_cross(y, z), _cross(z, x), _cross(x, y)]
    eyes = np.stack([-(normal * shift).sum(axis=0) for normal in adjugate] + [(x * adjugate[0]).sum(axis=0)], axis=1)
    largest = np.abs(eyes).max(axis=1, keepdims=True, initial=np.finfo(np.float64).tiny)
    return np.asarray((eyes / largest).astype(np.float32))


def _cross(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    (a, b, c), (p, q, r) = first, second
    return np.stack([b * r - c * q, c * p - a * r, a * q - b * p])


def _shown(edges: MeshEdges, eyes: NDArray[np.float32], solid: NDArray[np.bool_]) -> tuple[_Chosen, _Chosen]:
    """Choose the edges of M instances of a mesh that are outlines for an eye.

    Args:
        edges: the mesh's edges.
        eyes: (M, 4) the eye's place, from `_eyes`.
        solid: (M,) whether only the fronts of an instance are drawn.

    Returns:
        The numbers of instances and of edges, (N,) int64 each, for edges whose first side is in front, and the same for
        edges whose second side is in front.
    """
    # For both adjacent faces: is the eye behind the face's plane? A negative w inverts the answer.
    homogeneous = eyes * np.array([-1, -1, -1, 1], np.float32)
    below = [homogeneous @ plane > 0 for plane in edges.plane]
    # Both triangles lie on one side of the edge.
    number, edge = np.divmod(np.flatnonzero(below[0] == below[1]), len(edges.border))
    below_first, border = below[0][number, edge], edges.border[edge]
    eye_below, only_fronts = below_first ^ (eyes[number, 3] < 0), solid[number]
    # The side in front separates the eye from the other one.
    first = border | (eye_below != edges.below[0, edge])
    second = ~first & (eye_below != edges.below[1, edge])
    first &= ~(only_fronts & below_first)
    second &= ~only_fronts | below_first
    return (number[first], edge[first]), (number[second], edge[second])
