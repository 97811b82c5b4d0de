"""Makes a normalised model with UV in model units from surfaces of any position and size."""

from itertools import chain

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.mesh import Floats, Mesh, make_part, merged, normalised, without_degenerate
from semisynth_gl.geometry.unwrap import project_uv
from semisynth_gl.inputs.arguments import MOST, to_array
from semisynth_gl.inputs.errors import InputError

# A part's UV map is used if it is usable on more than this share of the part's surface.
_LEAST_MAPPED = 0.5
# A triangle's UV is unusable if it stretches the texture by this factor or more, relative to the median of its part.
_MOST_STRETCH = 16

Surface = tuple[Floats, NDArray[np.int64], Floats | None]
"""Positions, (V, 3); triangles, (T, 3); and UV, (V, 2) with v downwards, or None if there is no UV map."""


def make_model(name: str, positions: object, triangles: object, uv: object = None) -> Mesh:
    """Make a model from a surface of any position and size, as the program does with the user's files.

    The model is normalised: its bounding sphere has radius 1 about the origin. A UV map is scaled to model units.
    Triangles without usable UV are projected along the nearest of 26 directions. Triangles without area are dropped.

    Args:
        name: the model's name in the provenance of a sample.
        positions: (V, 3), array-like, of any unit, up to 1e9; z is up.
        triangles: (T, 3), array-like, indices of positions; anticlockwise seen from outside.
        uv: (V, 2), array-like, of any unit, up to 1e9; u to the right and v downwards in the patch. None for no UV map.

    Raises:
        InputError: if shapes, indices or values are wrong, or no triangle has an area.
    """
    points = to_array(f"model {name}: positions", positions, np.float64)
    coordinates = None if uv is None else to_array(f"model {name}: uv", uv, np.float64)
    index = to_array(f"model {name}: triangles", triangles, np.uint32)
    # Checks shapes and values.
    make_part(name, points, np.zeros((*points.shape[:1], 2)) if coordinates is None else coordinates, index)
    return join_surfaces(name, [(points, index.astype(np.int64), coordinates)])


@np.errstate(all="ignore")  # numbers that are not finite are refused, or belong to triangles that are dropped
def join_surfaces(name: str, parts: list[Surface]) -> Mesh:
    """Join surfaces into one model, see `make_model`.

    Raises InputError if there are no triangles, the model has no extent, or no triangle has an area. The error's
    ``text`` is a clause, such as "has no extent"; its ``argument`` is the model.
    """
    argument = f"model {name}"
    if not parts:
        raise InputError("has no triangles", argument=argument)
    parts = [_without_unused_vertices(*part) for part in parts]
    # Centre and scale in float64, since a model may be far from its origin, or of any size.
    vertices = np.concatenate([positions for positions, _, _ in parts])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = low / 2 + high / 2
    extent = float(np.abs(high / 2 - low / 2).max())
    if not extent > 0 or extent < 1e-9 * float(np.abs(centre).max()):
        raise InputError("has no extent", argument=argument)
    try:
        unwrapped = [_unwrapped(name, (positions - centre) / extent, faces, uv) for positions, faces, uv in parts]
        # Normalise twice, since dropped triangles may have enlarged the bounding box.
        return normalised(without_degenerate(normalised(merged(name, chain(*unwrapped)))))
    except InputError as error:
        raise InputError("has no triangle with an area", argument=argument) from error


def _without_unused_vertices(positions: Floats, triangles: NDArray[np.int64], uv: Floats | None) -> Surface:
    used, renumbered = np.unique(triangles, return_inverse=True)
    return positions[used], renumbered.reshape(-1, 3), None if uv is None else uv[used]


def _unwrapped(name: str, positions: Floats, triangles: NDArray[np.int64], uv: Floats | None) -> list[Mesh]:
    """Return a part as one or two meshes: triangles with usable UV in model units, others with projected UV."""
    if uv is None:
        return [project_uv(name, positions, triangles)]
    area, uv_area, stretch = _texture_stretch(positions[triangles], uv[triangles])
    is_mapped = (area > 0) & np.isfinite(stretch)
    # The scale is the median over the surface. A few triangles that fill most of the map, such as the eyes of an animal
    # whose body needs only a few texels, would decide a mean.
    factor = np.sqrt(area[is_mapped] / uv_area[is_mapped])
    order = np.argsort(factor, kind="stable")
    share = np.cumsum(area[is_mapped][order])
    scale = float(factor[order][np.searchsorted(share, share[-1] / 2)]) if len(share) else 1.0
    usable = (area == 0) | (is_mapped & (stretch < _MOST_STRETCH * scale))
    if area[usable].sum() <= _LEAST_MAPPED * area.sum():
        return [project_uv(name, positions, triangles)]
    # This changes no usable triangle with an area: its UV is finite and within the limits.
    clipped = np.clip(np.where(np.isfinite(uv), uv, 0) * scale, -MOST, MOST)
    mapped = make_part(name, positions, clipped, triangles[usable])
    return [mapped] if usable.all() else [mapped, project_uv(name, positions, triangles[~usable])]


def _texture_stretch(corners: Floats, uv: Floats) -> tuple[Floats, Floats, Floats]:
    """Return twice the area of triangles, twice their area in UV, and the stretch of the texture on them; (T,) each.

    The stretch is the largest ratio, over all directions, of a length on the surface to its length in UV. It is
    infinite or NaN if the triangle has no area in UV. ``corners`` is (T, 3, 3), ``uv`` is (T, 3, 2).
    """
    # [[a, b], [b, c]] has the inner products of two edges on the surface; [[p, q], [q, r]] has them in UV. The squared
    # ratios are the eigenvalues of the inverse of the second matrix times the first.
    (a, b, c), (p, q, r) = (
        ((first * first).sum(axis=1), (first * second).sum(axis=1), (second * second).sum(axis=1))
        for first, second in (np.moveaxis(np.diff(points, axis=1), 1, 0) for points in (corners, uv))
    )
    determinant, uv_determinant = a * c - b * b, p * r - q * q
    half_trace = (c * p - 2 * b * q + a * r) / 2
    root = np.sqrt(np.maximum(half_trace**2 - determinant * uv_determinant, 0))
    stretch = np.sqrt((half_trace + root) / uv_determinant)
    return np.sqrt(np.maximum(determinant, 0)), np.sqrt(np.maximum(uv_determinant, 0)), stretch
