"""pygfx on wgpu: unlit materials, without its antialiasing; depth is copied out of its internal depth texture.

It draws with Vulkan; where there is no GPU, Mesa's lavapipe is a driver for it (mesa-vulkan-drivers).
"""

import os
import tempfile
from pathlib import Path

os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())

import numpy as np
import pygfx
import wgpu
from loop import Options, run, write_arrays
from PIL import Image
from scene import FAR_M, NEAR_M, OPENGL_FROM_CAMERA, Model, PeerScene


class Pygfx:
    """Each instance is one object; each frame gives it its geometry, material and pose."""

    def __init__(self, scene: PeerScene, options: Options) -> None:
        self._scene, self._our_encoders = scene, options.our_encoders
        usage = wgpu.TextureUsage
        target = pygfx.Texture(
            dim=2,
            size=(scene.width_px, scene.height_px, 1),
            format="rgba8unorm-srgb",
            usage=usage.RENDER_ATTACHMENT | usage.COPY_SRC | usage.TEXTURE_BINDING,
        )
        self._renderer = pygfx.WgpuRenderer(target, pixel_scale=1, ppaa="none")
        self._materials = [_material(path) for path in scene.patches]
        self._models = [_geometry(model) for model in scene.models]
        self._drawn = pygfx.Scene()
        self._walls = [pygfx.Mesh(_geometry(wall), self._materials[0]) for wall in scene.walls]
        self._objects = [pygfx.Mesh(self._models[0], self._materials[0]) for _ in range(scene.model.shape[1])]
        self._drawn.add(*self._walls, *self._objects)
        for wall in self._walls:
            wall.local.matrix = OPENGL_FROM_CAMERA
        # pygfx's field of view applies to the mean of width and height.
        mean_px = (scene.width_px + scene.height_px) / 2
        self._eye = pygfx.PerspectiveCamera(
            float(np.degrees(2 * np.arctan(mean_px / 2 / scene.focal_px))),
            scene.width_px / scene.height_px,
            depth_range=(NEAR_M, FAR_M),
            maintain_aspect=False,
        )
        self.version = f"{pygfx.__version__}, wgpu {wgpu.__version__}, {self._renderer.device.adapter.info['device']}"

    def write_pair(self, frame: int, folder: Path) -> None:
        """See `loop.Peer`."""
        scene = self._scene
        for wall, patch in zip(self._walls, scene.wall_patch[frame], strict=True):
            wall.material = self._materials[patch]
        poses = OPENGL_FROM_CAMERA @ scene.camera_from_model[frame]
        for shown, model, patch, pose in zip(self._objects, scene.model[frame], scene.patch[frame], poses, strict=True):
            shown.geometry, shown.material = self._models[model], self._materials[patch]
            shown.local.matrix = pose
        left = self._render(0.0)
        window_depth = self._window_depth().astype(np.float64)
        projection = self._eye.projection_matrix
        right = self._render(scene.baseline_m)
        depth_m = np.abs(projection[2, 3] / (window_depth + projection[2, 2]))
        disparity = (scene.focal_baseline / depth_m).astype(np.float32)
        write_arrays(folder, left, right, disparity, our_encoders=self._our_encoders)

    def _render(self, x_m: float) -> np.ndarray:
        self._eye.local.position = (x_m, 0, 0)
        self._renderer.render(self._drawn, self._eye)
        return np.ascontiguousarray(self._renderer.snapshot()[..., :3])

    def _window_depth(self) -> np.ndarray:
        """Copy the depth buffer, (H, W) float32; pygfx has no public way to it."""
        texture = self._renderer._blender.get_texture("depth")  # noqa: SLF001
        width, height, _ = texture.size
        data = self._renderer.device.queue.read_texture(
            {"texture": texture, "mip_level": 0, "origin": (0, 0, 0), "aspect": "depth-only"},
            {"offset": 0, "bytes_per_row": 4 * width, "rows_per_image": height},
            texture.size,
        )
        return np.frombuffer(data, np.float32).reshape(height, width)


def _material(patch: Path) -> pygfx.MeshBasicMaterial:
    # v runs upwards, texture rows downwards.
    rows = np.array(Image.open(patch).convert("RGBA"))[::-1].copy()
    texture = pygfx.Texture(rows, dim=2, generate_mipmaps=True)
    return pygfx.MeshBasicMaterial(map=pygfx.TextureMap(texture, wrap="repeat"), side="both", alpha_mode="solid")


def _geometry(model: Model) -> pygfx.Geometry:
    return pygfx.Geometry(positions=model.positions, indices=model.triangles, texcoords=model.uv)


if __name__ == "__main__":
    run(Pygfx)
