"""Cheap checks of a rendered pair: one that fails is drawn again from another sub-seed."""

import numpy as np

from semisynth_gl.config.model import Config
from semisynth_gl.frame import Frame
from semisynth_gl.textures.crops import texture_measure

# Walls and models keep clear of the near plane, where the disparity is max_px; what reaches it was cut open by it.
_AT_NEAR_PLANE = 1e-5


def faults(frame: Frame, config: Config) -> list[str]:
    """Say what is wrong with a pair, a clause each with its numbers; empty where nothing is."""
    section, found = config.checks, []
    brightness = float(min(frame.left.image.mean(), frame.right.image.mean()))
    if brightness < section.min_brightness:
        found.append(f"too dark: mean {brightness:.1f} levels, at least {section.min_brightness:g} wanted")
    # Every second pixel of every second row: a share of the time, and texture of a pixel's size is seen either way.
    texture = min(
        texture_measure(np.ascontiguousarray(image[::2, ::2])) for image in (frame.left.image, frame.right.image)
    )
    if texture < section.min_texture:
        found.append(f"too little texture: {texture:.2f} levels, at least {section.min_texture:g} wanted")
    for view in (frame.left, frame.right):
        disparity = view.get("disparity")
        if disparity is None:
            continue
        valid = disparity[np.isfinite(disparity)]
        if len(valid) < section.min_valid * disparity.size:
            share = len(valid) / disparity.size
            found.append(f"too few pixels with truth: {share:.3f}, at least {section.min_valid:g} wanted")
        elif len(valid) and float(valid.max()) > config.disparity.max_px * (1 - _AT_NEAR_PLANE):
            found.append(f"cut by the near plane: disparity {float(valid.max()):.3f} px of {config.disparity.max_px:g}")
    return list(dict.fromkeys(found))
