"""Stereo training pairs from photographs, rendered headless with exact disparity.

`load_config` and `render_pair` are the short way. `Renderer` draws scenes made by hand: meshes, patches, instances and
cameras as arrays. Importing this package loads no OpenGL; the names below are loaded when they are first used.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from semisynth_gl.camera import Crop, StereoCamera
    from semisynth_gl.config import Config, load_config
    from semisynth_gl.dataset.reader import open_dataset
    from semisynth_gl.errors import BackendError, InputError, SemisynthError
    from semisynth_gl.frame import Frame, View
    from semisynth_gl.geometry.mesh import Mesh, make_mesh
    from semisynth_gl.pairs.pipeline import PairRenderer, render_pair
    from semisynth_gl.render.renderer import Renderer
    from semisynth_gl.scene.scene import Motion, Scene, make_scene, move

_HOME = {
    "BackendError": "errors",
    "Config": "config",
    "Crop": "camera",
    "Frame": "frame",
    "InputError": "errors",
    "Mesh": "geometry.mesh",
    "Motion": "scene.scene",
    "PairRenderer": "pairs.pipeline",
    "Renderer": "render.renderer",
    "Scene": "scene.scene",
    "SemisynthError": "errors",
    "StereoCamera": "camera",
    "View": "frame",
    "load_config": "config",
    "make_mesh": "geometry.mesh",
    "make_scene": "scene.scene",
    "move": "scene.scene",
    "open_dataset": "dataset.reader",
    "render_pair": "pairs.pipeline",
}

__version__ = version("semisynth-gl")

__all__ = [
    "BackendError",
    "Config",
    "Crop",
    "Frame",
    "InputError",
    "Mesh",
    "Motion",
    "PairRenderer",
    "Renderer",
    "Scene",
    "SemisynthError",
    "StereoCamera",
    "View",
    "load_config",
    "make_mesh",
    "make_scene",
    "move",
    "open_dataset",
    "render_pair",
]


def __dir__() -> list[str]:
    return [*__all__, "__version__", "__doc__"]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - any public name
    if name not in _HOME:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
