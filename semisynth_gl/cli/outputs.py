"""Files and tables that commands write: options for files, JSON, aligned text."""

import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import click


class OutputFileType(click.Path):
    """Option type of a file to write: its folder must exist, and its name must end in one of ``endings``, if any."""

    def __init__(self, *endings: str) -> None:
        super().__init__(path_type=Path)
        self._endings = endings

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path; raises BadParameter if it cannot be written or has a wrong ending."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if self._endings and path.suffix.lower() not in self._endings:
            self.fail(f"{path}: expected a name that ends in {' or '.join(self._endings)}", param, ctx)
        if path.is_dir():
            self.fail(f"{path}: is a folder; name a file", param, ctx)
        if not path.parent.is_dir():
            self.fail(f"{path}: the folder {path.parent} does not exist", param, ctx)
        return path


def write_json(path: Path | None, values: object) -> None:
    """Write values as JSON if there is a path."""
    if path is not None:
        path.write_text(f"{json.dumps(values, indent=1)}\n", "utf-8")


def table(rows: Iterable[Sequence[str]]) -> list[str]:
    """Return rows of cells as lines, in columns; the first column is aligned to the left, the others to the right."""
    rows = [*rows]
    first, *others = (max(map(len, cells)) for cells in zip(*rows, strict=True))
    return [
        "  ".join([name.ljust(first), *(cell.rjust(width) for cell, width in zip(cells, others, strict=True))])
        for name, *cells in rows
    ]
