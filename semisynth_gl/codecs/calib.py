"""The cameras as text: Middlebury's calib.txt and KITTI's calib_cam_to_cam.txt."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from semisynth_gl.codecs.codec import Codec
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.inputs.errors import InputError, ReadError

# HSM reads lines by their position, such as ndisp in line 7, so the order matters.
_KEYS = ("cam0", "cam1", "doffs", "baseline", "width", "height", "ndisp", "isint", "vmin", "vmax", "dyavg", "dymax")


@dataclass(frozen=True, slots=True)
class CalibContent:
    """The content of a calib.txt. ``doffs_px`` is the file's own value, which should agree with the camera's.

    ``ndisp`` is an upper bound of the disparities in whole pixels; ``vmin_px`` and ``vmax_px`` are the smallest and the
    largest disparity of the left view.
    """

    camera: StereoCamera
    doffs_px: float
    ndisp: int
    vmin_px: float
    vmax_px: float


class MiddleburyCalib(Codec[CalibContent]):
    """Middlebury's calib.txt, with the baseline in millimetres."""

    suffix = ".txt"
    description = "Middlebury's calib.txt"

    def encode(self, value: CalibContent) -> bytes:
        """Encode a calibration, with the lines in Middlebury's order."""
        camera = value.camera
        fx, fy, cy = float(camera.focal_px), float(camera.focal_y_px), float(camera.cy_px)
        eyes = [f"[{fx!r} 0 {float(cx)!r}; 0 {fy!r} {cy!r}; 0 0 1]" for cx in (camera.cx_left_px, camera.cx_right_px)]
        lengths = float(value.doffs_px), float(camera.baseline_m) * 1000
        sizes = camera.width_px, camera.height_px, value.ndisp
        values = (*eyes, *map(repr, lengths), *sizes, 0, f"{value.vmin_px:g}", f"{value.vmax_px:g}", 0, 0)
        return "".join(f"{key}={text}\n" for key, text in zip(_KEYS, values, strict=True)).encode()

    def decode(self, data: bytes, path: Path) -> CalibContent:
        """Decode a calibration, with lines in any order. It cannot tell whether the last number is cut off."""
        values = calib_values(data.decode("utf-8", "replace"))
        try:
            number = {key: float(values[key]) for key in _KEYS[2:]}
            left, right = (
                [float(number) for number in re.sub(r"[\[\];,]", " ", values[key]).split()] for key in ("cam0", "cam1")
            )
            fx, fy, cy = left[0], left[4], left[5]
            sides, centres = (int(values["width"]), int(values["height"])), (left[2], right[2], cy)
            camera = StereoCamera(*sides, fx, number["baseline"] / 1000, *centres, fy_over_fx=fy / fx)
            ndisp = int(values["ndisp"])
        except (KeyError, IndexError, ValueError, ZeroDivisionError, InputError) as error:
            raise ReadError(path, f"expected the lines {', '.join(_KEYS)}: {error!r}") from None
        for matrix in (left, right):
            if matrix != [fx, 0, matrix[2], 0, fy, cy, 0, 0, 1]:
                raise ReadError(path, f"expected [fx 0 cx; 0 fy cy; 0 0 1], with fx, fy and cy of cam0, got {matrix}")
        return CalibContent(camera, number["doffs"], ndisp, number["vmin"], number["vmax"])


class KittiCalib(Codec[Any]):
    """KITTI's calib_cam_to_cam.txt: size, rotation and projection of both colour cameras, with lengths in metres.

    It is written for KITTI's loaders, and not read back.
    """

    suffix = ".txt"
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

    def decode(self, data: bytes, path: Path) -> bytes:  # noqa: ARG002 - the codec's signature
        """Return the bytes unchanged: the cameras are in a pair's JSON file too."""
        return data


MIDDLEBURY_CALIB, KITTI_CALIB = MiddleburyCalib(), KittiCalib()


def calib_values(text: str) -> dict[str, str]:
    """Return the values of ``name=value`` lines by name; order, spaces and other lines are ignored."""
    lines = (line.partition("=") for line in text.splitlines())
    return {name.strip(): value.strip() for name, sign, value in lines if sign}
