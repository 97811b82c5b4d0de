"""A room: a box with floor, walls and ceiling, doorways and niches."""

from itertools import pairwise
from typing import Final

import numpy as np

from semisynth_gl.config import Config, Range
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.mesh import Mesh, make_mesh
from semisynth_gl.scene import Floats
from semisynth_gl.scene.arrangement import Arrangement, Catalogue, Corner, Wall, camera_over_floor
from semisynth_gl.scene.furnishing import fill_niche, furnish
from semisynth_gl.scene.rig import BEYOND_NEAR, Sway, check_reachable, near_depth_m
from semisynth_gl.scene.view_volume import (
    TURNED_BACK,
    box_normals,
    corner_rays,
    deepest_m,
    fitted_offsets,
    smallest_offsets,
)

# Range of the wall's depth, metres, in rooms of true size; a nearer or farther room is scaled.
_TRUE = Range(2.5, 9.0)
# Range of the ceiling's height, metres, in rooms of true size.
_HEIGHT = Range(2.4, 3.3)
# Begin and end of holes, as shares of the wall's edges: columns of each, and rows of doorways and of niches.
_HOLES: Final = ((0.12, 0.4), (0.37, 0.63), (0.6, 0.88))
_DOORWAY_ROWS, _NICHE_ROWS = (0.2, 1.0), (0.3, 0.62)
# Share of a wall's edges by which the space behind a hole extends beyond the hole.
_BEHIND = 1e-3
# Factors by which a second room is made smaller until it fits, and its smallest depth, in metres of the room.
_SMALLER = (1.0, 0.7, 0.5, 0.35, 0.25)
_SHALLOWEST_M = 0.3

_Rectangle = tuple[Floats, Floats, Floats]
"""Top left corner, edge to the right and edge downwards, (3,) each; see `Arrangement.add_rectangle`."""


def _pierced(low: Corner, high: Corner, name: str) -> Mesh:
    """Build the unit square of the x-y plane with a rectangular hole from ``low`` to ``high``; u is x, and v is y."""
    lines = [
        np.unique(np.concatenate([np.linspace(0, a, 4), np.linspace(a, b, 4), np.linspace(b, 1, 4)]))
        for a, b in zip(low, high, strict=True)
    ]
    x, y = (np.concatenate([grid.ravel() for grid in grids]) for grids in zip(np.meshgrid(*lines), strict=True))
    width = len(lines[0])
    triangles = []
    for j, (top, bottom) in enumerate(pairwise(lines[1])):
        for i, (left, right) in enumerate(pairwise(lines[0])):
            if low[0] <= left and right <= high[0] and low[1] <= top and bottom <= high[1]:
                continue
            first = j * width + i
            triangles += [(first, first + 1, first + width + 1), (first, first + width + 1, first + width)]
    return make_mesh(name, np.c_[x, y, np.zeros(len(x))], np.c_[x, y], triangles)


def _hole(place: int, rows: tuple[float, float]) -> tuple[Corner, Corner]:
    """Return the corners (u, v) of the hole at one of `_HOLES`."""
    (left, right), (top, bottom) = _HOLES[place], rows
    return (left, top), (right, bottom)


DOORWAYS: Final = tuple(_pierced(*_hole(k, _DOORWAY_ROWS), "wall with a doorway") for k in range(len(_HOLES)))
NICHES: Final = tuple(_pierced(*_hole(k, _NICHE_ROWS), "wall with a niche") for k in range(len(_HOLES)))


def sample_room(
    config: Config, camera: StereoCamera, catalogue: Catalogue, rng: np.random.Generator, sway: Sway
) -> Arrangement:
    """Sample a room with everything in it; nothing comes nearer than the depth of ``disparity.max_px``.

    Raises:
        InputError: where the sampled disparity of the wall lies beyond infinity.
    """
    section, background, disparity = config.room, config.background, config.disparity
    wall_px = (background.wall_disparity_px or Range(disparity.min_px, disparity.min_px)).sample(rng)
    check_reachable(camera, wall_px, "background.wall_disparity_px")
    wall_m, near_m = float(camera.depth_m(wall_px)), near_depth_m(camera, disparity)
    # Walls must keep clear of the near plane, even if a large doffs leaves hardly any depths between min_px and max_px.
    farthest_m = max(float(camera.depth_m(min(wall_px, disparity.min_px))), BEYOND_NEAR * near_m)
    metre = wall_m / float(np.clip(wall_m, _TRUE.low, _TRUE.high))
    height = section.camera_height_m.sample(rng) * metre
    row = section.floor_row.sample(rng) * camera.height_px - 0.5
    pitch = float(np.clip(np.arctan2(height, wall_m) - np.arctan2(row - camera.cy_px, camera.focal_y_px), -0.35, 0.9))
    turn = np.deg2rad(background.wall_turn_deg)
    yaw, roll = rng.uniform(-2, 2) * turn, rng.normal() * np.deg2rad(section.roll_deg)
    aside = rng.uniform(0.25, 1.15, 2)
    above = max(_HEIGHT.sample(rng) * metre - height, 0.3 * metre)
    for share in TURNED_BACK:
        angles = share * yaw, share * pitch, share * roll
        camera_from_floor = camera_over_floor(height, *angles)
        # Walls in the order right, left, ahead, behind, ceiling, floor; normals in the camera's frame.
        normal = box_normals(camera_from_floor[:3, :3])
        smallest = smallest_offsets(camera, normal, near_m, sway)
        reach = (corner_rays(camera) * wall_m @ normal.T).max(axis=0)
        offset = np.empty(6)
        offset[:2] = smallest[:2] + aside * np.maximum(reach[:2] - smallest[:2], 0.5 * metre)
        offset[2] = wall_m * max(float(np.cos(angles[0]) * np.cos(angles[1])), 0.2)
        offset[3:] = 0.5 * wall_m, above, height
        offset, in_range = fitted_offsets(camera, normal, offset, smallest, farthest_m, sway, movable=4)
        if in_range:
            break
    if offset[5] > height:
        camera_from_floor = camera_over_floor(float(offset[5]), *angles)
    right, left, ahead, behind, above, height = offset
    top = above + height
    room = Arrangement(camera, camera_from_floor, near_m, catalogue, metre, rng, farthest_m, sway)
    walls = (
        Wall(np.array([-left, ahead, top]), np.array([left + right, 0, 0]), top),
        Wall(np.array([right, ahead, top]), np.array([0, -ahead - behind, 0]), top),
        Wall(np.array([-left, -behind, top]), np.array([0, ahead + behind, 0]), top),
    )
    room.add_rectangle((-left, ahead, 0), (left + right, 0, 0), (0, -ahead - behind, 0))
    room.add_rectangle((-left, -behind, top), (left + right, 0, 0), (0, ahead + behind, 0))
    room.add_rectangle((right, -behind, top), (-left - right, 0, 0), (0, 0, -top))

    for wall in walls:
        kind = rng.random()
        if kind < section.doorway:
            _add_doorway(room, wall)
        elif kind < section.doorway + section.niche:
            _add_niche(room, wall)
        else:
            room.add_rectangle(wall.corner, wall.right, wall.down)
    furnish(room, section, walls)
    return room


def _add_doorway(room: Arrangement, wall: Wall) -> None:
    """Add a wall with a doorway and the largest room behind it that fits, or a wall without one where no room fits."""
    place = int(room.rng.integers(len(_HOLES)))
    deep = room.rng.uniform(0.8, 4) * room.metre
    aside = room.rng.uniform(0.3, 1.5) * room.metre / wall.length_m
    for share in _SMALLER:
        low, high = _HOLES[place][0] - share * aside, _HOLES[place][1] + share * aside
        behind = _behind(wall, (low, 0.0), (high, 1.0), share * deep)
        if share * deep >= _SHALLOWEST_M * room.metre and _fits(room, behind):
            _pierce(room, wall, DOORWAYS[place], _hole(place, _DOORWAY_ROWS), behind)
            return
    room.add_rectangle(wall.corner, wall.right, wall.down)


def _add_niche(room: Arrangement, wall: Wall) -> None:
    """Add a wall with a niche and things in it, or a wall without a niche where the niche does not fit."""
    place, deep = int(room.rng.integers(len(_HOLES))), room.rng.uniform(0.15, 0.4) * room.metre
    low, high = _hole(place, _NICHE_ROWS)
    behind = _behind(wall, low, high, deep)
    if not _fits(room, behind):
        room.add_rectangle(wall.corner, wall.right, wall.down)
        return
    _pierce(room, wall, NICHES[place], (low, high), behind)
    # The niche's floor, on which the things stand, lies a little below its hole.
    fill_niche(room, wall, low, (high[0], high[1] + _BEHIND), deep)


def _pierce(room: Arrangement, wall: Wall, model: Mesh, hole: tuple[Corner, Corner], behind: list[_Rectangle]) -> None:
    """Add a wall with a hole, and the rectangles that `_behind` returned; left and right side share a texture."""
    room.add_rectangle(wall.corner, wall.right, wall.down, model=model)
    wall.take(*hole)
    *others, left, right = behind
    for rectangle in others:
        room.add_rectangle(*rectangle)
    room.add_rectangle(*right, texture=room.add_rectangle(*left))


def _fits(room: Arrangement, behind: list[_Rectangle]) -> bool:
    """Return whether all views show the rectangles within the room's farthest depth."""
    faces = np.array([[corner, corner + u, corner + u + v, corner + v] for corner, u, v in behind])
    pose = room.camera_from_floor
    return deepest_m(room.camera, faces @ pose[:3, :3].T + pose[:3, 3], room.sway) <= room.farthest_m


def _behind(wall: Wall, low: Corner, high: Corner, deep: float) -> list[_Rectangle]:
    """Return the inside of a box behind a wall: its far side, floor, ceiling, left side and right side.

    The box reaches from one corner (u, v) of the wall to the opposite one, and ``deep`` metres behind the wall.
    """
    # The box is a little larger than its hole: edges that only met would leave gaps in float32.
    (left, top), (right, bottom) = (low[0] - _BEHIND, low[1] - _BEHIND), (high[0] + _BEHIND, high[1] + _BEHIND)
    across, down, out = (right - left) * wall.right, (bottom - top) * wall.down, deep * wall.out
    return [
        (wall.at(left, top, deep), across, down),
        (wall.at(left, bottom, deep), across, -out),
        (wall.at(left, top), across, out),
        (wall.at(left, top), out, down),
        (wall.at(right, top, deep), -out, down),
    ]
