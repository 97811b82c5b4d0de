"""Stereo training pairs from photographs, rendered headless with exact disparity.

`load_config` and `render_pair` are the short way; `generate` and `open_dataset` write and read whole datasets.
`Renderer` draws scenes made by hand: meshes, patches, instances and cameras as arrays. Importing this package loads no
OpenGL; the names below are loaded when they are first used. They are public: docs/python.md says what may change.
"""

# Nothing is imported here: until the program's first statement, which follows, Ctrl-C is a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from semisynth_gl.config import Config, load_config
    from semisynth_gl.dataset.reader import Dataset, open_dataset
    from semisynth_gl.dataset.sample import StoredFrame
    from semisynth_gl.frame.camera import Crop, StereoCamera
    from semisynth_gl.frame.frame import Frame, View
    from semisynth_gl.generation.generate import GenerationResult, generate
    from semisynth_gl.geometry.mesh import Mesh, make_mesh
    from semisynth_gl.geometry.model_units import make_model
    from semisynth_gl.inputs.errors import BackendError, InputError, SemisynthError
    from semisynth_gl.metrics.evaluate import evaluate
    from semisynth_gl.metrics.score import Score, score
    from semisynth_gl.pairs.pipeline import Pair, PairRenderer, render_pair
    from semisynth_gl.render.renderer import Renderer
    from semisynth_gl.scene.scene import Motion, Scene, make_scene, move

    __version__: str

_HOME = {
    "BackendError": "inputs.errors",
    "Config": "config",
    "Crop": "frame.camera",
    "Dataset": "dataset.reader",
    "Frame": "frame.frame",
    "GenerationResult": "generation.generate",
    "InputError": "inputs.errors",
    "Mesh": "geometry.mesh",
    "Motion": "scene.scene",
    "Pair": "pairs.pipeline",
    "PairRenderer": "pairs.pipeline",
    "Renderer": "render.renderer",
    "Scene": "scene.scene",
    "Score": "metrics.score",
    "SemisynthError": "inputs.errors",
    "StereoCamera": "frame.camera",
    "StoredFrame": "dataset.sample",
    "View": "frame.frame",
    "evaluate": "metrics.evaluate",
    "generate": "generation.generate",
    "load_config": "config",
    "make_mesh": "geometry.mesh",
    "make_model": "geometry.model_units",
    "make_scene": "scene.scene",
    "move": "scene.scene",
    "open_dataset": "dataset.reader",
    "render_pair": "pairs.pipeline",
    "score": "metrics.score",
}

__all__ = [
    "BackendError",
    "Config",
    "Crop",
    "Dataset",
    "Frame",
    "GenerationResult",
    "InputError",
    "Mesh",
    "Motion",
    "Pair",
    "PairRenderer",
    "Renderer",
    "Scene",
    "Score",
    "SemisynthError",
    "StereoCamera",
    "StoredFrame",
    "View",
    "evaluate",
    "generate",
    "load_config",
    "make_mesh",
    "make_model",
    "make_scene",
    "move",
    "open_dataset",
    "render_pair",
    "score",
]


def __dir__() -> list[str]:
    return [*__all__, "__version__", "__doc__"]


def __getattr__(name: str) -> "Any":  # noqa: ANN401 - any public name
    from importlib import import_module, metadata  # noqa: PLC0415 - see above

    if name == "__version__":
        return metadata.version("semisynth-gl")
    if name not in _HOME:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
