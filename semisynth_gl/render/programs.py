"""Linked shader programs, with errors that say what is wrong."""

from collections.abc import Mapping

import moderngl

from semisynth_gl.errors import BackendError
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.shader_source import shader_source
from semisynth_gl.render.structs import check_blocks


def link_program(context: GraphicsContext, vertex: str, fragment: str, defines: Mapping[str, int]) -> moderngl.Program:
    """Compile and link two shaders, and check the blocks that numpy packs for them.

    Args:
        context: the open context.
        vertex: file of the vertex shader; see `shader_source`.
        fragment: file of the fragment shader, likewise.
        defines: for the fragment shader.

    Raises:
        BackendError: where the driver refuses the shaders, with its message, or lays out a block in another way.
    """
    try:
        program = context.gl.program(
            vertex_shader=shader_source(vertex), fragment_shader=shader_source(fragment, defines)
        )
    except moderngl.Error as error:
        raise BackendError(f"{context.renderer} does not compile {vertex} and {fragment}: {error}") from error
    check_blocks(context, program)
    return program
