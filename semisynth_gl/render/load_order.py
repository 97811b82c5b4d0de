"""Loads libraries that contain their own LLVM before Mesa's driver loads the system's LLVM.

Mesa loads its software driver, and with it the system's LLVM, with RTLD_GLOBAL: libraries that are loaded later find
the symbols of that LLVM before their own. PyTorch's optimisers import triton if it is installed. triton exports the
symbols of its LLVM, so after the driver, triton would call the system's LLVM. The versions differ, which causes a
segmentation fault. A library that is loaded before the driver is already bound to its own symbols.
"""

import ctypes
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path


@cache
def load_before_driver() -> None:
    """Load triton's libraries, if it is installed, without importing it. Call this before a driver may be loaded."""
    spec = None
    # find_spec raises ValueError if sys.modules has a replacement of the module without a specification.
    with suppress(ValueError):
        spec = find_spec("triton")
    for folder in (spec and spec.submodule_search_locations) or ():
        for library in sorted(Path(folder).glob("_C/libtriton*.so")):
            # A library that cannot be loaded now cannot be imported later, so it is harmless.
            with suppress(OSError):
                ctypes.CDLL(str(library), ctypes.RTLD_LOCAL)
