"""The camera of one eye before rectification: its sensor, its lens, and its rotation to the rectified camera.

The formulas are OpenCV's. A position is in px, and pixel centres have whole numbers. A direction is (x, y) at z = 1.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np

from semisynth_gl.frame.camera import Eye, Floats, StereoCamera, camera_matrix

LensModel = Literal["radial-tangential", "fisheye"]
COEFFICIENTS: Mapping[LensModel, tuple[int, ...]] = {"radial-tangential": (4, 5, 8, 12), "fisheye": (4,)}
"""Numbers of distortion coefficients that OpenCV accepts for each lens model."""

# Maximum number of Newton steps.
_STEPS = 30
# Step of the finite differences that replace derivatives.
_DIFFERENCE = 1e-6
# Maximum length of a step. With longer ones, a start far from the solution could lead to a wrong solution.
_LONGEST_STEP = 0.3
# Replaces smaller divisors.
_TINY = 1e-12
# Tolerance for calibrations that are printed with six digits.
_PRINTED = 1e-5


@dataclass(frozen=True, slots=True)
class RawCamera:
    """A camera before rectification: its lens distorts, and it is rotated relative to the rectified camera.

    ``fx_px`` and ``fy_px`` are the focal lengths, ``cx_px`` and ``cy_px`` the principal point.

    Attributes:
        model: OpenCV's ``radial-tangential`` (k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4), or ``fisheye`` (k1 to k4), which is
            Kannala and Brandt's.
        distortion: the model's coefficients: 4, 5, 8 or 12, for a fisheye 4.
        rotation: rows of rectified_from_raw, which OpenCV's stereoRectify returns as R1 or R2.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    model: LensModel
    distortion: tuple[float, ...]
    rotation: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Self:
        """Build a camera from what `record` returns; raises KeyError, TypeError or ValueError if it is wrong."""
        (fx, _, cx), (_, fy, cy), _ = record["K"]
        rotation = tuple(tuple(float(each) for each in row) for row in record["R"])
        distortion = tuple(float(each) for each in record["D"])
        if len(distortion) not in COEFFICIENTS[record["model"]] or [len(row) for row in rotation] != [3, 3, 3]:
            raise ValueError(f"expected D of the model and R of 3 x 3 numbers, got {distortion} and {rotation}")
        sides = int(record["width_px"]), int(record["height_px"])
        return cls(*sides, float(fx), float(fy), float(cx), float(cy), record["model"], distortion, rotation)

    @property
    def matrix(self) -> Floats:
        """The camera matrix K, (3, 3) float64."""
        return camera_matrix(self.fx_px, self.fy_px, self.cx_px, self.cy_px)

    def distorted(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the distorted directions (...) of directions (...), both in the raw camera's frame."""
        k = self.distortion
        r2 = x * x + y * y
        if self.model == "fisheye":
            r = np.sqrt(r2)
            theta = np.arctan(r)
            theta2 = theta * theta
            theta_d = theta * (1 + theta2 * (k[0] + theta2 * (k[1] + theta2 * (k[2] + theta2 * k[3]))))
            factor = np.where(r > 0, theta_d / np.maximum(r, _TINY), 1.0)
            return x * factor, y * factor
        k = (*k, *(0.0,) * (12 - len(k)))
        radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        radial = radial / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
        xy2 = 2 * x * y
        return (
            x * radial + k[2] * xy2 + k[3] * (r2 + 2 * x * x) + r2 * (k[8] + r2 * k[9]),
            y * radial + k[2] * (r2 + 2 * y * y) + k[3] * xy2 + r2 * (k[10] + r2 * k[11]),
        )

    def undistorted(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the directions (...) whose distorted directions are given, by Newton's method; nan if it fails."""
        with np.errstate(all="ignore"):
            u, v = x, y
            if self.model == "fisheye":
                angle = np.hypot(x, y)
                factor = np.tan(np.minimum(angle, 1.4)) / np.maximum(angle, _TINY)
                u, v = x * factor, y * factor
            for _ in range(_STEPS):
                x0, y0 = self.distorted(u, v)
                x1, y1 = self.distorted(u + _DIFFERENCE, v)
                x2, y2 = self.distorted(u, v + _DIFFERENCE)
                a, b, c, d = x1 - x0, x2 - x0, y1 - y0, y2 - y0
                determinant = (a * d - b * c) / _DIFFERENCE
                step_u = (d * (x - x0) - b * (y - y0)) / determinant
                step_v = (a * (y - y0) - c * (x - x0)) / determinant
                # Far from the axis, steps may be longer: a small angle is a long distance at z = 1.
                longest = _LONGEST_STEP * (1 + u * u + v * v)
                shorter = np.minimum(1.0, longest / np.maximum(np.hypot(step_u, step_v), _TINY))
                u, v = u + step_u * shorter, v + step_v * shorter
                if not (np.hypot(step_u, step_v) > _TINY * longest).any():
                    break
            x0, y0 = self.distorted(u, v)
            failed = ~(np.hypot(x0 - x, y0 - y) < 1e-9 * (1 + np.hypot(x, y)))
            return np.where(failed, np.nan, u), np.where(failed, np.nan, v)

    def to_rectified(self, pinhole: Floats, x_px: Floats, y_px: Floats) -> tuple[Floats, Floats]:
        """Return the positions in a rectified image, px, of positions (...) in the raw image.

        ``pinhole`` is the (3, 3) camera matrix of the rectified camera. Points behind it become nan.
        """
        x, y = self.undistorted((x_px - self.cx_px) / self.fx_px, (y_px - self.cy_px) / self.fy_px)
        return _project(pinhole @ np.array(self.rotation), x, y)

    def to_raw(self, pinhole: Floats, x_px: Floats, y_px: Floats) -> tuple[Floats, Floats]:
        """Return the positions in the raw image, px, of positions (...) in a rectified image; see `to_rectified`."""
        u, v = _project(np.array(self.rotation).T @ np.linalg.inv(pinhole), x_px, y_px)
        with np.errstate(all="ignore"):
            x, y = self.distorted(u, v)
        return x * self.fx_px + self.cx_px, y * self.fy_px + self.cy_px

    def is_rectified(self, camera: StereoCamera, eye: Eye) -> bool:
        """Return whether this is the rectified camera of one eye, within the rounding of printed calibrations."""
        return (
            not np.any(self.distortion)
            and self.model != "fisheye"
            and (self.width_px, self.height_px) == (camera.width_px, camera.height_px)
            and np.allclose(self.matrix, camera.matrix(eye), rtol=_PRINTED)
            and np.allclose(np.array(self.rotation), np.eye(3), atol=_PRINTED)
        )

    def scaled(self, scale: float) -> "RawCamera":
        """Return the camera whose images have sides multiplied by ``scale``, rounded to whole pixels."""
        return replace(
            self,
            width_px=max(1, int(self.width_px * scale + 0.5)),
            height_px=max(1, int(self.height_px * scale + 0.5)),
            fx_px=self.fx_px * scale,
            fy_px=self.fy_px * scale,
            cx_px=(self.cx_px + 0.5) * scale - 0.5,
            cy_px=(self.cy_px + 0.5) * scale - 0.5,
        )

    def record(self) -> dict[str, object]:
        """Return K, D, R and the size in JSON's types, by the names of OpenCV's stereoRectify."""
        return {
            "width_px": self.width_px,
            "height_px": self.height_px,
            "model": self.model,
            "K": self.matrix.tolist(),
            "D": list(self.distortion),
            "R": [list(row) for row in self.rotation],
        }


def _project(matrix: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Project points (...) at z = 1 by a (3, 3) matrix to positions (...); nan where the new z is not positive."""
    ray = np.stack([x, y, np.ones_like(x)], axis=-1) @ matrix.T
    with np.errstate(all="ignore"):
        ahead = np.where(ray[..., 2] > 0, ray[..., 2], np.nan)
        return ray[..., 0] / ahead, ray[..., 1] / ahead


def rotation_of(vector_rad: tuple[float, float, float]) -> tuple[tuple[float, ...], ...]:
    """Return the rows of the matrix of a rotation vector, by Rodrigues' formula."""
    vector = np.array(vector_rad)
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / max(angle, _TINY)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return tuple(tuple(row) for row in rotation.tolist())
