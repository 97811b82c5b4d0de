"""Makes a model of surfaces of any place and size: normalised, with UV in model units."""

from itertools import chain

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.mesh import Floats, Mesh, make_part, merged, normalised, without_degenerate
from semisynth_gl.geometry.unwrap import project_uv
from semisynth_gl.inputs.arguments import MOST, to_array
from semisynth_gl.inputs.errors import InputError

UV_LOSS = 0.5
"""Share of a part's surface without usable UV from which on the part's UV map is not used at all."""

PULL_LIMIT = 16
"""A triangle's UV is unusable where it stretches the texture this many times as much as the median of its part."""


Surface = tuple[Floats, NDArray[np.int64], Floats | None]
"""Positions, (V, 3); triangles, (T, 3); and UV, (V, 2) with v downwards, or None where there is no UV map."""


def make_model(name: str, positions: object, triangles: object, uv: object = None) -> Mesh:
    """Make a model from a surface of any place and size, as is done with the user's files.

    The model is normalised: its bounding sphere has radius 1 about the origin. Its UV is measured in model units. A UV
    map is scaled to model units. Without a UV map, and where the map is unusable, every triangle is projected along the
    nearest of 26 directions. Triangles without area are left out.

    Args:
        name: the model's name in the provenance of a sample.
        positions: (V, 3), array-like, of any unit, up to 1e9; z is up.
        triangles: (T, 3), array-like, indices of positions; anticlockwise seen from outside.
        uv: (V, 2), array-like, of any unit, up to 1e9; u to the right and v downwards in the patch. None for no UV map.

    Raises:
        InputError: where shapes, indices or values are wrong, or no triangle has an area.
    """
    points = to_array(f"model {name}: positions", positions, np.float64)
    unmapped = np.zeros((len(points) if points.ndim else 0, 2))
    coordinates = None if uv is None else to_array(f"model {name}: uv", uv, np.float64)
    index = to_array(f"model {name}: triangles", triangles, np.uint32)
    make_part(name, points, unmapped if coordinates is None else coordinates, index)  # checks shapes and values
    return join_surfaces(name, [(points, index.astype(np.int64), coordinates)])


@np.errstate(all="ignore")  # numbers that are not finite are found, or belong to triangles that are left out
def join_surfaces(name: str, parts: list[Surface]) -> Mesh:
    """Join surfaces to one model, see `make_model`.

    Raises InputError where there are no triangles, the model has no extent, or no triangle has an area; its text is a
    clause about the file.
    """
    argument = f"model {name}"
    if not parts:
        raise InputError("has no triangles", argument=argument)
    parts = [_without_loose_vertices(*part) for part in parts]
    # In float64, before anything is rounded: a model may stand far from its origin, or be of any size.
    vertices = np.concatenate([positions for positions, _, _ in parts])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = low / 2 + high / 2
    extent = float(np.abs(high / 2 - low / 2).max())
    if not extent > 0 or extent < 1e-9 * float(np.abs(centre).max()):
        raise InputError("has no extent", argument=argument)
    try:
        unwrapped = [_unwrapped(name, (positions - centre) / extent, faces, uv) for positions, faces, uv in parts]
        # Normalised twice, since triangles without area may have widened the bounding box.
        return normalised(without_degenerate(normalised(merged(name, list(chain(*unwrapped))))))
    except InputError as error:
        raise InputError("has no triangle with an area", argument=argument) from error


def _without_loose_vertices(positions: Floats, triangles: NDArray[np.int64], uv: Floats | None) -> Surface:
    """Drop the vertices that no triangle uses: they would count in the size of the model."""
    used, renumbered = np.unique(triangles, return_inverse=True)
    return positions[used], renumbered.reshape(-1, 3), None if uv is None else uv[used]


def _unwrapped(name: str, positions: Floats, triangles: NDArray[np.int64], uv: Floats | None) -> list[Mesh]:
    """Return a part with its UV map in model units where the map is usable, and projected UV elsewhere."""
    if uv is None:
        return [project_uv(name, positions, triangles)]
    area, uv_area, pull = _texture_pull(positions[triangles], uv[triangles])
    mapped = (area > 0) & np.isfinite(pull)
    if area[mapped].sum() <= UV_LOSS * area.sum():
        return [project_uv(name, positions, triangles)]
    # The scale is a median: on half of the surface the texture is finer. A mean would be decided by a few triangles
    # that fill much of the map, such as the eyes on a body of one colour.
    factor = np.sqrt(area[mapped] / uv_area[mapped])
    order = np.argsort(factor, kind="stable")
    share = np.cumsum(area[mapped][order])
    scale = float(factor[order][np.searchsorted(share, share[-1] / 2)])
    usable = (area == 0) | (mapped & (pull < PULL_LIMIT * scale))
    if area[usable].sum() <= UV_LOSS * area.sum():
        return [project_uv(name, positions, triangles)]
    # Clipping does no harm: only triangles that are left out, here or later as degenerate, have UV beyond the limits.
    held = np.clip(np.where(np.isfinite(uv), uv, 0) * scale, -MOST, MOST)
    kept = make_part(name, positions, held, triangles[usable])
    return [kept] if usable.all() else [kept, project_uv(name, positions, triangles[~usable])]


def _texture_pull(corners: Floats, uv: Floats) -> tuple[Floats, Floats, Floats]:
    """Return twice the area of triangles, twice their area in UV, and the pull of the texture on them; (T,) each.

    The pull is the largest ratio, over all directions, of a length on the surface to its length in UV. It is infinite
    or NaN where the UV map has collapsed. ``corners`` is (T, 3, 3), ``uv`` is (T, 3, 2).
    """
    # Squared ratios are eigenvalues of inv(T) S; S and T hold inner products of two edges, on the surface and in UV.
    a, b, c = _inner_products(np.diff(corners, axis=1))
    p, q, r = _inner_products(np.diff(uv, axis=1))
    determinant, uv_determinant = a * c - b * b, p * r - q * q
    half_trace = (c * p - 2 * b * q + a * r) / 2
    root = np.sqrt(np.maximum(half_trace**2 - determinant * uv_determinant, 0))
    pull = np.sqrt((half_trace + root) / uv_determinant)
    return np.sqrt(np.maximum(determinant, 0)), np.sqrt(np.maximum(uv_determinant, 0)), pull


def _inner_products(edges: Floats) -> tuple[Floats, ...]:
    """Return inner products of two edges, (T, 2, D): first by first, first by second, second by second; (T,) each."""
    first, second = edges[:, 0], edges[:, 1]
    return (first * first).sum(axis=1), (first * second).sum(axis=1), (second * second).sum(axis=1)
