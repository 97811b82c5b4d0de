"""The table of a scene's instances: one row for each, with its model, its pose and its patch.

All parts of a scene append rows to one table, `semisynth_gl.scene.mapping` gives each row its patch, and `to_scene`
hands the table to the renderer.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.scene import Projector, Scene

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
        model=table["model"].copy(),
        world_from_model=table["pose"].copy(),
        layer=np.zeros(len(table), np.int64) if layer is None else layer,
        uv_scale=table["uv_scale"].copy(),
        uv_offset=table["uv_offset"].copy(),
        sky=table["sky"].copy(),
        projector=projector,
    )
