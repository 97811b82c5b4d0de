"""Cheap checks of a rendered pair; a pair that fails them is sampled again from another sub-seed."""

import numpy as np

from semisynth_gl.config.model import Config
from semisynth_gl.frame.frame import Frame, finite_range
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.textures.crops import least_texture

# The mean of every so many rows is taken first: in a usual image, these rows keep the mean above the limit even if all
# others are black.
_ROWS = 8

# Factor over the limit at which a sample of every 64th pixel proves that the image has enough texture.
_AMPLE = 8

# Share of max_px within which a disparity counts as at the near plane. Walls and models stay farther away, so a surface
# there was cut open by the plane.
_AT_NEAR_PLANE = 1e-5

# A room's disparity may be as small as this share of the smallest one that it aims for, since some walls cannot be
# moved in far enough.
_FAR_BELOW = 0.5


def faults(frame: Frame, config: Config, sampled: SampledScene | None = None) -> list[str]:
    """Return the faults of a pair, without repetition, such as "too dark: mean 3.0 levels, at least 8 wanted".

    The limits are those of the config's section checks. ``sampled`` is the scene that the frame shows as rendered, and
    tells which disparities to expect; None for a frame that has passed the lenses.
    """
    section, clauses, images = config.checks, [], (frame.left.image, frame.right.image)
    of_rows, least = min(image[::_ROWS].mean() for image in images), section.min_brightness
    if of_rows < _ROWS * least and (brightness := min(image.mean() for image in images)) < least:
        clauses.append(f"too dark: mean {brightness:.1f} levels, at least {least:g} wanted")
    # `least_texture` halves both sides again. Every 64th pixel takes a tenth of the time, and settles usual images.
    sampled_texture = least_texture(image[::4, ::4] for image in images)
    if sampled_texture < _AMPLE * section.min_texture and (texture := least_texture(images)) < section.min_texture:
        clauses.append(f"too little texture: {texture:.2f} levels, at least {section.min_texture:g} wanted")
    return list(dict.fromkeys(clauses + _disparity_faults(frame, config, sampled)))


def _disparity_faults(frame: Frame, config: Config, sampled: SampledScene | None) -> list[str]:
    """Return the first fault of each view's disparity."""
    everywhere, least_px = False, -np.inf
    # The sky has no disparity, and neither has a point that a right camera's deviation shifts to the left. Signed
    # disparities have no lower limit.
    if sampled is not None and frame.camera.rectified and not config.disparity.signed:
        everywhere = not sampled.scene.sky.any()
        least_px = _FAR_BELOW * float(sampled.scene.camera.disparity_px(sampled.sequence.static.farthest_m))
    # The margin is a share of f B / Z, which is the disparity plus doffs: a signed disparity may be 0 or negative.
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
        elif missing and everywhere:
            clauses.append(f"too deep: no disparity for {missing} pixels in view")
        elif valid and smallest < least_px:
            clauses.append(f"too deep: disparity {smallest:.3f} px in a room, at least {least_px:.3f} wanted")
    return clauses
