"""The space that the two views show at any moment of the sway: how near walls may come in it, and how deep they are."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from semisynth_gl.frame.camera import EYES, RECTIFIED, Eye, StereoCamera
from semisynth_gl.geometry.mesh import cross
from semisynth_gl.scene import Floats
from semisynth_gl.scene.rig import BEYOND_NEAR, NO_SWAY, Sway

WIDEST_RAD = np.deg2rad(85).item()
"""Largest angle of a ray to the optical axis at any moment of the sway; wider views are treated as unbounded."""

_BOUNDS = (-WIDEST_RAD, WIDEST_RAD)

# Order in which a view's or a face's corners follow its border.
_IN_TURN = (0, 1, 3, 2)
# Largest number of times that a box is made smaller.
_FITS = 16
# Smallest cosine of the sway's angle that is divided by.
_LEAST_COSINE = 1e-3
TURNED_BACK = (1.0, 0.5, 0.25, 0.0)
"""Shares of its angles by which a box is turned, tried until no corner is too deep; unturned, it shows a wall ahead."""

# Share by which walls that are brought in stay short of the farthest depth.
_ROUNDING = 1e-9


def corner_rays(camera: StereoCamera, *eyes: Eye) -> Floats:
    """Return rays (R, 3), as `StereoCamera.rays` does, through the corners of the views of ``eyes``, or of both views.

    Where the right camera deviates, the corners of its rectified twin's views are included.
    """
    return np.concatenate([rays for eye, rays in _corner_rays(camera) if not eyes or eye in eyes])


def _corner_rays(camera: StereoCamera) -> Iterator[tuple[Eye, Floats]]:
    """Yield each view's eye, and rays (4, 3) through its corners.

    Where the right camera deviates, the views of its rectified twin are included: the scene may be shown by both pairs.
    """
    x, y = np.array([(0, 0), (1, 0), (0, 1), (1, 1)]).T * [[camera.width_px], [camera.height_px]] - 0.5
    twins = (camera,) if camera.rectified else (camera, replace(camera, deviation=RECTIFIED))
    for eye in EYES:
        for twin in twins:
            yield eye, twin.rays(eye, x, y)


def smallest_offsets(camera: StereoCamera, normal: Floats, near_m: float, sway: Sway = NO_SWAY) -> Floats:
    """Return the smallest distances of walls at which both cameras are inside and all pixels are beyond the near plane.

    Along a ray from an eye at e, a wall normal . p = offset has depth Z = (offset - normal . e) / (normal . ray), and
    normal . ray is linear over the image: its largest value is at a corner. A sway moves the eyes by at most its reach,
    and the right eye by 2 B sin(angle / 2) more; and it turns a ray by at most its angle towards the normal.

    Args:
        camera: the camera.
        normal: (F, 3) the walls' unit normals, away from the camera.
        near_m: depth of the near plane.
        sway: the sway.

    Returns:
        (F,) distances from the left camera's centre, metres.
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


def deepest_m(camera: StereoCamera, faces: Floats, sway: Sway = NO_SWAY) -> float:
    """Return the largest planar depth at which either view shows flat faces at any moment of the sway; 0 for none.

    Faces count even if others hide them. They are convex; ``faces`` (F, 4, 3) has their corners in order around the
    border, in the left camera's frame without its sway.
    """
    largest = 0.0
    for eye, rays in _corner_rays(camera):
        inwards = _inwards(rays, sway.angle_rad)
        # Smallest normal . p of the points on the inner side of each side of the view.
        least = inwards[:, 0] * camera.offset_m(eye) - _reach_m(camera, eye, sway)
        for face in faces:
            part = face
            for normal, offset in zip(inwards, least, strict=True):
                part = _clipped(part, normal, float(offset))
            if len(part):
                aside = np.linalg.norm(part[:, :2], axis=1)
                # The optical axis may turn towards a point at the side. The depth is convex, so a corner is the
                # deepest.
                depth_m = part[:, 2] + aside * np.sin(sway.angle_rad) + sway.reach_m
                largest = max(largest, float(depth_m.max()))
    return largest


def box_normals(axes: Floats) -> Floats:
    """Return the outward normals (6, 3) of a box: the columns of ``axes`` (3, 3), each followed by its opposite."""
    return np.concatenate([axes.T[k // 2][None] * (1 - 2 * (k % 2)) for k in range(6)])


def box_faces(normal: Floats, offset_m: Floats) -> Floats:
    """Return the corners (6, 4, 3) of the faces of a box around the left camera, in order around each face.

    ``normal`` (6, 3) comes from `box_normals`; ``offset_m`` (6,) are the walls' distances from the left camera.
    """
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
    sway: Sway = NO_SWAY,
    *,
    movable: int = 6,
) -> tuple[Floats, bool]:
    """Move the walls of a box out to their smallest distances, then bring some in until no view sees too deep.

    Args:
        camera: the camera.
        normal: (6, 3) the walls' normals, see `box_normals`.
        offset_m: (6,) the walls' distances from the left camera.
        smallest_m: (6,) their smallest distances, see `smallest_offsets`.
        farthest_m: the largest depth that a view may show.
        sway: the sway.
        movable: how many walls, from the first one on, may be brought in.

    Returns:
        The new distances (6,), and whether no view shows more than ``farthest_m``.
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
    """Return the smallest depth of a sphere's centre at which the sphere stays beyond the near plane at any moment.

    ``aside_m`` is the centre's largest distance from the optical axis of the camera without its sway: a sphere at the
    side comes nearer where the camera turns away from it.
    """
    turn = np.sin(sway.angle_rad), max(float(np.cos(sway.angle_rad)), _LEAST_COSINE)
    return np.asarray((near_m + radius_m + sway.reach_m + aside_m * turn[0]) / turn[1])


@dataclass(frozen=True, slots=True)
class Height:
    """The upper and the lower end of what both views show, at any moment of the sway."""

    top: float  # y / z of the highest rays; y points down
    bottom: float  # y / z of the lowest rays
    reach_m: float  # largest distance by which the sway moves an eye

    @property
    def secants(self) -> tuple[float, float]:
        """1 / cos of the angles of the highest and of the lowest rays, seen from the side."""
        return (1 + self.top**2) ** 0.5, (1 + self.bottom**2) ** 0.5


def height_of_view(camera: StereoCamera, sway: Sway = NO_SWAY) -> Height:
    """Return the upper and the lower end of what both views show, at any moment of the sway."""
    rays = corner_rays(camera)
    angles = np.arctan2(rays[:, 1], rays[:, 2])
    low, high = float(angles.min()), float(angles.max())
    if sway.angle_rad > 0:
        # As in `_inwards`, but angles that no image reaches are clipped.
        nearest = float((rays[:, 2] / np.linalg.norm(rays, axis=1)).min())
        low, high = (
            float(np.clip(end + sign * np.arcsin(min(np.sin(sway.angle_rad) * np.cos(end) / nearest, 1.0)), *_BOUNDS))
            for end, sign in ((low, -1), (high, 1))
        )
    return Height(float(np.tan(low)), float(np.tan(high)), _reach_m(camera, "right", sway))


def _reach_m(camera: StereoCamera, eye: Eye, sway: Sway) -> float:
    """Return the largest distance by which a sway moves one eye."""
    aside = abs(camera.offset_m(eye)) * 2 * np.sin(min(sway.angle_rad, np.pi) / 2)
    return float(sway.reach_m + aside)


def _inwards(rays: Floats, angle_rad: float) -> Floats:
    """Return the inward unit normals (4, 3) of a view's four sides, or (0, 3) where the view is unbounded.

    ``rays`` (4, 3) go through the view's corners; the view turns by up to ``angle_rad`` about any axis.
    """
    rays = rays[list(_IN_TURN)]
    normal = np.array([cross(rays[k], rays[(k + 1) % 4]) for k in range(4)])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    if angle_rad == 0:
        return normal
    middle, towards = np.array([0, 0, 1.0]), rays / np.linalg.norm(rays, axis=1, keepdims=True)
    # Each side is turned outwards about its line in the image, until the view's rays lie on its inner side however the
    # view turns. All rays lie within `widest` of the optical axis.
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
    """Return the part (M, 3) of a convex polygon (N, 3) in which normal . p >= least."""
    if not len(polygon):
        return polygon
    inner = polygon @ normal - least
    inside = inner >= 0
    if inside.all():
        return polygon
    if not inside.any():
        return polygon[:0]
    following, beyond = (np.concatenate([each[1:], each[:1]]) for each in (polygon, inner))
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = polygon + (inner / (inner - beyond))[:, None] * (following - polygon)
    # Each corner that stays, followed by the crossing on the side that begins at the corner.
    both, kept = np.empty((2 * len(polygon), 3)), np.empty(2 * len(polygon), bool)
    both[::2], both[1::2] = polygon, crossing
    kept[::2], kept[1::2] = inside, inside != (beyond >= 0)
    return both[kept]
