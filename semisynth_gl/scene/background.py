"""Samples the kind of a scene's background, and the simple backgrounds: the inside of a cuboid, or one far plane."""

from typing import Literal, get_args

import numpy as np
import pyrr

from semisynth_gl.config import Config, Range
from semisynth_gl.config.scene_sections import BackgroundSection
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.geometry.mesh import cross
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene import Floats
from semisynth_gl.scene.instances import Instances, new_instances
from semisynth_gl.scene.left_view import grid_px
from semisynth_gl.scene.rig import SequenceRig
from semisynth_gl.scene.view_volume import WIDEST_RAD, corner_rays, fit_box, smallest_offsets

# Range of the positions of side walls: 0 is as near as possible, and 1 is at the edge of the view.
_SIDE_WALL = Range(0.3, 1.1)
# Walls overlap at their edges by this share of their size; otherwise float32 would leave gaps.
OVERLAP = 1e-4

BackgroundKind = Literal["cuboid", "plane", "room", "street"]


def sample_kind(section: BackgroundSection, rng: np.random.Generator) -> BackgroundKind:
    """Sample the kind of one sequence's background by the config's weights."""
    kinds: tuple[BackgroundKind, ...] = get_args(BackgroundKind)
    weights = np.cumsum([getattr(section, kind) for kind in kinds])
    return kinds[int(np.searchsorted(weights, rng.random() * weights[-1], side="right"))]


def sample_plane(config: Config, rig: SequenceRig, rng: np.random.Generator, *, sky: bool = False) -> Instances:
    """Sample a far plane that fills both views at any moment of the sway; return a table of one row.

    With ``sky`` the plane is infinitely far away. Its ``depth_m`` then only scales the texture, and is the depth at
    which the ground ends. Raises InputError if a plane that fills the swaying view would be infinite.
    """
    camera, sway = rig.camera, rig.sway
    disparity_px = config.background.plane_disparity_px.sample(rng)
    depth = float(camera.depth_m(disparity_px))
    rays = corner_rays(camera)
    if sway.moves:
        aside = abs(camera.offset_m("right")) + sway.reach_m
        # Largest angle between a ray and the plane's normal.
        widest = float(np.arctan2(np.linalg.norm(rays[:, :2], axis=1), rays[:, 2]).max()) + sway.angle_rad
        if widest >= WIDEST_RAD:
            raise InputError(
                f"a view that sways sees up to {np.rad2deg(widest):.0f} degrees off a far plane's normal, expected "
                f"less than {np.rad2deg(WIDEST_RAD):.0f}: lower camera.sway_deg, raise the focal length, or set "
                "background.plane and background.street to 0"
            )
        if not sky and not config.disparity.signed:
            # The plane's disparity must stay above half of the sampled disparity, so its depth in the view must stay
            # below `most_m`. Both views show the plane up to the distance  half = (depth + aside) tan(widest) + aside
            # from the axis. A camera that turns sees such a point at a depth of up to  depth + half sin(angle) + reach.
            most_m, sine = float(camera.depth_m(disparity_px / 2)), np.sin(sway.angle_rad)
            growth = np.tan(widest) * sine
            depth = min(depth, (most_m - sway.reach_m - aside * (growth + sine)) / (1 + growth))
        # With a large doffs, the plane may be so near that the camera would sway into it.
        depth = max(depth, float(smallest_offsets(rig, np.array([[0.0, 0.0, 1.0]]))[0]))
    corners = _corner_points(camera, depth)
    if sky:
        # Both eyes see the sky from the same position.
        corners = np.concatenate([corners, rays / rays[:, 2:] * depth])
    low, high = corners.min(axis=0), corners.max(axis=0)
    if sway.moves:
        half = (depth + aside) * np.tan(widest) + aside
        low, high = np.minimum(low, -half), np.maximum(high, half)
    margin = 0.01 * (high - low)
    low, high = low - margin, high + margin
    world_from_face = np.diag([*(high[:2] - low[:2]), 1.0, 1.0])
    world_from_face[:3, 3] = low[0], low[1], depth
    return new_instances(1, pose=world_from_face, unit_m=(high - low)[:2], large=True, sky=sky, depth_m=depth)


def sample_cuboid(config: Config, rig: SequenceRig, rng: np.random.Generator) -> tuple[Instances, Floats]:
    """Sample the inside of a cuboid around both cameras.

    Returns a table of six rows, and the depths (R,) that the left view shows at the points of `grid_px`. The rows are
    the walls in the order +x, -x, +y, -y, +z (the back wall), -z (behind the cameras) of the cuboid's axes. A wall's
    ``depth_m`` is its median depth in the left view. For a wall that the view does not show, it is the sampled depth of
    the back wall.
    """
    camera, turn = rig.camera, np.deg2rad(config.background.wall_turn_deg)
    angles = rng.uniform(-turn, turn, 3)
    wall_m = float(camera.depth_m(sample_wall_px(config, rng)))
    farthest_m = float(camera.depth_m(config.disparity.min_px))
    fraction = _SIDE_WALL.sample_many(rng, 4)
    centre_ray = camera.rays("left", np.array((camera.width_px - 1) / 2), np.array((camera.height_px - 1) / 2))

    def axes_of(factor: float) -> Floats:
        return np.asarray(pyrr.matrix33.create_from_eulers(factor * angles), np.float64).T

    def offsets_m(normal: Floats, smallest_m: Floats) -> Floats:
        offset = np.full(6, 0.5 * wall_m)
        reach = (_corner_points(camera, wall_m) @ normal.T).max(axis=0)
        offset[:4] = smallest_m[:4] + fraction * np.maximum(reach[:4] - smallest_m[:4], 0)
        offset[4] = wall_m * max(float(normal[4] @ centre_ray), 0.1)
        # If the back wall faces all corner rays, its farthest corner has at least min_px, even if side walls hide it.
        steepest = float((corner_rays(camera) @ normal[4]).min())
        if steepest > 0:
            offset[4] = min(offset[4], farthest_m * steepest)
        return offset

    factor, offset = fit_box(rig, axes_of, offsets_m, farthest_m)
    axes = axes_of(factor)
    world_from_face, size = np.tile(np.eye(4), (6, 1, 1)), np.empty((6, 2))
    for face in range(6):
        # Walls 2 k and 2 k + 1 lie at +offset and -offset on axis k, and extend along the other two axes, i and j.
        k, sign = face // 2, 1 - 2 * (face % 2)
        i, j = (k + 1) % 3, (k + 2) % 3
        extent = np.array([offset[2 * axis] + offset[2 * axis + 1] for axis in (i, j)])
        low = -offset[[2 * i + 1, 2 * j + 1]] - OVERLAP * extent
        size[face] = (1 + 2 * OVERLAP) * extent
        corner = sign * offset[face] * axes[:, k] + low[0] * axes[:, i] + low[1] * axes[:, j]
        columns = axes[:, i] * size[face, 0], axes[:, j] * size[face, 1], axes[:, k], corner
        world_from_face[face, :3] = np.stack(columns, axis=1)
    normal = np.concatenate([(axis, -axis) for axis in axes.T])
    with np.errstate(divide="ignore"):
        depth_m = offset / (camera.rays("left", *grid_px(camera)) @ normal.T)
    depth_m[~(depth_m > 0)] = np.inf
    seen_m, hit = depth_m.min(axis=1), depth_m.argmin(axis=1)
    median_m = [np.median(seen_m[hit == k]) if (hit == k).any() else wall_m for k in range(6)]
    return new_instances(6, pose=world_from_face, unit_m=size, large=True, depth_m=median_m), seen_m


def sample_wall_px(config: Config, rng: np.random.Generator) -> float:
    """Sample the back wall's disparity at the image's centre."""
    least_px = config.disparity.min_px
    return (config.background.wall_disparity_px or Range(least_px, least_px)).sample(rng)


def _corner_points(camera: StereoCamera, depth_m: float) -> Floats:
    """Return the corners of both views at one planar depth, (R, 3), in the left camera's frame."""
    at_one_m = {eye: (rays := corner_rays(camera, [eye])) / rays[:, 2:] for eye in EYES}
    return np.concatenate([at_one_m[eye] * depth_m + np.array([camera.offset_m(eye), 0, 0]) for eye in EYES])


def lay_ground(camera: StereoCamera, depth_m: Range, across: Floats, along: Floats, offset_m: float) -> Floats:
    """Return the pose (4, 4), in the left camera's frame, with which the model `GROUND` covers a range of depths.

    The unit vectors ``across`` and ``along``, (3,) each, are parallel to the ground and point right and ahead.
    ``offset_m`` is the ground's distance from the left camera.
    """
    down = cross(along, across)
    # The wedge's tip is so far behind the cameras that the wedge fills the width of both views.
    widest = float(np.abs(corner_rays(camera)[:, 0]).max()) * 1.1
    behind = abs(camera.offset_m("right")) / widest + 0.5 * depth_m.low
    length = behind + 1.05 * depth_m.high
    columns = across * length * widest, down * length, along * length, down * offset_m - along * behind
    return np.vstack([np.stack(columns, axis=1), [0, 0, 0, 1]])
