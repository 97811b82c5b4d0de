"""The structs that numpy packs for shaders, and checks of their layout against the driver's."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.context import GraphicsContext

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

RUN = np.dtype([("instance", "<u4"), ("first_triangle", "<u4"), ("triangles", "<u4"), ("fronts_only", "<u4")])
"""The struct Run of slivers.comp, std430: triangles of one instance."""

COMMAND = np.dtype(
    [("count", "<u4"), ("instances", "<u4"), ("first_index", "<u4"), ("base_vertex", "<i4"), ("base_instance", "<u4")]
)
"""OpenGL's DrawElementsIndirectCommand."""


@dataclass(frozen=True, slots=True)
class Block:
    """A block of shaders whose elements numpy packs.

    A storage block holds an array of elements; a uniform block is a single element.
    """

    binding: int
    dtype: np.dtype[np.void]  # of an element
    array: str = ""  # GLSL's name of a storage block's array; "" for a uniform block


BLOCKS: dict[str, Block] = {
    "Constants": Block(0, CONSTANTS),
    "ProjectedLight": Block(1, PROJECTOR),
    "Moves": Block(4, MOVE, "moves"),
    "Runs": Block(4, RUN, "runs"),
    "Wearers": Block(5, WEARER, "wearers"),
}
"""The blocks that `link_program` checks, by their names in GLSL."""


def members(dtype: np.dtype[Any]) -> Iterator[tuple[str, int, int, str]]:
    """Yield name in GLSL, offset in bytes, number of components and their kind, "i" or "f", of a struct's members.

    A field of shape (3, 4) stands for three vec4, the rows of a matrix, whose names end in ``_x``, ``_y`` and ``_z``.
    Fields without a name are padding.
    """
    for name, field in (dtype.fields or {}).items():
        offset, shape = field[1], field[0].shape
        kind = "f" if field[0].base.kind == "f" else "i"
        if name.startswith("f") and name[1:].isdigit():
            continue
        if shape == (3, 4):
            for row, axis in enumerate("xyz"):
                yield f"{name}_{axis}", offset + row * 16, 4, kind
        else:
            yield name, offset, int(np.prod(shape, dtype=int)), kind


def check_blocks(context: GraphicsContext, program: moderngl.Program | moderngl.ComputeShader) -> None:
    """Raise BackendError, with both layouts, where a program lays a block out differently than numpy packs it."""
    for name, block in BLOCKS.items():
        expected = {member: offset for member, offset, _, _ in members(block.dtype)}
        actual = context.unbound.block_layout(program.glo, name, list(expected), block.array)
        if actual is not None and actual != (expected, block.dtype.itemsize):
            raise BackendError(
                f"{context.renderer} lays out the block {name} as {actual[0]} in {actual[1]} bytes, but the "
                f"program packs {expected} in {block.dtype.itemsize} bytes"
            )


def check_attributes(program: moderngl.Program, dtype: np.dtype[Any]) -> None:
    """Raise BackendError where numpy packs a vertex attribute with another type or size than a linked program takes.

    Attributes that the compiler has removed are not checked.
    """
    for name, _, *expected in members(dtype):
        attribute = program.get(name, None)
        if isinstance(attribute, moderngl.Attribute) and [attribute.dimension, str(attribute.shape)] != expected:
            raise BackendError(
                f"the shader takes {name} as {attribute.dimension} of {attribute.shape}, but the program packs "
                f"{expected[0]} of {expected[1]}"
            )
