"""Samples a room: a box with floor, walls and ceiling, doorways and niches."""

import numpy as np

from semisynth_gl.config import Config, Range
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.scene import Floats
from semisynth_gl.scene.background import sample_wall_px
from semisynth_gl.scene.catalogue import DOORWAY_HOLES, DOORWAYS, NICHE_HOLES, NICHES, Corner, ModelCatalogue
from semisynth_gl.scene.floor_scene import FloorSceneBuilder, Wall, camera_over_floor
from semisynth_gl.scene.furnishing import fill_niche, furnish
from semisynth_gl.scene.rig import SequenceRig
from semisynth_gl.scene.view_volume import corner_rays, deepest_m, fit_box

# Range of the far wall's depth, metres, in which rooms are not scaled.
_UNSCALED = Range(2.5, 9.0)
# Range of the ceiling's height, metres before scaling.
_CEILING = Range(2.4, 3.3)
# Share of a wall's edges by which the box behind a hole is larger than the hole on each side.
_BEHIND = 1e-3
# Factors of the size of a room behind a doorway, tried until the room fits, and its minimum depth before scaling.
_SIZES = (1.0, 0.7, 0.5, 0.35, 0.25)
_SHALLOWEST_M = 0.3


def sample_room(
    config: Config, rig: SequenceRig, catalogue: ModelCatalogue, rng: np.random.Generator
) -> FloorSceneBuilder:
    """Sample a furnished room; everything that a view shows of it is beyond the near plane."""
    section, background, camera = config.room, config.background, rig.camera
    wall_px = sample_wall_px(config, rng)
    wall_m = float(camera.depth_m(wall_px))
    # A large doffs may leave hardly any depths between min_px and max_px; walls must still be beyond the near plane.
    farthest_m = max(float(camera.depth_m(min(wall_px, config.disparity.min_px))), rig.clear_m)
    metre = wall_m / float(np.clip(wall_m, _UNSCALED.low, _UNSCALED.high))
    height = section.camera_height_m.sample(rng) * metre
    row = section.floor_row.sample(rng) * camera.height_px - 0.5
    pitch = float(np.clip(np.arctan2(height, wall_m) - np.arctan2(row - camera.cy_px, camera.focal_y_px), -0.35, 0.9))
    turn = np.deg2rad(background.wall_turn_deg)
    yaw, roll = rng.uniform(-2, 2) * turn, rng.normal() * np.deg2rad(section.roll_deg)
    aside = rng.uniform(0.25, 1.15, 2)
    above = max(_CEILING.sample(rng) * metre - height, 0.3 * metre)

    def camera_from(height_m: float, factor: float) -> Floats:
        return camera_over_floor(height_m, factor * yaw, factor * pitch, factor * roll)

    def offsets_m(normal: Floats, smallest_m: Floats) -> Floats:
        # The walls are in the order right, left, ahead, behind, ceiling, floor.
        reach = (corner_rays(camera) * wall_m @ normal.T).max(axis=0)
        sides = smallest_m[:2] + aside * np.maximum(reach[:2] - smallest_m[:2], 0.5 * metre)
        return np.array([*sides, wall_m * max(float(normal[2, 2]), 0.2), 0.5 * wall_m, above, height])

    factor, offset = fit_box(rig, lambda factor: camera_from(height, factor)[:3, :3], offsets_m, farthest_m, movable=4)
    right, left, ahead, behind, above, height = offset
    room = FloorSceneBuilder(rig, camera_from(float(height), factor), catalogue, metre, rng, farthest_m)
    top = above + height
    walls = (  # ahead, on the right, on the left
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
            pierced = _add_doorway(room, wall)
        else:
            pierced = kind < section.doorway + section.niche and _add_niche(room, wall)
        if not pierced:
            room.add_rectangle(wall.corner, wall.right, wall.down)
    furnish(room, section, walls)
    return room


def _add_doorway(room: FloorSceneBuilder, wall: Wall) -> bool:
    """Add a wall with a doorway, and the largest room behind it that fits; return False if no room fits."""
    number = int(room.rng.integers(len(DOORWAYS)))
    deep = room.rng.uniform(0.8, 4) * room.metre
    aside = room.rng.uniform(0.3, 1.5) * room.metre / wall.length_m
    (left, _), (right, _) = DOORWAY_HOLES[number]
    for factor in _SIZES:
        low, high = (left - factor * aside, 0.0), (right + factor * aside, 1.0)
        is_deep = factor * deep >= _SHALLOWEST_M * room.metre
        if is_deep and _pierce(room, wall, DOORWAYS[number], low, high, factor * deep):
            wall.taken.append(DOORWAY_HOLES[number])
            return True
    return False


def _add_niche(room: FloorSceneBuilder, wall: Wall) -> bool:
    """Add a wall with a niche and things in the niche; return False if the niche does not fit."""
    number, deep = int(room.rng.integers(len(NICHES))), room.rng.uniform(0.15, 0.4) * room.metre
    low, high = NICHE_HOLES[number]
    if not _pierce(room, wall, NICHES[number], low, high, deep):
        return False
    wall.taken.append((low, high))
    # The niche's floor, on which the things stand, is a little below the hole.
    fill_niche(room, wall, low, (high[0], high[1] + _BEHIND), deep)
    return True


def _pierce(room: FloorSceneBuilder, wall: Wall, model: Mesh, low: Corner, high: Corner, deep: float) -> bool:
    """Add a wall with a hole, and the inside of a box behind the hole; return False if a view would see too deep.

    ``low`` and ``high`` are opposite corners (u, v) of the box on the wall. The box is ``deep`` metres deep.
    """
    # The box is a little larger than the hole; otherwise float32 would leave gaps.
    (left, top), (right, bottom) = (low[0] - _BEHIND, low[1] - _BEHIND), (high[0] + _BEHIND, high[1] + _BEHIND)
    across, down, out = (right - left) * wall.right, (bottom - top) * wall.down, deep * wall.out
    # Each face of the box: top left corner, edge to the right, and edge down.
    left_side = wall.at(left, top), out, down
    right_side = wall.at(right, top, deep), -out, down
    far_side = wall.at(left, top, deep), across, down
    floor, ceiling = (wall.at(left, bottom, deep), across, -out), (wall.at(left, top), across, out)
    behind = [far_side, floor, ceiling, left_side, right_side]
    faces = np.array([[corner, corner + u, corner + u + v, corner + v] for corner, u, v in behind])
    pose = room.camera_from_floor
    if deepest_m(room.rig, faces @ pose[:3, :3].T + pose[:3, 3]) > room.farthest_m:
        return False
    room.add_rectangle(wall.corner, wall.right, wall.down, model=model)
    for face in (far_side, floor, ceiling):
        room.add_rectangle(*face)
    shared = room.add_rectangle(*left_side)
    room.add_rectangle(*right_side, texture=shared)
    return True
