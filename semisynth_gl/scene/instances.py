"""The table of a scene's instances: one row for each, with its model, its pose and its patch.

`PatchAssignment` assigns a patch to each row. `to_scene` converts the table into the renderer's arrays.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.scene import Bools, Floats, Ints
from semisynth_gl.scene.scene import Projector, Scene
from semisynth_gl.textures.atlas import Patch
from semisynth_gl.textures.subjects import patch_chances

# Maximum factor by which a large patch is enlarged so that it does not repeat.
_ENLARGED = 2.0
# Multiples of this number, modulo 1, spread evenly over [0, 1).
_GOLDEN = (5**0.5 - 1) / 2

INSTANCE = np.dtype(
    [
        ("model", np.int64),  # index into the sampler's models: `SURFACE_MODELS`, then the library's
        ("pose", np.float64, (4, 4)),  # world_from_model, metres
        ("unit_m", np.float64, 2),  # lengths of one unit of u and of v
        ("texture", np.int64),  # number of the row whose texture it has: its own number, or an earlier row's
        ("large", np.bool_),  # whether it always gets a large patch, even if only a small part of it is visible
        ("sky", np.bool_),  # whether it is infinitely far away
        ("depth_m", np.float64),  # depth at which its texture has the sampled number of texels per pixel
        ("uv_low", np.float64, 2),  # lowest visible UV
        ("uv_high", np.float64, 2),  # highest visible UV
        ("slot", np.int64),  # slot of a particle; a slot shows one particle after the other; -1 if static
        ("generation", np.int64),  # number of a particle among those of its slot, in order of time; -1 if static
        ("resting", np.bool_),  # whether it is a particle at rest
        ("patch", np.int64),  # number of its patch; a patch of video frames has an atlas layer per frame
        ("uv_scale", np.float64, 2),  # patches per UV unit
        ("uv_offset", np.float64, 2),  # patches
    ],
    align=True,
)
Instances = NDArray[np.void]
"""A table: an array (N,) of `INSTANCE`."""


def new_instances(count: int, **fields: ArrayLike) -> Instances:
    """Return a table of ``count`` static instances; columns that are not in ``fields`` are 0."""
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
    """Return a table as the renderer's arrays; by default the camera is at the world's origin, and all layers are 0."""
    return Scene(
        camera=camera,
        near_m=near_m,
        camera_from_world=np.eye(4) if camera_from_world is None else camera_from_world,
        world_from_model=table["pose"].copy(),
        layer=np.zeros(len(table), np.int64) if layer is None else layer,
        projector=projector,
        **{name: table[name].copy() for name in ("model", "uv_scale", "uv_offset", "sky")},
    )


def choose(cumulative: Floats, uniform: Floats) -> Ints:
    """Choose N of K items, given their cumulative chances (K,) and uniform random numbers (N,); return indices (N,)."""
    return np.minimum(np.searchsorted(cumulative, uniform, side="right"), len(cumulative) - 1)


class PatchAssignment:
    """Assigns patches of the atlas to instances; ``patches`` has small patches before large ones."""

    def __init__(self, section: TexturesSection, patches: Sequence[Patch]) -> None:
        self._section = section
        self._small = sum(not patch.large for patch in patches)
        self._small_chances, self._large_chances = (
            np.cumsum(patch_chances([patch.subject_name for patch in some]))
            for some in (patches[: self._small], patches[self._small :])
        )
        self._first_layer = np.array([patch.first_layer for patch in patches])
        self._layer_count = np.array([patch.layer_count for patch in patches])

    def layers(self, patch: Ints, sequence: int, frame: int) -> Ints:
        """Return the atlas layers (N,) that patches (N,) show in a frame; videos start at different frames."""
        count = self._layer_count[patch]
        # 7919 is a prime above all counts, so successive patches start at different frames.
        return np.asarray(self._first_layer[patch] + ((patch * 7919 + sequence) % count + frame) % count)

    def apply(self, table: Instances, uniform: Floats, camera: StereoCamera) -> None:
        """Set ``patch``, ``uv_scale`` and ``uv_offset`` of N instances.

        A row of the uniform random numbers ``uniform`` (N, 4) chooses the patch, the visible part of the patch in u and
        in v, and the texels per pixel. Instances that share a texture share the row of the first of these instances,
        except for the visible part of a large patch: each side of a box shows a different part.
        """
        shared = uniform[table["texture"]]  # a copy, whose first column changes below
        texels_range = self._section.texels_per_pixel
        texels = texels_range.low * (texels_range.high / texels_range.low) ** shared[:, 3]
        patch, large = choose(self._small_chances, shared[:, 0]), np.zeros(len(table), bool)
        if len(self._large_chances):
            # Large surfaces get large patches, and so do surfaces on which a small patch would repeat.
            repeats = _extent_px(table, camera).max(axis=1) * texels > self._section.patch_px
            large = table["large"] | repeats
            # Spread large patches evenly: texture k adds k * _GOLDEN to the random number of the table's first row.
            static = np.flatnonzero(large & (table["slot"] < 0))
            order = np.unique(table["texture"][static], return_inverse=True)[1]
            shared[static, 0] = (uniform[:1, 0] + order * _GOLDEN) % 1.0
            patch[large] = self._small + choose(self._large_chances, shared[large, 0])
        part = np.where(large[:, None], uniform[:, 1:3], shared[:, 1:3])
        table["patch"] = patch
        table["uv_scale"], table["uv_offset"] = map_patches(table, camera, self._section, texels, part, large)


def _extent_px(table: Instances, camera: StereoCamera) -> Floats:
    """Return the lengths, px, along u and v of each instance's visible part, as if it faced the camera: (N, 2)."""
    extent = table["uv_high"] - table["uv_low"]
    return np.asarray(extent * table["unit_m"] * (camera.focal_px / table["depth_m"])[:, None])


def map_patches(
    table: Instances, camera: StereoCamera, section: TexturesSection, texels: Floats, part: Floats, large: Bools
) -> tuple[Floats, Floats]:
    """Map patches to N instances: small patches at any offset, large patches so that they repeat as little as possible.

    ``texels`` (N,) is the number of texels per pixel for an instance that faces the camera at its ``depth_m``. The
    uniform numbers ``part`` (N, 2) choose the part of the patch that an instance shows. ``large`` (N,) says whether the
    patch is large. Returns `Scene.uv_scale` and `Scene.uv_offset`.
    """
    # On a large surface that faces the camera, one large patch is at least as wide as the view.
    spanning = large & table["large"]
    texels = np.where(spanning, np.minimum(texels, section.large_px / camera.width_px), texels)
    patch_px = np.where(large, section.large_px, section.patch_px)
    if large.any():
        seen = _extent_px(table, camera).max(axis=1) * texels / patch_px
        texels = np.where(large, texels / np.clip(seen, 1.0, _ENLARGED), texels)
    focal_patches = camera.focal_px / patch_px  # at one texel per pixel
    scale = table["unit_m"] * (focal_patches * texels / table["depth_m"])[:, None]
    # The visible part of the surface must be inside a large patch, which is mirrored or repeated beyond its borders.
    free = 1 - (table["uv_high"] - table["uv_low"]) * scale
    return scale, np.where(large[:, None], part * free - table["uv_low"] * scale, part)
