"""Files that commands write."""

import json
import os
from pathlib import Path

import click


class OutputFile(click.Path):
    """The type of a file to write; its folder has to exist, and its name to have one of the ``endings``, if any."""

    def __init__(self, *endings: str) -> None:
        super().__init__(path_type=Path)
        self._endings = endings

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path, or refuse it before anything is computed."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if self._endings and path.suffix.lower() not in self._endings:
            self.fail(f"{path}: expected a name that ends in {self._endings[0]}", param, ctx)
        if path.is_dir():
            self.fail(f"{path}: is a folder; name a file", param, ctx)
        if not path.parent.is_dir():
            self.fail(f"{path}: the folder {path.parent} does not exist", param, ctx)
        return path


def write_json(path: Path, values: object) -> None:
    """Write values as JSON."""
    path.write_text(f"{json.dumps(values, indent=1)}\n", "utf-8")
