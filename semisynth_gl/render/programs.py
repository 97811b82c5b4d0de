"""Linked shader programs and their uniforms, with errors that say what is wrong."""

from collections.abc import Mapping

import moderngl

from semisynth_gl.errors import BackendError
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.shader_source import shader_source


def link_program(context: GraphicsContext, vertex: str, fragment: str, defines: Mapping[str, int]) -> moderngl.Program:
    """Compile and link two files of shaders/; ``defines`` are for the fragment shader.

    Raises:
        BackendError: with the driver's message, where it refuses them.
    """
    try:
        return context.gl.program(vertex_shader=shader_source(vertex), fragment_shader=shader_source(fragment, defines))
    except moderngl.Error as error:
        raise BackendError(f"{context.renderer} does not compile {vertex} and {fragment}: {error}") from error


def set_uniform(program: moderngl.Program, name: str, value: float | tuple[float, ...]) -> None:
    """Set a uniform; matrices are given column by column.

    Raises:
        KeyError: where the program has none of that name. The compiler also removes those that change nothing.
    """
    uniform = program.get(name, None)
    if not isinstance(uniform, moderngl.Uniform):
        raise KeyError(f"the shader program has no uniform {name}: misspelt, or without effect on its outputs")
    uniform.value = value
