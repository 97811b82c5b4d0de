"""What calibrations say of a rig: the arrays of both eyes by OpenCV's names, lenses, and units of length.

K is a camera matrix, D are the coefficients of a lens, R and T lead from the left camera's frame to the right one's,
R1 and R2 from each raw camera's frame to the rectified one's, P1 and P2 project rectified points.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from semisynth_gl.calibration.tree import Array, FormatError
from semisynth_gl.frame.camera import Eye
from semisynth_gl.frame.raw_camera import COEFFICIENTS, LensModel, RawCamera

UNITS: Mapping[str, float] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""Metres per unit of a translation, by the unit's name."""

# Largest baseline, m, that a number without a unit stands for; larger ones are in cm or in mm, whichever is nearer to
# 12 cm, the baseline of most rigs.
_LARGEST_M, _BETWEEN_CM_AND_MM = 2.5, 38.0

# What tools call the two models of a lens that are read.
_RADIAL_TANGENTIAL = (
    "plumbbob rationalpolynomial radtan radtan8 radialtangential radialtangential8 pinholeradtan pinholeradtan8 brown "
    "brownconrady modifiedbrownconrady lensmodelpinhole lensmodelopencv4 lensmodelopencv5 lensmodelopencv8 "
    "lensmodelopencv12"
)
_FISHEYE = "fisheye equidistant equi kannalabrandt kannalabrandt4 kannalabrandt8 kb4 pinholeequi pinholeequidistant"
_LENSES: dict[str, LensModel] = {
    **dict.fromkeys(_RADIAL_TANGENTIAL.split(), "radial-tangential"),
    **dict.fromkeys(_FISHEYE.split(), "fisheye"),
}
# Lenses of other models, and how to calibrate with one that is read.
_KALIBR = "kalibr_calibrate_cameras --models pinhole-radtan or pinhole-equi"
_BASALT = "Basalt's --cam-types kb4"
_OTHERS = {
    **dict.fromkeys(("omni", "omniradtan", "omninone", "dsnone", "eucmnone", "fov", "pinholefov", "atan"), _KALIBR),
    **dict.fromkeys(("ds", "doublesphere", "eucm"), f"{_KALIBR}, or {_BASALT}"),
    "ucm": _BASALT,
    **dict.fromkeys(("mei", "scaramuzza", "ocam"), "camodocal's --camera-model kannala-brandt"),
    **dict.fromkeys(("lensmodelcahvor", "lensmodelcahvore"), "mrcal-calibrate-cameras --lensmodel LENSMODEL_OPENCV8"),
    "lensmodelsplinedstereographic": "mrcal-convert-lensmodel LENSMODEL_OPENCV8",
}
# OpenCV's 14 coefficients end with the tilt of a sensor.
_WITH_TILT, _WITHOUT_TILT = 14, 12
# Images of radial-tangential lenses are hardly wider than this times the focal length, 100 degrees.
_WIDE = 2.4
_MOST_SKEW = 1e-4


class Size(NamedTuple):
    """Size of an image, pixels."""

    width_px: int
    height_px: int

    def __str__(self) -> str:
        return f"{self.width_px} x {self.height_px}"

    def scaled(self, scale: float) -> "Size":
        """Return the size times a factor, rounded to whole pixels."""
        return Size(*(max(1, int(side * scale + 0.5)) for side in self))


class DisparityBounds(NamedTuple):
    """Bounds of disparity that a calibration states, px, else None; ``ndisp`` and ``vmax_px`` are upper bounds."""

    ndisp: float | None = None
    vmin_px: float | None = None
    vmax_px: float | None = None


NO_BOUNDS = DisparityBounds()


@dataclass(frozen=True, slots=True, eq=False)
class EyeArrays:
    """The arrays of one eye; None for what a calibration does not say.

    Attributes:
        k: camera matrix (3, 3) before rectification.
        d: coefficients (N,) of the lens in OpenCV's order.
        model: model of the lens.
        r: rectified_from_raw, (3, 3).
        p: projection matrix (3, 4) of the rectified images, its last column in pixels times metres.
        fault: why the lens cannot be used; ``d`` and ``model`` are None then.
    """

    k: Array | None = None
    d: Array | None = None
    model: LensModel | None = None
    r: Array | None = None
    p: Array | None = None
    fault: str | None = None

    def camera(self, size: Size) -> RawCamera | None:
        """Return the camera before rectification; its images have ``size``. None where K, D or R is missing."""
        if self.k is None or self.d is None or self.model is None or self.r is None:
            return None
        (fx, _, cx), (_, fy, cy), _ = self.k.tolist()
        rows = tuple(tuple(row) for row in self.r.tolist())
        return RawCamera(*size, fx, fy, cx, cy, self.model, tuple(self.d.tolist()), rows)


@dataclass(frozen=True, slots=True, eq=False)
class StereoArrays:
    """What a calibration says of a rig; None for what it does not say.

    Attributes:
        left: arrays of the left eye.
        right: arrays of the right eye.
        size: size of the images.
        r: rotation R (3, 3), right_from_left.
        t_m: translation T (3,), metres.
        bounds: bounds of disparity.
        layout: layout of the benchmark whose calibration this is; None for any other.
        notes: sentences on what was concluded and not read.
        source: name of the file or files, for messages.
    """

    left: EyeArrays
    right: EyeArrays
    size: Size | None = None
    r: Array | None = None
    t_m: Array | None = None
    bounds: DisparityBounds = NO_BOUNDS
    layout: str | None = None
    notes: tuple[str, ...] = ()
    source: str = ""

    @property
    def is_rectified(self) -> bool:
        """Whether the calibration projects rectified images."""
        return self.left.p is not None and self.right.p is not None

    @property
    def lens_fault(self) -> str | None:
        """Why the stated lenses cannot be used. None where they can, and where no lens is stated."""
        models = {self.left.model, self.right.model} - {None}
        if len(models) > 1:
            return f"expected lenses of one model, got {self.left.model} left and {self.right.model} right"
        return self.left.fault or self.right.fault

    def raw_cameras(self, size: Size) -> Mapping[Eye, RawCamera] | None:
        """Return both cameras before rectification; None where one of them is missing."""
        left, right = self.left.camera(size), self.right.camera(size)
        return None if self.lens_fault or left is None or right is None else {"left": left, "right": right}


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Array:
    """Return K (3, 3) of focal lengths and a principal point, px."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def projections(left: Array, right: Array, baseline: float) -> tuple[Array, Array]:
    """Return P (3, 4) of both rectified cameras from K (3, 3) of each and their distance."""
    shift = np.array([[-right[0, 0] * baseline], [0], [0]])
    return np.hstack([left, np.zeros((3, 1))]), np.hstack([right, shift])


def lens_of(
    d: Array | None, names: Iterable[str], k: Array | None = None, size: Size | None = None
) -> tuple[Array, LensModel, str | None]:
    """Return the coefficients and the model of a lens, and a note where the model was concluded.

    Args:
        d: coefficients in any shape; None or none for a lens that does not bend.
        names: what the calibration calls the lens.
        k: camera matrix (3, 3).
        size: size of the images.

    Raises:
        FormatError: where the lens has another model than OpenCV's two, or another number of coefficients, or the
            camera matrix has skew.
    """
    if k is not None and abs(k[0, 1]) > _MOST_SKEW * k[0, 0]:
        raise FormatError(f"a camera matrix has a skew of {k[0, 1]:g}: expected [fx 0 cx; 0 fy cy; 0 0 1]")
    model: LensModel | None = None
    for name in names:
        key = re.sub(r"[^a-z0-9]", "", name.lower()).removeprefix("distortion").removeprefix("camera")
        if key in _OTHERS:
            raise FormatError(
                f"its lens is {name}: expected radial-tangential or equidistant (fisheye). Calibrate with "
                f"{_OTHERS[key]}"
            )
        model = _LENSES.get(key, model)
    coefficients = np.zeros(0) if d is None else d.ravel()
    if not np.isfinite(coefficients).all():
        raise FormatError(f"expected finite coefficients of the lens, got {coefficients.tolist()}")
    note = None
    if model is None and len(coefficients) == COEFFICIENTS["fisheye"][0] and coefficients.any():
        if k is not None and size is not None and size.width_px > _WIDE * k[0, 0]:
            raise FormatError(
                "a wide lens with 4 coefficients may be radial-tangential or a fisheye: add the value "
                "distortion_model, fisheye or radtan, to the file"
            )
        note = "4 coefficients were taken for a radial-tangential lens; for a fisheye, add `distortion_model: fisheye`"
    model = model or "radial-tangential"
    if not len(coefficients):
        coefficients = np.zeros(4 if model == "fisheye" else 5)
    # Files may end in zeros that the model has no place for.
    most = 4 if model == "fisheye" else _WITHOUT_TILT
    if len(coefficients) > most and not coefficients[most:].any():
        coefficients = coefficients[:most]
    if len(coefficients) not in COEFFICIENTS[model]:
        counts = " or ".join(map(str, COEFFICIENTS[model]))
        tilt = ": the last two, a tilted sensor's, must be 0" if len(coefficients) == _WITH_TILT else ""
        raise FormatError(f"expected {counts} coefficients of a {model} lens, got {len(coefficients)}{tilt}")
    return coefficients, model, note


def unit_of(length: float) -> str:
    """Return the unit in which a baseline was probably measured: m, cm or mm."""
    if length <= _LARGEST_M:
        return "m"
    return "cm" if length <= _BETWEEN_CM_AND_MM else "mm"
