"""Middlebury's calib.txt."""

import numpy as np

from semisynth_gl.frame import Frame


def encode_calib(frame: Frame, ndisp: int) -> bytes:
    """Write a frame's calibration in Middlebury's order (HSM reads line 7 as ndisp), baseline in millimetres.

    Args:
        frame: its camera, and its left disparity for vmin and vmax, the range of valid disparities.
        ndisp: an upper bound of disparities, in whole pixels.
    """
    camera = frame.camera
    valid = frame.disparity_left[np.isfinite(frame.disparity_left)]
    vmin, vmax = (float(valid.min()), float(valid.max())) if valid.size else (0.0, 0.0)
    f, cy = float(camera.focal_px), float(camera.cy_px)
    lines = [
        f"cam0=[{f!r} 0 {float(camera.cx_left_px)!r}; 0 {f!r} {cy!r}; 0 0 1]",
        f"cam1=[{f!r} 0 {float(camera.cx_right_px)!r}; 0 {f!r} {cy!r}; 0 0 1]",
        f"doffs={float(camera.doffs_px)!r}",
        f"baseline={float(camera.baseline_m) * 1000!r}",
        f"width={camera.width_px}",
        f"height={camera.height_px}",
        f"ndisp={ndisp}",
        "isint=0",
        f"vmin={vmin:g}",
        f"vmax={vmax:g}",
        "dyavg=0",
        "dymax=0",
    ]
    return ("\n".join(lines) + "\n").encode()
