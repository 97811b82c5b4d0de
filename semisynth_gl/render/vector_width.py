"""The vector width that LP_NATIVE_VECTOR_WIDTH sets, and Mesa's folder of compiled shaders for it.

Without the variable, llvmpipe uses the processor's width: 128 bits on ARM and on x86 without AVX, else 256. Mesa's
cache of compiled shaders tells shaders and processors apart, but not the widths that the variable sets. In a process
with 128 bits, a vertex shader compiled for 256 writes eight vertices at a time into a buffer for a multiple of four,
and overruns it. So each width gets a folder of its own.
"""

import os
from functools import cache
from pathlib import Path

from semisynth_gl.inputs.errors import BackendError

WIDTH = "LP_NATIVE_VECTOR_WIDTH"
"""The environment variable."""

# With more than 256 bits, LLVM 15 and 19 crash as they compile the shaders; llvmpipe takes no more by itself.
_WIDTHS_BITS = "128", "256"
# Names of the variable for Mesa's folder: from Mesa 22.1 on, and before.
_FOLDERS = "MESA_SHADER_CACHE_DIR", "MESA_GLSL_CACHE_DIR"


@cache
def separate_compiled_shaders() -> None:
    """Have Mesa keep the compiled shaders of a width that the environment sets in a folder for that width.

    Call this before anything may load a driver: the driver and this function read the environment only once.

    Raises:
        BackendError: where the environment sets another width than 128 or 256 bits.
    """
    width = os.environ.get(WIDTH)
    if not width:
        return
    if width not in _WIDTHS_BITS:
        raise BackendError(
            f"{WIDTH}={width}: expected {' or '.join(_WIDTHS_BITS)} (bits), since llvmpipe does not draw with others; "
            "change the variable, or unset it"
        )
    chosen = (os.environ.get(name) for name in (*_FOLDERS, "XDG_CACHE_HOME"))
    parent = Path(next(filter(None, chosen), Path.home() / ".cache"))
    # A process inherits the folder of the one that started it.
    folder = parent if parent.name == f"llvmpipe-{width}-bits" else parent / f"llvmpipe-{width}-bits"
    os.environ.update(dict.fromkeys(_FOLDERS, str(folder)))
