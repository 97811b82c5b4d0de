"""Builds scenes of static instances over a floor: upright models, boxes, rectangles and walls."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from semisynth_gl.geometry.mesh import Mesh, cross
from semisynth_gl.geometry.rotations import about_z
from semisynth_gl.scene import Floats
from semisynth_gl.scene.background import OVERLAP
from semisynth_gl.scene.catalogue import FACE, SURFACE_MODELS, Corner, ModelCatalogue
from semisynth_gl.scene.instances import INSTANCE, Instances, new_instances
from semisynth_gl.scene.rig import SequenceRig

# Kinds of models that always get a large patch, like walls.
_LARGE = frozenset({"house"})

Diameters = Mapping[str, tuple[float, float]]
"""The smallest and the largest diameter of the bounding sphere of each kind, by the kind's name, metres."""


class SizedModel(NamedTuple):
    """A model of a catalogue, and its size."""

    number: int  # index into the catalogue's models
    size_m: float  # diameter of the bounding sphere


def camera_over_floor(height_m: float, yaw_rad: float, pitch_rad: float, roll_rad: float) -> Floats:
    """Return camera_from_floor, (4, 4), of a left camera over a floor.

    The floor's frame has its origin below the camera; x points right, y ahead and z up. The optical axis is turned by
    the yaw from y to the right, and by the pitch downwards; a positive roll moves the camera's right side down.
    """
    ahead = np.array([np.sin(yaw_rad) * np.cos(pitch_rad), np.cos(yaw_rad) * np.cos(pitch_rad), -np.sin(pitch_rad)])
    right = np.array([np.cos(yaw_rad), -np.sin(yaw_rad), 0.0])
    down = cross(ahead, right)
    rolled = np.cos(roll_rad) * right + np.sin(roll_rad) * down
    matrix = np.eye(4)
    matrix[:3, :3] = rolled, cross(ahead, rolled), ahead
    matrix[:3, 3] = -matrix[:3, 2] * height_m
    return matrix


@dataclass(slots=True, eq=False)
class FloorSceneBuilder:
    """Builds the static instances of a room or a street one by one, in the floor's frame; see `camera_over_floor`."""

    rig: SequenceRig
    camera_from_floor: Floats  # (4, 4), metres
    catalogue: ModelCatalogue
    metre: float  # metres that 1 m of the room or street takes after scaling; 1 without scaling
    rng: np.random.Generator
    farthest_m: float = np.inf  # intended maximum depth in all views
    things: list[np.void] = field(default_factory=list)  # rows of `INSTANCE`, whose poses are floor_from_model
    taken: list[tuple[float, float, float]] = field(default_factory=list)  # occupied circles of the floor: x, y, radius
    raised: list[tuple[Corner, Corner, float]] = field(default_factory=list)  # pavements: opposite corners, height

    def table(self) -> Instances:
        """Return the table of the instances in the left camera's frame; ``depth_m`` is that of a model's origin."""
        table = np.array(self.things, INSTANCE)
        table["pose"] = self.camera_from_floor @ table["pose"]
        table["depth_m"] = np.maximum(table["pose"][:, 2, 3], self.rig.near_m)
        return table

    def depths_m(self, points: Floats) -> Floats:
        """Return the planar depths (N,) of points (N, 3) of the floor's frame, for the left camera."""
        return np.asarray(points @ self.camera_from_floor[2, :3] + self.camera_from_floor[2, 3])

    def pick(self, sizes_m: Diameters) -> SizedModel | None:
        """Choose a model from several kinds, which are equally likely; return None if the library has none of them.

        The size is uniform between the limits of ``sizes_m``, and then scaled with the room or street.
        """
        kind, variant, size = self.rng.random(3)
        known = [name for name in sizes_m if name in self.catalogue.by_name]
        if not known:
            return None
        name = known[int(kind * len(known))]
        numbers = self.catalogue.by_name[name]
        low, high = sizes_m[name]
        size_m = (low + (high - low) * float(size)) * self.metre
        return SizedModel(int(numbers[int(variant * len(numbers))]), size_m)

    def extent_m(self, model: SizedModel) -> Floats:
        """Return the lengths (3,) of a model's bounding box, in metres."""
        return self.catalogue.extent(model.number) * model.size_m / 2

    def add(
        self, model: int, pose: Floats, unit_m: ArrayLike, texture: int | None = None, *, large: bool = True
    ) -> int:
        """Add a row to the list of things; return its number.

        ``model`` is the model's number in the catalogue. The other arguments are columns of `INSTANCE`; by default the
        texture is a new one.
        """
        number = len(self.things)
        texture = number if texture is None else texture
        self.things.append(new_instances(1, model=model, pose=pose, unit_m=unit_m, texture=texture, large=large)[0])
        return number

    def add_rectangle(
        self, corner: ArrayLike, u: ArrayLike, v: ArrayLike, *, model: Mesh = FACE, texture: int | None = None
    ) -> int:
        """Add a rectangle whose texture is upright and unmirrored; return the rectangle's number.

        Seen from the front, ``corner`` (3,) is at the top left, and the edges ``u`` and ``v``, (3,) each, lead right
        and down. ``model`` is a surface model over the unit square.
        """
        edges = np.array([u, v], np.float64)
        sizes = np.linalg.norm(edges, axis=1)
        matrix = np.eye(4)
        matrix[:3, 0], matrix[:3, 1] = edges * (1 + 2 * OVERLAP)
        matrix[:3, 2] = cross(edges[0], edges[1]) / sizes.prod() * sizes.mean()
        matrix[:3, 3] = np.asarray(corner, np.float64) - OVERLAP * edges.sum(axis=0)
        return self.add(SURFACE_MODELS.index(model), matrix, sizes, texture)

    def add_box(
        self, middle: ArrayLike, size: ArrayLike, yaw_rad: float = 0.0, texture: int | None = None
    ) -> int | None:
        """Add the five sides of a box that has no bottom; return the number of the first side.

        A box too near to the camera is not added: the result is None. ``middle`` (3,) is the middle of the bottom.
        ``size`` (3,) has the width, the depth and the height. All sides have the texture of the thing number
        ``texture``, by default a new one.
        """
        (x, y, z), at = np.asarray(size, np.float64) * (0.5, 0.5, 1), np.asarray(middle, np.float64)
        turn = about_z(yaw_rad)
        if self._too_near((-x, -y, 0), (x, y, z), turn, at):
            return None
        first = len(self.things)
        for corner, u, v in (
            ((-x, -y, z), (2 * x, 0, 0), (0, 0, -z)),
            ((x, -y, z), (0, 2 * y, 0), (0, 0, -z)),
            ((x, y, z), (-2 * x, 0, 0), (0, 0, -z)),
            ((-x, y, z), (0, -2 * y, 0), (0, 0, -z)),
            ((-x, y, z), (2 * x, 0, 0), (0, -2 * y, 0)),
        ):
            self.add_rectangle(turn @ corner + at, turn @ u, turn @ v, texture=first if texture is None else texture)
        return first

    def stand(self, model: SizedModel, at: ArrayLike, yaw_rad: float, stretch: Floats | float = 1.0) -> int | None:
        """Stand a model upright on the point ``at`` (3,), which is below the model's origin; return the thing's number.

        A model too near to the camera is not added: the result is None. ``stretch`` is a factor of the size, or one
        factor for each axis of the model, (3,).
        """
        number = model.number
        scale = model.size_m / 2 * (np.ones(3) * stretch)
        low, high = self.catalogue.low[number] * scale, self.catalogue.high[number] * scale
        origin, turn = np.asarray(at, np.float64) - (0, 0, low[2]), about_z(yaw_rad)
        if self._too_near(low, high, turn, origin):
            return None
        matrix = np.eye(4)
        matrix[:3, :3] = turn * scale
        matrix[:3, 3] = origin
        return self.add(number, matrix, scale.mean(), large=self.catalogue.models[number].name in _LARGE)

    def _too_near(self, low: ArrayLike, high: ArrayLike, turn: Floats, at: Floats) -> bool:
        """Return whether a box between two opposite corners, rotated and then moved, is too near to the camera."""
        corners = np.array(list(product(*np.stack([low, high], axis=1))))
        return bool(self.depths_m(corners @ turn.T + at).min() < self.rig.clear_m)

    def floor_m(self, x: float, y: float) -> float:
        """Return the height of the floor at a point: 0, or the height of a pavement."""
        return next((z for (a, b), (c, d), z in self.raised if a < x < c and b < y < d), 0.0)

    def is_free(self, x: float, y: float, radius_m: float) -> bool:
        """Return whether a circle is clear of all taken circles; circles may overlap by a fifth of their radii."""
        return all((x - a) ** 2 + (y - b) ** 2 > (0.8 * (radius_m + r)) ** 2 for a, b, r in self.taken)


class Wall:
    """A wall, seen from inside the room.

    ``corner`` is the top left corner. The edges ``right`` and ``down`` begin there. ``out`` is the outward unit normal.
    All are (3,), in the floor's frame. ``taken`` lists the rectangles of the wall's hole and of the things that hang on
    the wall, each as opposite corners (u, v) in fractions of the edges.
    """

    def __init__(self, corner: Floats, right: Floats, height_m: float) -> None:
        self.corner, self.right, self.height_m = corner, right, height_m
        self.down = np.array([0, 0, -height_m])
        self.length_m = float(np.linalg.norm(right))
        self.out = cross(right, self.down) / (height_m * self.length_m)
        self.taken: list[tuple[Corner, Corner]] = []

    @property
    def yaw_rad(self) -> float:
        """Rotation about z after which a model's back, at +y, faces the wall."""
        return float(np.arctan2(self.out[1], self.out[0]) - np.pi / 2)

    def is_free(self, low: Corner, high: Corner) -> bool:
        """Return whether a rectangle between corners (u, v) is inside the wall and clear of all taken rectangles."""
        if min(low) < 0 or max(high) > 1:
            return False
        return not any(all(low[k] < end[k] and begin[k] < high[k] for k in (0, 1)) for begin, end in self.taken)

    def at(self, u: float, v: float, out_m: float = 0.0) -> Floats:
        """Return the point (3,) at fractions ``u`` and ``v`` of the wall's edges, ``out_m`` behind the wall."""
        return np.asarray(self.corner + u * self.right + v * self.down + out_m * self.out)
