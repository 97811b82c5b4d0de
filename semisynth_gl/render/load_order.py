"""Libraries that bring an LLVM, which must be loaded before Mesa's driver brings the system's.

Mesa loads its software driver with RTLD_GLOBAL, and with it the system's LLVM: whatever is loaded later finds that
LLVM's symbols before its own. triton, which PyTorch's optimisers import where it is installed, exports its LLVM, so it
would call the system's, of another version: a segmentation fault. A library that is loaded before the driver has bound
to its own symbols already, so a later import is safe.
"""

import ctypes
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path


@cache
def load_before_driver() -> None:
    """Load triton's libraries, where it is installed, without importing it. Call it before what may load a driver."""
    spec = None
    # A module of that name that somebody has made up in this process has no specification.
    with suppress(ValueError):
        spec = find_spec("triton")
    for folder in (spec and spec.submodule_search_locations) or ():
        for library in sorted(Path(folder).glob("_C/libtriton*.so")):
            # One that cannot be loaded now cannot be imported later either: then it does no harm.
            with suppress(OSError):
                ctypes.CDLL(str(library), ctypes.RTLD_LOCAL)
