"""The atlas of a dataset, from whatever source its config names; made once and then found in the cache."""

from pathlib import Path
from typing import Any

from semisynth_gl.config.model import TexturesSection
from semisynth_gl.errors import InputError
from semisynth_gl.remember import own_sources, remembered, versions
from semisynth_gl.seeds import Purpose, generator
from semisynth_gl.textures.atlas import Atlas
from semisynth_gl.textures.atlas_entry import packed_atlas, unpacked_atlas
from semisynth_gl.textures.images import find_images
from semisynth_gl.textures.photographs import builtin_photographs
from semisynth_gl.textures.procedural import procedural_atlas
from semisynth_gl.textures.selection import build_atlas, names_of


def prepare_atlas(section: TexturesSection, seed: int) -> Atlas:
    """Build the patch atlas that a config asks for, or find the one that was built of the same before.

    Raises:
        InputError: where no image is found or none is usable.
    """
    images = _images(section)

    def make() -> tuple[Atlas, list[Path]]:
        rng = generator(seed, Purpose.ATLAS)
        if section.source == "procedural":
            return procedural_atlas(rng, section.max_patches, section.patch_px), []
        opened: list[Path] = []
        atlas = build_atlas(
            images,
            patch_px=section.patch_px,
            scales=section.scales,
            min_texture=section.min_texture,
            max_patches=section.max_patches,
            sequence=section.sequence,
            rng=rng,
            opened=opened,
        )
        return atlas, opened

    def decided_by() -> dict[str, Any]:
        keys = {"source", "patch_px", "scales", "min_texture", "max_patches", "sequence"}
        return {
            "section": section.model_dump(mode="json", include=keys),
            "seed": seed,
            "images": list(names_of(images).values()) if images else [],
            "versions": versions("numpy", "Pillow"),
            "program": own_sources("textures", "seeds.py"),
        }

    return remembered(
        "atlas",
        decided_by,
        files=images,
        make=make,
        pack=lambda atlas: packed_atlas(atlas, images),
        unpack=lambda entry: unpacked_atlas(entry, images),
    )


def _images(section: TexturesSection) -> list[Path]:
    """The files that patches may come from, sorted by their names."""
    if section.source == "procedural":
        return []
    if section.source == "builtin":
        return sorted(builtin_photographs(), key=Path.as_posix)
    if not section.images:
        raise InputError(
            "textures.source is images, but there are none: give --images FOLDER, or set textures.images in the config"
        )
    return find_images(section.images)
