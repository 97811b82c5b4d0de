"""A wall of a room, as it is seen from inside."""

import numpy as np

from semisynth_gl.geometry.mesh import cross
from semisynth_gl.scene import Floats
from semisynth_gl.scene.arrangement import Corner


class Wall:
    """A wall as it is seen from inside the room.

    Args:
        corner: (3,) top left corner, in the floor's frame.
        right: (3,) edge from that corner to the right.
        height_m: height of the wall.

    Attributes:
        down: (3,) edge from the corner down.
        length_m: length of the edge to the right.
        out: (3,) unit normal, from the room outwards.
    """

    def __init__(self, corner: Floats, right: Floats, height_m: float) -> None:
        self.corner = corner
        self.right = right
        self.height_m = height_m
        self.down = np.array([0, 0, -height_m])
        self.length_m = float(np.linalg.norm(right))
        self.out = cross(right, self.down) / (height_m * self.length_m)
        # Opposite corners (u, v) of the doorway or niche, and of the things that hang on the wall.
        self._taken: list[tuple[Corner, Corner]] = []

    @property
    def yaw_rad(self) -> float:
        """The turn about z that puts a model's back, +y, to the wall."""
        return float(np.arctan2(self.out[1], self.out[0]) - np.pi / 2)

    def is_free(self, low: Corner, high: Corner) -> bool:
        """Return whether a rectangle from lowest to highest (u, v) lies on the wall, clear of all taken rectangles."""
        if min(low) < 0 or max(high) > 1:
            return False
        return not any(all(low[k] < end[k] and begin[k] < high[k] for k in (0, 1)) for begin, end in self._taken)

    def take(self, low: Corner, high: Corner) -> None:
        """Mark a rectangle as taken by a doorway, a niche or a thing that hangs."""
        self._taken.append((low, high))

    def at(self, u: float, v: float, out_m: float = 0.0) -> Floats:
        """Return the place (3,) at shares ``u`` and ``v`` of the wall's edges, ``out_m`` behind the wall."""
        return np.asarray(self.corner + u * self.right + v * self.down + out_m * self.out)
