"""All models in one vertex buffer, and the draw of a scene's instances of them in one call."""

from collections.abc import Sequence

import moderngl
import numpy as np

from semisynth_gl.camera import Eye
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.render.projection import in_view, view_from_world
from semisynth_gl.scene.scene import Scene

# The per-instance attributes of mesh.vert, in their order.
_INSTANCE = np.dtype([("view_from_model", "<f4", (3, 4)), ("patch_from_uv", "<f4", (4,)), ("layer", "<i4")])
_INSTANCE_FORMAT = "4f 4f 4f 4f 1i /i"
_INSTANCE_NAMES = ("view_from_model_x", "view_from_model_y", "view_from_model_z", "patch_from_uv", "layer")
# OpenGL's DrawElementsIndirectCommand.
_COMMAND = np.dtype(
    [("count", "<u4"), ("instances", "<u4"), ("first_index", "<u4"), ("base_vertex", "<i4"), ("base_instance", "<u4")]
)
_FEWEST_INSTANCES = 256


class ModelBuffers:
    """The models of a renderer on the GPU, and room for the instances of one eye's draw.

    Args:
        gl: the context.
        program: the program of mesh.vert.
        models: at least one.
    """

    def __init__(self, gl: moderngl.Context, program: moderngl.Program, models: Sequence[Mesh]) -> None:
        self._gl = gl
        self._program = program
        self._vertices = gl.buffer(
            np.concatenate([np.hstack([mesh.positions, mesh.uv]) for mesh in models]).astype("<f4", order="C")
        )
        self._indices = gl.buffer(np.concatenate([mesh.triangles.reshape(-1) for mesh in models]).astype("<u4"))
        index_counts = np.array([mesh.triangles.size for mesh in models])
        vertex_counts = np.array([len(mesh.positions) for mesh in models])
        self._radius = np.array([mesh.radius for mesh in models])
        self._model_commands = np.zeros(len(models), _COMMAND)
        self._model_commands["count"] = index_counts
        self._model_commands["first_index"] = np.cumsum(index_counts) - index_counts
        self._model_commands["base_vertex"] = np.cumsum(vertex_counts) - vertex_counts
        self._commands = gl.buffer(reserve=len(models) * _COMMAND.itemsize, dynamic=True)
        self._make_room(_FEWEST_INSTANCES)

    def __len__(self) -> int:
        return len(self._model_commands)

    def draw(self, scene: Scene, eye: Eye) -> None:
        """Draw the instances that one eye may see into the framebuffer in use, grouped by model."""
        view_from_model = view_from_world(scene.camera, eye, scene.camera_from_world) @ scene.world_from_model
        linear = view_from_model[:, :3, :3]
        # The largest row sum of |A^T A| bounds the squared largest singular value from above, and is equal to it where
        # the instance is scaled along its own axes and then rotated.
        stretch = np.sqrt(np.abs(linear.transpose(0, 2, 1) @ linear).sum(axis=2).max(axis=1, initial=0.0))
        radius_m = self._radius[scene.model] * stretch
        seen = np.flatnonzero(in_view(scene.camera, eye, scene.near_m, view_from_model[:, :3, 3], radius_m))
        if len(seen) == 0:
            return
        seen = seen[np.argsort(scene.model[seen], kind="stable")]
        instances = np.zeros(len(seen), _INSTANCE)
        instances["view_from_model"] = view_from_model[seen, :3]
        instances["patch_from_uv"][:, :2] = scene.uv_scale[seen]
        instances["patch_from_uv"][:, 2:] = scene.uv_offset[seen]
        instances["layer"] = scene.layer[seen]
        models, counts = np.unique(scene.model[seen], return_counts=True)
        commands = self._model_commands[models]
        commands["instances"] = counts
        commands["base_instance"] = np.cumsum(counts) - counts
        if len(seen) > self._capacity:
            self._mesh_vao.release()
            self._instances.release()
            self._make_room(2 * len(seen))
        self._instances.orphan()
        self._instances.write(instances)
        self._commands.orphan()
        self._commands.write(commands)
        self._mesh_vao.render_indirect(self._commands, moderngl.TRIANGLES, len(commands))

    def _make_room(self, capacity: int) -> None:
        self._capacity = capacity
        self._instances = self._gl.buffer(reserve=capacity * _INSTANCE.itemsize, dynamic=True)
        self._mesh_vao = self._gl.vertex_array(
            self._program,
            [(self._vertices, "3f 2f", "position", "uv"), (self._instances, _INSTANCE_FORMAT, *_INSTANCE_NAMES)],
            index_buffer=self._indices,
            index_element_size=4,
        )
