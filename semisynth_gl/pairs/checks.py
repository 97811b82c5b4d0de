"""Cheap checks of a rendered pair. If it fails, its scene is sampled again from a different sub-seed."""

import numpy as np

from semisynth_gl.config.model import Config
from semisynth_gl.frame.frame import Frame, finite_range
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.textures.crops import least_texture

# Step of the rows that the quick check of brightness reads. Most images pass: they would be bright enough even if all
# other rows were black.
_ROWS = 8

# An image has enough texture if a sample of every 64th pixel has this many times the limit.
_AMPLE = 8

# Share of max_px: the near plane cut a surface whose disparity is closer to max_px, since walls and models stay beyond.
_AT_NEAR_PLANE = 1e-5

# A room may have disparities down to this share of the intended minimum: some walls cannot be moved close enough.
_FAR_BELOW = 0.5


def faults(frame: Frame, config: Config, sampled: SampledScene | None = None) -> list[str]:
    """Return the faults of a pair, such as "too dark: mean 3.0 levels, at least 8 wanted".

    The config's section checks has the limits. ``sampled`` is the pair's scene, which limits the disparities of a room;
    None after lenses and imperfections.
    """
    section, clauses, images = config.checks, [], (frame.left.image, frame.right.image)
    row_brightness, least = min(image[::_ROWS].mean() for image in images), section.min_brightness
    if row_brightness < _ROWS * least and (brightness := min(image.mean() for image in images)) < least:
        clauses.append(f"too dark: mean {brightness:.1f} levels, at least {least:g} wanted")
    # `least_texture` halves both sides again, so it reads every 64th pixel.
    sampled_texture = least_texture(image[::4, ::4] for image in images)
    if sampled_texture < _AMPLE * section.min_texture and (texture := least_texture(images)) < section.min_texture:
        clauses.append(f"too little texture: {texture:.2f} levels, at least {section.min_texture:g} wanted")
    return list(dict.fromkeys(clauses + _disparity_faults(frame, config, sampled)))


def _disparity_faults(frame: Frame, config: Config, sampled: SampledScene | None) -> list[str]:
    """Return the first fault of each view's disparity."""
    is_dense, least_px = False, -np.inf
    # The sky has no disparity. Neither have points that a deviating right camera shifts to the left. Signed disparities
    # have no lower limit.
    if sampled is not None and frame.camera.rectified and not config.disparity.signed:
        is_dense = not sampled.scene.sky.any()
        least_px = _FAR_BELOW * float(sampled.scene.camera.disparity_px(sampled.sequence.static.farthest_m))
    # The margin is relative to f B / Z, which is the disparity plus doffs: a signed disparity may be 0 or negative.
    doffs_px = frame.camera.doffs_px if config.disparity.signed else 0.0
    near_plane_px = (config.disparity.max_px + doffs_px) * (1 - _AT_NEAR_PLANE) - doffs_px
    limits, clauses = config.checks, []
    for view in (frame.left, frame.right):
        if "disparity" not in view:
            continue
        valid, smallest, largest = finite_range(view.disparity)
        share, missing = valid / view.disparity.size, view.disparity.size - valid
        if valid < limits.min_valid * view.disparity.size:
            clauses.append(f"too few pixels with truth: {share:.3f}, at least {limits.min_valid:g} wanted")
        elif valid and largest > near_plane_px:
            clauses.append(f"cut by the near plane: disparity {largest:.3f} px of {config.disparity.max_px:g}")
        elif missing and is_dense:
            clauses.append(f"too deep: no disparity for {missing} pixels in view")
        elif valid and smallest < least_px:
            clauses.append(f"too deep: disparity {smallest:.3f} px in a room, at least {least_px:.3f} wanted")
    return clauses
