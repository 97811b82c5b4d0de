"""Cheap checks of a rendered pair: one that fails is drawn again from another sub-seed."""

import numpy as np

from semisynth_gl.config.model import Config
from semisynth_gl.frame import Frame
from semisynth_gl.textures.crops import least_texture

# Walls and models keep clear of the near plane, where the disparity is max_px: a surface there was cut open by it.
_AT_NEAR_PLANE = 1e-5


def faults(frame: Frame, config: Config) -> list[str]:
    """Return the faults of a pair, each a clause with its numbers."""
    section, clauses = config.checks, []
    brightness = float(min(frame.left.image.mean(), frame.right.image.mean()))
    if brightness < section.min_brightness:
        clauses.append(f"too dark: mean {brightness:.1f} levels, at least {section.min_brightness:g} wanted")
    texture = least_texture((frame.left.image, frame.right.image))
    if texture < section.min_texture:
        clauses.append(f"too little texture: {texture:.2f} levels, at least {section.min_texture:g} wanted")
    for view in (frame.left, frame.right):
        disparity = view.get("disparity")
        if disparity is None:
            continue
        valid = disparity[np.isfinite(disparity)]
        if len(valid) < section.min_valid * disparity.size:
            share = len(valid) / disparity.size
            clauses.append(f"too few pixels with truth: {share:.3f}, at least {section.min_valid:g} wanted")
        elif len(valid) and float(valid.max()) > config.disparity.max_px * (1 - _AT_NEAR_PLANE):
            largest, limit = float(valid.max()), config.disparity.max_px
            clauses.append(f"cut by the near plane: disparity {largest:.3f} px of {limit:g}")
    return list(dict.fromkeys(clauses))
