"""A wall of a room, as it is seen from inside."""

import numpy as np

from semisynth_gl.geometry.mesh import cross
from semisynth_gl.scene import Floats
from semisynth_gl.scene.arrangement import Corner


class Wall:
    """A wall as the room sees it: its corner at the top left, its edges to the right and down, and its far side."""

    def __init__(self, corner: Floats, right: Floats, height_m: float) -> None:
        self.corner = corner
        self.right = right
        self.height_m = height_m
        self.down = np.array([0, 0, -height_m])
        self.length_m = float(np.linalg.norm(right))
        # From the room outwards, where "right" and "down" are as seen from inside.
        self.out = cross(right, self.down) / (height_m * self.length_m)
        # Opposite corners (u, v) of its doorway or niche, and of what hangs on it.
        self._taken: list[tuple[Corner, Corner]] = []

    @property
    def yaw_rad(self) -> float:
        """Turn about z of a model whose back, +y, is to the wall."""
        return float(np.arctan2(self.out[1], self.out[0]) - np.pi / 2)

    def is_free(self, low: Corner, high: Corner) -> bool:
        """Whether a rectangle from one corner (u, v) to the opposite one lies on the wall, and meets none taken."""
        if min(low) < 0 or max(high) > 1:
            return False
        return not any(all(low[k] < end[k] and begin[k] < high[k] for k in (0, 1)) for begin, end in self._taken)

    def take(self, low: Corner, high: Corner) -> None:
        """Take a rectangle for a doorway, a niche or something that hangs."""
        self._taken.append((low, high))

    def at(self, u: float, v: float, out_m: float = 0.0) -> Floats:
        """Return the place (3,) at shares of the wall's edges, and so far behind the wall."""
        return np.asarray(self.corner + u * self.right + v * self.down + out_m * self.out)
