"""Things that rest: models that stand, lie and hang in a frame whose z points up, and flat rectangles beside them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.mesh import Mesh, cross
from semisynth_gl.geometry.parts import turned_about_z
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.background import FACE, OVERLAP
from semisynth_gl.scene.rig import BEYOND_NEAR
from semisynth_gl.scene.support import surfaces_below

# Kinds that are as large as walls.
_LARGE = frozenset({"house"})
# Cosine of the steepest slope that a thing stands on.
_LEVEL = 0.98


@dataclass(frozen=True, slots=True)
class FloorView:
    """The left camera's pose over a floor: z up, y ahead, x to the right, the origin on the floor below the camera.

    Attributes:
        camera: the camera.
        camera_from_floor: (4, 4) float64, metres.
        near_m: nothing stands nearer than this depth.
    """

    camera: StereoCamera
    camera_from_floor: Floats
    near_m: float

    @classmethod
    def over_floor(
        cls, camera: StereoCamera, near_m: float, height_m: float, yaw_rad: float, pitch_rad: float, roll_rad: float
    ) -> "FloorView":
        """Place a camera over a floor.

        Args:
            camera: the camera.
            near_m: see `FloorView`.
            height_m: above the floor.
            yaw_rad: to the right of y.
            pitch_rad: downwards.
            roll_rad: about the optical axis.
        """
        ahead = np.array([np.sin(yaw_rad) * np.cos(pitch_rad), np.cos(yaw_rad) * np.cos(pitch_rad), -np.sin(pitch_rad)])
        right = np.array([np.cos(yaw_rad), -np.sin(yaw_rad), 0.0])
        down = cross(ahead, right)
        rolled = np.cos(roll_rad) * right + np.sin(roll_rad) * down
        matrix = np.eye(4)
        matrix[:3, :3] = rolled, cross(ahead, rolled), ahead
        matrix[:3, 3] = -matrix[:3, 2] * height_m
        return cls(camera, matrix, near_m)

    def depth_m(self, points: Floats) -> Floats:
        """Return the planar depths of points (N, 3) of the floor's frame."""
        return np.asarray(points @ self.camera_from_floor[2, :3] + self.camera_from_floor[2, 3])


@dataclass(frozen=True, slots=True, eq=False)
class Catalogue:
    """The models that things are taken from.

    Attributes:
        still: the still models, which the sampler counts first.
        models: the still models, then the library.
        by_name: numbers of the models that things may be, by their names.
        low: (M, 3) float64, corner of each model's bounding box.
        high: (M, 3) float64, the opposite corner.
    """

    still: tuple[Mesh, ...]
    models: tuple[Mesh, ...]
    by_name: Mapping[str, Ints]
    low: Floats
    high: Floats

    @classmethod
    def of(cls, still: Sequence[Mesh], library: Sequence[Mesh], drawn: Ints) -> "Catalogue":
        """Take stock of still models, and of a library of which the models ``drawn``, (D,) int64, may be drawn."""
        models = (*still, *library)
        names = np.array([library[number].name for number in drawn])
        by_name = {str(name): len(still) + drawn[names == name] for name in np.unique(names)}
        boxes = np.array([(mesh.positions.min(axis=0), mesh.positions.max(axis=0)) for mesh in models], np.float64)
        return cls(tuple(still), models, by_name, boxes[:, 0], boxes[:, 1])

    def number(self, still: Mesh) -> int:
        """Return the number of a still model."""
        return next(number for number, mesh in enumerate(self.still) if mesh is still)

    def extent(self, number: int) -> Floats:
        """Return the lengths (3,) of a model's bounding box, in model units."""
        return np.asarray(self.high[number] - self.low[number])

    def pick(
        self, sizes_m: Mapping[str, tuple[float, float]], metre: float, rng: np.random.Generator
    ) -> tuple[int, float] | None:
        """Pick a model of some kinds and its diameter; None where the library has none of them.

        Kinds count alike: the config's weights are for things in the air.

        Args:
            sizes_m: smallest and largest diameter of each kind.
            metre: length of a metre there.
            rng: draws both.
        """
        kind, variant, size = rng.random(3)
        known = [name for name in sizes_m if name in self.by_name]
        if not known:
            return None
        name = known[int(kind * len(known))]
        numbers = self.by_name[name]
        low, high = sizes_m[name]
        return int(numbers[int(variant * len(numbers))]), (low + (high - low) * float(size)) * metre


@dataclass(slots=True, eq=False)
class Arrangement:
    """Still things, gathered one by one.

    Attributes:
        view: the camera.
        model: numbers of models.
        floor_from_model: (4, 4) float64 each.
        unit_m: (2,) each, length of one UV unit.
        wears: the number of the thing whose texture each wears: its own, or that of an earlier one.
        large: whether each wears a large patch, where there are any.
        farthest_m: no view shows more than this depth, if the walls could be brought in so far.
    """

    view: FloorView
    catalogue: Catalogue
    model: list[int] = field(default_factory=list)
    floor_from_model: list[Floats] = field(default_factory=list)
    unit_m: list[tuple[float, float]] = field(default_factory=list)
    wears: list[int] = field(default_factory=list)
    large: list[bool] = field(default_factory=list)
    farthest_m: float = np.inf
    _taken: list[tuple[float, float, float]] = field(default_factory=list)
    _raised: list[tuple[tuple[float, float], tuple[float, float], float]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.model)

    def add(
        self, model: int, matrix: Floats, unit_m: tuple[float, float], wears: int | None = None, *, large: bool = True
    ) -> int:
        """Add a thing; return its number."""
        self.large.append(large)
        self.model.append(model)
        self.floor_from_model.append(matrix)
        self.unit_m.append(unit_m)
        self.wears.append(len(self.wears) if wears is None else wears)
        return len(self.model) - 1

    def add_rectangle(
        self, corner: ArrayLike, u: ArrayLike, v: ArrayLike, *, model: Mesh = FACE, wears: int | None = None
    ) -> int:
        """Add a rectangle, or another model over the unit square, that shows the texture upright and unmirrored.

        Args:
            corner: (3,) its corner at the top left, as it is seen.
            u: (3,) its edge to the right.
            v: (3,) its edge downwards.
            model: a still model over the unit square of x and y.
            wears: see `Arrangement`.
        """
        edges = np.array([u, v], np.float64)
        sizes = np.linalg.norm(edges, axis=1)
        begin = np.asarray(corner, np.float64) - OVERLAP * edges.sum(axis=0)
        matrix = np.eye(4)
        matrix[:3, 0], matrix[:3, 1] = edges * (1 + 2 * OVERLAP)
        matrix[:3, 2] = cross(edges[0], edges[1]) / sizes.prod() * sizes.mean()
        matrix[:3, 3] = begin
        return self.add(self.catalogue.number(model), matrix, (float(sizes[0]), float(sizes[1])), wears)

    def add_box(self, middle: ArrayLike, half: ArrayLike, yaw_rad: float = 0.0, wears: int | None = None) -> int | None:
        """Add five sides of a box, all but its bottom; return the number of the first.

        Nothing is added, and None is returned, where it comes too near.

        Args:
            middle: (3,) middle of its bottom.
            half: (3,) half its width and depth, and its height.
            yaw_rad: its turn about z.
            wears: see `Arrangement`; by default its sides share a texture that nothing else wears.
        """
        (x, y, z), at = np.asarray(half, np.float64), np.asarray(middle, np.float64)
        turn = turned_about_z(yaw_rad)
        corners = np.array([[i * x, j * y, k * z] for i in (-1, 1) for j in (-1, 1) for k in (0, 1)]) @ turn.T + at
        if self.view.depth_m(corners).min() < BEYOND_NEAR * self.view.near_m:
            return None

        def side(corner: ArrayLike, u: ArrayLike, v: ArrayLike, wears: int | None) -> int:
            begin = turn @ np.asarray(corner, np.float64) + at
            return self.add_rectangle(begin, turn @ np.asarray(u, float), turn @ np.asarray(v, float), wears=wears)

        first = side((-x, -y, z), (2 * x, 0, 0), (0, 0, -z), wears)
        same = self.wears[first]
        side((x, -y, z), (0, 2 * y, 0), (0, 0, -z), same)
        side((x, y, z), (-2 * x, 0, 0), (0, 0, -z), same)
        side((-x, y, z), (0, -2 * y, 0), (0, 0, -z), same)
        side((-x, y, z), (2 * x, 0, 0), (0, -2 * y, 0), same)
        return first

    def stand(
        self, picked: tuple[int, float], at: ArrayLike, yaw_rad: float, stretch: Floats | None = None
    ) -> int | None:
        """Stand a model on a place, upright; return its number, or None where it comes too near, and is not added.

        Args:
            picked: number of the model, and its diameter in metres.
            at: (3,) the place, below the model's middle.
            yaw_rad: its turn about z.
            stretch: (3,) factors along the model's own axes.
        """
        number, size_m = picked
        scale = size_m / 2 * (np.ones(3) if stretch is None else stretch)
        low, high = self.catalogue.low[number] * scale, self.catalogue.high[number] * scale
        place = np.asarray(at, np.float64) - (0, 0, low[2])
        turn = turned_about_z(yaw_rad)
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        if self.view.depth_m(corners @ turn.T + place).min() < BEYOND_NEAR * self.view.near_m:
            return None
        matrix = np.eye(4)
        matrix[:3, :3] = turn * scale
        matrix[:3, 3] = place
        unit = float(scale.mean())
        return self.add(number, matrix, (unit, unit), large=self.catalogue.models[number].name in _LARGE)

    def top(self, number: int, x: float, y: float) -> float | None:
        """Return the height of a thing over a place of the floor; None where its top is not level there.

        Args:
            number: the thing's.
            x: the place, in the floor's frame, metres.
            y: the same.
        """
        mesh, matrix = self.catalogue.models[self.model[number]], self.floor_from_model[number]
        corners = (mesh.positions.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3])[mesh.triangles]
        top = surfaces_below(corners, np.array([[x, y, np.inf]]))[0]
        return None if top is None or top.normal[2] < _LEVEL else top.height

    def raise_floor(self, low: tuple[float, float], high: tuple[float, float], height_m: float) -> None:
        """Say that the floor between two corners (x, y) is higher, as on a pavement."""
        self._raised.append((low, high, height_m))

    def floor_m(self, x: float, y: float) -> float:
        """Return the height of the floor at a place."""
        raised = (z for (a, b), (c, d), z in self._raised if a < x < c and b < y < d)
        return next(raised, 0.0)

    def is_free(self, x: float, y: float, radius_m: float) -> bool:
        """Whether a circle on the floor meets none that is taken; things may come close."""
        return all((x - a) ** 2 + (y - b) ** 2 > (0.8 * (radius_m + r)) ** 2 for a, b, r in self._taken)

    def take(self, x: float, y: float, radius_m: float) -> None:
        """Take a circle on the floor."""
        self._taken.append((x, y, radius_m))
