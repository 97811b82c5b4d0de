"""The camera of one eye before rectification: its sensor, its lens, and its rotation to the rectified camera.

The formulas are OpenCV's. A position is in px, and pixel centres have whole numbers. A direction is (x, y) at z = 1.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np

from semisynth_gl.frame.camera import Eye, Floats, StereoCamera

LensModel = Literal["radial-tangential", "fisheye"]
COEFFICIENTS: Mapping[LensModel, tuple[int, ...]] = {"radial-tangential": (4, 5, 8, 12), "fisheye": (4,)}
"""Numbers of coefficients that OpenCV knows for each model of a lens."""

# Maximum number of Newton's steps, and the width of the finite differences that replace derivatives.
_STEPS, _DIFFERENCE = 30, 1e-6
# Maximum length of a step. With longer ones, a start far from the solution could lead to a wrong solution.
_LONGEST_STEP = 0.3
_NEAREST = 1e-12
# Rounding of calibrations that are printed with six digits.
_PRINTED = 1e-5


@dataclass(frozen=True, slots=True)
class RawCamera:
    """A camera before rectification: its lens bends directions, and it is rotated against the rectified camera.

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
        return np.array([[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1]], np.float64)

    def distorted(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the directions (...) to which the lens bends directions (...), in the raw camera's frame."""
        k = self.distortion
        square = x * x + y * y
        if self.model == "fisheye":
            radius = np.sqrt(square)
            angle = np.arctan(radius)
            power = angle * angle
            bent = angle * (1 + power * (k[0] + power * (k[1] + power * (k[2] + power * k[3]))))
            factor = np.where(radius > 0, bent / np.maximum(radius, _NEAREST), 1.0)
            return x * factor, y * factor
        k = (*k, *(0.0,) * (12 - len(k)))
        factor = 1 + square * (k[0] + square * (k[1] + square * k[4]))
        factor = factor / (1 + square * (k[5] + square * (k[6] + square * k[7])))
        across = 2 * x * y
        return (
            x * factor + k[2] * across + k[3] * (square + 2 * x * x) + square * (k[8] + square * k[9]),
            y * factor + k[2] * (square + 2 * y * y) + k[3] * across + square * (k[10] + square * k[11]),
        )

    def undistorted(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the directions (...) that the lens bends to directions (...), by Newton's method; nan if it fails."""
        with np.errstate(all="ignore"):
            along, down = x, y
            if self.model == "fisheye":
                angle = np.hypot(x, y)
                factor = np.tan(np.minimum(angle, 1.4)) / np.maximum(angle, _NEAREST)
                along, down = x * factor, y * factor
            for _ in range(_STEPS):
                x0, y0 = self.distorted(along, down)
                x1, y1 = self.distorted(along + _DIFFERENCE, down)
                x2, y2 = self.distorted(along, down + _DIFFERENCE)
                a, b, c, d = x1 - x0, x2 - x0, y1 - y0, y2 - y0
                determinant = (a * d - b * c) / _DIFFERENCE
                off_x, off_y = x - x0, y - y0
                step_x = (d * off_x - b * off_y) / determinant
                step_y = (a * off_y - c * off_x) / determinant
                # Far from the axis, steps may be longer: a small angle is a long distance at z = 1.
                longest = _LONGEST_STEP * (1 + along * along + down * down)
                shorter = np.minimum(1.0, longest / np.maximum(np.hypot(step_x, step_y), _NEAREST))
                along, down = along + step_x * shorter, down + step_y * shorter
                if not (np.hypot(step_x, step_y) > _NEAREST * longest).any():
                    break
            x0, y0 = self.distorted(along, down)
            missed = ~(np.hypot(x0 - x, y0 - y) < 1e-9 * (1 + np.hypot(x, y)))
            return np.where(missed, np.nan, along), np.where(missed, np.nan, down)

    def rectified(self, pinhole: Floats, x_px: Floats, y_px: Floats) -> tuple[Floats, Floats]:
        """Return the positions in a rectified image, px, of positions (...) in the raw image.

        ``pinhole`` is the (3, 3) camera matrix of the rectified camera. Points behind it become nan.
        """
        x, y = self.undistorted((x_px - self.cx_px) / self.fx_px, (y_px - self.cy_px) / self.fy_px)
        return _project(pinhole @ np.array(self.rotation), x, y)

    def raw(self, pinhole: Floats, x_px: Floats, y_px: Floats) -> tuple[Floats, Floats]:
        """Return the positions in the raw image, px, of positions (...) in a rectified image; see `rectified`."""
        along, down = _project(np.array(self.rotation).T @ np.linalg.inv(pinhole), x_px, y_px)
        with np.errstate(all="ignore"):
            x, y = self.distorted(along, down)
        return x * self.fx_px + self.cx_px, y * self.fy_px + self.cy_px

    def is_rectified(self, camera: StereoCamera, eye: Eye) -> bool:
        """Return whether raw images are rectified already, within the rounding of printed calibrations."""
        return (
            not np.any(self.distortion)
            and self.model != "fisheye"
            and (self.width_px, self.height_px) == (camera.width_px, camera.height_px)
            and np.allclose(self.matrix, pinhole_of(camera, eye), rtol=_PRINTED)
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
    """Return the rows of the rotation by a rotation vector, by Rodrigues' formula."""
    vector = np.array(vector_rad)
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / max(angle, _NEAREST)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return tuple(tuple(row) for row in rotation.tolist())


def pinhole_of(camera: StereoCamera, eye: Eye) -> Floats:
    """Return the camera matrix of one eye of a rectified pair, (3, 3) float64."""
    cx, cy, fx, fy = camera.lens_px(eye)
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
