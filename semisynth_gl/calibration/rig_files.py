"""Calibration files: Middlebury's and ETH3D's and KITTI's here, others by `yaml_rigs`; each format by its content."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.calibration import yaml_rigs
from semisynth_gl.calibration.file_values import FormatError, checked_size
from semisynth_gl.calibration.opencv_rigs import OpenCvValues, opencv_rig
from semisynth_gl.calibration.raw_rig import Unrectified
from semisynth_gl.calibration.rig import DisparityBounds, Projections, Rig, Size, rectified
from semisynth_gl.calibration.ros_rigs import Camera, paired
from semisynth_gl.calibration.yaml_rigs import Read, parse_yaml
from semisynth_gl.codecs import read_bytes
from semisynth_gl.codecs.calib import calib_matrix, calib_values
from semisynth_gl.config.fields import LARGEST
from semisynth_gl.inputs.errors import InputError, ReadError, shown
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.textures.image_files import find_files

FORMATS = (
    "calib.txt of Middlebury and ETH3D (cam0=[...], cam1=[...], baseline=...)",
    "calib_cam_to_cam.txt of KITTI (P_rect_02: ..., P_rect_03: ...) or its P2: and P3:",
    *yaml_rigs.FORMATS,
)
"""The formats that `read_rigs` reads, as text for messages."""

_EXPECTED = f"expected {'; '.join(FORMATS)}"
_EXTENSIONS = (".txt", ".yaml", ".yml", ".json")
# At most one way to match each text: without alternatives to try, a text that does not match fails fast.
_NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_KITTI = re.compile(
    rf"^(P_rect_0[0-3]|P[0-3]|S_rect_0[0-3])[ \t]*:[ \t]*({_NUMBER}(?:[ \t]+{_NUMBER})*)[ \t\r]*$", re.MULTILINE
)
_KITTI_PAIRS = (("P_rect_02", "P_rect_03"), ("P_rect_00", "P_rect_01"), ("P2", "P3"), ("P0", "P1"))
# First part of the name of a folder that ETH3D's archives have.
_ETH3D = "two_view_"
# Largest number of characters of a matrix in a message.
_SHOWN = 400
_LARGEST_BYTES = 1 << 20


def read_rigs(
    sources: Sequence[str | Path],
    *,
    size: Size | None = None,
    unit_m: float | None = None,
    alpha: float | None = None,
    fov_deg: float | None = None,
) -> list[Rig]:
    """Read rectified rigs from calibration files and globs, in the order of the files.

    Each file describes a rig, except for ROS's camera_info, which describes one camera. Those of both cameras, the left
    camera's first, in two files or in one, make a rig; the right camera's suffices, since it holds the baseline.

    Args:
        sources: names of files, and globs.
        size: size of the images, for files that do not state it; where a file does, both must be equal.
        unit_m: metres per unit of the translation in OpenCV files; None for files in metres, and for other formats.
        alpha: how to rectify files that do not say it, see `Unrectified.rectified`; None for other files.
        fov_deg: likewise, instead of ``alpha``.

    Raises:
        InputError: where there is no file, a rig is not rectified, or OpenCV is needed and missing.
        ReadError: where a file has none of the formats, or breaks its format.
    """
    paths: dict[Path, None] = {}
    for source in sources:
        if expanded(source).is_dir():
            raise InputError(
                f"{source} is a folder; give files, or a glob such as '{source}/*/calib.txt'", argument="calib"
            )
        matches = find_files([source], _EXTENSIONS)
        if not matches:
            raise InputError(
                f"{source}: no such file, and as a glob it matches no .txt, .yaml, .yml or .json", argument="calib"
            )
        paths |= dict.fromkeys(matches)
    calibrations = _opencv_rigs([each for path in paths for each in _read(path, unit_m)], size, unit_m)
    pairs = [_projections(pair, alpha, fov_deg) for pair in calibrations if not isinstance(pair, Camera)]
    cameras = [camera for camera in calibrations if isinstance(camera, Camera)]
    if cameras and (pairs or len(cameras) > 2):
        names = ", ".join(camera.source for camera in cameras[:4]) + (", ..." if len(cameras) > 4 else "")
        raise InputError(
            f"{len(cameras)} of {len(calibrations)} calibrations are of one camera ({names}): expected two of "
            "these, the left camera's first, or only the right camera's"
        )
    if cameras:
        pairs = [_projections(paired(cameras), alpha, fov_deg)]
    return [rectified(pair, size) for pair in pairs]


def _projections(rig: Projections | Unrectified, alpha: float | None, fov_deg: float | None) -> Projections:
    if isinstance(rig, Unrectified):
        try:
            return rig.rectified(alpha, fov_deg)
        except FormatError as error:
            raise ReadError(Path(rig.source), str(error)) from None
    for name, value in {"alpha": alpha, "fov_deg": fov_deg}.items():
        if value is not None:
            raise InputError(
                f"{rig.source} states how its images are rectified: leave this out, or give an OpenCV file with only "
                "K, D, R and T",
                argument=name,
            )
    return rig


def _opencv_rigs(calibrations: Sequence[OpenCvValues | Read], size: Size | None, unit_m: float | None) -> list[Read]:
    """Turn OpenCV's values into rigs; a file of intrinsics and a file of extrinsics make one rig."""
    files = [each for each in calibrations if isinstance(each, OpenCvValues)]
    if len(files) == 2 and files[0].raw_only != files[1].raw_only:
        calibrations = [files[0].joined(files[1]), *(each for each in calibrations if each not in files)]
    rigs: list[Read] = []
    for each in calibrations:
        try:
            rigs.append(opencv_rig(each, size, unit_m) if isinstance(each, OpenCvValues) else each)
        except FormatError as error:
            raise ReadError(Path(each.source), str(error)) from None
    return rigs


def _read(path: Path, unit_m: float | None) -> Sequence[OpenCvValues | Read]:
    try:
        return _parsed(read_bytes(path, _LARGEST_BYTES).decode("utf-8-sig"), str(path), unit_m)
    except UnicodeDecodeError:
        raise ReadError(path, f"is not text; {_EXPECTED}") from None
    except FormatError as error:
        raise ReadError(path, str(error)) from None


def _parsed(text: str, source: str, unit_m: float | None) -> Sequence[OpenCvValues | Read]:
    calibrations: Sequence[OpenCvValues | Read]
    if "cam0" in (lines := calib_values(text)):
        calibrations = [_middlebury(lines, source)]
    elif _KITTI.search(text):
        calibrations = [_kitti(text, source)]
    else:
        calibrations = parse_yaml(text, source, _EXPECTED)
    if unit_m is not None and not isinstance(calibrations[0], OpenCvValues):
        raise FormatError("its format states the unit: leave the unit out, which is only for OpenCV's files")
    return calibrations


def _middlebury(values: Mapping[str, str], source: str) -> Projections:
    missing = [key for key in ("cam0", "cam1", "baseline") if key not in values]
    if missing:
        raise FormatError(f"lacks {', '.join(missing)}: expected cam0=[...], cam1=[...], baseline=... in millimetres")

    def number(key: str) -> float:
        try:
            return float(values[key])
        except ValueError:
            raise FormatError(f"{key}: expected a number, got {shown(values[key])}") from None

    left, right = (_middlebury_matrix(key, values[key]) for key in ("cam0", "cam1"))
    baseline_m = number("baseline") / 1000
    if not abs(baseline_m) <= LARGEST:
        raise FormatError(f"baseline: expected at most {LARGEST:g} m, got {baseline_m:g} m")
    right[0, 3] = -right[0, 0] * baseline_m
    doffs_px = float(right[0, 2] - left[0, 2])
    if "doffs" in values and abs(number("doffs") - doffs_px) > 0.02:
        raise FormatError(
            f"doffs is {number('doffs'):g}, but cx of cam1 minus cx of cam0 is {doffs_px:g}: one of them is wrong"
        )
    size = (number("width"), number("height")) if "width" in values and "height" in values else None
    ndisp, vmin, vmax = (number(key) if key in values else None for key in ("ndisp", "vmin", "vmax"))
    # ETH3D's files have the same form as Middlebury's, but lie in folders such as two_view_training or two_view_test.
    layout = "eth3d" if any(part.startswith(_ETH3D) for part in Path(source).absolute().parts) else "middlebury"
    return Projections(left, right, checked_size(size), source, DisparityBounds(ndisp, vmin, vmax), layout)


def _middlebury_matrix(key: str, text: str) -> NDArray[np.float64]:
    """Return a matrix (3, 4), its last column 0."""
    try:
        matrix = np.reshape(calib_matrix(text), (3, 3))
    except ValueError:
        raise FormatError(f"{key}: expected a matrix [f 0 cx; 0 f cy; 0 0 1], got {shown(text, _SHOWN)}") from None
    if not (np.abs(matrix) <= LARGEST).all():
        raise FormatError(f"{key}: expected finite numbers of at most {LARGEST:g}, got {shown(text, _SHOWN)}")
    return np.hstack([matrix, np.zeros((3, 1))])


def _kitti(text: str, source: str) -> Projections:
    values = {key: [float(number) for number in numbers.split()] for key, numbers in _KITTI.findall(text)}
    pair = next((pair for pair in _KITTI_PAIRS if values.keys() >= set(pair)), None)
    if pair is None:
        raise FormatError(f"has {', '.join(values)}: expected P_rect_02 and P_rect_03, or P2 and P3")
    for key in pair:
        if len(values[key]) != 12:
            raise FormatError(f"{key}: expected 12 numbers, got {len(values[key])}")
    sizes = [values.get(key.replace("P", "S", 1)) for key in pair]
    if sizes[0] != sizes[1] or (sizes[0] is not None and len(sizes[0]) != 2):
        raise FormatError(f"the rectified sizes are {sizes[0]} and {sizes[1]}: expected one width and height")
    left, right = (np.reshape(values[key], (3, 4)) for key in pair)
    return Projections(left, right, checked_size(sizes[0]), source, layout="kitti")
