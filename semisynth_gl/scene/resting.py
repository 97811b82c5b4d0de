"""Particles at rest: models that lie on the surface below them instead of falling."""

from collections.abc import Sequence

import numpy as np

from semisynth_gl.geometry.mesh import Mesh, least_axis
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.scene import placed_vertices
from semisynth_gl.scene.support import surfaces_below

# Cosine of the steepest slope on which a model comes to rest.
_STEEPEST = 0.5


def triangles_of(models: Sequence[Mesh], model: Ints, world_from_model: Floats) -> Floats:
    """Return the corners (T, 3, 3) of all triangles of N instances, in the world's frame."""
    meshes = [models[number] for number in model.tolist()]
    parts = [placed_vertices(mesh, pose)[mesh.triangles] for mesh, pose in zip(meshes, world_from_model, strict=True)]
    return np.concatenate([np.empty((0, 3, 3)), *parts])


def come_to_rest(poses: Floats, meshes: Sequence[Mesh], corners: Floats, up: Floats) -> dict[int, Floats]:
    """Lower P particles onto the surfaces below them.

    Each particle keeps its rotation, and touches the plane of the surface below its centre with the point that is
    lowest over that plane. A particle above nothing, or above a slope of more than 60 degrees, is left out.

    Args:
        poses: (P, 4, 4) world_from_model.
        meshes: the P models.
        corners: (T, 3, 3) corners of the triangles to rest on, in the world's frame.
        up: (3,) unit vector that points up.

    Returns:
        The poses (4, 4) of the particles that have come to rest, by number.
    """
    # A frame whose z points up.
    aside = np.cross(up, least_axis(up))
    aside /= np.linalg.norm(aside)
    turn = np.stack([aside, np.cross(up, aside), up])
    places = np.array([turn @ pose[:3, 3] for pose in poses]).reshape(-1, 3)
    supports = surfaces_below(corners @ turn.T, places)
    rested = dict[int, Floats]()
    for number, (mesh, pose, place, support) in enumerate(zip(meshes, poses, places, supports, strict=True)):
        if support is None or support.normal[2] < _STEEPEST:
            continue
        outwards = turn.T @ support.normal
        lowest = float((mesh.positions.astype(np.float64) @ pose[:3, :3].T @ outwards).min())
        rested[number] = pose.copy()
        rested[number][:3, 3] = turn.T @ (*place[:2], support.height) - lowest * outwards
    return rested
