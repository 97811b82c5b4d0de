"""Middlebury's calib.txt back to a camera."""

from dataclasses import dataclass
from pathlib import Path

from semisynth_gl.camera import StereoCamera
from semisynth_gl.errors import InputError
from semisynth_gl.read.error import ReadError, read_bytes

# HSM counts lines instead of reading names, so the order matters.
_KEYS = ("cam0", "cam1", "doffs", "baseline", "width", "height", "ndisp", "isint", "vmin", "vmax", "dyavg", "dymax")


@dataclass(frozen=True, slots=True)
class Calibration:
    """What calib.txt says.

    Attributes:
        camera: both cameras; the baseline in metres.
        doffs_px: the line of that name, which should be the camera's.
        ndisp: an upper bound of the disparities.
        vmin_px: the least disparity of the left view.
        vmax_px: the largest.
    """

    camera: StereoCamera
    doffs_px: float
    ndisp: int
    vmin_px: float
    vmax_px: float


def decode_calib(data: bytes, path: Path) -> Calibration:
    """Decode calib.txt.

    Args:
        data: the file's bytes.
        path: the file's name, for messages.

    Raises:
        ReadError: where it is not text, lines are missing, in another order, or not what their names say.
    """
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError:
        raise ReadError(path, "is not text") from None
    lines = [line.partition("=") for line in text.splitlines()]
    keys = tuple(key for key, _, _ in lines)
    if keys != _KEYS:
        raise ReadError(path, f"expected the lines {', '.join(_KEYS)} in this order, got {', '.join(keys)}")
    if not text.endswith("\n"):
        raise ReadError(path, f"the last line has no end, as if cut off: {text[-20:]!r}")
    values = {key: value for key, _, value in lines}
    try:
        left, right = _matrix(values["cam0"]), _matrix(values["cam1"])
        number = {key: float(values[key]) for key in ("doffs", "baseline", "vmin", "vmax")}
        whole = {key: int(values[key]) for key in ("width", "height", "ndisp")}
    except ValueError as error:
        raise ReadError(path, str(error)) from None
    focal, cy = left[0], left[5]
    same = [focal, 0.0, None, 0.0, focal, cy, 0.0, 0.0, 1.0]
    for name, matrix in (("cam0", left), ("cam1", right)):
        if any(wanted is not None and wanted != came for wanted, came in zip(same, matrix, strict=True)):
            raise ReadError(path, f"{name} is not [f 0 cx; 0 f cy; 0 0 1] with the f and cy of cam0: {values[name]}")
    try:
        camera = StereoCamera(whole["width"], whole["height"], focal, number["baseline"] / 1000, left[2], right[2], cy)
    except InputError as error:
        raise ReadError(path, str(error)) from None
    return Calibration(camera, number["doffs"], whole["ndisp"], number["vmin"], number["vmax"])


def read_calib(path: Path) -> Calibration:
    """Read calib.txt; see `decode_calib`."""
    return decode_calib(read_bytes(path), path)


def _matrix(text: str) -> list[float]:
    """Nine numbers of ``[a b c; d e f; g h i]``, row by row."""
    rows = [row.split() for row in text.strip().removeprefix("[").removesuffix("]").split(";")]
    if [len(row) for row in rows] != [3, 3, 3]:
        raise ValueError(f"expected a matrix [f 0 cx; 0 f cy; 0 0 1], got {text!r}")
    return [float(value) for row in rows for value in row]
