"""Whether a folder that is yet to be written is among the photographs."""

import glob
import os
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

from semisynth_gl.inputs.user_files import expanded


def reaching_source(folder: Path, sources: Sequence[str]) -> str | None:
    """Return the first folder or glob by which `find_files` would find photographs in a folder, or None."""
    real = Path(os.path.realpath(folder))
    return next((source for source in sources if _reaches(expanded(source), real)), None)


def _reaches(source: Path, folder: Path) -> bool:
    parts = source.absolute().parts
    plain = list(takewhile(lambda part: not glob.has_magic(part), parts))
    base, rest = Path(os.path.realpath(Path(*plain))), parts[len(plain) :]
    if not rest or "**" in rest:
        return folder.is_relative_to(base)
    pattern = base.joinpath(*rest)
    # A folder that a pattern matches is searched.
    return Path(*folder.parts[: len(pattern.parts)]).match(str(pattern))
