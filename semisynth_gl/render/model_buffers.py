"""All models in one vertex buffer, from which the instances of a scene are drawn with two calls for each atlas."""

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

_FEWEST_INSTANCES = 256
# Texture units of common_triangles.glsl.
_TRIANGLES, _TRACED = 4, 5
# Triangles or instances in a row of a texture, and texels of each.
_PER_ROW, _TEXELS = 1024, 3


@dataclass(frozen=True, slots=True)
class InstanceRange:
    """A run of instances to draw, with patches of one atlas."""

    atlas: int  # number of the atlas
    first: int  # number of the first instance, in the order of drawing
    fronts: int  # number of instances that show only fronts; they come first
    both_sides: int  # number of instances that may show backs, too


class SceneBuffers:
    """The models of a renderer on the GPU, and buffers for the instances of one eye's view.

    Args:
        gl: the context.
        models: at least one mesh.
        atlas_ends: `PatchTextures.ends`.
        traced: whether shaders look up triangles; see `bind_triangles`.

    Attributes:
        meshes: the meshes.
        vertices: buffer with x y z u v of each vertex, float32.
        vertex_number: (V,) uint32, number in ``vertices`` of each vertex of the models, one model after the other.
        filled: (N,) int64, the scene's instances that `fill` has uploaded, in the order of drawing.
    """

    def __init__(
        self, gl: moderngl.Context, models: Sequence[Mesh], atlas_ends: NDArray[np.int64], *, traced: bool
    ) -> None:
        self._gl, self.meshes = gl, models
        self._atlas_ends = atlas_ends
        index_counts = np.array([mesh.triangles.size for mesh in models])
        vertex_counts = np.array([len(mesh.positions) for mesh in models])
        triangles = np.concatenate([mesh.triangles for mesh in models]).astype(np.int64)
        base_vertex = np.cumsum(vertex_counts) - vertex_counts
        order = np.arange(vertex_counts.sum())
        if traced:
            triangles += base_vertex.repeat(index_counts // 3)[:, None]
            order, triangles = _by_last_corner(triangles, len(order))
            base_vertex = np.cumsum(index_counts // 3) - index_counts // 3
            triangles -= base_vertex.repeat(index_counts // 3)[:, None]
        vertices = np.concatenate([np.hstack([mesh.positions, mesh.uv]) for mesh in models])[order]
        self.vertices = gl.buffer(vertices.astype("<f4", order="C"))
        self.vertex_number = np.empty(vertex_counts.sum(), np.uint32)
        self.vertex_number[order] = np.arange(len(order))
        self._indices = gl.buffer(triangles.astype("<u4", order="C"))
        self._triangles = self._texture(_corners(models)) if traced else None
        self._traced: moderngl.Texture | None = None
        self._model_commands = np.zeros(len(models), COMMAND)
        self._model_commands["count"] = index_counts
        self._model_commands["first_index"] = np.cumsum(index_counts) - index_counts
        self._model_commands["base_vertex"] = base_vertex
        self._vaos: dict[int, moderngl.VertexArray] = {}
        self.filled = np.zeros(0, np.int64)
        self._filled_commands = np.zeros(0, COMMAND)
        self._instances = gl.buffer(reserve=_FEWEST_INSTANCES * DRAWN_INSTANCE.itemsize, dynamic=True)
        self._commands = gl.buffer(reserve=_FEWEST_INSTANCES * COMMAND.itemsize, dynamic=True)

    def __len__(self) -> int:
        return len(self._model_commands)

    def fill(self, transforms: InstanceTransforms, eye: Eye, part: Crop | None = None) -> list[InstanceRange]:
        """Upload the instances that one eye may see in a part of its image, or all of it; return runs to draw in order.

        There is a run for each atlas; large patches come last, since most are on walls, which hide little. Within a
        run, instances that show only fronts come first. Among them, and among the rest, near instances come before far
        instances, so that hidden surfaces are not shaded.
        """
        scene, view_from_model = transforms.scene, transforms.rows(eye)
        # The sky is never too near, so it is always uploaded.
        seen = np.flatnonzero(transforms.in_view(eye, part) | scene.sky)
        fronts_only = transforms.fronts_only(eye)[seen]
        atlas = np.searchsorted(self._atlas_ends, scene.layer[seen], side="right")
        farthest_m = np.where(scene.sky[seen], np.inf, view_from_model[seen, 2, 3] + transforms.radius_m[seen])
        order = np.lexsort((farthest_m, ~fronts_only, atlas))
        seen, atlas, fronts_only = seen[order], atlas[order], fronts_only[order]
        begin = np.concatenate([[0], self._atlas_ends])[atlas]
        instances = np.zeros(len(seen), DRAWN_INSTANCE)
        instances["view_from_model"] = view_from_model[seen]
        instances["patch_from_uv"] = transforms.patch_from_uv[seen]
        instances["layer"] = scene.layer[seen] - begin
        instances["instance"] = seen
        instances["sky"] = scene.sky[seen]
        commands = self._model_commands[scene.model[seen]]
        commands["instances"] = 1
        commands["base_instance"] = np.arange(len(seen))
        refill(self._instances, instances)
        refill(self._commands, commands)
        self.filled, self._filled_commands = seen, commands
        first, filled = 0, []
        for number in np.unique(atlas):
            count, fronts = int((atlas == number).sum()), int((fronts_only & (atlas == number)).sum())
            filled.append(InstanceRange(int(number), first, fronts, count - fronts))
            first += count
        return filled

    def select(
        self,
        filled: Sequence[InstanceRange],
        numbers: NDArray[np.int64],
        first_triangle: NDArray[np.int64] | None = None,
        triangles: NDArray[np.int64] | None = None,
    ) -> list[InstanceRange]:
        """Choose some of the instances that `fill` has uploaded, until its next call; return the runs to draw instead.

        Args:
            filled: the result of `fill`.
            numbers: (S,) ascending positions of the chosen instances in the order of drawing; repeats are allowed.
            first_triangle: (S,) first triangle to draw, as its number in the model; None to draw all triangles.
            triangles: (S,) number of triangles to draw; None to draw all.
        """
        commands = self._filled_commands[numbers]
        if first_triangle is not None and triangles is not None:
            commands["first_index"] += (3 * first_triangle).astype(np.uint32)
            commands["count"] = 3 * triangles
        refill(self._commands, commands)
        selected = []
        for own in filled:
            ends = own.first, own.first + own.fronts, own.first + own.fronts + own.both_sides
            first, middle, last = np.searchsorted(numbers, ends).tolist()
            selected.append(InstanceRange(own.atlas, first, middle - first, last - middle))
        return selected

    def draw(self, program: moderngl.Program, filled: InstanceRange) -> None:
        """Draw a run of uploaded instances into the framebuffer in use."""
        if filled.fronts:
            self._gl.enable(moderngl.CULL_FACE)
            # In the window, image rows run downwards, which reverses the sense of rotation.
            self._gl.front_face = "cw"
            self._vao(program).render_indirect(self._commands, moderngl.TRIANGLES, filled.fronts, first=filled.first)
            self._gl.disable(moderngl.CULL_FACE)
        if filled.both_sides:
            self._vao(program).render_indirect(
                self._commands, moderngl.TRIANGLES, filled.both_sides, first=filled.first + filled.fronts
            )

    def bind_triangles(self, transforms: InstanceTransforms, eye: Eye) -> None:
        """Bind the textures of common_triangles.glsl: all models' triangles, and all instances relative to one eye."""
        assert self._triangles is not None  # noqa: S101 - the models are traced
        scene = transforms.scene
        texels = transforms.rows(eye).astype("<f4").view("<u4").reshape(-1, 4 * _TEXELS)
        rows = max(1, ceil(len(scene) / _PER_ROW))
        if self._traced is None or self._traced.height < rows:
            if self._traced is not None:
                self._traced.release()
            self._traced = self._texture(np.concatenate([texels, texels]))
        else:
            self._traced.write(_whole_rows(texels), (0, 0, self._traced.width, rows))
        self._triangles.use(_TRIANGLES)
        self._traced.use(_TRACED)

    def _texture(self, numbers: NDArray[np.uint32]) -> moderngl.Texture:
        """Make a texture of (N, 4 * _TEXELS) uint32; drivers hold 2^24 triangles or more."""
        rows = max(1, ceil(len(numbers) / _PER_ROW))
        texture = self._gl.texture((_PER_ROW * _TEXELS, rows), 4, _whole_rows(numbers), dtype="u4")
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


def _whole_rows(numbers: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Pad the content of a texture of `SceneBuffers` to whole rows, at least one."""
    rows = np.zeros((max(1, ceil(len(numbers) / _PER_ROW)) * _PER_ROW, 4 * _TEXELS), np.uint32)
    rows[: len(numbers)] = numbers
    return rows


def _corners(models: Sequence[Mesh]) -> NDArray[np.uint32]:
    """Return (T, 12), for each corner: the bits of x, y, z, and the triangle across the edge to the next corner."""
    positions = np.concatenate([mesh.positions.astype("<f4")[mesh.triangles] for mesh in models]).view("<u4")
    across, first = [], 0
    for mesh in models:
        own = neighbours(mesh)
        across.append(np.where(own == NO_NEIGHBOUR, own, own + np.uint32(first)))
        first += len(own)
    return np.concatenate([positions, np.concatenate(across)[:, :, None]], axis=2).reshape(-1, 12)


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
    result = number.repeat(3).reshape(-1, 3)
    # Of a vertex's copies, use the last one before the triangle's own corner, else the first one after it: the driver's
    # cache may hold it.
    key = source[by_source] * len(source) + by_source
    before = np.searchsorted(key, triangles[:, :2] * len(source) + number[:, None]) - 1
    result[:, :2] = by_source[before + (source[by_source[before]] != triangles[:, :2])]
    return source, result


def refill(buffer: moderngl.Buffer, rows: NDArray[Any]) -> None:
    """Replace the content of a buffer. The buffer grows if the rows need more space, and never shrinks."""
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
            known, count = program.get(name, None) is not None, shape[-1] if shape else 1
            parts.append(f"{count}{kind if known else 'x4'}")
            names += [name] * known
    return " ".join(parts) + suffix, names
