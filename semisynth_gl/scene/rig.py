"""Drawing the stereo camera of one sequence."""

import numpy as np

from semisynth_gl.camera import StereoCamera
from semisynth_gl.config import Range
from semisynth_gl.config.model import CameraSection, DisparitySection
from semisynth_gl.errors import InputError


def draw_camera(section: CameraSection, rng: np.random.Generator) -> StereoCamera:
    """Draw every range of the section once, always in the same order."""
    zero = Range(0.0, 0.0)
    if section.focal_px is not None:
        focal_px = section.focal_px.draw(rng)
    else:
        assert section.focal_mm is not None and section.sensor_width_mm is not None  # noqa: S101, PT018 - CameraSection
        focal_px = section.focal_mm.draw(rng) / section.sensor_width_mm * section.width_px
    baseline_m = section.baseline_m.draw(rng)
    doffs_px = (section.doffs_px or zero).draw(rng)
    centre_x, centre_y = (section.width_px - 1) / 2, (section.height_px - 1) / 2
    cx_left_px = (section.cx_left_px or Range(centre_x - doffs_px / 2, centre_x - doffs_px / 2)).draw(rng)
    cx_right_px = (section.cx_right_px or Range(cx_left_px + doffs_px, cx_left_px + doffs_px)).draw(rng)
    cy_px = (section.cy_px or Range(centre_y, centre_y)).draw(rng)
    return StereoCamera(section.width_px, section.height_px, focal_px, baseline_m, cx_left_px, cx_right_px, cy_px)


def near_depth_m(camera: StereoCamera, section: DisparitySection) -> float:
    """Depth of the near plane, where the disparity reaches ``max_px``.

    Raises:
        InputError: where doffs leaves no positive depth for that disparity.
    """
    check_reachable(camera, section.min_px, "disparity.min_px")
    return float(camera.depth_m(section.max_px))


def check_reachable(camera: StereoCamera, disparity_px: float, key: str) -> None:
    """Check that a disparity has a depth in front of the camera.

    Raises:
        InputError: where d + doffs is not positive: such rays never meet.
    """
    if disparity_px + camera.doffs_px <= 0:
        raise InputError(
            f"{key}: {disparity_px:g} px lies beyond infinity for a camera whose principal points differ by doffs = "
            f"{camera.doffs_px:g} px: raise {key} above {-camera.doffs_px:g}, or change camera.doffs_px or cx"
        )
