"""Stereo training pairs from photographs, rendered headless with exact disparity.

`load_config` and `render_pair` are the short way; `generate` and `open_dataset` write and read whole datasets.
`Renderer` draws scenes made by hand: meshes, patches, instances and cameras as arrays. Importing this package loads no
OpenGL. Its public names are in ``__init__.pyi``, and loaded when they are first used; docs/python.md says what may
change.
"""

from importlib.metadata import version

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__version__ = version("semisynth-gl")
