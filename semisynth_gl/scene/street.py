"""Samples a street: a ground to the horizon, a road with kerbs, houses, vehicles, trees, fences and people."""

from typing import Final

import numpy as np

from semisynth_gl.config import Config, Range
from semisynth_gl.config.scene_sections import StreetSection
from semisynth_gl.geometry.mesh import cross
from semisynth_gl.scene.background import lay_ground, sample_plane
from semisynth_gl.scene.catalogue import FACE, GROUND, SURFACE_MODELS, ModelCatalogue
from semisynth_gl.scene.floor_scene import Diameters, FloorSceneBuilder, camera_over_floor
from semisynth_gl.scene.rig import SequenceRig
from semisynth_gl.scene.view_volume import smallest_offsets

_VEHICLES: Final[Diameters] = {"car": (4.2, 5.6), "bicycle": (1.7, 1.9)}
_HOUSES: Final[Diameters] = {"house": (10, 20)}
_TALL: Final[Diameters] = {"tree": (4, 9), "street_lamp": (5, 9), "road_sign": (2.2, 3), "scaffold": (4, 8)}
_LOW: Final[Diameters] = {
    "figure": (1.6, 1.9), "animal": (0.6, 1.3), "bench": (1.4, 2.2), "bin": (0.9, 1.3),
    "potted_plant": (0.8, 1.6), "grass": (0.5, 1.4), "road_sign": (2.0, 2.8), "cuboid": (0.5, 1.4),
    "cylinder": (0.6, 1.2), "ladder": (2, 3.5), "chair": (1.0, 1.2), "table": (1.2, 2.0),
    "clothes_rack": (1.5, 1.9),
}  # fmt: skip
_FENCES: Final[Diameters] = {"fence": (2.2, 3.0)}

# Minimum depth of the backdrop of a street that is not scaled; with a nearer backdrop, the whole street is scaled down.
_UNSCALED_M = 25.0
# Maximum distance of things, and height of kerbs, metres before scaling.
_FARTHEST = 90.0
_KERB = 0.14
# Number of positions to try for a thing.
_TRIES = 6

_Span = tuple[float, float]
"""Begin and end of an interval, metres."""


def sample_street(
    config: Config, rig: SequenceRig, catalogue: ModelCatalogue, rng: np.random.Generator, *, sky: bool = False
) -> FloorSceneBuilder:
    """Sample a street; everything that a view shows of it is beyond the near plane.

    The first thing is the backdrop: the sky if ``sky`` is set, else a far plane. Raises InputError as `sample_plane`
    does.
    """
    section, near_m = config.street, rig.near_m
    [backdrop] = sample_plane(config, rig, rng, sky=sky)
    backdrop_m = float(backdrop["depth_m"])
    metre = min(1.0, backdrop_m / _UNSCALED_M)
    yaw, pitch, roll = np.deg2rad(rng.normal(size=3) * (section.yaw_deg, section.tilt_deg, section.tilt_deg))
    height = section.camera_height_m.sample(rng) * metre
    down = -camera_over_floor(height, yaw, pitch, roll)[:3, 2]
    height = max(height, float(smallest_offsets(rig, down[None])[0]))
    camera_from_floor = camera_over_floor(height, yaw, pitch, roll)
    street = FloorSceneBuilder(rig, camera_from_floor, catalogue, metre, rng)
    pose = np.linalg.inv(camera_from_floor) @ backdrop["pose"]
    street.add(SURFACE_MODELS.index(FACE), pose, backdrop["unit_m"])
    # The ground's length is along the camera's viewing direction.
    ahead = camera_from_floor[2, :3] * (1, 1, 0)
    along = camera_from_floor[:3, :3] @ (ahead / np.linalg.norm(ahead))
    across = cross(along, camera_from_floor[:3, 2])
    ground = lay_ground(rig.camera, Range(near_m, backdrop_m), across, along, height)
    sizes = np.linalg.norm(ground[:3, [0, 2]], axis=0)
    street.add(SURFACE_MODELS.index(GROUND), np.linalg.inv(camera_from_floor) @ ground, sizes)
    ahead_m = near_m, min(backdrop_m, _FARTHEST * metre)
    road = section.road_width_m.sample(rng) * metre / 2
    pavement = rng.uniform(1.5, 4) * metre
    middle = rng.uniform(-0.5, 0.5) * road
    for side in (-1, 1):
        if rng.random() < section.pavement:
            _add_pavement(street, middle + side * road, side, pavement, ahead_m)
        _add_row(street, section, middle + side * (road + pavement), side, ahead_m)
    for _ in range(round(section.vehicles.sample(rng))):
        lane = rng.uniform(0.3, 0.85) if rng.random() < 0.8 else rng.uniform(-0.2, 0.2)
        x = middle + (road * lane) * rng.choice((-1, 1))
        facing = rng.normal() * 0.06 + np.pi * int(rng.integers(2))
        _stand(street, _VEHICLES, (x, x), ahead_m, facing)
    for sizes, count in ((_TALL, section.tall), (_LOW, section.low)):
        for _ in range(round(count.sample(rng))):
            side = rng.choice((-1, 1))
            span = sorted((middle + side * road, middle + side * (road + pavement)))
            _stand(street, sizes, (span[0], span[1]), ahead_m)
    return street


def _add_pavement(street: FloorSceneBuilder, kerb: float, side: int, width: float, ahead_m: _Span) -> None:
    """Add a pavement of slabs, which are longer at a distance; slabs too near to the camera are not added."""
    (near_m, reach), metre = ahead_m, street.metre
    begin, first = 0.3 * near_m, None
    while begin < reach:
        end = min(begin + max(2.0 * metre, 0.6 * begin), reach)
        middle = (kerb + side * width / 2, (begin + end) / 2, 0)
        added = street.add_box(middle, (width, end - begin, _KERB * metre), texture=first)
        if added is not None:
            first = added if first is None else first
            street.raised.append(((middle[0] - width / 2, begin), (middle[0] + width / 2, end), _KERB * metre))
        begin = end


def _add_row(street: FloorSceneBuilder, section: StreetSection, border: float, side: int, ahead_m: _Span) -> None:
    """Add houses, fences and gaps along one side of the road; ``side`` is -1 for the left, 1 for the right.

    ``border`` is x of the pavement's outer edge.
    """
    metre, rng = street.metre, street.rng
    y = rng.uniform(0.2, 1.5) * ahead_m[0]
    while y < ahead_m[1]:
        kind = rng.random()
        if kind < section.houses:
            back = rng.uniform(0.1, 3) * metre
            long, high = rng.uniform(6, 16) * metre, rng.uniform(3, 12) * metre
            picked = street.pick(_HOUSES)
            facing = -side * np.pi / 2  # turns the front, -y, to the road
            if picked is not None and rng.random() < 0.7:
                wide, deep, _ = street.extent_m(picked)
                street.stand(picked, (border + side * (back + deep / 2), y + wide / 2, 0), facing)
                y += wide + rng.uniform(0, 2) * metre
            else:
                street.add_box((border + side * (back + 4 * metre), y + long / 2, 0), (8 * metre, long, high))
                y += long + rng.uniform(0, 4) * metre
        elif kind < section.houses + section.fences:
            for _ in range(int(rng.integers(2, 7))):
                picked = street.pick(_FENCES)
                if picked is None:
                    break
                wide, deep, _ = street.extent_m(picked)
                # Keep the fence clear of the pavement's edge.
                street.stand(picked, (border + side * (0.1 * metre + deep / 2), y + wide / 2, 0), np.pi / 2)
                y += wide
            y += 0.5 * metre
        else:
            y += rng.uniform(3, 12) * metre


def _stand(street: FloorSceneBuilder, sizes_m: Diameters, x_m: _Span, y_m: _Span, yaw_rad: float | None = None) -> None:
    """Stand a thing where the floor is free, at a distance that is log-uniform; by default the yaw is random."""
    picked, rng = street.pick(sizes_m), street.rng
    if picked is None:
        return
    radius = float(street.extent_m(picked)[:2].max()) / 2
    for _ in range(_TRIES):
        x = rng.uniform(*x_m)
        y = y_m[0] * (y_m[1] / y_m[0]) ** rng.random()
        yaw = rng.uniform(0, 2 * np.pi) if yaw_rad is None else yaw_rad
        if street.is_free(x, y, radius) and street.stand(picked, (x, y, street.floor_m(x, y)), yaw) is not None:
            street.taken.append((x, y, radius))
            return
