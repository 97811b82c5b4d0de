"""Cheap checks of a rendered pair: one that fails is drawn again from another sub-seed."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.model import Config
from semisynth_gl.frame import Frame, finite_range
from semisynth_gl.textures.crops import least_texture, surely_has_texture

# Rows of which one is looked at first: the others, however dark, leave the mean of a common image above the limit.
_ROWS = 8

# Walls and models keep clear of the near plane, where the disparity is max_px: a surface there was cut open by it.
_AT_NEAR_PLANE = 1e-5


def faults(frame: Frame, config: Config) -> list[str]:
    """Return the faults of a pair, each a clause with its numbers."""
    section, clauses, images = config.checks, [], (frame.left.image, frame.right.image)
    if not all(_surely_bright(image, section.min_brightness) for image in images):
        brightness = float(min(image.mean() for image in images))
        if brightness < section.min_brightness:
            clauses.append(f"too dark: mean {brightness:.1f} levels, at least {section.min_brightness:g} wanted")
    if not surely_has_texture(images, section.min_texture):
        texture = least_texture(images)
        if texture < section.min_texture:
            clauses.append(f"too little texture: {texture:.2f} levels, at least {section.min_texture:g} wanted")
    for view in (frame.left, frame.right):
        disparity = view.get("disparity")
        if disparity is None:
            continue
        valid, _, largest = finite_range(disparity)
        if valid < section.min_valid * disparity.size:
            share = valid / disparity.size
            clauses.append(f"too few pixels with truth: {share:.3f}, at least {section.min_valid:g} wanted")
        elif valid and largest > _near_plane_px(frame, config):
            limit = config.disparity.max_px
            clauses.append(f"cut by the near plane: disparity {largest:.3f} px of {limit:g}")
    return list(dict.fromkeys(clauses))


def _near_plane_px(frame: Frame, config: Config) -> float:
    """Return the disparity from which a surface is cut by the near plane."""
    # Of signed disparities, what is about 0 is not near by itself.
    doffs_px = frame.camera.doffs_px if config.disparity.signed else 0.0
    return (config.disparity.max_px + doffs_px) * (1 - _AT_NEAR_PLANE) - doffs_px


def _surely_bright(image: NDArray[np.uint8], least: float) -> bool:
    """Return True where some rows alone prove that the mean is not below a limit; False says nothing."""
    # Less what the mean may round.
    return int(image[::_ROWS].sum(dtype=np.uint64)) * (1 - 1e-9) >= least * image.size
