"""The cameras as text: Middlebury's calib.txt and KITTI's calib_cam_to_cam.txt."""

import re
from dataclasses import dataclass
from pathlib import Path

from semisynth_gl.codecs.codec import Codec
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import InputError, ReadError

# HSM takes lines by their position, such as ndisp from line 7, so the order matters.
_KEYS = ("cam0", "cam1", "doffs", "baseline", "width", "height", "ndisp", "isint", "vmin", "vmax", "dyavg", "dymax")
# Spaces around values are stripped afterwards, since a pattern for them would backtrack at each space.
_LINE = re.compile(r"^[ \t]*(\w+)[ \t]*=(.*)$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Calibration:
    """The content of a calib.txt. ``doffs_px`` is the file's own value, which should agree with the camera's.

    ``ndisp`` is an upper bound of the disparities in whole pixels; ``vmin_px`` and ``vmax_px`` are the smallest and the
    largest disparity of the left view.
    """

    camera: StereoCamera
    doffs_px: float
    ndisp: int
    vmin_px: float
    vmax_px: float


class MiddleburyCalib(Codec[Calibration]):
    """Middlebury's calib.txt, with the baseline in millimetres."""

    name = "txt"
    description = "Middlebury's calib.txt"

    def encode(self, value: Calibration) -> bytes:
        """Encode a calibration, with the lines in Middlebury's order."""
        camera = value.camera
        fx, fy, cy = float(camera.focal_px), float(camera.focal_y_px), float(camera.cy_px)
        eyes = [f"[{fx!r} 0 {float(cx)!r}; 0 {fy!r} {cy!r}; 0 0 1]" for cx in (camera.cx_left_px, camera.cx_right_px)]
        lengths = float(value.doffs_px), float(camera.baseline_m) * 1000
        sizes = camera.width_px, camera.height_px, value.ndisp
        values = (*eyes, *map(repr, lengths), *sizes, 0, f"{value.vmin_px:g}", f"{value.vmax_px:g}", 0, 0)
        return "".join(f"{key}={text}\n" for key, text in zip(_KEYS, values, strict=True)).encode()

    def decode(self, data: bytes, path: Path) -> Calibration:
        """Decode a calibration; raises ReadError also where lines are missing or in another order."""
        text = _text(data, path)
        lines = [line.partition("=") for line in text.splitlines()]
        keys = tuple(key for key, _, _ in lines)
        if keys != _KEYS:
            raise ReadError(path, f"expected the lines {', '.join(_KEYS)} in this order, got {', '.join(keys)}")
        if not text.endswith("\n"):
            raise ReadError(path, f"the last line has no end, as if cut off: {text[-20:]!r}")
        values = {key: value for key, _, value in lines}
        try:
            left, right = calib_matrix(values["cam0"]), calib_matrix(values["cam1"])
            number = {key: float(values[key]) for key in ("doffs", "baseline", "vmin", "vmax")}
            count = {key: int(values[key]) for key in ("width", "height", "ndisp")}
        except ValueError as error:
            raise ReadError(path, str(error)) from None
        fx, fy, cy = left[0], left[4], left[5]
        for name, matrix in (("cam0", left), ("cam1", right)):
            if matrix != [fx, 0.0, matrix[2], 0.0, fy, cy, 0.0, 0.0, 1.0]:
                raise ReadError(
                    path, f"{name} is not [fx 0 cx; 0 fy cy; 0 0 1] with fx, fy and cy of cam0: {values[name]}"
                )
        try:
            sides, points = (count["width"], count["height"]), (left[2], right[2], cy)
            camera = StereoCamera(*sides, fx, number["baseline"] / 1000, *points, fy_over_fx=fy / fx)
        except (InputError, ZeroDivisionError) as error:
            raise ReadError(path, str(error)) from None
        return Calibration(camera, number["doffs"], count["ndisp"], number["vmin"], number["vmax"])


class KittiCalib(Codec[StereoCamera]):
    """KITTI's calib_cam_to_cam.txt: size, rotation and projection of both colour cameras, with lengths in metres."""

    name = "txt"
    description = "KITTI's calib_cam_to_cam.txt"

    def encode(self, value: StereoCamera) -> bytes:
        """Encode a rectified pair of cameras."""
        fx, fy, cy = float(value.focal_px), float(value.focal_y_px), float(value.cy_px)
        lines = []
        for number, cx, shift in (
            ("02", float(value.cx_left_px), 0.0),
            ("03", float(value.cx_right_px), -float(value.focal_baseline)),
        ):
            lines += [
                f"S_rect_{number}: {value.width_px} {value.height_px}",
                f"R_rect_{number}: 1 0 0 0 1 0 0 0 1",
                f"P_rect_{number}: {fx!r} 0 {cx!r} {shift!r} 0 {fy!r} {cy!r} 0 0 0 1 0",
            ]
        return ("\n".join(lines) + "\n").encode()

    def decode(self, data: bytes, path: Path) -> StereoCamera:
        """Decode a rectified pair of cameras; see `Codec.decode`."""
        text = _text(data, path)
        try:
            lines = {name: rest.split() for name, _, rest in (line.partition(":") for line in text.splitlines())}
            size = [int(value) for value in lines["S_rect_02"]]
            left, right = ([float(value) for value in lines[f"P_rect_{number}"]] for number in ("02", "03"))
            (fx, _, cx_left, _, _, fy, cy), (cx_right, shift) = left[:7], right[2:4]
            if not text.endswith("\n") or size != [int(value) for value in lines["S_rect_03"]]:
                raise ReadError(path, "the last line has no end, or the two cameras are not of one size")
            for number, came, expected in (
                ("02", left, [fx, 0, cx_left, 0, 0, fy, cy, 0, 0, 0, 1, 0]),
                ("03", right, [fx, 0, cx_right, shift, 0, fy, cy, 0, 0, 0, 1, 0]),
            ):
                if came != expected:
                    raise ReadError(
                        path, f"P_rect_{number} is {came}, expected {expected}: fx, fy and cy of P_rect_02, no skew"
                    )
            width, height = size
            return StereoCamera(width, height, fx, -shift / fx, cx_left, cx_right, cy, fy_over_fx=fy / fx)
        except (KeyError, IndexError, ValueError, ZeroDivisionError, InputError) as error:
            raise ReadError(path, f"expected S_rect and P_rect of the cameras 02 and 03: {error!r}") from None


MIDDLEBURY_CALIB, KITTI_CALIB = MiddleburyCalib(), KittiCalib()


def calib_values(text: str) -> dict[str, str]:
    """Return the values of ``name=value`` lines by name; they may stand in any order, with other lines and spaces."""
    return {key: value.strip(" \t\r") for key, value in _LINE.findall(text)}


def calib_matrix(text: str) -> list[float]:
    """Return the nine numbers of ``[a b c; d e f; g h i]``, row by row.

    Commas may stand between the numbers, and semicolons may be missing. Raises ValueError for any other text.
    """
    rows = [row.replace(",", " ").split() for row in text.strip().removeprefix("[").removesuffix("]").split(";")]
    if [len(row) for row in rows] not in ([3, 3, 3], [9]):
        raise ValueError(f"expected a matrix [fx 0 cx; 0 fy cy; 0 0 1], got {text!r}")
    return [float(value) for row in rows for value in row]


def _text(data: bytes, path: Path) -> str:
    try:
        return data.decode("ascii")
    except UnicodeDecodeError:
        raise ReadError(path, "is not text") from None
