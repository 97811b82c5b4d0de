"""All models in one vertex buffer, from which the instances of a view are drawn.

A view takes at most two draw calls for each atlas: one with back-face culling, one without.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Crop, Eye
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.topology import NO_NEIGHBOUR, neighbours
from semisynth_gl.render.instance_transforms import InstanceTransforms

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

_FEWEST_INSTANCES = 256  # initial capacity of the buffers
# Texture units of common_triangles.glsl.
_CORNERS_UNIT, _INSTANCE_ROWS_UNIT = 4, 5
# In these textures, a triangle or an instance takes three texels, and a row holds 1024 of either.
_PER_ROW, _TEXELS = 1024, 3


@dataclass(frozen=True, slots=True)
class DrawRange:
    """Successive draw commands, one for each instance or part of one. All have patches of the same atlas."""

    atlas: int  # number of the atlas
    first: int  # number of the first command
    fronts: int  # number of commands with back-face culling; they come first
    both_sides: int  # number of commands without back-face culling


class SceneBuffers:
    """A renderer's models on the GPU, and the instances and draw commands of one view.

    ``atlas_ends`` is `PatchTextures.ends`. ``with_triangles`` says whether shaders look up triangles by number; see
    `bind_triangles`.

    Attributes:
        meshes: the meshes.
        vertices: buffer with x y z u v of each vertex, float32.
        vertex_number: (V,) uint32, position in ``vertices`` of each vertex of the models, model by model.
        uploaded: (N,) int64, the scene's instances that `upload` has uploaded, in the order of drawing.
    """

    def __init__(
        self, gl: moderngl.Context, models: Sequence[Mesh], atlas_ends: NDArray[np.int64], *, with_triangles: bool
    ) -> None:
        self._gl, self.meshes = gl, models
        self._atlas_ends = atlas_ends
        triangle_counts = np.array([len(mesh.triangles) for mesh in models])
        vertex_counts = np.array([len(mesh.positions) for mesh in models])
        first_triangle = np.cumsum(triangle_counts) - triangle_counts
        base_vertex = np.cumsum(vertex_counts) - vertex_counts
        triangles = np.concatenate([mesh.triangles for mesh in models]).astype(np.int64)
        # The vertex of the models that each vertex of the buffer repeats.
        source = np.arange(vertex_counts.sum())
        if with_triangles:
            triangles += base_vertex.repeat(triangle_counts)[:, None]
            source, triangles = _by_last_corner(triangles, len(source))
            base_vertex = first_triangle
            triangles -= base_vertex.repeat(triangle_counts)[:, None]
        vertices = np.concatenate([np.hstack([mesh.positions, mesh.uv]) for mesh in models])[source]
        self.vertices = gl.buffer(vertices.astype("<f4", order="C"))
        self.vertex_number = np.empty(vertex_counts.sum(), np.uint32)
        self.vertex_number[source] = np.arange(len(source))
        self._indices = gl.buffer(triangles.astype("<u4", order="C"))
        self._triangle_corners = self._texture(_triangle_corners(models)) if with_triangles else None
        self._instance_rows: moderngl.Texture | None = None
        self._model_commands = np.zeros(len(models), COMMAND)
        self._model_commands["count"] = 3 * triangle_counts
        self._model_commands["instances"] = 1
        self._model_commands["first_index"] = 3 * first_triangle
        self._model_commands["base_vertex"] = base_vertex
        self._vaos: dict[int, moderngl.VertexArray] = {}
        self.uploaded = np.zeros(0, np.int64)
        self._uploaded_commands = np.zeros(0, COMMAND)
        self._instances = gl.buffer(reserve=_FEWEST_INSTANCES * DRAWN_INSTANCE.itemsize, dynamic=True)
        self._commands = gl.buffer(reserve=_FEWEST_INSTANCES * COMMAND.itemsize, dynamic=True)

    def __len__(self) -> int:
        return len(self._model_commands)

    def upload(self, transforms: InstanceTransforms, eye: Eye, part: Crop | None = None) -> list[DrawRange]:
        """Upload the instances that one eye may see in a part of its image, or in all of it; return what to draw.

        There is a range for each atlas. That of large patches comes last, since most of them are on walls, which hide
        little. Within a range, commands with back-face culling come first. Among these, and among the others, near
        instances come before far ones, so that few hidden surfaces are shaded.
        """
        scene, view_from_model = transforms.scene, transforms.rows(eye)
        # The near plane, which `in_view` tests, does not cut the sky.
        seen = np.flatnonzero(transforms.in_view(eye, part) | scene.sky)
        fronts_only = transforms.fronts_only(eye)[seen]
        atlas = np.searchsorted(self._atlas_ends, scene.layer[seen], side="right")
        farthest_m = np.where(scene.sky[seen], np.inf, view_from_model[seen, 2, 3] + transforms.radius_m[seen])
        order = np.lexsort((farthest_m, ~fronts_only, atlas))
        seen, atlas, fronts_only = seen[order], atlas[order], fronts_only[order]
        first_layer = np.concatenate([[0], self._atlas_ends])[atlas]
        instances = np.zeros(len(seen), DRAWN_INSTANCE)
        instances["view_from_model"] = view_from_model[seen]
        instances["patch_from_uv"] = transforms.patch_from_uv[seen]
        instances["layer"] = scene.layer[seen] - first_layer
        instances["instance"] = seen
        instances["sky"] = scene.sky[seen]
        commands = self._model_commands[scene.model[seen]]
        commands["base_instance"] = np.arange(len(seen))
        refill(self._instances, instances)
        refill(self._commands, commands)
        self.uploaded, self._uploaded_commands = seen, commands
        first, ranges = 0, []
        for number in np.unique(atlas).tolist():
            in_atlas = atlas == number
            count, fronts = int(in_atlas.sum()), int((fronts_only & in_atlas).sum())
            ranges.append(DrawRange(number, first, fronts, count - fronts))
            first += count
        return ranges

    def select(
        self,
        ranges: Sequence[DrawRange],
        numbers: NDArray[np.int64],
        first_triangle: NDArray[np.int64] | None = None,
        triangles: NDArray[np.int64] | None = None,
    ) -> list[DrawRange]:
        """Replace the draw commands by S commands, for some of the uploaded instances or parts of them.

        Args:
            ranges: the result of `upload`.
            numbers: (S,) positions in `uploaded` of the instances to draw, ascending; repeats are allowed.
            first_triangle: (S,) the first triangle to draw, as its number in the model; None to draw all triangles.
            triangles: (S,) number of triangles to draw; None to draw all.

        Returns:
            The ranges of the new commands.
        """
        commands = self._uploaded_commands[numbers]
        if first_triangle is not None and triangles is not None:
            commands["first_index"] += (3 * first_triangle).astype(np.uint32)
            commands["count"] = 3 * triangles
        refill(self._commands, commands)
        selected = []
        for old in ranges:
            ends = old.first, old.first + old.fronts, old.first + old.fronts + old.both_sides
            first, middle, last = np.searchsorted(numbers, ends).tolist()
            selected.append(DrawRange(old.atlas, first, middle - first, last - middle))
        return selected

    def draw(self, program: moderngl.Program, drawn: DrawRange) -> None:
        """Draw a range of the commands into the framebuffer in use."""
        vao = self._vao(program)
        if drawn.fronts:
            self._gl.enable(moderngl.CULL_FACE)
            # In the window, image rows run downwards, which reverses the sense of rotation.
            self._gl.front_face = "cw"
            vao.render_indirect(self._commands, moderngl.TRIANGLES, drawn.fronts, first=drawn.first)
            self._gl.disable(moderngl.CULL_FACE)
        if drawn.both_sides:
            first = drawn.first + drawn.fronts
            vao.render_indirect(self._commands, moderngl.TRIANGLES, drawn.both_sides, first=first)

    def bind_triangles(self, transforms: InstanceTransforms, eye: Eye) -> None:
        """Bind the textures of common_triangles.glsl: all models' triangles, and all instances relative to one eye."""
        assert self._triangle_corners is not None  # noqa: S101 - made because of ``with_triangles``
        texels = _whole_rows(transforms.rows(eye).astype("<f4").view("<u4").reshape(-1, 4 * _TEXELS))
        height = len(texels) // _PER_ROW
        if self._instance_rows is not None and self._instance_rows.height >= height:
            self._instance_rows.write(texels, (0, 0, self._instance_rows.width, height))
        else:
            if self._instance_rows is not None:
                self._instance_rows.release()
            self._instance_rows = self._texture(texels)
        self._triangle_corners.use(_CORNERS_UNIT)
        self._instance_rows.use(_INSTANCE_ROWS_UNIT)

    def _texture(self, texels: NDArray[np.uint32]) -> moderngl.Texture:
        """Make a texture of whole rows. All drivers have 2^14 rows or more, enough for 2^24 triangles."""
        size = _PER_ROW * _TEXELS, len(texels) // _PER_ROW
        texture = self._gl.texture(size, 4, texels, dtype="u4")
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture

    def _vao(self, program: moderngl.Program) -> moderngl.VertexArray:
        if program.glo not in self._vaos:
            vertex, vertex_names = _format(program, VERTEX, "")
            instance, instance_names = _format(program, DRAWN_INSTANCE, " /i")
            self._vaos[program.glo] = self._gl.vertex_array(
                program,
                [(self.vertices, vertex, *vertex_names), (self._instances, instance, *instance_names)],
                index_buffer=self._indices,
                index_element_size=4,
            )
        return self._vaos[program.glo]


def _whole_rows(texels: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Pad the texels of N triangles or instances, (N, 12), to whole rows of a texture, at least one."""
    rows = np.zeros((max(1, ceil(len(texels) / _PER_ROW)) * _PER_ROW, 4 * _TEXELS), np.uint32)
    rows[: len(texels)] = texels
    return rows


def _triangle_corners(models: Sequence[Mesh]) -> NDArray[np.uint32]:
    """Return whole rows of 12 numbers a triangle: for each corner, the bits of x, y, z as float32, and a neighbour.

    The neighbour is the number of the triangle across the edge to the next corner.
    """
    positions = np.concatenate([mesh.positions.astype("<f4")[mesh.triangles] for mesh in models]).view("<u4")
    across, first = [], 0
    for mesh in models:
        in_mesh = neighbours(mesh)
        across.append(np.where(in_mesh == NO_NEIGHBOUR, in_mesh, in_mesh + np.uint32(first)))
        first += len(in_mesh)
    return _whole_rows(np.concatenate([positions, np.concatenate(across)[:, :, None]], axis=2).reshape(-1, 12))


def _by_last_corner(triangles: NDArray[np.int64], vertices: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Repeat vertices so that vertex t is the last corner of triangle t, and of no other triangle.

    A vertex shader can then output the triangle's number, since flat outputs are those of the last vertex. With
    gl_PrimitiveID, llvmpipe would split the mesh into single triangles.

    Returns:
        (V,) the old number of each new vertex, and (T, 3) the same triangles in the same order, with new numbers.
    """
    number = np.arange(len(triangles))
    is_last = np.zeros(vertices, bool)
    is_last[triangles[:, 2]] = True
    source = np.concatenate([triangles[:, 2], np.flatnonzero(~is_last)])
    by_source = np.argsort(source, kind="stable")
    renumbered = np.empty_like(triangles)
    renumbered[:, 2] = number
    # A first or second corner may be any copy of its vertex. Choose the last copy before number t, which the driver's
    # cache may still hold, or the first one after it.
    key = source[by_source] * len(source) + by_source
    before = np.searchsorted(key, triangles[:, :2] * len(source) + number[:, None]) - 1
    renumbered[:, :2] = by_source[before + (source[by_source[before]] != triangles[:, :2])]
    return source, renumbered


def refill(buffer: moderngl.Buffer, rows: NDArray[Any]) -> None:
    """Replace the content of a buffer. If the rows need more space, the buffer grows to twice their size."""
    buffer.orphan(2 * rows.nbytes if rows.nbytes > buffer.size else -1)
    if len(rows):
        buffer.write(rows)


def _format(program: moderngl.Program, dtype: np.dtype[Any], suffix: str) -> tuple[str, list[str]]:
    """Return the buffer format and the attributes' names; attributes that the compiler has removed become padding."""
    parts, names = [], []
    for field in dtype.names or ():
        kind, shape = dtype[field].base.kind, dtype[field].shape
        # A field of shape (3, 4) is three vec4 attributes, the rows of a matrix.
        rows = [f"{field}_{axis}" for axis in "xyz"] if shape == (3, 4) else [field]
        for name in rows:
            is_used, count = program.get(name, None) is not None, shape[-1] if shape else 1
            parts.append(f"{count}{kind if is_used else 'x4'}")
            names += [name] * is_used
    return " ".join(parts) + suffix, names
