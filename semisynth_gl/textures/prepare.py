"""The atlas of a dataset, from whatever source its config names; built once and then loaded from the cache."""

from pathlib import Path
from typing import Any

from semisynth_gl.cache.lookup import cached, package_versions, source_digest
from semisynth_gl.config.model import TexturesSection
from semisynth_gl.errors import InputError
from semisynth_gl.seeds import Purpose, generator
from semisynth_gl.splits import WHOLE, Split
from semisynth_gl.textures.atlas import Atlas
from semisynth_gl.textures.atlas_entry import packed_atlas, unpacked_atlas
from semisynth_gl.textures.images import find_images
from semisynth_gl.textures.photographs import builtin_photographs
from semisynth_gl.textures.procedural import procedural_atlas
from semisynth_gl.textures.selection import build_atlas, names_of

SOURCES = ("textures", "seeds.py", "splits.py")
"""The program's sources that decide an atlas: a change of any of them makes the cache build it anew."""

# What `Split.share` is told to share out.
_PHOTOGRAPHS = 0


def prepare_atlas(section: TexturesSection, seed: int, split: Split = WHOLE) -> Atlas:
    """Build the patch atlas that a config asks for, or find the one that was built of the same before.

    Args:
        section: what to cut from what.
        seed: the dataset's.
        split: whose photographs; of image sequences whole folders are held out, since their frames show the same.

    Raises:
        InputError: where no image is found, none is usable, or there are too few to hold some out.
    """
    images = images_of(section, seed, split)
    seed = split.seed(seed)

    def build() -> tuple[Atlas, list[Path]]:
        rng = generator(seed, Purpose.ATLAS)
        if section.source == "procedural":
            return procedural_atlas(rng, section.max_patches, section.patch_px), []
        opened: list[Path] = []
        atlas = build_atlas(
            images,
            patch_px=section.patch_px,
            scales=section.scales,
            min_texture=section.min_texture,
            min_sharpness=section.min_sharpness,
            min_difference=section.min_difference,
            flat_share=section.flat_share,
            max_patches=section.max_patches,
            sequence=section.sequence,
            rng=rng,
            opened=opened,
        )
        return atlas, opened

    def key() -> dict[str, Any]:
        fields = {"source", "patch_px", "scales", "max_patches", "sequence"}
        fields |= {"min_texture", "min_sharpness", "min_difference", "flat_share"}
        return {
            "section": section.model_dump(mode="json", include=fields),
            "seed": seed,
            "images": list(names_of(images).values()) if images else [],
            "versions": package_versions("numpy", "Pillow"),
            "program": source_digest(SOURCES),
        }

    return cached(
        "atlas",
        key,
        files=images,
        build=build,
        pack=lambda atlas: packed_atlas(atlas, images),
        unpack=lambda entry: unpacked_atlas(entry, images),
    )


def images_of(section: TexturesSection, seed: int, split: Split = WHOLE) -> list[Path]:
    """Return the files that a split's patches may come from, sorted; none for patches that are procedural.

    Raises:
        InputError: where there are none, or too few to hold some out.
    """
    images = _found(section)
    if not split.held_out or not images:
        return images
    if not section.sequence:
        return split.share(images, seed, "photographs", _PHOTOGRAPHS)
    folders = split.share(sorted({path.parent for path in images}), seed, "folders of frames", _PHOTOGRAPHS)
    return [path for path in images if path.parent in folders]


def _found(section: TexturesSection) -> list[Path]:
    if section.source == "procedural":
        return []
    if section.source == "builtin":
        return sorted(builtin_photographs(), key=Path.as_posix)
    if not section.images:
        raise InputError(
            "textures.source is images, but there are none: give --images FOLDER, or set textures.images in the config"
        )
    return find_images(section.images)
