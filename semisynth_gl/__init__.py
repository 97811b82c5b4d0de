"""Stereo training pairs from photographs, rendered headless with exact disparity.

`load_config` and `render_pair` render single pairs; `generate` and `open_dataset` write and read whole datasets.
`Renderer` renders scenes made by hand: meshes, patches, instances and cameras as arrays. Importing this package loads
no OpenGL. Its public names are in ``__init__.pyi``, and are loaded at first use. docs/python.md says what may change.
"""

from importlib.metadata import version

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__version__ = version("semisynth-gl")
