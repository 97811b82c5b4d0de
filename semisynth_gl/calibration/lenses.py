"""The lenses of a calibration: their model, and their coefficients as OpenCV takes them."""

import re
from collections.abc import Mapping

import numpy as np

from semisynth_gl.calibration.aliases import ArrayPair, key_and_camera, lens_arrays
from semisynth_gl.calibration.sizes import ImageSize
from semisynth_gl.calibration.tree import Array, FormatError, Tree, listing
from semisynth_gl.frame.raw_camera import COEFFICIENTS, LensModel

# Images of radial-tangential lenses are hardly wider than this times the focal length, 100 degrees.
_WIDE = 2.4
_MOST_SKEW = 1e-4
# Values of a flag such as ``fisheye`` that mean false.
_FALSE = {"", "0", "false", "no", "off", "none"}
# The names that tools use for the two supported lens models, and for others; letters and digits only.
_MODELS: Mapping[LensModel, str] = {
    "radial-tangential": r"plumbbob|rationalpolynomial|(pinhole)?rad(ial)?tan(gential)?8?|(modified)?brown(conrady)?"
    r"|lensmodel(pinhole|opencv\d+)",
    "fisheye": r"fisheye|(pinhole)?equi(distant)?|kannalabrandt\d?|kb\d",
}
_OTHER_MODELS = (
    r"omni.*|(ds|eucm)(none)?|(pinhole)?fov|atan|doublesphere|ucm|mei|scaramuzza|ocam"
    r"|lensmodel(?!pinhole$|opencv\d+$).*"
)


def lens_model(tree: Tree) -> LensModel | None:
    """Return the stated lens model; raises FormatError for an unsupported model, or for two models."""
    models: set[LensModel] = set()
    for name, value in tree.items():
        key = key_and_camera(name)[0]
        text = value if isinstance(value, str) else "".join(f"{number:g}" for number in value.ravel()[:1])
        if re.search("fisheye|equidist", key) and text.lower() not in _FALSE:
            models.add("fisheye")
        if not isinstance(value, str) or not re.search("model|type|lens|dist|projection", key):
            continue
        word = re.sub(r"[^a-z0-9]", "", text.lower()).removeprefix("distortion").removeprefix("camera")
        if re.fullmatch(_OTHER_MODELS, word):
            raise FormatError(f"its lens is {text}: calibrate with a radial-tangential or equidistant (fisheye) lens")
        models |= {model for model, pattern in _MODELS.items() if re.fullmatch(pattern, word)}
    if len(models) > 1:
        raise FormatError("expected lenses of one model, got radial-tangential and fisheye lenses")
    return next(iter(models), None)


def usable_lenses(
    model: LensModel | None, k: ArrayPair, d: ArrayPair | None, size: ImageSize | None, tree: Tree, notes: list[str]
) -> tuple[LensModel, ArrayPair]:
    """Return the model and the coefficients of both lenses; raises FormatError if they cannot be used."""
    if d is None and (found := lens_arrays(tree)):
        raise FormatError(f"expected coefficients of both lenses, got {listing(found)}")
    if d is None:
        notes.append("no lens coefficients were found: the cameras are taken to be pinholes")
        d = np.zeros(0), np.zeros(0)
    is_wide = size is not None and size.width_px > _WIDE * float(k[0][0, 0])
    if model is None and is_wide and d[0].any() and len(d[0]) in (4, 5) and not d[0][4:].any():
        raise FormatError(
            "a wide lens with 4 coefficients may be radial-tangential or a fisheye: add the value distortion_model, "
            "fisheye or radtan, to the file"
        )
    model = model or "radial-tangential"
    return model, (_coefficients(d[0], model, k[0]), _coefficients(d[1], model, k[1]))


def _coefficients(d: Array, model: LensModel, k: Array) -> Array:
    """Return the coefficients (N,) of a lens in a number that OpenCV's model takes; zeros if there are none.

    Raises FormatError if their number does not fit the model, or if the camera matrix K (3, 3) has skew.
    """
    if abs(k[0, 1]) > _MOST_SKEW * k[0, 0]:
        raise FormatError(f"a camera matrix has a skew of {k[0, 1]:g}: expected [fx 0 cx; 0 fy cy; 0 0 1]")
    counts = COEFFICIENTS[model]
    if not d[counts[-1] :].any():  # files may end in zeros beyond the model's coefficients
        d = d[: counts[-1]] if len(d) else np.zeros(counts[0])
    if len(d) not in counts:
        raise FormatError(f"expected {' or '.join(map(str, counts))} coefficients of a {model} lens, got {len(d)}")
    return d
