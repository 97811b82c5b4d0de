"""Check that a dataset is apart from its sources: else a next run would use its files as photographs or models."""

import os
from pathlib import Path

from upath import UPath

from semisynth_gl.dataset.documents import Plan
from semisynth_gl.dataset.root import is_local
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.textures.image_files import find_files
from semisynth_gl.textures.images import image_extensions
from semisynth_gl.textures.reach import photograph_sources, reaching_source


def check_apart(root: UPath, plan: Plan) -> None:
    """Raise InputError if the dataset's folder is inside a folder of photographs or models, or holds any of them."""
    if not is_local(root):
        return
    config, folder, real = plan.config, Path(root), Path(os.path.realpath(root))
    advice = "Choose a folder apart from it"
    sources, extensions = photograph_sources(config.textures), image_extensions()
    if sources:
        # "file" stands for any name, since the next dataset in this folder may have other names.
        paths = [name for split in plan.splits for name in plan.files(split, 0).values()]
        source = reaching_source(folder / "file", sources)
        files = (reaching_source(folder / name, sources, extensions) for name in paths)
        source = source or next(filter(None, files), None)
        if source is not None:
            raise InputError(
                f"{root}: is inside the photographs ({source}): images of the dataset would become "
                f"photographs. {advice}",
                argument="out",
            )
        if folder.is_dir():
            for path in find_files(sources, extensions):
                if Path(os.path.realpath(path)).is_relative_to(real):
                    raise InputError(f"{root}: the photograph {path} is inside this folder. {advice}", argument="out")
    for models in config.models.folders:
        real_models = Path(os.path.realpath(expanded(models)))
        if real.is_relative_to(real_models) or real_models.is_relative_to(real):
            inside = "is inside" if real.is_relative_to(real_models) else "holds"
            raise InputError(f"{root}: {inside} the models {models}. {advice}", argument="out")
