"""A room: a box with floor, walls and ceiling, doorways and niches, and what stands, lies and hangs in it."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import StereoCamera
from semisynth_gl.config import Range
from semisynth_gl.config.model import BackgroundSection, DisparitySection, RoomSection
from semisynth_gl.geometry.mesh import Mesh, make_mesh
from semisynth_gl.scene.arrangement import Arrangement, Catalogue, View
from semisynth_gl.scene.background import corner_rays, first_hit, grid_px, smallest_offsets
from semisynth_gl.scene.rig import Sway, check_reachable, near_depth_m

Floats = NDArray[np.float64]

# Diameters of bounding spheres, metres.
_STANDING: Final[Mapping[str, tuple[float, float]]] = {
    "table": (1.1, 1.9),
    "chair": (0.95, 1.2),
    "bookcase": (1.2, 2.2),
    "shelf": (1.0, 1.8),
    "lamp": (0.9, 1.7),
    "clothes_rack": (1.2, 1.8),
    "potted_plant": (0.7, 1.6),
    "cactus": (0.5, 1.3),
    "fan": (0.8, 1.4),
    "ladder": (1.2, 2.1),
    "stairs": (1.2, 2.2),
    "basket": (0.4, 0.7),
    "cage": (0.5, 0.9),
    "picture_frame": (0.8, 1.4),
    "bench": (1.2, 1.9),
    "bin": (0.7, 1.1),
    "bicycle": (1.6, 1.8),
    "figure": (1.5, 1.8),
    "animal": (0.5, 1.1),
    "cushion": (0.5, 0.8),
    "blob": (0.5, 1.0),
    "cuboid": (0.4, 1.1),
    "cube": (0.4, 0.9),
    "cylinder": (0.4, 0.9),
    "capsule": (0.5, 0.9),
}
_FURNITURE: Final = {name: _STANDING[name] for name in ("table", "bookcase", "shelf", "cuboid", "cube")}
"""Things with a flat top, on which small things stand: half of all that stands."""
_AT_WALLS: Final = frozenset({"bookcase", "shelf", "picture_frame", "bench", "clothes_rack", "stairs"})
_SMALL: Final[Mapping[str, tuple[float, float]]] = {
    "bottle": (0.2, 0.35),
    "vase": (0.15, 0.4),
    "mug": (0.09, 0.14),
    "goblet": (0.14, 0.22),
    "bowl_stack": (0.15, 0.3),
    "jug": (0.2, 0.35),
    "flower": (0.25, 0.5),
    "potted_plant": (0.25, 0.5),
    "cactus": (0.15, 0.35),
    "lamp": (0.35, 0.6),
    "basket": (0.2, 0.4),
    "gear": (0.1, 0.25),
    "spring": (0.1, 0.25),
    "torus_knot": (0.12, 0.3),
    "bolt": (0.1, 0.2),
    "cushion": (0.25, 0.5),
    "animal": (0.15, 0.4),
    "figure": (0.15, 0.4),
    "blob": (0.12, 0.4),
    "car": (0.15, 0.35),
    "cube": (0.08, 0.3),
    "cuboid": (0.1, 0.4),
    "sphere": (0.08, 0.25),
    "cone": (0.1, 0.3),
    "cylinder": (0.08, 0.3),
    "pyramid": (0.1, 0.25),
    "prism": (0.1, 0.3),
    "torus": (0.1, 0.25),
    "cloth": (0.4, 0.9),
}
_HANGING: Final[Mapping[str, tuple[float, float]]] = {
    "hook_rail": (0.5, 1.0),
    "grating": (0.4, 0.9),
    "lattice_panel": (0.4, 1.0),
    "picture_frame": (0.5, 1.0),
    "gear": (0.3, 0.6),
    "spoked_wheel": (0.4, 0.8),
}

# Walls of a room whose metres are true stand so far away; a nearer or farther room is scaled.
_TRUE = Range(2.5, 9.0)
_HEIGHT = Range(2.4, 3.3)
_HOLES: Final = ((0.12, 0.4), (0.37, 0.63), (0.6, 0.88))
_TRIES = 8
# By this share of a wall's edges, what lies behind a hole goes on behind the wall.
_BEHIND = 1e-3


def _pierced(low: tuple[float, float], high: tuple[float, float], name: str) -> Mesh:
    """Build the unit square of x and y, with a rectangular hole from ``low`` to ``high``; u along x and v along y."""
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


DOORWAYS: Final = tuple(_pierced((left, 0.2), (right, 1.0), "wall with a doorway") for left, right in _HOLES)
NICHES: Final = tuple(_pierced((left, 0.3), (right, 0.62), "wall with a niche") for left, right in _HOLES)


class _Wall:
    """A wall as the room sees it: its corner at the top left, its edges to the right and down, and its far side."""

    def __init__(self, corner: Floats, right: Floats, height_m: float) -> None:
        self.corner = corner
        self.right = right
        self.down = np.array([0, 0, -height_m])
        self.length_m = float(np.linalg.norm(right))
        # From the room outwards, where "right" and "down" are as seen from inside.
        self.out = np.cross(right, self.down) / (height_m * self.length_m)
        # The corners (u, v) of its doorway or niche.
        self.hole: tuple[tuple[float, float], tuple[float, float]] | None = None

    @property
    def yaw_rad(self) -> float:
        """Turn about z of a model whose back, +y, is to the wall."""
        return float(np.arctan2(self.out[1], self.out[0]) - np.pi / 2)

    def meets_hole(self, low: tuple[float, float], high: tuple[float, float]) -> bool:
        """Whether a rectangle from one corner (u, v) to the opposite one meets the doorway or niche."""
        if self.hole is None:
            return False
        begin, end = self.hole
        return all(low[k] < end[k] and begin[k] < high[k] for k in (0, 1))

    def at(self, u: float, v: float, out_m: float = 0.0) -> Floats:
        return np.asarray(self.corner + u * self.right + v * self.down + out_m * self.out)


def draw_room(
    section: RoomSection,
    background: BackgroundSection,
    disparity: DisparitySection,
    camera: StereoCamera,
    catalogue: Catalogue,
    still: Mapping[str, int],
    rng: np.random.Generator,
    sway: Sway,
) -> Arrangement:
    """Draw a room with all that is in it; nothing comes nearer than the depth of ``disparity.max_px``.

    Args:
        section: what rooms hold.
        background: disparity and turn of the far wall.
        disparity: its limits.
        camera: the camera.
        catalogue: the models.
        still: numbers of the still models "doorway" and "niche", the first of three each.
        rng: randomness.
        sway: the motion of the camera.

    Raises:
        InputError: where a disparity lies beyond infinity.
    """
    wall_px = (background.wall_disparity_px or Range(disparity.min_px, disparity.min_px)).draw(rng)
    check_reachable(camera, wall_px, "background.wall_disparity_px")
    wall_m, near_m = float(camera.depth_m(wall_px)), near_depth_m(camera, disparity)
    farthest_m = float(camera.depth_m(min(wall_px, disparity.min_px)))
    metre = wall_m / float(np.clip(wall_m, _TRUE.low, _TRUE.high))
    height = section.camera_height_m.draw(rng) * metre
    row = section.floor_row.draw(rng) * camera.height_px - 0.5
    pitch = float(np.clip(np.arctan2(height, wall_m) - np.arctan2(row - camera.cy_px, camera.focal_px), -0.35, 0.9))
    turn = np.deg2rad(background.wall_turn_deg)
    yaw, roll = rng.uniform(-2, 2) * turn, rng.normal() * np.deg2rad(section.roll_deg)
    view = View.over_floor(camera, near_m, height, yaw, pitch, roll)
    axes = view.camera_from_floor[:3, :3]
    # Walls in the order right, left, ahead, behind, ceiling, floor; normals in the camera's frame.
    normal = np.concatenate([axes.T[k // 2][None] * (1 - 2 * (k % 2)) for k in range(6)])
    smallest = smallest_offsets(camera, normal, near_m, sway)
    reach = (corner_rays(camera) * wall_m @ normal.T).max(axis=0)
    offset = np.empty(6)
    offset[:2] = smallest[:2] + rng.uniform(0.25, 1.15, 2) * np.maximum(reach[:2] - smallest[:2], 0.5 * metre)
    offset[2] = wall_m * max(float(np.cos(yaw) * np.cos(pitch)), 0.2)
    offset[3] = 0.5 * wall_m
    offset[4] = max(_HEIGHT.draw(rng) * metre - height, 0.3 * metre)
    offset[5] = height
    offset = np.maximum(offset, smallest)
    deepest = _deepest(camera, normal, offset)
    if deepest > farthest_m:
        offset[:4] = np.maximum(offset[:4] * farthest_m / deepest, smallest[:4])
    if offset[5] > height:
        view = View.over_floor(camera, near_m, float(offset[5]), yaw, pitch, roll)
    right, left, ahead, behind, above, height = offset
    top = above + height
    room = Arrangement(view, catalogue)
    walls = (
        _Wall(np.array([-left, ahead, top]), np.array([left + right, 0, 0]), top),
        _Wall(np.array([right, ahead, top]), np.array([0, -ahead - behind, 0]), top),
        _Wall(np.array([-left, -behind, top]), np.array([0, ahead + behind, 0]), top),
    )
    room.add_rectangle((-left, ahead, 0), (left + right, 0, 0), (0, -ahead - behind, 0))
    room.add_rectangle((-left, -behind, top), (left + right, 0, 0), (0, ahead + behind, 0))
    room.add_rectangle((right, -behind, top), (-left - right, 0, 0), (0, 0, -top))
    for wall in walls:
        kind = rng.random()
        if kind < section.doorway:
            _add_doorway(room, wall, still["doorway"], farthest_m, metre, rng)
        elif kind < section.doorway + section.niche:
            _add_niche(room, wall, still["niche"], metre, rng)
        else:
            room.add_rectangle(wall.corner, wall.right, wall.down)
    _furnish(room, section, walls, metre, rng)
    return room


def _deepest(camera: StereoCamera, normal: Floats, offset: Floats) -> float:
    """Largest depth of the bare room in the left view."""
    rays = np.concatenate([corner_rays(camera, "left"), camera.rays("left", *grid_px(camera))])
    return float(first_hit(normal, offset, rays)[0].max())


def _add_doorway(
    room: Arrangement, wall: _Wall, model: int, farthest_m: float, metre: float, rng: np.random.Generator
) -> None:
    """Add a wall with a doorway and the room behind it, as deep as the disparities allow."""
    place = int(rng.integers(len(_HOLES)))
    deep = rng.uniform(0.8, 4) * metre
    aside = rng.uniform(0.3, 1.5) * metre / wall.length_m
    low, high = _HOLES[place][0] - aside, _HOLES[place][1] + aside
    corners = np.array([wall.at(u, v, deep) for u in (low, high) for v in (0, 1)])
    over = float(room.view.depth_m(corners).max()) - farthest_m
    deep -= max(over, 0.0) * 1.2
    if deep < 0.3 * metre:
        room.add_rectangle(wall.corner, wall.right, wall.down)
        return
    room.add_rectangle(wall.corner, wall.right, wall.down, model=model + place)
    wall.hole = (_HOLES[place][0], 0.2), (_HOLES[place][1], 1.0)
    _add_box_behind(room, wall, (low, 0.0), (high, 1.0), deep)


def _add_niche(room: Arrangement, wall: _Wall, model: int, metre: float, rng: np.random.Generator) -> None:
    """Add a wall with a niche, and things in it."""
    place, deep = int(rng.integers(len(_HOLES))), rng.uniform(0.15, 0.4) * metre
    room.add_rectangle(wall.corner, wall.right, wall.down, model=model + place)
    (left, right), (top, bottom) = _HOLES[place], (0.3, 0.62)
    wall.hole = (left, top), (right, bottom)
    _add_box_behind(room, wall, (left, top), (right, bottom), deep)
    for share in (np.arange(4) + rng.uniform(0.2, 0.8, 4)) / 4:
        picked = room.catalogue.pick(_SMALL, rng)
        if picked is not None and rng.random() < 0.8:
            at = wall.at(left + float(share) * (right - left), bottom + _BEHIND, 0.5 * deep)
            room.stand((picked[0], picked[1] * metre), at, rng.uniform(0, 2 * np.pi))


def _add_box_behind(
    room: Arrangement, wall: _Wall, low: tuple[float, float], high: tuple[float, float], deep: float
) -> None:
    """Add the inside of a box behind a wall: its far side, floor, ceiling and two sides."""
    # A little larger than its hole: edges that only met would leave gaps in float32.
    (left, top), (right, bottom) = (low[0] - _BEHIND, low[1] - _BEHIND), (high[0] + _BEHIND, high[1] + _BEHIND)
    across, down, out = (right - left) * wall.right, (bottom - top) * wall.down, deep * wall.out
    room.add_rectangle(wall.at(left, top, deep), across, down)
    room.add_rectangle(wall.at(left, bottom, deep), across, -out)
    room.add_rectangle(wall.at(left, top), across, out)
    side = room.add_rectangle(wall.at(left, top), out, down)
    room.add_rectangle(wall.at(right, top, deep), -out, down, wears=side)


def _furnish(
    room: Arrangement, section: RoomSection, walls: tuple[_Wall, ...], metre: float, rng: np.random.Generator
) -> None:
    tops: list[int] = []
    if rng.random() < section.rug:
        _add_rug(room, walls[0], metre, rng)
    for _ in range(round(section.pillars.draw(rng))):
        _add_pillar(room, walls, metre, rng)
    for _ in range(round(section.furniture.draw(rng))):
        placed = _add_standing(room, walls, metre, rng)
        if placed is not None:
            tops.append(placed)
    for _ in range(round(section.small.draw(rng))):
        picked = room.catalogue.pick(_SMALL, rng)
        if picked is None:
            break
        small, yaw = (picked[0], picked[1] * metre), rng.uniform(0, 2 * np.pi)
        top = _on_top(room, tops[int(rng.integers(len(tops)))], rng) if tops and rng.random() < 0.7 else None
        room.stand(small, (*_on_floor(room, walls, rng), 0) if top is None else top, yaw)
    for _ in range(round(section.pictures.draw(rng))):
        _hang(room, walls[int(rng.integers(len(walls)))], metre, rng)
    if rng.random() < section.curtain:
        _hang_curtain(room, walls[int(rng.integers(len(walls)))], rng)


def _on_top(room: Arrangement, number: int, rng: np.random.Generator) -> tuple[float, float, float] | None:
    """Draw a place on top of a thing; None where its top is not level there."""
    low, high = room.catalogue.low[room.model[number]], room.catalogue.high[room.model[number]]
    matrix, spot = room.floor_from_model[number], low + (high - low) * (*rng.uniform(0.12, 0.88, 2), 1)
    x, y, _ = matrix[:3, :3] @ spot + matrix[:3, 3]
    z = room.top(number, x, y)
    return None if z is None else (x, y, z)


def _on_floor(room: Arrangement, walls: tuple[_Wall, ...], rng: np.random.Generator) -> tuple[float, float]:
    """Draw a place on the floor, inside the walls, within the view's angle or just beside it."""
    camera, pose = room.view.camera, room.view.camera_from_floor
    ahead, right, left = walls[0], walls[1].corner[0], walls[2].corner[0]
    x, y = 0.0, 0.0
    for _ in range(_TRIES):
        column = rng.uniform(-0.1, 1.1) * camera.width_px - 0.5
        ray = pose[:3, :3].T @ np.array([(column - camera.cx_left_px) / camera.focal_px, 0, 1])
        flat = ray[:2] / np.linalg.norm(ray[:2])
        reach = min(
            ahead.corner[1] / flat[1] if flat[1] > 0 else np.inf,
            right / flat[0] if flat[0] > 0 else np.inf,
            left / flat[0] if flat[0] < 0 else np.inf,
        )
        low = min(room.view.near_m, 0.7 * reach)
        distance = np.sqrt(rng.uniform((low / reach) ** 2, 1)) * reach
        x, y = float(flat[0] * distance), float(flat[1] * distance)
        if left < x < right and y < ahead.corner[1]:
            break
    return x, y


def _add_standing(room: Arrangement, walls: tuple[_Wall, ...], metre: float, rng: np.random.Generator) -> int | None:
    """Stand a piece of furniture; return the number of one with a flat top."""
    picked = room.catalogue.pick(_FURNITURE if rng.random() < 0.5 else _STANDING, rng)
    if picked is None:
        return None
    number, size = picked[0], picked[1] * metre
    name = room.catalogue.models[number].name
    scale = rng.uniform(0.85, 1.0, 3) * size / 2
    half = (room.catalogue.high[number] - room.catalogue.low[number])[:2] * scale[:2] / 2
    for _ in range(_TRIES):
        x, y = _on_floor(room, walls, rng)
        yaw = rng.uniform(0, 2 * np.pi)
        if name in _AT_WALLS or rng.random() < 0.35:
            wall = walls[int(rng.integers(3))]
            yaw = wall.yaw_rad
            away = float((wall.corner[:2] - (x, y)) @ wall.out[:2]) - half[1] - 0.02 * metre
            x, y = x + away * wall.out[0], y + away * wall.out[1]
        radius = float(np.linalg.norm(half)) * 0.8
        if room.is_free(x, y, radius):
            placed = room.stand((number, size), (x, y, 0), yaw, scale * 2 / size)
            if placed is None:
                continue
            room.take(x, y, radius)
            return placed if name in _FURNITURE else None
    return None


def _add_rug(room: Arrangement, ahead: _Wall, metre: float, rng: np.random.Generator) -> None:
    distance = rng.uniform(0.3, 0.8) * float(ahead.corner[1])
    size, yaw = rng.uniform(0.8, 2.4, 2) * metre, rng.uniform(0, np.pi)
    room.add_box((rng.uniform(-0.3, 0.3) * distance, distance, 0), (*size / 2, 0.012 * metre), yaw)


def _add_pillar(room: Arrangement, walls: tuple[_Wall, ...], metre: float, rng: np.random.Generator) -> None:
    for _ in range(_TRIES):
        x, y = _on_floor(room, walls, rng)
        half = rng.uniform(0.12, 0.25) * metre
        if room.is_free(x, y, half) and room.add_box((x, y, 0), (half, half, -walls[0].down[2]), rng.uniform(0, 1.6)):
            room.take(x, y, 1.4 * half)
            return


def _hang(room: Arrangement, wall: _Wall, metre: float, rng: np.random.Generator) -> None:
    """Hang a picture, or a thing, on a wall; not before its doorway or niche."""
    u, v = rng.uniform(0.08, 0.92), rng.uniform(0.12, 0.6)
    picked = room.catalogue.pick(_HANGING, rng) if rng.random() < 0.3 else None
    if picked is None:
        wide, high = rng.uniform(0.3, 1.2, 2) * metre
        thick = rng.uniform(0.01, 0.04) * metre
        if wall.meets_hole((u, v), (u + wide / wall.length_m, v + high / -wall.down[2])):
            return
        corner = wall.at(u, v, -thick)
        across, down = wall.right / wall.length_m * wide, wall.down / np.linalg.norm(wall.down) * high
        if (room.view.depth_m(np.array([corner, corner + across, corner + down])) > room.view.near_m).all():
            first = room.add_rectangle(corner, across, down)
            room.add_rectangle(corner + down, across, thick * wall.out, wears=first)
            room.add_rectangle(corner, down, thick * wall.out, wears=first)
            room.add_rectangle(corner + across, down, thick * wall.out, wears=first)
        return
    number, size = picked[0], picked[1] * metre
    deep = room.catalogue.high[number][1] * size / 2
    low, high = ((u + side * size / 2 / wall.length_m, v + side * size / 2 / -wall.down[2]) for side in (-1, 1))
    if wall.meets_hole(low, high):
        return
    room.stand((number, size), wall.at(u, v, -deep) - (0, 0, size / 2), wall.yaw_rad)


def _hang_curtain(room: Arrangement, wall: _Wall, rng: np.random.Generator) -> None:
    """Hang a curtain from the ceiling, or from below it, before a wall."""
    picked = room.catalogue.pick({"curtain": (1.0, 1.0)}, rng)
    if picked is None:
        return
    number = picked[0]
    extent = room.catalogue.high[number] - room.catalogue.low[number]
    high = -wall.down[2] * rng.uniform(0.5, 0.95)
    size = 2 * high / extent[2]
    top = -wall.down[2] * 0.99 - high
    foot = wall.at(rng.uniform(0.1, 0.9), 1.0, -extent[1] * size / 2) + np.array([0, 0, top])
    room.stand((number, size), foot, wall.yaw_rad)
