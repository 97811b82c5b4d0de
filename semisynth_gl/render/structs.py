"""The structs that numpy packs for shaders, and the bindings of their blocks."""

import numpy as np

# Bindings of the blocks: of uniforms, and of storage.
CONSTANTS_BINDING, PROJECTOR_BINDING = 0, 1
MOVES_BINDING, WEARERS_BINDING = 4, 5

CONSTANTS = np.dtype(
    [
        ("clip_from_view", "<f4", (4, 4)),  # column by column
        ("centre_px", "<f4", 2),
        ("focal_px", "<f4", 2),
        ("focal_baseline", "<f4"),
        ("doffs_px", "<f4"),
        ("near_m", "<f4"),
        ("other_from_own", "<f4"),
        ("least_px", "<f4"),
        ("", "<f4", 3),
    ]
)
"""The uniform block of common_constants.glsl, std140."""

PROJECTOR = np.dtype(
    [
        ("projector_from_window", "<f4", (4, 4)),  # column by column
        ("middle_px", "<f4", 2),
        ("projector_focal_px", "<f4"),
        ("power", "<f4"),
        ("ambient", "<f4"),
        ("", "<f4", 3),
    ]
)
"""The uniform block of common_projector.glsl, std140."""

WEARER = np.dtype([("view_from_model", "<f4", (3, 4)), ("patch_from_uv", "<f4", 4), ("worn", "<f4", 4)])
"""The struct Wearer of edges.geom, std430."""

MOVE = np.dtype([("turn_and_shift", "<f4", (3, 4)), ("centre", "<f4", 3), ("", "<f4"), ("then", "<u4"), ("", "<u4", 3)])
"""The struct Move of flow.comp, std430."""

VERTEX = np.dtype([("position", "<f4", 3), ("uv", "<f4", 2)])
"""The attributes of a vertex in mesh.vert."""

DRAWN_INSTANCE = np.dtype(
    [
        ("view_from_model", "<f4", (3, 4)),
        ("patch_from_uv", "<f4", 4),
        ("layer", "<i4"),
        ("instance", "<i4"),
        ("sky", "<i4"),
    ]
)
"""The attributes of an instance in mesh.vert."""

COMMAND = np.dtype(
    [("count", "<u4"), ("instances", "<u4"), ("first_index", "<u4"), ("base_vertex", "<i4"), ("base_instance", "<u4")]
)
"""OpenGL's DrawElementsIndirectCommand."""
