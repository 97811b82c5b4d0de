"""pyrender, unlit (RenderFlags.FLAT) and offscreen on EGL.

Variants: msaa4 is pyrender as released, with four samples of colour and depth per pixel. none patches multisampling
out.
"""

import os
from pathlib import Path

os.environ["PYOPENGL_PLATFORM"] = "egl"

import numpy as np
import pyrender
import pyrender.renderer
from loop import Options, run, write_arrays
from OpenGL.GL import GL_RENDERER, glGetString
from PIL import Image
from scene import FAR_M, NEAR_M, OPENGL_FROM_CAMERA, Model, PeerScene


class Pyrender:
    """Makes a mesh for each combination of model and patch, and replaces the scene's nodes in each frame."""

    def __init__(self, scene: PeerScene, options: Options) -> None:
        if options.variant == "none":
            _without_multisampling()
        self._scene, self._our_encoders = scene, options.our_encoders
        textures = [
            pyrender.Texture(source=Image.open(path).convert("RGB"), source_channels="RGB") for path in scene.patches
        ]
        materials = [
            pyrender.MetallicRoughnessMaterial(
                baseColorTexture=texture, doubleSided=True, metallicFactor=0, roughnessFactor=1
            )
            for texture in textures
        ]
        self._meshes = [
            [pyrender.Mesh([primitive(model, material)]) for material in materials]
            for model in [*scene.models, *scene.walls]
        ]
        self._drawn = pyrender.Scene(bg_color=[0, 0, 0, 0], ambient_light=[1, 1, 1])
        # pyrender deletes textures that the scene does not use from the GPU: a hidden mesh uses all patches.
        kept = pyrender.Mesh([primitive(scene.walls[0], material) for material in materials], is_visible=False)
        self._drawn.add(kept)
        self._eye = self._drawn.add(
            pyrender.IntrinsicsCamera(
                scene.focal_px, scene.focal_px, scene.width_px / 2, scene.height_px / 2, znear=NEAR_M, zfar=FAR_M
            )
        )
        self._nodes: list[pyrender.Node] = []
        self._renderer = pyrender.OffscreenRenderer(scene.width_px, scene.height_px)
        self._renderer.render(self._drawn, pyrender.RenderFlags.FLAT)
        self.version = f"{pyrender.__version__}, {glGetString(GL_RENDERER).decode()}"

    def write_pair(self, frame: int, folder: Path) -> None:
        """See `loop.Peer`."""
        scene = self._scene
        for node in self._nodes:
            self._drawn.remove_node(node)
        self._nodes = [
            self._drawn.add(self._meshes[len(scene.models) + wall][patch], pose=OPENGL_FROM_CAMERA)
            for wall, patch in enumerate(scene.wall_patch[frame].tolist())
        ]
        poses = OPENGL_FROM_CAMERA @ scene.camera_from_model[frame]
        for model, patch, pose in zip(scene.model[frame].tolist(), scene.patch[frame].tolist(), poses, strict=True):
            self._nodes.append(self._drawn.add(self._meshes[model][patch], pose=pose))
        left, depth_m = self._render(0.0)
        right, _ = self._render(scene.baseline_m)
        with np.errstate(divide="ignore"):
            disparity = (scene.focal_baseline / depth_m).astype(np.float32)
        write_arrays(folder, left, right, disparity, our_encoders=self._our_encoders)

    def _render(self, x_m: float) -> tuple[np.ndarray, np.ndarray]:
        pose = np.eye(4)
        pose[0, 3] = x_m
        self._drawn.set_pose(self._eye, pose)
        return self._renderer.render(self._drawn, pyrender.RenderFlags.FLAT)


def primitive(model: Model, material: pyrender.Material) -> pyrender.Primitive:
    """Convert a mesh to pyrender's."""
    corners = model.triangles.ravel()
    return pyrender.Primitive(positions=model.positions[corners], texcoord_0=model.uv[corners], material=material)


def _without_multisampling() -> None:
    """Give pyrender's multisampled buffers one sample per pixel."""
    allocate = pyrender.renderer.glRenderbufferStorageMultisample

    def allocate_single(target: int, _samples: int, kind: int, width: int, height: int) -> None:
        allocate(target, 0, kind, width, height)

    pyrender.renderer.glRenderbufferStorageMultisample = allocate_single


if __name__ == "__main__":
    run(Pyrender)
