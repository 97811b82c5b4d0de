"""How patches lie on surfaces: how large, where, and which surfaces wear large patches."""

from dataclasses import dataclass, fields

import numpy as np

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.scene import Bools, Floats

# Largest factor by which large patches are enlarged so that they do not repeat.
_ENLARGED = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The surfaces of N instances, measured for the patches that cover them."""

    depth_m: Floats  # (N,) the depth at which the mapping scale holds
    unit_m: Floats  # (N, 2) lengths of one unit of u and of v
    low: Floats  # (N, 2) the lowest UV that is seen
    high: Floats  # (N, 2) the highest UV that is seen
    large: Bools  # (N,) whether a surface wears a large patch however little of it is seen

    def __add__(self, other: "Surfaces") -> "Surfaces":
        both = ((getattr(self, key.name), getattr(other, key.name)) for key in fields(self))
        return Surfaces(*(np.concatenate(pair) for pair in both))

    def extent_px(self, camera: StereoCamera) -> Floats:
        """Return the lengths in px, along u and v, of each surface's visible part if it faced the camera, (N, 2)."""
        return np.asarray((self.high - self.low) * self.unit_m * (camera.focal_px / self.depth_m)[:, None])


def wears_large(surfaces: Surfaces, camera: StereoCamera, section: TexturesSection, texels: Floats) -> Bools:
    """Return which surfaces wear a large patch, (N,): large surfaces, and those on which a small patch would repeat.

    ``texels`` (N,) are the texels per pixel of each surface where it faces the camera at its depth.
    """
    return np.asarray(surfaces.large | (surfaces.extent_px(camera).max(axis=1) * texels > section.patch_px))


def map_patches(
    surfaces: Surfaces, camera: StereoCamera, section: TexturesSection, texels: Floats, place: Floats, large: Bools
) -> tuple[Floats, Floats]:
    """Lay patches on N surfaces: small patches anywhere, large patches so that they do not repeat if that is possible.

    Args:
        surfaces: the surfaces.
        camera: the camera.
        section: the config's textures.
        texels: (N,) texels per pixel where a surface faces the camera at its depth.
        place: (N, 2) uniform numbers from 0 to 1 that say which part of its patch a surface shows.
        large: (N,) whether a surface wears a large patch.

    Returns:
        Patches per UV unit, and offsets in patches, (N, 2) each: `Scene.uv_scale` and `Scene.uv_offset`.
    """
    # One patch spans at least the width of the view on a large surface that faces the camera.
    spanning = large & surfaces.large
    texels = np.where(spanning, np.minimum(texels, section.large_px / camera.width_px), texels)
    patch_px = np.where(large, section.large_px, section.patch_px)
    if large.any():
        seen = surfaces.extent_px(camera).max(axis=1) * texels / patch_px
        texels = np.where(large, texels / np.clip(seen, 1.0, _ENLARGED), texels)
    # At one texel per pixel, this many patches cover a unit of a ray's slope X / Z.
    patches_per_slope = camera.focal_px / patch_px
    scale = surfaces.unit_m * (patches_per_slope * texels / surfaces.depth_m)[:, None]
    # The visible part must lie between two borders of the patch, since the patch is mirrored beyond them.
    free = 1 - (surfaces.high - surfaces.low) * scale
    return scale, np.where(large[:, None], place * free - surfaces.low * scale, place)
