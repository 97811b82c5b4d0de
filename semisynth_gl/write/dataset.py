"""A dataset's folder: whole scenes appear in it one by one, or not at all."""

import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from semisynth_gl.errors import InputError

INDEX = "dataset.json"
_PARTIAL = ".partial"
# Says that an unfinished folder is this program's.
_MARK = "semisynth-gl"
_SCENE_MARK = "pair.json"


class DatasetFolder:
    """The folder that a dataset is written to.

    Files are written under ``.partial/`` and renamed when they are whole; the index comes last, so a folder without one
    is not finished. Nothing on disk changes before `open`.

    Args:
        path: the folder; it need not exist.
        overwrite: replace an earlier dataset of this program in it. Other people's files are never deleted.

    Raises:
        InputError: where the folder holds something and ``overwrite`` is off, or something that is no dataset of this
            program, or where it is a file.
    """

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        self.path = path
        self._partial = path / _PARTIAL
        self._created = not path.exists()
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: expected a folder to write to, but it is a file")
        held = _held(path)
        if held and not overwrite:
            raise InputError(
                f"{path}: the folder is not empty (it holds {_few(held)}). "
                "Choose another with --out, or give --overwrite to replace a dataset that this program wrote"
            )
        foreign = _foreign(path, held)
        if foreign:
            raise InputError(
                f"{path}: --overwrite replaces only what this program wrote, but the folder holds {_few(foreign)}. "
                "Choose another folder with --out, or remove these yourself"
            )

    def open(self) -> None:
        """Create the folder, or empty it of the dataset that it holds.

        Raises:
            InputError: where that is not allowed or not possible.
        """
        try:
            self._partial.mkdir(parents=True, exist_ok=True)
            (self._partial / _MARK).touch()
            # The index goes first: from here on the folder does not claim to be finished.
            (self.path / INDEX).unlink(missing_ok=True)
            for name in _held(self.path):
                if name != _PARTIAL:
                    shutil.rmtree(self.path / name)
        except OSError as error:
            raise InputError(f"{self.path}: the folder cannot be written to: {error.strerror or error}") from None

    def add_folder(self, name: PurePosixPath, files: Mapping[str, bytes]) -> None:
        """Write files into a new folder ``name`` below the dataset's, which appears when all of them are whole.

        Raises:
            OSError: where the disk is full or refuses; nothing of the folder is left then.
        """
        partial = self._partial / name.name
        destination = self.path / name
        try:
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir()
            for file_name, data in files.items():
                (partial / file_name).write_bytes(data)
            destination.parent.mkdir(parents=True, exist_ok=True)
            partial.rename(destination)
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise

    def add_file(self, name: PurePosixPath, data: bytes) -> None:
        """Write one file below the dataset's folder, which appears when it is whole."""
        partial = self._partial / name.name
        destination = self.path / name
        destination.parent.mkdir(parents=True, exist_ok=True)
        try:
            partial.write_bytes(data)
            partial.rename(destination)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise

    def finish(self, index: Mapping[str, Any]) -> None:
        """Write the index, which says that the dataset is complete."""
        self.add_file(PurePosixPath(INDEX), (json.dumps(index, indent=1) + "\n").encode())
        shutil.rmtree(self._partial)

    def abandon(self) -> None:
        """Drop what is half-written. Whole scenes stay, and so does the mark that they are this program's."""
        with suppress(OSError):
            shutil.rmtree(self._partial, ignore_errors=True)
            if any(self.path.iterdir()):
                self._partial.mkdir()
                (self._partial / _MARK).touch()
            elif self._created:
                self.path.rmdir()


def _foreign(path: Path, held: list[str]) -> list[str]:
    """Names of what lies in a folder and was not written by this program; all of it where nothing proves otherwise."""
    if not ((path / _PARTIAL / _MARK).is_file() or _is_index(path / INDEX)):
        return held
    foreign = [name for name in held if name not in (_PARTIAL, INDEX, "MiddEval3") or (path / name).is_symlink()]
    root = path / "MiddEval3"
    foreign += [f"MiddEval3/{name}" for name in _held(root) if name not in ("trainingF", "official_train.txt")]
    scenes = root / "trainingF"
    foreign += [f"MiddEval3/trainingF/{name}" for name in _held(scenes) if not (scenes / name / _SCENE_MARK).is_file()]
    return foreign


def _is_index(path: Path) -> bool:
    try:
        index = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(index, dict) and index.get("program") == _MARK


def _held(path: Path) -> list[str]:
    return sorted(entry.name for entry in path.iterdir()) if path.is_dir() else []


def _few(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
