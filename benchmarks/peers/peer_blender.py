"""Blender, as the bpy package.

Variants: workbench (flat, textured) and eevee (emission only, one sample), both without antialiasing. Each instance is
an object. Workbench renders each eye separately, Eevee both eyes in one render. Blender writes the images as PNG at its
default compression, and its compositor writes f B / depth of the left eye as float EXR with ZIP compression.

With our encoders, Blender writes uncompressed Targa and EXR files to memory (/dev/shm if it exists), from which this
script reads the pixels.
"""

import atexit
import shutil
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
import gpu
import numpy as np
from exr import read_exr
from loop import Options, run, write_arrays
from mathutils import Matrix
from scene import FAR_M, NEAR_M, OPENGL_FROM_CAMERA, Model, PeerScene

_SENSOR_MM = 36.0
_TARGA_HEADER_BYTES = 18
_COSTLY_EFFECTS = (
    "use_gtao",
    "use_bloom",
    "use_ssr",
    "use_soft_shadows",
    "use_shadows",
    "use_raytracing",
    "use_volumetric_shadows",
    "use_volumetric_lights",
    "use_overscan",
    "use_fast_gi",
)


class Blender:
    """Sets mesh, material and pose of all objects for each frame, and renders both eyes."""

    def __init__(self, scene: PeerScene, options: Options) -> None:
        self._scene = scene
        self._scratch = _scratch_folder() if options.our_encoders else None
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._blender = bpy.context.scene
        self._set_up_rendering(options.variant)
        self._materials = [_material(path) for path in scene.patches]
        self._models = [self._mesh(model) for model in scene.models]
        self._walls = [self._object(self._mesh(wall)) for wall in scene.walls]
        self._objects = [self._object(self._models[0]) for _ in range(scene.model.shape[1])]
        for wall in self._walls:
            wall.matrix_world = Matrix(OPENGL_FROM_CAMERA.tolist())
        self._left, self._right = self._eye(0.0), self._eye(scene.baseline_m)
        self._disparity = self._disparity_output()
        self._in_one_render = options.variant == "eevee"
        if self._in_one_render:
            self._set_up_views()

    @property
    def version(self) -> str:
        """See `loop.Peer`. Blender knows the device only after it has rendered."""
        return f"{bpy.app.version_string}, {gpu.platform.renderer_get()}"

    def write_pair(self, frame: int, folder: Path) -> None:
        """See `loop.Peer`."""
        scene = self._scene
        for shown, model, patch, pose in zip(
            self._objects,
            scene.model[frame],
            scene.patch[frame],
            OPENGL_FROM_CAMERA @ scene.camera_from_model[frame],
            strict=True,
        ):
            shown.data = self._models[model]
            shown.material_slots[0].material = self._materials[patch]
            shown.matrix_world = Matrix(pose.tolist())
        for wall, patch in zip(self._walls, scene.wall_patch[frame], strict=True):
            wall.material_slots[0].material = self._materials[patch]
        self._blender.frame_set(frame)
        target = self._scratch or folder
        self._disparity.directory = str(target)
        if self._in_one_render:
            self._render(target / "view", self._left)
            for name in ("left", "right"):
                [image] = target.glob(f"view_{name}.*")
                image.replace(target / f"{name}{image.suffix}")
        else:
            self._disparity.mute = False
            self._render(target / "left", self._left)
            self._disparity.mute = True
            self._render(target / "right", self._right)
        if self._scratch:
            disparity, *others = sorted(self._scratch.glob("disp*.exr"))
            left, right = (self._read_targa(self._scratch / f"{name}.tga") for name in ("left", "right"))
            write_arrays(folder, left, right, read_exr(disparity), our_encoders=True)
            for path in (disparity, *others):
                path.unlink()

    def _render(self, path: Path, eye: bpy.types.Object) -> None:
        self._blender.camera, self._blender.render.filepath = eye, str(path)
        bpy.ops.render.render(write_still=True)

    def _set_up_views(self) -> None:
        """Make each render include both eyes; the scene's camera is the left one."""
        render, stereo = self._blender.render, self._left.data.stereo
        render.use_multiview = True
        for view in render.views:
            view.file_suffix = f"_{view.name}"
        stereo.convergence_mode, stereo.pivot = "PARALLEL", "LEFT"
        stereo.interocular_distance = self._scene.baseline_m
        render.image_settings.views_format = self._disparity.format.views_format = "INDIVIDUAL"

    def _set_up_rendering(self, variant: str) -> None:
        blender, render = self._blender, self._blender.render
        render.resolution_x, render.resolution_y, render.resolution_percentage = (
            self._scene.width_px,
            self._scene.height_px,
            100,
        )
        render.image_settings.file_format = "TARGA_RAW" if self._scratch else "PNG"
        render.image_settings.color_mode = "RGB"
        render.dither_intensity = 0
        render.use_persistent_data = True
        render.use_sequencer = False
        blender.view_settings.view_transform = "Standard"
        blender.world = bpy.data.worlds.new("world")
        blender.view_layers[0].use_pass_z = True
        if variant == "eevee":
            render.engine = "BLENDER_EEVEE"
            blender.eevee.taa_render_samples = 1
            for effect in _COSTLY_EFFECTS:
                if hasattr(blender.eevee, effect):
                    setattr(blender.eevee, effect, False)
            return
        render.engine = "BLENDER_WORKBENCH"
        blender.display.render_aa = "OFF"
        shading = blender.display.shading
        shading.light, shading.color_type = "FLAT", "TEXTURE"
        shading.show_shadows = shading.show_cavity = False
        shading.show_object_outline = shading.show_specular_highlight = False

    def _mesh(self, model: Model) -> bpy.types.Mesh:
        mesh = bpy.data.meshes.new("model")
        mesh.from_pydata(model.positions.tolist(), [], model.triangles.tolist())
        uv = mesh.uv_layers.new(name="UVMap")
        uv.data.foreach_set("uv", np.ascontiguousarray(model.uv[model.triangles.ravel()], np.float32).ravel())
        mesh.materials.append(self._materials[0])
        mesh.update()
        return mesh

    def _object(self, mesh: bpy.types.Mesh) -> bpy.types.Object:
        made = bpy.data.objects.new("object", mesh)
        self._blender.collection.objects.link(made)
        made.material_slots[0].link = "OBJECT"
        return made

    def _eye(self, x_m: float) -> bpy.types.Object:
        camera = bpy.data.cameras.new("eye")
        camera.sensor_fit, camera.sensor_width = "HORIZONTAL", _SENSOR_MM
        camera.lens = self._scene.focal_px * _SENSOR_MM / self._scene.width_px
        camera.clip_start, camera.clip_end = NEAR_M, FAR_M
        eye = bpy.data.objects.new("eye", camera)
        eye.location.x = x_m
        self._blender.collection.objects.link(eye)
        return eye

    def _disparity_output(self) -> bpy.types.Node:
        """Make the compositor write f B / depth; return the node that writes the file."""
        tree = bpy.data.node_groups.new("compositor", "CompositorNodeTree")
        self._blender.compositing_node_group = tree
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        image, divide = tree.nodes.new("NodeGroupOutput"), tree.nodes.new("ShaderNodeMath")
        output = tree.nodes.new("CompositorNodeOutputFile")
        output.file_name = "disp_"
        output.format.media_type, output.format.color_mode = "IMAGE", "BW"
        output.file_output_items.new("FLOAT", "disparity")
        self._blender.render.compositor_device = "CPU"
        output.format.file_format, output.format.color_depth = "OPEN_EXR", "32"
        output.format.exr_codec = "NONE" if self._scratch else "ZIP"
        layers = tree.nodes.new("CompositorNodeRLayers")
        tree.links.new(layers.outputs["Image"], image.inputs[0])
        divide.operation = "DIVIDE"
        divide.inputs[0].default_value = self._scene.focal_baseline
        tree.links.new(layers.outputs["Depth"], divide.inputs[1])
        tree.links.new(divide.outputs[0], output.inputs[0])
        return output

    def _read_targa(self, path: Path) -> np.ndarray:
        """Read an uncompressed Targa, (H, W, 3) uint8; Blender writes BGR, and the bottom row first."""
        pixels = np.fromfile(path, np.uint8, offset=_TARGA_HEADER_BYTES)
        size = self._scene.height_px * self._scene.width_px * 3
        return pixels[:size].reshape(self._scene.height_px, self._scene.width_px, 3)[::-1, :, ::-1]


def _material(patch: Path) -> bpy.types.Material:
    material = bpy.data.materials.new("patch")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output, emission, texture = (
        tree.nodes.new(kind) for kind in ("ShaderNodeOutputMaterial", "ShaderNodeEmission", "ShaderNodeTexImage")
    )
    texture.image = bpy.data.images.load(str(patch))
    tree.links.new(texture.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    tree.nodes.active = texture  # Workbench shows this texture
    texture.select = True
    return material


def _scratch_folder() -> Path:
    memory = Path("/dev/shm")  # noqa: S108 - the folder made in it is private
    folder = Path(tempfile.mkdtemp(prefix="peer-blender-", dir=memory if memory.is_dir() else None))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


if __name__ == "__main__":
    run(Blender)
