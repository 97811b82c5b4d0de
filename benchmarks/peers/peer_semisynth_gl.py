"""This project's renderer: one `Renderer` for all frames, its arrays written by its own encoders.

The variants "none", "edges" and "ssaa2" render with this antialiasing mode and write only the left disparity. The
variant "all" has no antialiasing and writes both disparities and both visibility masks, as a dataset does.
"""

from pathlib import Path

import numpy as np
from loop import Options, run, write_arrays
from PIL import Image
from scene import NEAR_M, PeerScene

from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import GREY8
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.mesh import Mesh, make_mesh
from semisynth_gl.geometry.topology import marked_solid
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import Scene, make_scene


def own_models(scene: PeerScene) -> list[Mesh]:
    """Convert the models; the walls come last."""
    return [
        marked_solid(make_mesh(str(number), model.positions, model.uv, model.triangles))
        for number, model in enumerate([*scene.models, *scene.walls])
    ]


def own_scene(scene: PeerScene, frame: int) -> Scene:
    """Convert a frame."""
    return make_scene(
        StereoCamera.centred(scene.width_px, scene.height_px, scene.focal_px, scene.baseline_m),
        model=np.concatenate([scene.model[frame], len(scene.models) + np.arange(len(scene.walls))]),
        world_from_model=np.concatenate([scene.camera_from_model[frame], np.tile(np.eye(4), (len(scene.walls), 1, 1))]),
        layer=np.concatenate([scene.patch[frame], scene.wall_patch[frame]]),
        # v points up in the scene, and down in the renderer.
        uv_scale=(1.0, -1.0),
        uv_offset=(0.0, 1.0),
        near_m=NEAR_M,
    )


class SemisynthGl:
    """The renderer with the interface that the loop calls."""

    def __init__(self, scene: PeerScene, options: Options) -> None:
        self._scene = scene
        self._all = options.variant == "all"
        patches = np.stack([np.asarray(Image.open(path).convert("RGBA")) for path in scene.patches])
        self._renderer = Renderer(
            own_models(scene),
            patches,
            wrap="repeat",
            outputs=("visibility",) if self._all else (),
            truth="both" if self._all else "left",
            antialias="none" if self._all else options.variant,
        )
        self.version = f"{self._renderer.backend}, {self._renderer.renderer_name}"

    def write_pair(self, frame: int, folder: Path) -> None:
        """See `loop.Peer`."""
        pair = self._renderer.render(own_scene(self._scene, frame))
        write_arrays(folder, pair.left.image, pair.right.image, pair.left.disparity, our_encoders=True)
        if self._all:
            (folder / "disp_right.pfm").write_bytes(PFM.encode(pair.right.disparity))
            (folder / "visibility_left.png").write_bytes(GREY8.encode(pair.left.visibility))
            (folder / "visibility_right.png").write_bytes(GREY8.encode(pair.right.visibility))


if __name__ == "__main__":
    run(SemisynthGl)
