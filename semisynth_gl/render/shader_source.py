"""Reading GLSL from shaders/ and resolving its #include lines; needs no OpenGL."""

import re

from semisynth_gl.resources import data_root

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')


def shader_source(name: str) -> str:
    """Return the text of ``shaders/<name>`` with each ``#include "file"`` line replaced by that file.

    Raises:
        FileNotFoundError: where the file, or one that it includes, does not exist.
        ValueError: where files include each other in a circle.
    """
    return "\n".join(_lines(name, ()))


def _lines(name: str, parents: tuple[str, ...]) -> list[str]:
    if name in parents:
        raise ValueError(f"shaders include each other in a circle: {' -> '.join((*parents, name))}")
    path = data_root("shaders") / name
    if not path.is_file():
        raise FileNotFoundError(f"no shader {name} (included from {parents[-1] if parents else 'the program'})")
    lines: list[str] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        match = _INCLUDE.match(line)
        lines += _lines(match[1], (*parents, name)) if match else [line]
    return lines
