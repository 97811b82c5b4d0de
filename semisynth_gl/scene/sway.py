"""The camera's own motion: it sways about where it stands, as a hand or a vehicle does.

Everything is a formula of time, and bounded: so any frame can be rendered first, and walls keep clear of the camera.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.model import CameraSection
from semisynth_gl.scene.rotation import rotation_about

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Sway:
    """Six independent oscillations, about the world's origin and axes.

    Attributes:
        shift_m: (3,) amplitude of the left camera's position along x, y and z.
        turn_rad: (3,) amplitude of its rotation vector's x, y and z.
        period_s: (6,) of the three shifts and the three turns.
        phase_rad: (6,) at time 0.
    """

    shift_m: Floats
    turn_rad: Floats
    period_s: Floats
    phase_rad: Floats

    @property
    def reach_m(self) -> float:
        """How far the left camera gets from the origin at most."""
        return float(np.linalg.norm(self.shift_m))

    @property
    def angle_rad(self) -> float:
        """How far it turns at most, about any axis."""
        return float(np.linalg.norm(self.turn_rad))

    def camera_from_world(self, time_s: float) -> Floats:
        """The left camera's pose at any time, (4, 4) float64; the identity for one that stands still."""
        camera_from_world = np.eye(4)
        if self.reach_m == 0 and self.angle_rad == 0:
            return camera_from_world
        swing = np.sin(2 * np.pi * time_s / self.period_s + self.phase_rad)
        turn = self.turn_rad * swing[3:]
        angle = float(np.linalg.norm(turn))
        if angle > 0:
            camera_from_world[:3, :3] = rotation_about(turn[None] / angle, np.array([-angle]))[0]
        camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ (self.shift_m * swing[:3])
        return camera_from_world


STILL = Sway(np.zeros(3), np.zeros(3), np.ones(6), np.zeros(6))
"""No motion."""


def draw_sway(section: CameraSection, rng: np.random.Generator) -> Sway:
    """Draw the sway of one sequence: an amplitude for each axis, a period and a phase for each oscillation."""
    return Sway(
        section.sway_m.draw_many(rng, 3),
        np.deg2rad(section.sway_deg.draw_many(rng, 3)),
        section.sway_s.draw_many(rng, 6),
        rng.uniform(0, 2 * np.pi, 6),
    )
