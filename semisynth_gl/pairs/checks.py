"""Cheap checks of a rendered pair: one that fails is drawn again from another sub-seed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.model import Config
from semisynth_gl.frame.frame import Frame, finite_range
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.textures.crops import least_texture, surely_has_texture

# Rows of which one is looked at first: the others, however dark, leave the mean of a common image above the limit.
_ROWS = 8

# Walls and models keep clear of the near plane, where the disparity is max_px: a surface there was cut open by it.
_AT_NEAR_PLANE = 1e-5

# Rooms that no wall can be brought in for are let pass down to this share of the smallest disparity that they aim for.
_FAR_BELOW = 0.5


@dataclass(frozen=True, slots=True)
class Closed:
    """What a scene promises: whether its pixels have a disparity ``everywhere``, and the least that any of them has."""

    everywhere: bool
    least_px: float

    @classmethod
    def of(cls, sampled: SampledScene, config: Config) -> "Closed":
        """Return what the scene of a pair promises.

        A sky has no disparity, nor has a point that a right camera's deviation shifts to the left. Signed disparities
        may be as small as they are.
        """
        camera, signed = sampled.scene.camera, config.disparity.signed
        if signed or not camera.rectified:
            return cls(everywhere=False, least_px=-np.inf)
        return cls(not sampled.scene.sky.any(), _FAR_BELOW * float(camera.disparity_px(sampled.farthest_m)))


def faults(frame: Frame, config: Config, closed: Closed) -> list[str]:
    """Return the faults of a pair, each a clause with its numbers; ``closed`` is what its scene promises."""
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
        if disparity is not None:
            clauses += _disparity_faults(disparity, config, closed, _near_plane_px(frame, config))
    return list(dict.fromkeys(clauses))


def _disparity_faults(
    disparity: NDArray[np.float32], config: Config, closed: Closed, near_plane_px: float
) -> list[str]:
    """Return the first fault of a view's disparity, if any."""
    valid, smallest, largest = finite_range(disparity)
    missing = disparity.size - valid
    if valid < config.checks.min_valid * disparity.size:
        share, least = valid / disparity.size, config.checks.min_valid
        return [f"too few pixels with truth: {share:.3f}, at least {least:g} wanted"]
    if valid and largest > near_plane_px:
        return [f"cut by the near plane: disparity {largest:.3f} px of {config.disparity.max_px:g}"]
    if missing and closed.everywhere:
        return [f"too deep: no disparity for {missing} pixels in view"]
    if valid and smallest < closed.least_px:
        return [f"too deep: disparity {smallest:.3f} px in a room, at least {closed.least_px:.3f} wanted"]
    return []


def _near_plane_px(frame: Frame, config: Config) -> float:
    """Return the disparity from which a surface is cut by the near plane."""
    # f B / Z is the disparity plus doffs. A signed disparity may be near 0 or below, where a share of it is no margin.
    doffs_px = frame.camera.doffs_px if config.disparity.signed else 0.0
    return (config.disparity.max_px + doffs_px) * (1 - _AT_NEAR_PLANE) - doffs_px


def _surely_bright(image: NDArray[np.uint8], least: float) -> bool:
    """Return True where some rows alone prove that the mean is not below a limit; False says nothing."""
    # Less what the mean may round.
    return int(image[::_ROWS].sum(dtype=np.uint64)) * (1 - 1e-9) >= least * image.size
