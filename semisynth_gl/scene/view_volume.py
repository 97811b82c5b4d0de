"""The space that both views show at any moment of the sway: how near walls may stand, and how deep views see."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from semisynth_gl.frame.camera import EYES, RECTIFIED, Eye, StereoCamera
from semisynth_gl.geometry.mesh import cross
from semisynth_gl.scene import Floats
from semisynth_gl.scene.rig import SequenceRig

WIDEST_RAD = np.deg2rad(85).item()
"""Maximum angle of a ray to the optical axis at any moment of the sway; wider views are treated as unbounded."""

# Maximum number of times that a box is made smaller.
_SHRINKINGS = 16
# Minimum distance of a wall from an eye, as a share of the near plane's depth.
_CLEARANCE = 0.05
# Cosines of the sway's angle are raised to this value before division by them.
_LEAST_COSINE = 1e-3
# Factors of a box's rotation, tried in this order until no corner is too deep. With 0, a wall is straight ahead.
_ROTATIONS = (1.0, 0.5, 0.25, 0.0)
# Walls that are moved inwards end this share before the maximum depth, because of rounding.
_ROUNDING = 1e-9


def corner_rays(camera: StereoCamera, eyes: Sequence[Eye] = EYES) -> Floats:
    """Return rays (4 V, 3) through the corners of the views of ``eyes``, four for each view in order around its border.

    If the right camera deviates, the views of its rectified twin are included, since both pairs may show the scene.
    """
    x, y = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]).T * [[camera.width_px], [camera.height_px]] - 0.5
    twins = (camera,) if camera.rectified else (camera, replace(camera, deviation=RECTIFIED))
    return np.concatenate([twin.rays(eye, x, y) for eye in eyes for twin in twins])


def smallest_offsets(rig: SequenceRig, normal: Floats) -> Floats:
    """Return the smallest distances of walls that have both cameras inside and appear only beyond the near plane.

    Along a ray from an eye at e, a wall normal . p = offset has depth Z = (offset - normal . e) / (normal . ray). Since
    normal . ray is linear over the image, its largest value is at a corner. A sway moves the eyes by at most its reach,
    and the right eye by 2 B sin(angle / 2) more. The sway rotates a ray towards the normal by at most its angle.

    ``normal`` (F, 3) has the walls' unit normals, away from the camera. Distances (F,) are from the left camera's
    centre, metres.
    """
    camera, angle_rad, smallest = rig.camera, rig.sway.angle_rad, np.zeros(len(normal))
    for eye in EYES:
        shift = normal[:, 0] * camera.offset_m(eye) + _eye_reach_m(rig, eye)
        inside = shift + _CLEARANCE * rig.near_m
        rays = corner_rays(camera, [eye])
        towards = rays @ normal.T
        if angle_rad > 0:
            length = np.linalg.norm(rays, axis=1, keepdims=True)
            between = np.arccos(np.clip(towards / length, -1, 1))
            towards = length * np.cos(np.maximum(between - angle_rad, 0))
        beyond = shift + rig.clear_m * towards.max(axis=0)
        smallest = np.maximum(smallest, np.maximum(inside, beyond))
    return smallest


def deepest_m(rig: SequenceRig, faces: Floats) -> float:
    """Return the maximum planar depth of flat faces in both views at any moment of the sway; 0 if no view shows a face.

    Faces behind other faces are included. Faces are convex. ``faces`` (F, 4, 3) has their corners in order around the
    border, in the left camera's frame without its sway.
    """
    camera, sway, largest = rig.camera, rig.sway, 0.0
    views = [(eye, rays) for eye in EYES for rays in corner_rays(camera, [eye]).reshape(-1, 4, 3)]
    for eye, rays in views:
        inwards = _inwards(rays, sway.angle_rad)
        # A point p is in the view if normal . p >= least for each of the view's sides.
        least = inwards[:, 0] * camera.offset_m(eye) - _eye_reach_m(rig, eye)
        for face in faces:
            part = face
            for normal, offset in zip(inwards, least, strict=True):
                part = _clip(part, normal, float(offset))
            if len(part):
                # The optical axis may turn towards a point at the side. This bound is convex: a corner has the maximum.
                aside = np.linalg.norm(part[:, :2], axis=1)
                depth_m = part[:, 2] + aside * np.sin(sway.angle_rad) + sway.reach_m
                largest = max(largest, float(depth_m.max()))
    return largest


def fit_box(
    rig: SequenceRig,
    axes: Callable[[float], Floats],
    offsets_m: Callable[[Floats, Floats], Floats],
    farthest_m: float,
    movable: int = 6,
) -> tuple[float, Floats]:
    """Turn a box around the cameras and move its walls so that, if possible, no view sees deeper than ``farthest_m``.

    Walls are in the order of the axes, each followed by the opposite wall. Walls that are too near are first moved
    outwards to their smallest distances. Then the first ``movable`` walls are moved inwards.

    ``axes`` returns the box's axes as columns (3, 3), for a factor from 0 to 1 of its angles. ``offsets_m`` returns the
    walls' distances (6,), for their outward normals (6, 3) and smallest distances (6,).

    Returns:
        The factor of the angles, and the walls' distances (6,) from the left camera.
    """
    for factor in _ROTATIONS:
        normal = np.concatenate([(axis, -axis) for axis in axes(factor).T])
        smallest_m = smallest_offsets(rig, normal)
        offset_m = np.maximum(offsets_m(normal, smallest_m), smallest_m)
        for _ in range(_SHRINKINGS):
            deepest = deepest_m(rig, _box_faces(normal, offset_m))
            if deepest <= farthest_m:
                return factor, offset_m
            inwards_m = offset_m[:movable] * (farthest_m / deepest * (1 - _ROUNDING))
            offset_m[:movable] = np.maximum(inwards_m, smallest_m[:movable])
    return factor, offset_m


def _box_faces(normal: Floats, offset_m: Floats) -> Floats:
    """Return the corners (6, 4, 3) of the faces of a box around the left camera, in order around the faces."""
    walls, faces = normal * offset_m[:, None], []
    for wall in range(6):
        a, b = (2 * axis for axis in range(3) if axis != wall // 2)
        faces.append([walls[wall] + walls[i] + walls[j] for i, j in ((a, b), (a, b + 1), (a + 1, b + 1), (a + 1, b))])
    return np.array(faces)


def least_sphere_depth_m(rig: SequenceRig, radius_m: Floats | float, aside_m: Floats | float) -> Floats:
    """Return the smallest depth of a sphere's centre at which the sphere stays beyond the near plane at any moment.

    ``aside_m`` is the centre's largest distance from the optical axis of the camera without its sway. If the camera
    turns away from a sphere, the sphere's depth falls.
    """
    sine, cosine = np.sin(rig.sway.angle_rad), max(float(np.cos(rig.sway.angle_rad)), _LEAST_COSINE)
    return np.asarray((rig.near_m + radius_m + rig.sway.reach_m + aside_m * sine) / cosine)


class VerticalViewLimits(NamedTuple):
    """The upper and lower limits of the space that both views show at any moment of the sway."""

    top: float  # y / z of the highest rays; y points down
    bottom: float  # y / z of the lowest rays
    secants: tuple[float, float]  # sqrt(1 + (y / z)^2) of the highest and of the lowest rays
    reach_m: float  # largest distance by which the sway moves an eye


def vertical_view_limits(rig: SequenceRig) -> VerticalViewLimits:
    """Return the vertical limits of a rig's views."""
    rays, sway = corner_rays(rig.camera), rig.sway
    angles = np.arctan2(rays[:, 1], rays[:, 2])
    low, high = float(angles.min()), float(angles.max())
    if sway.angle_rad > 0:
        # Tilt the upper and the lower side of the view outwards as `_inwards` does, up to `WIDEST_RAD`.
        least_cosine = float((rays[:, 2] / np.linalg.norm(rays, axis=1)).min())
        turns = [np.arcsin(min(np.sin(sway.angle_rad) * np.cos(end) / least_cosine, 1.0)) for end in (low, high)]
        low, high = np.clip((low - turns[0], high + turns[1]), -WIDEST_RAD, WIDEST_RAD).tolist()
    top, bottom = float(np.tan(low)), float(np.tan(high))
    return VerticalViewLimits(top, bottom, ((1 + top**2) ** 0.5, (1 + bottom**2) ** 0.5), _eye_reach_m(rig, "right"))


def _eye_reach_m(rig: SequenceRig, eye: Eye) -> float:
    """Return the largest distance by which the sway moves one eye."""
    aside = abs(rig.camera.offset_m(eye)) * 2 * np.sin(min(rig.sway.angle_rad, np.pi) / 2)
    return float(rig.sway.reach_m + aside)


def _inwards(rays: Floats, angle_rad: float) -> Floats:
    """Return the inward unit normals (4, 3) of the four planes that bound a view, or (0, 3) if the view is unbounded.

    ``rays`` (4, 3) go through the view's corners. The view rotates by up to ``angle_rad`` about any axis.
    """
    normal = np.array([cross(rays[k], rays[(k + 1) % 4]) for k in range(4)])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    if angle_rad == 0:
        return normal
    axis, towards = np.array([0, 0, 1.0]), rays / np.linalg.norm(rays, axis=1, keepdims=True)
    # Tilt each plane outwards until all rays of the rotated view are on its inner side. The angle between a ray and the
    # optical axis is at most `widest`.
    widest = float(np.arccos(towards[:, 2].min()))
    tilt_rad = np.arccos(np.clip(normal @ axis, -1, 1))
    sine = np.sin(angle_rad) * np.sin(tilt_rad) / np.cos(widest)
    if widest + angle_rad >= WIDEST_RAD or (sine >= 1).any():
        return np.empty((0, 3))
    tilted_rad = tilt_rad - np.arcsin(sine)
    across = normal - (normal @ axis)[:, None] * axis
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.asarray(np.cos(tilted_rad)[:, None] * axis + np.sin(tilted_rad)[:, None] * across)


def _clip(polygon: Floats, normal: Floats, least: float) -> Floats:
    """Return the part (M, 3) of a convex polygon (N, 3) in which normal . p >= least (Sutherland and Hodgman 1974)."""
    inner = polygon @ normal - least
    inside = inner >= 0
    if inside.all():
        return polygon
    if not inside.any():
        return polygon[:0]
    next_corner, next_inner = (np.concatenate([each[1:], each[:1]]) for each in (polygon, inner))
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = polygon + (inner / (inner - next_inner))[:, None] * (next_corner - polygon)
    # Put each corner before the crossing on the edge to the next corner.
    points, kept = np.empty((2 * len(polygon), 3)), np.empty(2 * len(polygon), bool)
    points[::2], points[1::2] = polygon, crossing
    kept[::2], kept[1::2] = inside, inside != (next_inner >= 0)
    return points[kept]
