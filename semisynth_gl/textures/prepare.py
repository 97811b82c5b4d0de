"""The atlas of a dataset, from the source that its config names: built once, and then found in the cache."""

import logging
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Any

from semisynth_gl.cache import Entry, cached, file_states, installed_packages, package_versions
from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.errors import Skipped
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.atlas import Atlas, Patch
from semisynth_gl.textures.clips import AtlasLimits, natural_key
from semisynth_gl.textures.crop_report import CropCount, JudgedCrop, TextureReport
from semisynth_gl.textures.crops import Square
from semisynth_gl.textures.image_files import relative_names, unread_photographs
from semisynth_gl.textures.images import OUT_OF_MEMORY
from semisynth_gl.textures.large import with_large_patches
from semisynth_gl.textures.pictures import Picture, TextureImage
from semisynth_gl.textures.procedural import procedural_atlas
from semisynth_gl.textures.selection import build_atlas
from semisynth_gl.textures.sources import describe_source, open_source
from semisynth_gl.textures.subjects import photographed_subjects, subject_numbers

VERSION = 6
"""Increase this when the same inputs give other patches or pictures; see `semisynth_gl.cache`."""

_LOG = logging.getLogger(__name__)

# Memory for pictures that are kept to cut large patches from. The program's own take 42 MB; a plug-in's may be of any
# number and size, and pictures beyond the limit are drawn again.
_MOST_KEPT_BYTES = 1 << 28
# The ``purpose`` under which `Split.share` deals out photographs.
_PHOTOGRAPHS = 0
# Most of these keys decide how patches lie on models, not which patches there are; the names of the images have their
# own place in the cache's key.
_NOT_DECISIVE = {"images", "texels_per_pixel", "anisotropy", "large_anisotropy", "wrap"}


def prepare_atlas(section: TexturesSection, split: Split, images: Sequence[Path] | None = None) -> Atlas:
    """Build the patch atlas of a split, or load it from the cache; each split has its own drawn pictures.

    Args:
        section: the config's section.
        split: the split, whose seed decides the choice of patches.
        images: the result of `split_images`, where the caller has it already; else it is computed here.

    Raises:
        InputError: where no image is found, no image is usable, images are too few to hold some out, or a plug-in
            cannot be used.
    """
    source = open_source(section.source)
    if images is None:
        images = split_images(section, split)

    def key() -> dict[str, Any]:
        return {
            "section": section.model_dump(mode="json", exclude=_NOT_DECISIVE),
            "seed": split.seed,
            "images": list(relative_names(images).values()),
            "files": file_states(images),
            # Names of folders above the folder that all images share tell subjects apart, too.
            "subjects": subject_numbers(images),
            "versions": package_versions("numpy", "Pillow"),
            # A plug-in may use any other package.
            "plugin": source.plugin and [source.plugin.record, source.plugin.code_sha256, installed_packages()],
        }

    return cached(
        "atlas",
        VERSION,
        key,
        work=f"making {source.patches}" + (f" (images: {len(images):,})" if images and source.pictures is None else ""),
        build=lambda: _build(section, split, images),
        pack=lambda atlas: pack_atlas(atlas, images),
        unpack=lambda entry: unpack_atlas(entry, images),
    )


def _build(section: TexturesSection, split: Split, images: Sequence[Path]) -> Atlas:
    rng = generator(split.seed, Purpose.ATLAS)
    if section.source == "procedural":
        return procedural_atlas(rng, section.max_patches, section.patch_px)
    pictures = split_pictures(section, split)
    if not section.large_px or section.sequence:
        return build_atlas(images, section, AtlasLimits(), rng, pictures)
    kept: dict[str, TextureImage] = {}
    keeping = None if pictures is None else _keeping(pictures, kept)
    atlas = build_atlas(images, section, AtlasLimits(), rng, keeping)

    def named(names: Collection[str]) -> dict[str, TextureImage]:
        return kept | named_images(section, set(names) - set(kept), split, images)

    return with_large_patches(atlas, named, section, generator(split.seed, Purpose.LARGE_PATCHES))


def split_images(section: TexturesSection, split: Split) -> list[Path]:
    """Return the files that a split's patches may come from, sorted; none where all patches are drawn.

    Photographs of one subject are held out together, and so are all frames of a folder and folders of one subject.

    Raises:
        InputError: where no image is found, or images are too few to hold some out.
    """
    images = list(describe_source(section.source).files(section))
    if unread := unread_photographs(section.images):
        _LOG.info("%s", unread)
    if not images or not split.held_out:
        return images
    if not section.sequence:
        own = share_photographs(split, photographed_subjects(images), "photographs")
        return [path for path in images if path in own]
    # Successive frames look much the same, so the first frame of a folder decides which subject the folder shows.
    first = {path.parent: path for path in sorted(images, key=natural_key, reverse=True)}
    subjects = photographed_subjects([first[folder] for folder in sorted(first)])
    own = share_photographs(split, subjects, "folders of frames")
    return [path for path in images if first[path.parent] in own]


def split_pictures(section: TexturesSection, split: Split) -> Iterable[Picture] | None:
    """Return the pictures that a split's patches may come from; None where the source draws none.

    They can be iterated over once. Each picture is drawn when it is asked for. Splits have different pictures.

    Raises InputError where a plug-in cannot be used.
    """
    draw = open_source(section.source).pictures
    return None if draw is None else draw(generator(split.seed, Purpose.PICTURES))


def _keeping(pictures: Iterable[Picture], kept: dict[str, TextureImage]) -> Iterator[Picture]:
    """Yield pictures, and put them into ``kept`` by their names as long as there is room."""
    room = _MOST_KEPT_BYTES
    for picture in pictures:
        room -= picture.pixels.nbytes
        if room >= 0:
            kept[picture.name] = picture
        yield picture


def named_images(
    section: TexturesSection, names: Collection[str], split: Split, images: Sequence[Path]
) -> dict[str, TextureImage]:
    """Return the images of a split's atlas that have the given names; names that no image has are left out.

    ``images`` are the split's files, see `split_images`. Pictures are drawn again, up to the last picture that is
    asked for.
    """
    found: dict[str, TextureImage] = {name: path for path, name in relative_names(images).items() if name in names}
    missing = set(names) - set(found)
    pictures = iter(split_pictures(section, split) or ())
    while missing and (picture := next(pictures, None)):
        if picture.name in missing:
            found[picture.name] = picture
            missing.remove(picture.name)
    return found


def share_photographs(split: Split, subjects: Sequence[Sequence[Path]], what: str) -> set[Path]:
    """Return the photographs that a split takes, all or none of each subject; see `Split.share`.

    Args:
        split: the split.
        subjects: the photographs of each subject, see `photographed_subjects`.
        what: what the error calls the photographs, a plural noun.

    Raises:
        InputError: where there are too few subjects for each split to take one.
    """
    if sum(map(len, subjects)) > len(subjects):
        what = f"{what} of different subjects"
    return set(chain.from_iterable(split.share(subjects, what, _PHOTOGRAPHS)))


def pack_atlas(atlas: Atlas, images: Sequence[Path]) -> Entry | None:
    """Turn an atlas into an entry of the cache; None where an image was skipped for a reason that may not hold again.

    The entry refers to skipped files by their numbers in ``images``, the files that the atlas was built from, not by
    their paths, so that the folder may move.
    """
    skipped = atlas.report.images_skipped
    if any(image.reason == OUT_OF_MEMORY or str(image.path) in image.reason for image in skipped):
        return None
    number = {path: index for index, path in enumerate(images)}
    report = asdict(atlas.report) | {"images_skipped": [[number[image.path], image.reason] for image in skipped]}
    values = {"patches": [asdict(patch) for patch in atlas.patches], "report": report, "pictures": atlas.pictures}
    return Entry(values, {"layers": atlas.layers, "large_layers": atlas.large_layers})


def unpack_atlas(entry: Entry, images: Sequence[Path]) -> Atlas:
    """Turn an entry of the cache back into an equal atlas; ``images`` are the files that the atlas was built from."""
    report = entry.values["report"]
    typed = {
        "images_skipped": tuple(Skipped(images[index], reason) for index, reason in report["images_skipped"]),
        "too_small": tuple(report["too_small"]),
        "counts": tuple(CropCount(**count) for count in report["counts"]),
        "examples": tuple(
            JudgedCrop(reason, Square(*square), like and Square(*like)) for reason, square, like in report["examples"]
        ),
    }
    patches = tuple(Patch(**patch) for patch in entry.values["patches"])
    pictures, arrays = entry.values["pictures"], entry.arrays
    return Atlas(arrays["layers"], patches, TextureReport(**report | typed), pictures, arrays["large_layers"])
