"""Compiles and links shader programs: the GLSL of shaders/ with #include lines replaced and #define lines added."""

import re
from collections.abc import Mapping

import moderngl

from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.inputs.resources import data_root
from semisynth_gl.render.context import GraphicsContext

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')


def link_program(
    context: GraphicsContext, vertex: str, fragment: str, defines: Mapping[str, int], geometry: str | None = None
) -> moderngl.Program:
    """Compile and link the shaders in three files; ``defines`` are for the fragment and geometry shaders only.

    Raises:
        BackendError: where the driver refuses the shaders.
    """
    try:
        return context.gl.program(
            vertex_shader=shader_source(vertex),
            geometry_shader=None if geometry is None else shader_source(geometry, defines),
            fragment_shader=shader_source(fragment, defines),
        )
    except moderngl.Error as error:
        files = " and ".join(file for file in (vertex, geometry, fragment) if file is not None)
        raise BackendError(f"{context.renderer} does not compile {files}: {error}") from error


def link_meshes(context: GraphicsContext, defines: Mapping[str, int]) -> moderngl.Program:
    """Link mesh.vert and mesh.frag as `link_program` does. Define SNAPPED if the driver rounds triangles' corners."""
    steps = context.corner_steps
    snapped = {} if steps is None else {"SNAPPED": steps}
    return link_program(context, "mesh.vert", "mesh.frag", {**defines, **snapped})


def link_compute(context: GraphicsContext, compute: str, defines: Mapping[str, int]) -> moderngl.ComputeShader:
    """Compile and link a compute shader, see `shader_source`; raise BackendError where the driver refuses it."""
    try:
        return context.gl.compute_shader(shader_source(compute, defines))
    except moderngl.Error as error:
        raise BackendError(f"{context.renderer} does not compile {compute}: {error}") from error


def shader_source(name: str, defines: Mapping[str, int] | None = None) -> str:
    """Return the text of a shader.

    ``name`` is a file in shaders/, or an absolute path. Each ``#include "file"`` line is replaced by that file of
    shaders/, and each name in ``defines`` is defined as its number right after the ``#version`` line.

    Raises:
        FileNotFoundError: where the file, or one that it includes, does not exist.
    """
    version, *body = _lines(name)
    return "\n".join([version, *(f"#define {key} {value}" for key, value in (defines or {}).items()), *body])


def _lines(name: str) -> list[str]:
    lines: list[str] = []
    for line in (data_root("shaders") / name).read_text(encoding="utf-8").splitlines():
        match = _INCLUDE.match(line)
        lines += _lines(match[1]) if match else [line]
    return lines
