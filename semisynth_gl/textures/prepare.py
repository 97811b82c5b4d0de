"""The atlas of a dataset, from whatever source its config names."""

from semisynth_gl.config.model import TexturesSection
from semisynth_gl.errors import InputError
from semisynth_gl.seeds import Purpose, generator
from semisynth_gl.textures.atlas import Atlas
from semisynth_gl.textures.images import find_images
from semisynth_gl.textures.photographs import builtin_photographs
from semisynth_gl.textures.procedural import procedural_atlas
from semisynth_gl.textures.selection import build_atlas


def prepare_atlas(section: TexturesSection, seed: int) -> Atlas:
    """Build the patch atlas that a config asks for.

    Raises:
        InputError: where no image is found or none is usable.
    """
    rng = generator(seed, Purpose.ATLAS)
    if section.source == "procedural":
        return procedural_atlas(rng, section.max_patches, section.patch_px)
    if section.source == "images" and not section.images:
        raise InputError(
            "textures.source is images, but there are none: give --images FOLDER, or set textures.images in the config"
        )
    images = find_images(section.images) if section.source == "images" else builtin_photographs()
    return build_atlas(
        images,
        patch_px=section.patch_px,
        scales=section.scales,
        min_texture=section.min_texture,
        max_patches=section.max_patches,
        sequence=section.sequence,
        rng=rng,
    )
