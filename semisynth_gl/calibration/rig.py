"""Rectified rigs: checks that are common to all formats of calibrations, and ranges over several rigs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from semisynth_gl.calibration.arrays import NO_BOUNDS, DisparityBounds, Size, StereoArrays
from semisynth_gl.calibration.tree import Array
from semisynth_gl.config.fields import LARGEST, SMALLEST
from semisynth_gl.config.rig_sections import MOST_FY_OVER_FX, MOST_PIXELS, WIDEST_PX
from semisynth_gl.frame.camera import Eye, StereoCamera
from semisynth_gl.frame.raw_camera import RawCamera
from semisynth_gl.inputs.errors import InputError

# Largest differences between equal values, relative and in px: the rounding of calibrations that are printed with six
# digits, which is invisible in images.
_SAME_FOCAL = 1e-4
_SAME_CY_PX = 0.05
# Largest distance of a rectified right camera from the x axis, as a fraction of the baseline; KITTI's is off by 0.5 %.
_OFF_BASELINE = 0.01
# A principal point farther from the centre than this, as a fraction of the side, may be that of another size.
_NEAR_CENTRE = 0.1
# Largest entry of a projection matrix: the product of a focal length and a baseline.
_LARGEST_ENTRY = LARGEST**2


@dataclass(frozen=True, slots=True)
class Rig:
    """A rectified rig.

    Attributes:
        camera: the rectified cameras.
        source: name of the file or files, for messages.
        bounds: bounds of disparity that the calibration states.
        layout: layout of the benchmark whose calibration this is; None for any other.
        raw: the cameras before rectification; None where they are not known, or give rectified images by themselves.
        lens_fault: why cameras that the calibration states cannot be used.
        notes: sentences on what was concluded from the calibration.
    """

    camera: StereoCamera
    source: str
    bounds: DisparityBounds = NO_BOUNDS
    layout: str | None = None
    raw: Mapping[Eye, RawCamera] | None = None
    lens_fault: str | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        camera = self.camera
        if max(self.size) > WIDEST_PX or math.prod(self.size) > MOST_PIXELS:
            raise InputError(
                f"{self.source}: images of {self.size}: expected sides of at most {WIDEST_PX} and at most "
                f"{MOST_PIXELS:,} pixels"
            )
        limits = {
            "the focal length": (camera.focal_px, SMALLEST, LARGEST),
            "the baseline": (camera.baseline_m, SMALLEST, LARGEST),
            "cx of the left camera": (camera.cx_left_px, -LARGEST, LARGEST),
            "cx of the right camera": (camera.cx_right_px, -LARGEST, LARGEST),
            "cy": (camera.cy_px, -LARGEST, LARGEST),
            "fy / fx": (camera.fy_over_fx, 1 / MOST_FY_OVER_FX, MOST_FY_OVER_FX),
        }
        limits |= {name: (px, -LARGEST, LARGEST) for name, px in self.bounds._asdict().items() if px is not None}
        for name, (value, least, most) in limits.items():
            if not least <= value <= most:
                raise InputError(f"{self.source}: {name} is {value:g}: expected {least:g} to {most:g}")

    @property
    def size(self) -> Size:
        """Size of the images."""
        return Size(self.camera.width_px, self.camera.height_px)

    @property
    def view_deg(self) -> float:
        """Angle that the image's width takes, degrees."""
        return 2 * math.degrees(math.atan(self.camera.width_px / 2 / self.camera.focal_px))

    def cropped(self, size: Size) -> "Rig":
        """Return the rig of the images' centre, a window of ``size``."""
        across, down = ((whole - part) / 2 for whole, part in zip(self.size, size, strict=True))
        camera = replace(
            self.camera,
            width_px=size.width_px,
            height_px=size.height_px,
            cx_left_px=self.camera.cx_left_px - across,
            cx_right_px=self.camera.cx_right_px - across,
            cy_px=self.camera.cy_px - down,
        )
        raw = self.raw and {
            eye: replace(
                each,
                width_px=size.width_px,
                height_px=size.height_px,
                cx_px=each.cx_px - across,
                cy_px=each.cy_px - down,
            )
            for eye, each in self.raw.items()
        }
        return replace(self, camera=camera, raw=raw, source=f"{self.source}, the centre of {size}")

    def scaled(self, scale: float) -> "Rig":
        """Return the rig of images whose sides are multiplied by ``scale``: reduced below 1, enlarged above.

        Pixel centres are at whole numbers, so a position c becomes (c + 0.5) scale - 0.5. Middlebury's own reduced
        calibrations have c times scale, which shifts both principal points equally and changes no disparity.
        """
        camera = self.camera
        left, right, cy = ((c + 0.5) * scale - 0.5 for c in (camera.cx_left_px, camera.cx_right_px, camera.cy_px))
        size, focal_px = self.size.scaled(scale), camera.focal_px * scale
        camera = StereoCamera(*size, focal_px, camera.baseline_m, left, right, cy, fy_over_fx=camera.fy_over_fx)
        bounds = DisparityBounds(*(None if bound is None else bound * scale for bound in self.bounds))
        raw = self.raw and {eye: each.scaled(scale) for eye, each in self.raw.items()}
        return replace(self, camera=camera, bounds=bounds, raw=raw)


def plain_rig(focal_px: float, baseline_m: float, size: Size) -> Rig:
    """Return a rig with central principal points; raises InputError where a number is out of range."""
    if not baseline_m > 0:
        raise InputError(
            f"expected a distance above 0, from the left camera to the right, got {baseline_m:g}", argument="baseline_m"
        )
    return Rig(StereoCamera.centred(*size, focal_px, baseline_m), "the focal length, baseline and size given")


def rectified(arrays: StereoArrays, size: Size | None) -> Rig:
    """Check the projection matrices of a calibration, and return their rig.

    Both matrices of a rectified pair are K [I | t] with the same fx, fy and cy, and with t along x only. ``size`` is
    the user's size of the images; where the calibration states a size too, they must be equal. Raises InputError
    where the pair is not rectified, the baseline is not above 0, or the size is missing or differs.
    """
    left, right, source = arrays.left.p, arrays.right.p, arrays.source
    if left is None or right is None:
        raise _not_rectified(source, "it has no projection matrices")
    baseline_m = _baseline_m(source, left, right)
    if arrays.size is not None and size is not None and arrays.size != size:
        raise InputError(
            f"{source} is for images of {arrays.size}, not {size}: leave the size out, or give the scale if your "
            "images are reduced",
            argument="size",
        )
    size = arrays.size or size
    if size is None:
        raise InputError(f"{source}: does not say how large the images are: give the size, width and height")
    # The principal points of cameras that were turned a lot lie anywhere once they are rectified.
    raw_matrices = [each.k for each in (arrays.left, arrays.right) if each.k is not None]
    if (fault := turned_size_fault(size, *(raw_matrices or (left, right)))) is not None:
        raise InputError(f"{source}: {fault}")
    (fx, _, cx_left, _), (_, fy, cy, _), _ = left.tolist()
    camera = StereoCamera(*size, fx, baseline_m, cx_left, float(right[0, 2]), cy, fy_over_fx=fy / fx)
    raw = arrays.raw_cameras(size)
    if raw is not None and all(each.is_pinhole(camera, eye) for eye, each in raw.items()):
        raw = None
    return Rig(camera, source, arrays.bounds, arrays.layout, raw, arrays.lens_fault, arrays.notes)


def _baseline_m(source: str, left: Array, right: Array) -> float:
    """Return the baseline of two projection matrices; raises InputError where they are of no rectified pair."""
    for name, matrix in (("left", left), ("right", right)):
        _check_pinhole(source, name, matrix)
    for axis, name in enumerate(("fx", "fy")):
        own, other = float(left[axis, axis]), float(right[axis, axis])
        if abs(own - other) > _SAME_FOCAL * own:
            raise _not_rectified(source, f"focal lengths differ: {name} is {own:g} px left, {other:g} right")
    if abs(left[1, 2] - right[1, 2]) > _SAME_CY_PX:
        raise _not_rectified(source, f"cy differs: {left[1, 2]:g} px left, {right[1, 2]:g} px right")
    # Translations t, metres, from P = K [I | t]; their difference places the right camera in the left one's frame.
    left_m, right_m = (np.linalg.solve(matrix[:, :3], matrix[:, 3]) for matrix in (left, right))
    baseline_m, down_m, forward_m = map(float, left_m - right_m)
    if (fault := vertical_fault(baseline_m, down_m)) is not None:
        raise InputError(f"{source}: {fault}")
    if np.hypot(down_m, forward_m) > _OFF_BASELINE * abs(baseline_m):
        raise _not_rectified(
            source,
            f"the right camera stands {baseline_m:g} m to the right, but also {down_m:g} m below and {forward_m:g} m "
            f"in front of the left one, more than {_OFF_BASELINE:.0%} of the baseline",
        )
    if baseline_m <= 0:
        raise InputError(
            f"{source}: the baseline is {baseline_m:g} m: expected the right camera to the right of the left one; "
            "swap left and right, in the calibration and in your images"
        )
    return baseline_m


def vertical_fault(right_m: float, down_m: float) -> str | None:
    """Return what is wrong with a second camera rather above or below the first one than beside it; None for others.

    ``right_m`` and ``down_m`` lead from the first camera to the second.
    """
    if abs(down_m) <= abs(right_m):
        return None
    return (
        f"is a vertical rig: the right camera stands {abs(down_m):.6g} m {'below' if down_m > 0 else 'above'} the left "
        "one: expected cameras side by side. Turn the images of both by a quarter, as if the rig lay on its side, and "
        "calibrate the turned images"
    )


def turned_size_fault(size: Size, *matrices: Array) -> str | None:
    """Return what is wrong with a size whose width and height have changed places, by camera matrices; None for others.

    The principal points are far from the centre of such a size, and near the centre of the turned one.
    """

    def distance(width_px: int, height_px: int) -> float:
        return max(float(abs(m[k, 2] / side - 0.5)) for m in matrices for k, side in enumerate((width_px, height_px)))

    turned = Size(size.height_px, size.width_px)
    far = distance(*size)
    if far <= _NEAR_CENTRE or distance(*turned) > min(_NEAR_CENTRE, far / 2):
        return None
    cx_px, cy_px = matrices[0][:2, 2]
    return (
        f"the principal point ({cx_px:.6g}, {cy_px:.6g}) is far from the centre of images of {size}, and near that of "
        f"{turned}: the size is probably written as height, width: expected width, then height"
    )


def median_size(rigs: Sequence[Rig]) -> Size:
    """Return the median width and the median height of the images of one or more rigs."""
    return Size(*(sorted(sides)[len(rigs) // 2] for sides in zip(*(rig.size for rig in rigs), strict=True)))


def rig_ranges(rigs: Sequence[Rig]) -> dict[str, tuple[float, float]]:
    """Return the least and the largest value over one or more rigs, by key of the config's section ``camera``.

    The keys are ``focal_px``, ``fy_over_fx``, ``baseline_m``, ``cx_left_px``, ``doffs_px`` and ``cy_px``. Principal
    points are moved into images of `median_size`, so that they keep their distance from the centre.
    """
    size = median_size(rigs)
    values = [
        {
            "focal_px": camera.focal_px,
            "fy_over_fx": camera.fy_over_fx,
            "baseline_m": camera.baseline_m,
            "cx_left_px": camera.cx_left_px + (size.width_px - camera.width_px) / 2,
            "doffs_px": camera.doffs_px,
            "cy_px": camera.cy_px + (size.height_px - camera.height_px) / 2,
        }
        for camera in (rig.camera for rig in rigs)
    ]
    return {key: (min(value[key] for value in values), max(value[key] for value in values)) for key in values[0]}


def _check_pinhole(source: str, name: str, matrix: Array) -> None:
    """Check that the first three columns of a (3, 4) matrix are [fx 0 cx; 0 fy cy; 0 0 1], fx and fy above 0."""
    if not (np.abs(matrix) <= _LARGEST_ENTRY).all():  # written so that nan fails too
        fault = f"holds {matrix.tolist()}: expected finite numbers of at most {_LARGEST_ENTRY:g}"
        raise InputError(f"{source}: the {name} projection matrix {fault}")
    focal_px = float(min(matrix[0, 0], matrix[1, 1]))
    if not focal_px > 0:
        raise InputError(f"{source}: the {name} focal length is {focal_px:g} px: expected a number above 0")
    zeros = (matrix[0, 1], matrix[1, 0], matrix[2, 0], matrix[2, 1])
    if max(map(abs, zeros)) > _SAME_FOCAL * focal_px or abs(matrix[2, 2] - 1) > _SAME_FOCAL:
        raise _not_rectified(
            source,
            f"the {name} projection matrix has rotation or skew: expected [fx 0 cx; 0 fy cy; 0 0 1], got "
            f"{matrix[:, :3].tolist()}",
        )


def _not_rectified(source: str, why: str) -> InputError:
    return InputError(
        f"{source}: is not rectified: {why}. Rectify first (OpenCV: stereoRectify), and give the calibration of the "
        "rectified images"
    )
