"""Prepares a split's atlas from the source that the config names: builds it once, then loads it from the cache."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from itertools import chain
from pathlib import Path

from pydantic import TypeAdapter

from semisynth_gl.cache import CacheEntry, cached
from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.atlas import Atlas, Patch
from semisynth_gl.textures.canvas import PaintedPicture
from semisynth_gl.textures.crop_report import TextureReport
from semisynth_gl.textures.image_files import relative_names
from semisynth_gl.textures.large import with_large_patches
from semisynth_gl.textures.procedural import procedural_atlas
from semisynth_gl.textures.selection import build_atlas
from semisynth_gl.textures.sources import describe_source, open_source
from semisynth_gl.textures.subjects import group_by_subject

# Maximum number of pictures that are kept in memory until large patches are cut from them.
_REMEMBERED = 256
# The ``purpose`` in `Split.select` for photographs.
_PHOTOGRAPHS = 0
# Keys of the section that are not in the cache's key: ``images``, whose files are in it instead, and keys that only
# decide how patches are mapped to models.
_NOT_IN_KEY = {"images", "texels_per_pixel", "anisotropy", "large_anisotropy", "wrap"}


def prepare_atlas(section: TexturesSection, split: Split, images: Sequence[Path] | None = None) -> Atlas:
    """Build the patch atlas of a split, or load it from the cache. Each split has its own painted pictures.

    Args:
        section: the config's section.
        split: the split, whose seed decides the choice of patches.
        images: the result of `split_images`; None to compute it here.

    Raises:
        InputError: where no image is found, no image is usable, there are too few images to hold some out, or a plug-in
            cannot be used.
    """
    if images is None:
        images = split_images(section, split)
    key = {
        "section": section.model_dump(mode="json", exclude=_NOT_IN_KEY),
        "seed": split.seed,
        "images": list(images),
    }
    announce = f"making patches of {section.source}" + (f" (images: {len(images):,})" if images else "")
    entry = cached("atlas", key, lambda: pack_atlas(_build(section, split, images)), announce=announce)
    return unpack_atlas(entry)


def _build(section: TexturesSection, split: Split, images: Sequence[Path]) -> Atlas:
    rng = generator(split.seed, Purpose.ATLAS)
    if section.source == "procedural":
        return procedural_atlas(rng, section.max_patches, section.patch_px)
    paint = open_source(section.source).pictures
    pictures = paint and paint(generator(split.seed, Purpose.PICTURES))
    if not section.large_px or section.sequence:
        return build_atlas(images, section, rng, pictures)
    painted: dict[str, PaintedPicture] = {}
    atlas = build_atlas(images, section, rng, pictures and _remembered(pictures, painted))
    by_name = {name: path for path, name in relative_names(images).items()} | painted
    return with_large_patches(atlas, by_name, section, generator(split.seed, Purpose.LARGE_PATCHES))


def _remembered(pictures: Iterable[PaintedPicture], painted: dict[str, PaintedPicture]) -> Iterator[PaintedPicture]:
    """Yield pictures, and keep the first of them in ``painted``, by name, to cut large patches from them later."""
    for picture in pictures:
        if len(painted) < _REMEMBERED:
            painted[picture.name] = picture
        yield picture


def split_images(section: TexturesSection, split: Split) -> list[Path]:
    """Return the files from which a split's patches may be cut, sorted; none if all patches are painted.

    Photographs of one subject are held out together, and so are frames of one folder, and folders of one subject.

    Raises:
        InputError: where no image is found, or there are too few images to hold some out.
    """
    images = list(describe_source(section.source).files(section))
    if not images or not split.held_out:
        return images
    if not section.sequence:
        own = share_photographs(split, group_by_subject(images), "photographs")
        return [path for path in images if path in own]
    # Successive frames look much the same, so the first frame of a folder decides on the folder's subject.
    first = {path.parent: path for path in reversed(images)}
    subjects = group_by_subject([first[folder] for folder in sorted(first)])
    own = share_photographs(split, subjects, "folders of frames")
    return [path for path in images if first[path.parent] in own]


def share_photographs(split: Split, subjects: Sequence[Sequence[Path]], what: str) -> set[Path]:
    """Return the photographs of a split, all or none of each subject; see `Split.select`.

    Errors call the photographs ``what``, a plural noun.

    Raises:
        InputError: where there are fewer subjects than splits.
    """
    if sum(map(len, subjects)) > len(subjects):
        what = f"{what} of different subjects"
    return set(chain.from_iterable(split.select(subjects, what, _PHOTOGRAPHS)))


def pack_atlas(atlas: Atlas) -> CacheEntry:
    """Turn an atlas into an entry of the cache."""
    report = TypeAdapter(TextureReport).dump_python(atlas.report, mode="json")
    values = {"patches": [asdict(patch) for patch in atlas.patches], "report": report, "pictures": atlas.pictures}
    return CacheEntry(values, {"layers": atlas.layers, "large_layers": atlas.large_layers})


def unpack_atlas(entry: CacheEntry) -> Atlas:
    """Turn an entry of the cache back into an equal atlas."""
    patches = tuple(Patch(**patch) for patch in entry.values["patches"])
    report = TypeAdapter(TextureReport).validate_python(entry.values["report"])
    return Atlas(entry.arrays["layers"], patches, report, entry.values["pictures"], entry.arrays["large_layers"])
