"""The table of a scene's instances: one row for each, with its model, its pose and its patch.

All parts of a scene append rows to one table, `PatchMapping` gives each row its patch, and `to_scene` makes the
renderer's arrays of it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.scene import Bools, Floats, Ints
from semisynth_gl.scene.scene import Projector, Scene
from semisynth_gl.textures.atlas import Patch
from semisynth_gl.textures.shares import patch_chances

# Largest factor by which large patches are enlarged so that they do not repeat.
_ENLARGED = 2.0
# Multiples of this number, modulo 1, spread evenly over [0, 1).
_GOLDEN = (5**0.5 - 1) / 2

INSTANCE = np.dtype(
    [
        ("model", np.int64),  # index into the sampler's models: `SURFACE_MODELS`, then the library's
        ("pose", np.float64, (4, 4)),  # world_from_model, metres
        ("unit_m", np.float64, 2),  # lengths of one unit of u and of v
        ("texture", np.int64),  # the row whose texture it wears: itself, or an earlier one
        ("large", np.bool_),  # whether it wears a large patch however little of it is seen
        ("sky", np.bool_),  # whether it is infinitely far away
        ("depth_m", np.float64),  # depth at which the texels per pixel of its texture hold
        ("uv_low", np.float64, 2),  # lowest UV that is seen
        ("uv_high", np.float64, 2),  # highest UV that is seen
        ("slot", np.int64),  # slot of a particle; -1 for a static instance
        ("generation", np.int64),  # number of a particle in its slot; -1 for a static instance
        ("resting", np.bool_),  # whether it is a particle at rest
        ("patch", np.int64),  # the patch that it wears; a patch of video frames has an atlas layer per frame
        ("uv_scale", np.float64, 2),  # patches per UV unit
        ("uv_offset", np.float64, 2),  # patches
    ],
    align=True,
)
Instances = NDArray[np.void]
"""A table: an array (N,) of `INSTANCE`."""


def new_instances(count: int, **fields: ArrayLike) -> Instances:
    """Return a table of ``count`` static instances; columns that are not given are 0."""
    table = np.zeros(count, INSTANCE)
    table["slot"] = table["generation"] = -1
    for name, values in fields.items():
        table[name] = values
    return table


def to_scene(
    table: Instances,
    camera: StereoCamera,
    near_m: float,
    camera_from_world: Floats | None = None,
    layer: Ints | None = None,
    projector: Projector | None = None,
) -> Scene:
    """Return a table as the renderer's arrays; without a pose the camera is at rest, without layers all are 0."""
    return Scene(
        camera=camera,
        near_m=near_m,
        camera_from_world=np.eye(4) if camera_from_world is None else camera_from_world,
        world_from_model=table["pose"].copy(),
        layer=np.zeros(len(table), np.int64) if layer is None else layer,
        projector=projector,
        **{name: table[name].copy() for name in ("model", "uv_scale", "uv_offset", "sky")},
    )


def choose(ends: Floats, chance: Floats) -> Ints:
    """Map uniform numbers (N,) to the indices (N,) of K items by the cumulative chances (K,) of the items."""
    return np.minimum(np.searchsorted(ends, chance, side="right"), len(ends) - 1)


class PatchMapping:
    """Gives the atlas's patches, small ones before large ones, to instances."""

    def __init__(self, section: TexturesSection, patches: Sequence[Patch]) -> None:
        self._section = section
        self._small = sum(not patch.large for patch in patches)
        self._small_ends, self._large_ends = (
            np.cumsum(patch_chances([patch.shown for patch in some]))
            for some in (patches[: self._small], patches[self._small :])
        )
        self._first_layer = np.array([patch.first_layer for patch in patches])
        self._layer_count = np.array([patch.layer_count for patch in patches])

    def layers(self, patch: Ints, sequence: int, frame: int) -> Ints:
        """Return the atlas layers (N,) that patches (N,) show in a frame; each video begins at another frame."""
        count = self._layer_count[patch]
        return np.asarray(self._first_layer[patch] + ((patch * 7919 + sequence) % count + frame) % count)

    def apply(self, table: Instances, own: Floats, camera: StereoCamera) -> None:
        """Set ``patch``, ``uv_scale`` and ``uv_offset`` of N instances.

        The uniform random numbers ``own`` (N, 4) choose the patch, the part of the patch that is shown, in u and v, and
        the texels per pixel. An instance that wears another one's texture is textured by the other one's numbers, but
        shows a part of a large patch by its own: each side of a box shows another part.
        """
        chances, texels_range = own[table["texture"]], self._section.texels_per_pixel
        texels = texels_range.low * (texels_range.high / texels_range.low) ** chances[:, 3]
        patch, large = choose(self._small_ends, chances[:, 0]), np.zeros(len(table), bool)
        if len(self._large_ends):
            # Large surfaces wear large patches, and so do those on which a small patch would repeat.
            repeats = _extent_px(table, camera).max(axis=1) * texels > self._section.patch_px
            large = table["large"] | repeats
            # Large patches are spread over the static instances, so that few of them wear the same patch.
            static = np.flatnonzero(large & (table["slot"] < 0))
            order = np.unique(table["texture"][static], return_inverse=True)[1]
            chances[static, 0] = (own[:1, 0] + order * _GOLDEN) % 1.0
            patch[large] = self._small + choose(self._large_ends, chances[large, 0])
        part = np.where(large[:, None], own[:, 1:3], chances[:, 1:3])
        table["patch"] = patch
        table["uv_scale"], table["uv_offset"] = map_patches(table, camera, self._section, texels, part, large)


def _extent_px(table: Instances, camera: StereoCamera) -> Floats:
    """Return the lengths in px, along u and v, of each instance's visible part if it faced the camera, (N, 2)."""
    extent = table["uv_high"] - table["uv_low"]
    return np.asarray(extent * table["unit_m"] * (camera.focal_px / table["depth_m"])[:, None])


def map_patches(
    table: Instances, camera: StereoCamera, section: TexturesSection, texels: Floats, part: Floats, large: Bools
) -> tuple[Floats, Floats]:
    """Lay patches on N instances: small patches anywhere, large patches so that they do not repeat if possible.

    ``texels`` (N,) is the number of texels per pixel of an instance that faces the camera at its depth. The uniform
    numbers ``part`` (N, 2) choose the part of its patch that an instance shows; ``large`` (N,) says whether the patch
    is a large one. Returns `Scene.uv_scale` and `Scene.uv_offset`.
    """
    # One patch spans at least the width of the view on a large surface that faces the camera.
    spanning = large & table["large"]
    texels = np.where(spanning, np.minimum(texels, section.large_px / camera.width_px), texels)
    patch_px = np.where(large, section.large_px, section.patch_px)
    if large.any():
        seen = _extent_px(table, camera).max(axis=1) * texels / patch_px
        texels = np.where(large, texels / np.clip(seen, 1.0, _ENLARGED), texels)
    # At one texel per pixel, this many patches cover a unit of a ray's slope X / Z.
    patches_per_slope = camera.focal_px / patch_px
    scale = table["unit_m"] * (patches_per_slope * texels / table["depth_m"])[:, None]
    # The visible part must lie between two borders of the patch, since the patch is mirrored beyond them.
    free = 1 - (table["uv_high"] - table["uv_low"]) * scale
    return scale, np.where(large[:, None], part * free - table["uv_low"] * scale, part)
