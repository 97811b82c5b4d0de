"""Models and coefficients of lenses."""

import re
from collections.abc import Iterable, Mapping

import numpy as np

from semisynth_gl.calibration.tree import Array, FormatError
from semisynth_gl.frame.raw_camera import COEFFICIENTS, LensModel

# What tools call the two models of a lens that are read, and other models; letters and digits only.
_MODELS: Mapping[LensModel | None, str] = {
    "radial-tangential": r"plumbbob|rationalpolynomial|(pinhole)?rad(ial)?tan(gential)?8?|(modified)?brown(conrady)?"
    r"|lensmodel(pinhole|opencv\d+)",
    "fisheye": r"fisheye|(pinhole)?equi(distant)?|kannalabrandt\d?|kb\d",
    None: r"omni.*|(ds|eucm)(none)?|(pinhole)?fov|atan|doublesphere|ucm|mei|scaramuzza|ocam|lensmodel.*",
}
_MOST_SKEW = 1e-4


def model_of(names: Iterable[str]) -> LensModel | None:
    """Return the lens model that a calibration's names state for both cameras; None where they state none.

    Raises FormatError for a model that is not read, or for two models.
    """
    models: set[LensModel] = set()
    for name in names:
        key = re.sub(r"[^a-z0-9]", "", name.lower()).removeprefix("distortion").removeprefix("camera")
        for model in [model for model, pattern in _MODELS.items() if re.fullmatch(pattern, key)][:1]:
            if model is None:
                text = "calibrate with a radial-tangential or equidistant (fisheye) lens"
                raise FormatError(f"its lens is {name}: {text}")
            models.add(model)
    if len(models) > 1:
        raise FormatError("expected lenses of one model, got radial-tangential and fisheye ones")
    return next(iter(models), None)


def checked_coefficients(d: Array, model: LensModel, k: Array) -> Array:
    """Return the coefficients (N,) of a lens in as many numbers as OpenCV's model takes; zeros for none.

    Raises FormatError if their number does not fit the model, or if the camera matrix K (3, 3) has skew.
    """
    if abs(k[0, 1]) > _MOST_SKEW * k[0, 0]:
        raise FormatError(f"a camera matrix has a skew of {k[0, 1]:g}: expected [fx 0 cx; 0 fy cy; 0 0 1]")
    counts = COEFFICIENTS[model]
    if not d[counts[-1] :].any():  # files may end in zeros that the model has no place for
        d = d[: counts[-1]] if len(d) else np.zeros(counts[0])
    if len(d) not in counts:
        tilt = ": the last two, a tilted sensor's, must be 0" if len(d) == 14 else ""
        raise FormatError(
            f"expected {' or '.join(map(str, counts))} coefficients of a {model} lens, got {len(d)}{tilt}"
        )
    return d
