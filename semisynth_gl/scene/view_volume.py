"""The space that both views show, at any moment of the sway: how near walls may come in it, and how deep they are."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from semisynth_gl.frame.camera import EYES, RECTIFIED, Eye, StereoCamera
from semisynth_gl.geometry.mesh import cross
from semisynth_gl.scene import Floats
from semisynth_gl.scene.rig import BEYOND_NEAR, STILL, Sway

WIDEST_RAD = np.deg2rad(85).item()
"""Rays that may turn farther off the optical axis than this have no bounds."""

_BOUNDS = (-WIDEST_RAD, WIDEST_RAD)

# The corners of a view and of a face, in turn.
_IN_TURN = (0, 1, 3, 2)
_FITS = 16
_LEAST_COSINE = 1e-3
TURNED_BACK = (1.0, 0.5, 0.25, 0.0)
"""A box whose corner is too deep is turned by these shares of its angles: one that is not turned shows a wall ahead."""

# Walls that are brought in end this much before the depth that they were brought in for.
_ROUNDING = 1e-9


def corner_rays(camera: StereoCamera, *eyes: Eye) -> Floats:
    """Return rays (R, 3) through the corners of the named views, or of both, as `StereoCamera.rays` does."""
    return np.concatenate([rays for eye, rays in _corner_rays(camera) if not eyes or eye in eyes])


def _corner_rays(camera: StereoCamera) -> Iterator[tuple[Eye, Floats]]:
    """Yield each view's eye, and rays (4, 3) through its corners.

    Where the right camera deviates, the views of its rectified twin count, too: pairs of both may show the scene.
    """
    x, y = np.array([(0, 0), (1, 0), (0, 1), (1, 1)]).T * [[camera.width_px], [camera.height_px]] - 0.5
    twins = (camera,) if camera.rectified else (camera, replace(camera, deviation=RECTIFIED))
    for eye in EYES:
        for twin in twins:
            yield eye, twin.rays(eye, x, y)


def smallest_offsets(camera: StereoCamera, normal: Floats, near_m: float, sway: Sway = STILL) -> Floats:
    """Return the smallest distances of walls at which both cameras are inside and all pixels are beyond the near plane.

    Along a ray from an eye at e, a wall normal . p = offset has depth Z = (offset - normal . e) / (normal . ray), and
    normal . ray is linear over the image: its largest value is at a corner. A sway moves the eyes by at most its reach,
    and the right one by 2 B sin(angle / 2) more; and it turns a ray by at most its angle towards the normal.

    The unit normals (F, 3) lead away from the camera, and the distances (F,) begin at the left camera's centre.
    """
    smallest = np.zeros(len(normal))
    for eye in EYES:
        shift = normal[:, 0] * camera.offset_m(eye) + _reach_m(camera, eye, sway)
        inside = shift + 0.05 * near_m
        rays = corner_rays(camera, eye)
        towards = rays @ normal.T
        if sway.angle_rad > 0:
            length = np.linalg.norm(rays, axis=1, keepdims=True)
            between = np.arccos(np.clip(towards / length, -1, 1))
            towards = length * np.cos(np.maximum(between - sway.angle_rad, 0))
        beyond = shift + BEYOND_NEAR * near_m * towards.max(axis=0)
        smallest = np.maximum(smallest, np.maximum(inside, beyond))
    return smallest


def deepest_m(camera: StereoCamera, faces: Floats, sway: Sway = STILL) -> float:
    """Return the largest planar depth of what either view shows of flat faces at any moment of the sway; 0 for nothing.

    Faces that hide each other count alike. They are convex, with corners (F, 4, 3) in turn, in the left camera's frame
    without its sway.
    """
    largest = 0.0
    for eye, rays in _corner_rays(camera):
        inwards = _inwards(rays, sway.angle_rad)
        # Of points of a plane, how far they are on its inner side.
        least = inwards[:, 0] * camera.offset_m(eye) - _reach_m(camera, eye, sway)
        for face in faces:
            part = face
            for normal, offset in zip(inwards, least, strict=True):
                part = _clipped(part, normal, float(offset))
            if len(part):
                aside = np.linalg.norm(part[:, :2], axis=1)
                # The optical axis turns towards the side: the depth is convex, so a corner is the deepest.
                depth_m = part[:, 2] + aside * np.sin(sway.angle_rad) + sway.reach_m
                largest = max(largest, float(depth_m.max()))
    return largest


def box_normals(axes: Floats) -> Floats:
    """Return the outward normals (6, 3) of a box whose axes are columns (3, 3): of each axis, and of its opposite."""
    return np.concatenate([axes.T[k // 2][None] * (1 - 2 * (k % 2)) for k in range(6)])


def box_faces(normal: Floats, offset_m: Floats) -> Floats:
    """Return the faces (6, 4, 3) of a box around the left camera, of `box_normals` and the walls' distances (6,)."""
    walls = normal * offset_m[:, None]
    faces = []
    for wall in range(6):
        others = [axis for axis in range(3) if axis != wall // 2]
        ends = [(walls[2 * axis], walls[2 * axis + 1]) for axis in others]
        corners = [walls[wall] + first + second for first in ends[0] for second in ends[1]]
        faces.append([corners[k] for k in _IN_TURN])
    return np.array(faces)


def fitted_offsets(
    camera: StereoCamera,
    normal: Floats,
    offset_m: Floats,
    smallest_m: Floats,
    farthest_m: float,
    sway: Sway = STILL,
    *,
    movable: int = 6,
) -> tuple[Floats, bool]:
    """Move the walls of a box out to their smallest distances, and the first ones in until no view shows too deep.

    Return the distances (6,) of the walls, and whether all views now keep to the depth; see `box_faces`.
    """
    offset_m = np.maximum(offset_m, smallest_m)
    for _ in range(_FITS):
        deepest = deepest_m(camera, box_faces(normal, offset_m), sway)
        if deepest <= farthest_m:
            return offset_m, True
        nearer = offset_m[:movable] * (farthest_m / deepest * (1 - _ROUNDING))
        offset_m[:movable] = np.maximum(nearer, smallest_m[:movable])
    return offset_m, False


def clear_depth_m(near_m: float, radius_m: Floats | float, aside_m: Floats | float, sway: Sway) -> Floats:
    """Return the least depth of a sphere's middle with which the sphere stays beyond the near plane in any sway.

    ``aside_m`` is its largest distance from the optical axis of the camera without its sway: a sphere at the side comes
    nearer where the camera turns towards it.
    """
    turn = np.sin(sway.angle_rad), max(float(np.cos(sway.angle_rad)), _LEAST_COSINE)
    return np.asarray((near_m + radius_m + sway.reach_m + aside_m * turn[0]) / turn[1])


@dataclass(frozen=True, slots=True)
class Height:
    """Where both views end above and below, at any moment of the sway."""

    top: float  # y / z of the highest rays; y points down
    bottom: float  # y / z of the lowest rays
    reach_m: float  # so far the sway moves an eye

    @property
    def secants(self) -> tuple[float, float]:
        """1 / cos of the angles of the highest and of the lowest rays, seen from the side."""
        return (1 + self.top**2) ** 0.5, (1 + self.bottom**2) ** 0.5


def height_of_view(camera: StereoCamera, sway: Sway = STILL) -> Height:
    """Return where both views end above and below, at any moment of the sway."""
    rays = corner_rays(camera)
    angles = np.arctan2(rays[:, 1], rays[:, 2])
    low, high = float(angles.min()), float(angles.max())
    if sway.angle_rad > 0:
        # As in `_inwards`; what turns away farther than any image reaches is not followed.
        nearest = float((rays[:, 2] / np.linalg.norm(rays, axis=1)).min())
        low, high = (
            float(np.clip(end + sign * np.arcsin(min(np.sin(sway.angle_rad) * np.cos(end) / nearest, 1.0)), *_BOUNDS))
            for end, sign in ((low, -1), (high, 1))
        )
    return Height(float(np.tan(low)), float(np.tan(high)), _reach_m(camera, "right", sway))


def _reach_m(camera: StereoCamera, eye: Eye, sway: Sway) -> float:
    """Return how far a sway moves one eye at most."""
    aside = abs(camera.offset_m(eye)) * 2 * np.sin(min(sway.angle_rad, np.pi) / 2)
    return float(sway.reach_m + aside)


def _inwards(rays: Floats, angle_rad: float) -> Floats:
    """Return the unit normals (4, 3) of the sides of a view, inwards; (0, 3) where its rays have no bounds.

    The view has rays (4, 3) through its corners, and turns by up to an angle about any axis.
    """
    rays = rays[list(_IN_TURN)]
    normal = np.array([cross(rays[k], rays[(k + 1) % 4]) for k in range(4)])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    if angle_rad == 0:
        return normal
    middle, towards = np.array([0, 0, 1.0]), rays / np.linalg.norm(rays, axis=1, keepdims=True)
    # A side turns outwards about the line that it has in common with the image. Its sine to a turned ray must stay
    # positive: rays of the view lie within `widest` of the axis.
    widest = float(np.arccos(towards[:, 2].min()))
    tilt_rad = np.arccos(np.clip(normal @ middle, -1, 1))
    more = np.sin(angle_rad) * np.sin(tilt_rad) / np.cos(widest)
    if widest + angle_rad >= WIDEST_RAD or (more >= 1).any():
        return np.empty((0, 3))
    turned_rad = tilt_rad - np.arcsin(more)
    across = normal - (normal @ middle)[:, None] * middle
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.asarray(np.cos(turned_rad)[:, None] * middle + np.sin(turned_rad)[:, None] * across)


def _clipped(polygon: Floats, normal: Floats, least: float) -> Floats:
    """Return the part of a convex polygon (N, 3) where normal . p >= least, (M, 3)."""
    if not len(polygon):
        return polygon
    inner = polygon @ normal - least
    if (inner >= 0).all():
        return polygon
    following, beyond = np.roll(polygon, -1, axis=0), np.roll(inner, -1)
    crosses = (inner >= 0) != (beyond >= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = polygon + (inner / (inner - beyond))[:, None] * (following - polygon)
    # Each corner that stays, and behind it the crossing of its side.
    both = np.stack([polygon, crossing], axis=1).reshape(-1, 3)
    return np.asarray(both[np.stack([inner >= 0, crosses], axis=1).ravel()])
