"""What closes the view: the inside of a cuboid, or one far plane. Both are made of flat faces."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pyrr
from numpy.typing import NDArray

from semisynth_gl.camera import EYES, StereoCamera
from semisynth_gl.config import Range
from semisynth_gl.config.model import BackgroundSection, DisparitySection
from semisynth_gl.errors import InputError
from semisynth_gl.geometry.mesh import Mesh, make_mesh
from semisynth_gl.scene.rig import STILL, Sway, check_reachable, near_depth_m

_FACE_CELLS = 8


def _face() -> Mesh:
    v, u = np.meshgrid(*[np.linspace(0, 1, _FACE_CELLS + 1)] * 2, indexing="ij")
    corners = np.stack([u.ravel(), v.ravel()], axis=1)
    row = _FACE_CELLS + 1
    first = (np.arange(_FACE_CELLS)[:, None] * row + np.arange(_FACE_CELLS)).ravel()
    triangles = np.concatenate(
        [np.stack([first, first + 1, first + row + 1], 1), np.stack([first, first + row + 1, first + row], 1)]
    )
    return make_mesh("face", np.c_[corners, np.zeros(len(corners))], corners, triangles)


# The model that every face is an instance of: the unit square of the x-y plane, u along x and v along y. It is a grid
# because float32 rounds a vertex by its distance: what is near should not hang between vertices far away.
FACE = _face()

# Walls keep this much more than the smallest allowed depth, so that rounding never puts a pixel beyond max_px.
BEYOND_NEAR = 1.01
# Side walls stand between these fractions of the way from the nearest allowed place to just outside the view.
_SIDE_WALL = Range(0.3, 1.1)
# Walls go on behind each other by this share of their size: rounded to float32, edges that only met would leave gaps.
OVERLAP = 1e-4
_GRID = (48, 32)
# A far plane is no wider than this angle to its normal can see.
_WIDEST_RAD = np.deg2rad(85)


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """F flat faces in the left camera's frame, metres.

    Attributes:
        kind: "cuboid" or "plane".
        world_from_face: (F, 4, 4) float64, places the unit square `FACE`.
        size_m: (F, 2) float64, lengths of the two edges.
        normal: (F, 3) float64, unit, away from the camera.
        offset_m: (F,) float64, distance from the left camera's centre; points of a face have normal . p = offset.
        visible_depth_m: (F,) float64, median depth of a face in the left view, or its nearest depth if not seen.
    """

    kind: Literal["cuboid", "plane"]
    world_from_face: NDArray[np.float64]
    size_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    offset_m: NDArray[np.float64]
    visible_depth_m: NDArray[np.float64]

    def disparity_px(self, camera: StereoCamera) -> NDArray[np.float64]:
        """Disparities of the bare background on a coarse grid over the left view, flat float64."""
        depth, _ = _first_hit(self.normal, self.offset_m, _grid_rays(camera))
        return camera.disparity_px(depth)


def draw_background(
    section: BackgroundSection,
    disparity: DisparitySection,
    camera: StereoCamera,
    rng: np.random.Generator,
    sway: Sway = STILL,
) -> Background:
    """Draw the background of one sequence.

    No wall comes nearer than the depth of ``disparity.max_px`` in either view, and the cuboid holds both cameras,
    however they sway; the plane fills both views.

    Raises:
        InputError: where the plane would have to be endless to do so.
    """
    indoor = rng.random() * (section.cuboid + section.plane) < section.cuboid
    return _cuboid(section, disparity, camera, rng, sway) if indoor else _plane(section, disparity, camera, rng, sway)


def _plane(
    section: BackgroundSection,
    disparity: DisparitySection,
    camera: StereoCamera,
    rng: np.random.Generator,
    sway: Sway,
) -> Background:
    disparity_px = section.plane_disparity_px.draw(rng)
    check_reachable(camera, disparity_px, "background.plane_disparity_px")
    depth = float(camera.depth_m(disparity_px))
    if sway.reach_m > 0 or sway.angle_rad > 0:
        # With a large doffs the plane is not far, and the camera may come near it.
        ahead = np.array([[0.0, 0.0, 1.0]])
        depth = max(depth, float(smallest_offsets(camera, ahead, near_depth_m(camera, disparity), sway)[0]))
    corners = _corner_points(camera, depth)
    low, high = corners.min(axis=0), corners.max(axis=0)
    if sway.reach_m > 0 or sway.angle_rad > 0:
        widest = float(np.arctan(np.linalg.norm(corner_rays(camera)[:, :2], axis=1).max())) + sway.angle_rad
        if widest >= _WIDEST_RAD:
            raise InputError(
                f"camera.sway_deg turns views by up to {np.rad2deg(sway.angle_rad):.0f} degrees, and their corners to "
                f"{np.rad2deg(widest):.0f} degrees off the far plane's normal, at most {np.rad2deg(_WIDEST_RAD):.0f} "
                "can be filled: lower it, or set background.plane to 0"
            )
        aside = abs(camera.offset_m("right")) + sway.reach_m
        half = (depth + aside) * np.tan(widest) + aside
        low, high = np.minimum(low, -half), np.maximum(high, half)
    margin = 0.01 * (high - low)
    low, high = low - margin, high + margin
    world_from_face = np.eye(4)
    world_from_face[0, 0], world_from_face[1, 1] = high[:2] - low[:2]
    world_from_face[:3, 3] = low[0], low[1], depth
    return Background(
        "plane",
        world_from_face[None],
        (high - low)[None, :2],
        np.array([[0.0, 0.0, 1.0]]),
        np.array([depth]),
        np.array([depth]),
    )


def _cuboid(
    section: BackgroundSection,
    disparity: DisparitySection,
    camera: StereoCamera,
    rng: np.random.Generator,
    sway: Sway,
) -> Background:
    turn = np.deg2rad(section.wall_turn_deg)
    # Columns are the room's axes in the camera frame.
    axes = np.asarray(pyrr.matrix33.create_from_eulers(rng.uniform(-turn, turn, 3)), np.float64).T
    wall_px = section.wall_disparity_px or Range(disparity.min_px, disparity.min_px)
    drawn_px = wall_px.draw(rng)
    check_reachable(camera, drawn_px, "background.wall_disparity_px")
    wall_depth = float(camera.depth_m(drawn_px))
    near = near_depth_m(camera, disparity)
    farthest = float(camera.depth_m(disparity.min_px))
    fraction = _SIDE_WALL.draw_many(rng, 4)

    # Faces in the order +x, -x, +y, -y, +z (the back wall), -z (behind the cameras).
    normal = np.concatenate([axes.T[k // 2][None] * (1 - 2 * (k % 2)) for k in range(6)])
    smallest = smallest_offsets(camera, normal, near, sway)
    offset = np.empty(6)
    reach = (_corner_points(camera, wall_depth) @ normal.T).max(axis=0)
    offset[:4] = smallest[:4] + fraction * np.maximum(reach[:4] - smallest[:4], 0)
    centre_ray = camera.rays("left", np.array((camera.width_px - 1) / 2), np.array((camera.height_px - 1) / 2))
    offset[4] = wall_depth * max(float(normal[4] @ centre_ray), 0.1)
    # The back wall's far corner keeps to min_px where the turn allows it; side walls may cut it off before.
    steepest = float((corner_rays(camera) @ normal[4]).min())
    if steepest > 0:
        offset[4] = min(offset[4], farthest * steepest)
    offset[5] = 0.5 * wall_depth
    offset = np.maximum(offset, smallest)

    world_from_face = np.tile(np.eye(4), (6, 1, 1))
    size = np.empty((6, 2))
    for face in range(6):
        k, sign = face // 2, 1 - 2 * (face % 2)
        i, j = (k + 1) % 3, (k + 2) % 3
        room = {axis: offset[2 * axis] + offset[2 * axis + 1] for axis in (i, j)}
        low = {axis: -offset[2 * axis + 1] - OVERLAP * room[axis] for axis in (i, j)}
        size[face] = [(1 + 2 * OVERLAP) * room[axis] for axis in (i, j)]
        corner = sign * offset[face] * axes[:, k] + low[i] * axes[:, i] + low[j] * axes[:, j]
        world_from_face[face, :3, 0] = axes[:, i] * size[face, 0]
        world_from_face[face, :3, 1] = axes[:, j] * size[face, 1]
        world_from_face[face, :3, 2] = axes[:, k]
        world_from_face[face, :3, 3] = corner
    depth, hit = _first_hit(normal, offset, _grid_rays(camera))
    visible_depth = np.array([np.median(depth[hit == k]) if (hit == k).any() else wall_depth for k in range(6)])
    return Background("cuboid", world_from_face, size, normal, offset, visible_depth)


def smallest_offsets(
    camera: StereoCamera, normal: NDArray[np.float64], near_m: float, sway: Sway = STILL
) -> NDArray[np.float64]:
    """Smallest distance of walls with these normals that keeps both cameras inside and all pixels beyond near.

    Along a ray from an eye at e, a wall normal . p = offset has depth Z = (offset - normal . e) / (normal . ray), and
    normal . ray is linear over the image: its largest value is at a corner. A sway moves the eyes by at most its reach,
    and the right one by 2 B sin(angle / 2) more; and it turns a ray by at most its angle towards the normal.
    """
    smallest = np.full(len(normal), 0.0)
    for eye in EYES:
        aside = abs(camera.offset_m(eye)) * 2 * np.sin(min(sway.angle_rad, np.pi) / 2)
        shift = normal[:, 0] * camera.offset_m(eye) + (sway.reach_m + aside)
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


def corner_rays(camera: StereoCamera, *eyes: str) -> NDArray[np.float64]:
    """Rays (4 E, 3) with Z = 1 through the corners of the named views, or of both."""
    x = np.array([-0.5, camera.width_px - 0.5, -0.5, camera.width_px - 0.5])
    y = np.array([-0.5, -0.5, camera.height_px - 0.5, camera.height_px - 0.5])
    return np.concatenate([camera.rays(eye, x, y) for eye in EYES if not eyes or eye in eyes])


def _corner_points(camera: StereoCamera, depth_m: float) -> NDArray[np.float64]:
    """Corners of both views at one depth, (8, 3), in the left camera's frame."""
    return np.concatenate([corner_rays(camera, eye) * depth_m + np.array([camera.offset_m(eye), 0, 0]) for eye in EYES])


def grid_px(camera: StereoCamera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Columns and rows, flat, of a coarse grid over the view."""
    x = (np.arange(_GRID[0]) + 0.5) / _GRID[0] * camera.width_px - 0.5
    y = (np.arange(_GRID[1]) + 0.5) / _GRID[1] * camera.height_px - 0.5
    columns, rows = np.meshgrid(x, y)
    return columns.ravel(), rows.ravel()


def _grid_rays(camera: StereoCamera) -> NDArray[np.float64]:
    return camera.rays("left", *grid_px(camera))


def _first_hit(
    normal: NDArray[np.float64], offset: NDArray[np.float64], rays: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Depth along (R, 3) rays from the left camera to the first face, and that face: both (R,)."""
    with np.errstate(divide="ignore"):
        depth = offset / (rays @ normal.T)
    depth[~(depth > 0)] = np.inf
    return depth.min(axis=1), depth.argmin(axis=1)
