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

_LIBRARIES = {"triton": "_C/libtriton*.so"}
"""Packages that may be installed, and their libraries in them."""


@cache
def load_before_driver() -> None:
    """Load the libraries that do not survive to be loaded after Mesa's driver, of the packages that are installed here.

    The packages themselves are not imported. Call it before whatever may load a driver.
    """
    for package, library in _LIBRARIES.items():
        for path in sorted(found for folder in _folders(package) for found in folder.glob(library)):
            # One that cannot be loaded now cannot be imported later either: then it does no harm.
            with suppress(OSError):
                ctypes.CDLL(str(path), ctypes.RTLD_LOCAL)


def _folders(package: str) -> list[Path]:
    """Return the folders of an installed package; none where there is no such package."""
    # A module of that name that somebody has made up in this process has no specification.
    with suppress(ValueError):
        spec = find_spec(package)
        return [Path(folder) for folder in (spec and spec.submodule_search_locations) or ()]
    return []
