"""Furnishes a room with things that stand or hang."""

from typing import Final

import numpy as np

from semisynth_gl.config.scene_sections import RoomSection
from semisynth_gl.scene import Floats
from semisynth_gl.scene.catalogue import Corner
from semisynth_gl.scene.floor_scene import Diameters, FloorSceneBuilder, SizedModel, Wall
from semisynth_gl.scene.resting import surfaces_below
from semisynth_gl.scene.scene import transform_vertices

# Diameters of the bounding spheres: of things that stand on the floor, of small things that stand on the floor or on
# furniture, and of things that hang on walls.
_STANDING: Final[Diameters] = {
    "table": (1.1, 1.9), "chair": (0.95, 1.2), "bookcase": (1.2, 2.2), "shelf": (1.0, 1.8),
    "lamp": (0.9, 1.7), "clothes_rack": (1.2, 1.8), "potted_plant": (0.7, 1.6), "cactus": (0.5, 1.3),
    "fan": (0.8, 1.4), "ladder": (1.2, 2.1), "stairs": (1.2, 2.2), "basket": (0.4, 0.7),
    "cage": (0.5, 0.9), "picture_frame": (0.8, 1.4), "bench": (1.2, 1.9), "bin": (0.7, 1.1),
    "bicycle": (1.6, 1.8), "figure": (1.5, 1.8), "animal": (0.5, 1.1), "cushion": (0.5, 0.8),
    "blob": (0.5, 1.0), "cuboid": (0.4, 1.1), "cube": (0.4, 0.9), "cylinder": (0.4, 0.9),
    "capsule": (0.5, 0.9),
}  # fmt: skip
_FLAT_TOPPED: Final = {name: _STANDING[name] for name in ("table", "bookcase", "shelf", "cuboid", "cube")}
"""Things with a flat top, on which small things can stand; half of the furniture is chosen from these kinds only."""
_AT_WALLS: Final = frozenset({"bookcase", "shelf", "picture_frame", "bench", "clothes_rack", "stairs"})
_SMALL: Final[Diameters] = {
    "bottle": (0.2, 0.35), "vase": (0.15, 0.4), "mug": (0.09, 0.14), "goblet": (0.14, 0.22),
    "bowl_stack": (0.15, 0.3), "jug": (0.2, 0.35), "flower": (0.25, 0.5), "potted_plant": (0.25, 0.5),
    "cactus": (0.15, 0.35), "lamp": (0.35, 0.6), "basket": (0.2, 0.4), "gear": (0.1, 0.25),
    "spring": (0.1, 0.25), "torus_knot": (0.12, 0.3), "bolt": (0.1, 0.2), "cushion": (0.25, 0.5),
    "animal": (0.15, 0.4), "figure": (0.15, 0.4), "blob": (0.12, 0.4), "car": (0.15, 0.35),
    "cube": (0.08, 0.3), "cuboid": (0.1, 0.4), "sphere": (0.08, 0.25), "cone": (0.1, 0.3),
    "cylinder": (0.08, 0.3), "pyramid": (0.1, 0.25), "prism": (0.1, 0.3), "torus": (0.1, 0.25),
    "cloth": (0.4, 0.9),
}  # fmt: skip
_HANGING: Final[Diameters] = {
    "hook_rail": (0.5, 1.0), "grating": (0.4, 0.9), "lattice_panel": (0.4, 1.0), "picture_frame": (0.5, 1.0),
    "gear": (0.3, 0.6), "spoked_wheel": (0.4, 0.8),
}  # fmt: skip

_TRIES = 8
# Cosine of the steepest slope on which a small thing can stand.
_LEVEL = 0.98


def furnish(room: FloorSceneBuilder, section: RoomSection, walls: tuple[Wall, ...]) -> None:
    """Put things into a room, as many as the config says; a thing for which no free spot is found is left out.

    ``walls`` are the wall ahead, the right and the left wall.
    """
    rng, tops = room.rng, list[int]()
    if rng.random() < section.rug:
        _add_rug(room, walls[0])
    for _ in range(round(section.pillars.sample(rng))):
        _add_pillar(room, walls)
    for _ in range(round(section.furniture.sample(rng))):
        number = _add_standing(room, walls)
        if number is not None:
            tops.append(number)
    for _ in range(round(section.small.sample(rng))):
        picked = room.pick(_SMALL)
        if picked is None:
            break
        yaw = rng.uniform(0, 2 * np.pi)
        top = _sample_top_spot(room, tops[int(rng.integers(len(tops)))]) if tops and rng.random() < 0.7 else None
        room.stand(picked, (*_sample_floor_spot(room, walls), 0) if top is None else top, yaw)
    if rng.random() < section.curtain:
        _hang_curtain(room, walls[int(rng.integers(len(walls)))])
    for _ in range(round(section.pictures.sample(rng))):
        _hang(room, walls)


def fill_niche(room: FloorSceneBuilder, wall: Wall, low: Corner, high: Corner, deep_m: float) -> None:
    """Stand small things in a niche of a wall, given two opposite corners (u, v) of the niche and its depth."""
    for share in (np.arange(4) + room.rng.uniform(0.2, 0.8, 4)) / 4:
        picked = room.pick(_SMALL)
        if picked is not None and room.rng.random() < 0.8:
            at = wall.at(low[0] + float(share) * (high[0] - low[0]), high[1], 0.5 * deep_m)
            room.stand(picked, at, room.rng.uniform(0, 2 * np.pi))


def _sample_top_spot(room: FloorSceneBuilder, number: int) -> tuple[float, float, float] | None:
    """Sample a position (x, y, z) on top of a thing, given its number; return None if the top is not level there."""
    model, pose = room.things[number]["model"], room.things[number]["pose"]
    mesh, low, high = room.catalogue.models[model], room.catalogue.low[model], room.catalogue.high[model]
    position = low + (high - low) * (*room.rng.uniform(0.12, 0.88, 2), 1)
    x, y, _ = pose[:3, :3] @ position + pose[:3, 3]
    corners = transform_vertices(mesh, pose)[mesh.triangles]
    [height], [normal] = surfaces_below(corners, np.array([[x, y, np.inf]]))
    return (x, y, float(height)) if normal[2] >= _LEVEL else None


def _sample_floor_spot(room: FloorSceneBuilder, walls: tuple[Wall, ...]) -> tuple[float, float]:
    """Sample a position (x, y) on the floor, inside the walls, in the view or just beside it."""
    camera, pose = room.rig.camera, room.camera_from_floor
    ahead, right, left = walls[0].corner[1], walls[1].corner[0], walls[2].corner[0]
    column = room.rng.uniform(-0.1, 1.1) * camera.width_px - 0.5
    # The direction of this column over the floor, and the distance at which it meets a wall.
    ray = pose[:3, :3].T @ np.array([(column - camera.cx_left_px) / camera.focal_px, 0, 1])
    flat = ray[:2] / np.linalg.norm(ray[:2])
    reach = min(
        ahead / flat[1] if flat[1] > 0 else np.inf,
        right / flat[0] if flat[0] > 0 else np.inf,
        left / flat[0] if flat[0] < 0 else np.inf,
    )
    low = min(room.rig.near_m, 0.7 * reach)
    distance = np.sqrt(room.rng.uniform((low / reach) ** 2, 1)) * reach
    return float(flat[0] * distance), float(flat[1] * distance)


def _add_standing(room: FloorSceneBuilder, walls: tuple[Wall, ...]) -> int | None:
    """Stand a piece of furniture where the floor is free; return its number if it has a flat top, else None."""
    rng = room.rng
    picked = room.pick(_FLAT_TOPPED if rng.random() < 0.5 else _STANDING)
    if picked is None:
        return None
    name = room.catalogue.models[picked.number].name
    stretch = rng.uniform(0.85, 1.0, 3)
    half = room.catalogue.extent(picked.number)[:2] * stretch[:2] * picked.size_m / 4
    radius = float(np.linalg.norm(half)) * 0.8
    for _ in range(_TRIES):
        x, y = _sample_floor_spot(room, walls)
        yaw = rng.uniform(0, 2 * np.pi)
        # Kinds of `_AT_WALLS`, and some other things, are moved backwards to a wall.
        if name in _AT_WALLS or rng.random() < 0.35:
            wall = walls[int(rng.integers(3))]
            yaw = wall.yaw_rad
            away = float((wall.corner[:2] - (x, y)) @ wall.out[:2]) - half[1] - 0.02 * room.metre
            x, y = x + away * wall.out[0], y + away * wall.out[1]
        stood = room.stand(picked, (x, y, 0), yaw, stretch) if room.is_free(x, y, radius) else None
        if stood is not None:
            room.taken.append((x, y, radius))
            return stood if name in _FLAT_TOPPED else None
    return None


def _add_rug(room: FloorSceneBuilder, ahead: Wall) -> None:
    distance = room.rng.uniform(0.3, 0.8) * float(ahead.corner[1])
    size, yaw = room.rng.uniform(0.8, 2.4, 2) * room.metre, room.rng.uniform(0, np.pi)
    room.add_box((room.rng.uniform(-0.3, 0.3) * distance, distance, 0), (*size, 0.012 * room.metre), yaw)


def _add_pillar(room: FloorSceneBuilder, walls: tuple[Wall, ...]) -> None:
    for _ in range(_TRIES):
        x, y = _sample_floor_spot(room, walls)
        half = room.rng.uniform(0.12, 0.25) * room.metre
        size = 2 * half, 2 * half, walls[0].height_m
        if room.is_free(x, y, half) and room.add_box((x, y, 0), size, room.rng.uniform(0, 1.6)) is not None:
            room.taken.append((x, y, 1.4 * half))
            return


def _hang(room: FloorSceneBuilder, walls: tuple[Wall, ...]) -> None:
    """Hang a picture or a model on a wall, clear of doorways, niches and other things on the wall."""
    rng = room.rng
    picked = room.pick(_HANGING) if rng.random() < 0.3 else None
    for _ in range(_TRIES):
        wall, u, v = walls[int(rng.integers(len(walls)))], rng.uniform(0.02, 0.9), rng.uniform(0.06, 0.6)
        if picked is None:
            wide, high = rng.uniform(0.3, 1.2, 2) * room.metre
        else:
            wide, _, high = room.extent_m(picked)
        low, opposite = (u, v), (u + wide / wall.length_m, v + high / wall.height_m)
        if not wall.is_free(low, opposite):
            continue
        if picked is None:
            hung = _hang_picture(room, wall, wall.at(u, v), wide, high, rng.uniform(0.01, 0.04) * room.metre)
        else:
            deep = room.catalogue.high[picked.number][1] * picked.size_m / 2
            foot = wall.at((u + opposite[0]) / 2, opposite[1], -deep)
            hung = room.stand(picked, foot, wall.yaw_rad) is not None
        if hung:
            wall.taken.append((low, opposite))
            return


def _hang_picture(room: FloorSceneBuilder, wall: Wall, corner: Floats, wide: float, high: float, thick: float) -> bool:
    """Hang a picture, given its top left corner (3,), on a wall; return False if it would be too near to the camera."""
    corner = corner - thick * wall.out
    across, down = wall.right / wall.length_m * wide, wall.down / np.linalg.norm(wall.down) * high
    if (room.depths_m(np.array([corner, corner + across, corner + down])) <= room.rig.near_m).any():
        return False
    first = room.add_rectangle(corner, across, down)
    room.add_rectangle(corner + down, across, thick * wall.out, texture=first)
    room.add_rectangle(corner, down, thick * wall.out, texture=first)
    room.add_rectangle(corner + across, down, thick * wall.out, texture=first)
    return True


def _hang_curtain(room: FloorSceneBuilder, wall: Wall) -> None:
    """Hang a curtain in front of a wall, from just below the ceiling."""
    picked = room.pick({"curtain": (1.0, 1.0)})
    if picked is None:
        return
    extent = room.catalogue.extent(picked.number)
    high = wall.height_m * room.rng.uniform(0.5, 0.95)
    size = 2 * high / extent[2]
    top = wall.height_m * 0.99 - high
    middle, half = room.rng.uniform(0.1, 0.9), extent[0] * size / 4 / wall.length_m
    foot = wall.at(middle, 1.0, -extent[1] * size / 2) + np.array([0, 0, top])
    if room.stand(SizedModel(picked.number, size), foot, wall.yaw_rad) is not None:
        wall.taken.append(((middle - half, 0.0), (middle + half, 1.0)))
