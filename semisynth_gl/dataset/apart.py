"""Check that a dataset is apart from its sources: else a next run would use its files as photographs or models."""

import os
from pathlib import Path

from upath import UPath

from semisynth_gl.config import Config
from semisynth_gl.dataset.root import is_local
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.textures.image_files import find_files, reaching_source
from semisynth_gl.textures.images import image_extensions


def check_apart(root: UPath, config: Config) -> None:
    """Raise InputError if the dataset's folder is inside a folder of photographs or models, or holds any of them."""
    if not is_local(root):
        return
    images = config.textures.images if config.textures.source == "images" else ()
    if source := reaching_source(Path(root), images) or reaching_source(Path(root), config.models.folders):
        raise InputError(f"{root}: is inside {source}, from which the dataset is made. {_ADVICE}", argument="out")
    for path in (*(find_files(images, image_extensions()) if root.is_dir() else ()), *config.models.folders):
        if Path(os.path.realpath(expanded(path))).is_relative_to(os.path.realpath(root)):
            raise InputError(f"{root}: holds {path}, from which the dataset is made. {_ADVICE}", argument="out")


_ADVICE = "Its files would be used as photographs or models: choose a folder apart"
