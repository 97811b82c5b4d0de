"""How patches lie on surfaces: how large, where, and which surfaces wear large patches."""

from dataclasses import dataclass, fields

import numpy as np

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.scene import Bools, Floats

# Large patches are enlarged up to this factor so that they do not repeat.
_ENLARGED = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The surfaces of N instances, as their patches have to cover them."""

    depth_m: Floats  # (N,) the depth at which the mapping scale holds
    unit_m: Floats  # (N, 2) length of one UV unit
    low: Floats  # (N, 2) the lowest UV that is seen
    high: Floats  # (N, 2) the highest UV that is seen
    large: Bools  # (N,) whether it wears a large patch however little of it is seen

    def __add__(self, other: "Surfaces") -> "Surfaces":
        both = ((getattr(self, key.name), getattr(other, key.name)) for key in fields(self))
        return Surfaces(*(np.concatenate(pair) for pair in both))

    def extent_px(self, camera: StereoCamera) -> Floats:
        """Return what is seen of each surface, (N, 2): its lengths on the screen as if it faced the camera."""
        return np.asarray((self.high - self.low) * self.unit_m * (camera.focal_px / self.depth_m)[:, None])


def wears_large(surfaces: Surfaces, camera: StereoCamera, section: TexturesSection, texels: Floats) -> Bools:
    """Return which surfaces wear a large patch, (N,): the large ones, and those on which a small one would repeat.

    There are ``texels``, (N,), per pixel where a surface faces the camera at its depth.
    """
    return np.asarray(surfaces.large | (surfaces.extent_px(camera).max(axis=1) * texels > section.patch_px))


def map_patches(
    surfaces: Surfaces, camera: StereoCamera, section: TexturesSection, texels: Floats, place: Floats, large: Bools
) -> tuple[Floats, Floats]:
    """Lay patches on surfaces: small ones anywhere, large ones so that they do not repeat where that is possible.

    There are ``texels``, (N,), per pixel where a surface faces the camera at its depth; ``place``, (N, 2) from 0 to 1,
    is where its patch lies. Return the patches per UV unit and the offset in patches, (N, 2) each.
    """
    # At a large surface's depth, where it faces the camera, one patch spans the view at least.
    spanning = large & surfaces.large
    texels = np.where(spanning, np.minimum(texels, section.large_px / camera.width_px), texels)
    patch_px = np.where(large, section.large_px, section.patch_px)
    if large.any():
        seen = surfaces.extent_px(camera).max(axis=1) * texels / patch_px
        texels = np.where(large, texels / np.clip(seen, 1.0, _ENLARGED), texels)
    # A patch at its own resolution covers this part of a ray's slope X / Z, inverted.
    patches_per_slope = camera.focal_px / patch_px
    scale = surfaces.unit_m * (patches_per_slope * texels / surfaces.depth_m)[:, None]
    # What is seen lies between two borders of the patch, at which it would be mirrored.
    free = 1 - (surfaces.high - surfaces.low) * scale
    return scale, np.where(large[:, None], place * free - surfaces.low * scale, place)
