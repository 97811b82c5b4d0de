"""What calibrations say of a rig: the arrays of both eyes by OpenCV's names, lenses, and units of length.

K is a camera matrix, D are the coefficients of a lens, R and T lead from the left camera's frame to the right one's,
R1 and R2 from each raw camera's frame to the rectified one's, P1 and P2 project rectified points.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from semisynth_gl.calibration.kinds import Size
from semisynth_gl.calibration.tree import Array, FormatError
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.raw_camera import COEFFICIENTS, LensModel, RawCamera

UNITS: Mapping[str, float] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""Metres per unit of a translation, by the unit's name."""

# Largest baseline, m, that a number without a unit stands for; larger ones are in cm or in mm, whichever is nearer to
# 12 cm, the baseline of most rigs.
_LARGEST_M, _BETWEEN_CM_AND_MM = 2.5, 38.0

# What tools call the two models of a lens that are read, and other models; letters and digits only.
_LENSES: Mapping[LensModel, str] = {
    "radial-tangential": r"plumbbob|rationalpolynomial|(pinhole)?rad(ial)?tan(gential)?8?|(modified)?brown(conrady)?"
    r"|lensmodel(pinhole|opencv\d+)",
    "fisheye": r"fisheye|(pinhole)?equi(distant)?|kannalabrandt\d?|kb\d",
}
_OTHERS = r"omni.*|(ds|eucm)(none)?|(pinhole)?fov|atan|doublesphere|ucm|mei|scaramuzza|ocam|lensmodel.*"
# OpenCV's 14 coefficients end with the tilt of a sensor.
_WITH_TILT = 14
# Images of radial-tangential lenses are hardly wider than this times the focal length, 100 degrees.
_WIDE = 2.4
_MOST_SKEW = 1e-4

Pair = tuple[Array, Array]
"""An array of the left eye, and one of the right eye."""


class Lens(NamedTuple):
    """Coefficients (N,) of a lens in OpenCV's order, and their model."""

    coefficients: Array
    model: LensModel


@dataclass(frozen=True, slots=True, eq=False)
class StereoArrays:
    """What a calibration says of a rig; None for what it does not say.

    Attributes:
        size: size of the images.
        k: camera matrices (3, 3) before rectification.
        lenses: lenses of both eyes, of one model.
        r: rotation R (3, 3), right_from_left.
        t_m: translation T (3,), metres.
        rectification: rectified_from_raw of both eyes, (3, 3).
        p: projection matrices (3, 4) of the rectified images, the last column in pixels times metres.
        lens_fault: why lenses that are stated cannot be used; ``lenses`` is None then.
        notes: sentences on what was concluded and not read.
        source: name of the file or files, for messages.
    """

    size: Size | None = None
    k: Pair | None = None
    lenses: tuple[Lens, Lens] | None = None
    r: Array | None = None
    t_m: Array | None = None
    rectification: Pair | None = None
    p: Pair | None = None
    lens_fault: str | None = None
    notes: tuple[str, ...] = ()
    source: str = ""

    def raw_cameras(self, size: Size) -> Mapping[Eye, RawCamera] | None:
        """Return the cameras before rectification, for images of ``size``; None if the file lacks K, D or R."""
        if self.k is None or self.lenses is None or self.rectification is None:
            return None
        cameras: dict[Eye, RawCamera] = {}
        for eye, k, lens, rotation in zip(EYES, self.k, self.lenses, self.rectification, strict=True):
            (fx, _, cx), (_, fy, cy), _ = k.tolist()
            rows = tuple(tuple(row) for row in rotation.tolist())
            cameras[eye] = RawCamera(*size, fx, fy, cx, cy, lens.model, tuple(lens.coefficients.tolist()), rows)
        return cameras


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Array:
    """Return K (3, 3) of focal lengths and a principal point, px."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def projections(left: Array, right: Array, baseline: float) -> Pair:
    """Return P (3, 4) of both rectified cameras from K (3, 3) of each and their distance."""
    shift = np.array([[-right[0, 0] * baseline], [0], [0]])
    return np.hstack([left, np.zeros((3, 1))]), np.hstack([right, shift])


def models_of(names: Iterable[str]) -> set[LensModel]:
    """Return the models of lenses by what a calibration calls them; FormatError for a model that is not read."""
    models: set[LensModel] = set()
    for name in names:
        key = re.sub(r"[^a-z0-9]", "", name.lower()).removeprefix("distortion").removeprefix("camera")
        found = {model for model, pattern in _LENSES.items() if re.fullmatch(pattern, key)}
        if not found and re.fullmatch(_OTHERS, key):
            raise FormatError(f"its lens is {name}: calibrate with a radial-tangential or equidistant (fisheye) lens")
        models |= found
    return models


def make_lens(d: Array, model: LensModel | None, k: Array, size: Size | None) -> Lens:
    """Return a lens of OpenCV's models.

    ``d`` are coefficients (N,), none for a lens that does not bend; ``k`` is the camera matrix (3, 3). Without a model
    the lens is radial-tangential. Raises FormatError if coefficients do not fit the model, if four of a wide
    lens fit both models, or if K has skew.
    """
    if abs(k[0, 1]) > _MOST_SKEW * k[0, 0]:
        raise FormatError(f"a camera matrix has a skew of {k[0, 1]:g}: expected [fx 0 cx; 0 fy cy; 0 0 1]")
    if model is None and len(d) == 4 and d.any() and size is not None and size.width_px > _WIDE * k[0, 0]:
        raise FormatError(
            "a wide lens with 4 coefficients may be radial-tangential or a fisheye: add the value "
            "distortion_model, fisheye or radtan, to the file"
        )
    model = model or "radial-tangential"
    counts = COEFFICIENTS[model]
    if not len(d):
        d = np.zeros(counts[0])
    # Files may end in zeros that the model has no place for.
    if not d[counts[-1] :].any():
        d = d[: counts[-1]]
    if len(d) not in counts:
        tilt = ": the last two, a tilted sensor's, must be 0" if len(d) == _WITH_TILT else ""
        expected = " or ".join(map(str, counts))
        raise FormatError(f"expected {expected} coefficients of a {model} lens, got {len(d)}{tilt}")
    return Lens(d, model)


def unit_of(length: float) -> str:
    """Return the unit in which a baseline was probably measured: m, cm or mm."""
    if length <= _LARGEST_M:
        return "m"
    return "cm" if length <= _BETWEEN_CM_AND_MM else "mm"
