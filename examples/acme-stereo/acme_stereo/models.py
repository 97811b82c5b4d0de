"""Acme's knots."""

import numpy as np

from semisynth_gl import Mesh, make_model


def knot(rng: np.random.Generator) -> Mesh:
    """Tie a torus knot of random windings."""
    turns, loops = [(2, 3), (3, 2), (2, 5), (3, 4)][rng.integers(4)]
    along, around = (np.linspace(0, 2 * np.pi, count, endpoint=False) for count in (160, 8))
    radius = 2 + np.cos(loops * along)
    middle = np.stack([radius * np.cos(turns * along), radius * np.sin(turns * along), -np.sin(loops * along)], 1)
    forward = np.roll(middle, -1, 0) - np.roll(middle, 1, 0)
    side = np.cross(forward, middle)
    up = np.cross(side, forward)
    side, up = (axis / np.linalg.norm(axis, axis=1, keepdims=True) for axis in (side, up))
    tube = np.cos(around)[:, None] * side[:, None] + np.sin(around)[:, None] * up[:, None]
    positions = middle[:, None] + rng.uniform(0.15, 0.35) * tube
    number = np.arange(160 * 8).reshape(160, 8)
    right, below = np.roll(number, -1, 1), np.roll(number, -1, 0)
    corner = np.roll(right, -1, 0)
    triangles = np.concatenate([np.stack([number, below, corner], 2), np.stack([number, corner, right], 2)])
    return make_model(f"{turns}-{loops}", positions.reshape(-1, 3), triangles.reshape(-1, 3))
