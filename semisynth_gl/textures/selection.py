"""Builds an atlas from images: chooses the crops that become patches."""

import hashlib
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, groupby, zip_longest
from pathlib import Path

import numpy as np

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.errors import InputError, SkippedFile, abbreviate, counted
from semisynth_gl.textures.atlas import Atlas, Patch, opaque_layers
from semisynth_gl.textures.borders import Rectangle
from semisynth_gl.textures.canvas import PaintedPicture
from semisynth_gl.textures.clips import CropCandidate, cut_clips, cut_crops, read_clip
from semisynth_gl.textures.crop_report import CropCount, TextureReport
from semisynth_gl.textures.crops import DuplicateFinder
from semisynth_gl.textures.image_files import relative_names
from semisynth_gl.textures.subjects import subject_numbers

PATCHES_PER_SUBJECT = 4
"""Once the atlas is full and no subject has more patches than this, no more images are opened: decoding is slow."""


def build_atlas(
    images: Sequence[Path],
    section: TexturesSection,
    rng: np.random.Generator,
    pictures: Iterable[PaintedPicture] | None = None,
) -> Atlas:
    """Crop squares out of images, and keep crops that have texture, are sharp, and differ from each other.

    Images are opened one at a time in random order; files and painted pictures alternate as long as there are both.
    Crops that have texture and are sharp are good. An image's good crops are added in random order, with alternating
    scales. A crop that hardly differs from an earlier good crop of any image is a duplicate. While there are more than
    ``max_patches``, the fullest image of the fullest subject (see `subject_numbers`) loses a patch. Once the atlas is
    full and no subject has more than `PATCHES_PER_SUBJECT`, the remaining images are not opened.

    With ``section.sequence``, clips of successive frames (see `cut_clips`) replace images, and each clip is a subject.
    Crops are not compared, since successive clips of a video look much the same.

    Args:
        images: the files, in any order.
        section: the config's section.
        rng: source of all random choices.
        pictures: painted pictures with unique names, of which only as many as needed are painted; None for no pictures.

    Returns:
        The atlas, with its patches ordered by image, size, row and column, files before pictures.

    Raises:
        InputError: where there is no patch.
    """
    images = sorted(images, key=Path.as_posix)
    names = relative_names(images)
    clips = cut_clips(images, section, alone=pictures is None) if section.sequence else [[path] for path in images]
    subjects = dict(enumerate([] if section.sequence else subject_numbers(images)))
    skipped, duplicates = list[SkippedFile](), DuplicateFinder(section.min_difference)
    pending = {int(number): clips[number] for number in rng.permutation(len(clips))}
    opened: dict[int, _ImageCrops] = {}  # by number, in the order of opening
    painted: dict[str, str] = {}
    in_turn = zip_longest(list(pending.items()), enumerate(pictures or (), start=len(clips)))
    for number, image in filter(None, chain.from_iterable(in_turn)):
        if isinstance(image, PaintedPicture):
            painted[image.name] = hashlib.sha256(image.pixels.tobytes()).hexdigest()
            height, width = image.pixels.shape[:2]
            used = [image.name]
            crops = cut_crops(image.name, Rectangle(0, 0, width, height), image.pixels, section)
        else:
            used, crops, unread = read_clip(pending.pop(number), names, section)
            skipped += unread
        good = _alternate_sides([crop for crop in crops if crop.outcome == "kept"], rng)
        if section.min_difference and not section.sequence:
            for alike in duplicates.find([crop.frames[0] for crop in good]):
                good[alike].reject("duplicate")
        kept = [crop for crop in good if crop.outcome == "kept"]
        opened[number] = _ImageCrops(subjects.get(number, number), used, crops, kept)
        _evict(opened, section.max_patches)
        if _settled(opened, section.max_patches):
            break
    report = _report(opened, skipped, sum(map(len, pending.values())), section.patch_px)
    chosen = [crop for number in sorted(opened) for crop in opened[number].crops if crop.outcome == "kept"]
    if not chosen:
        given = counted(len(images) + len(painted), "image")
        if images and len(skipped) == len(images) and not painted:
            reasons = abbreviate([f"{each.path.name} {each.reason}" for each in report.images_skipped], 3)
            raise InputError(f"none of {given} can be read: {reasons}")
        raise InputError(
            f"no patch can be cut from {given}: try different images, or smaller textures.patch_px, min_texture and "
            f"min_sharpness\n{report.summary()}"
        )
    patches, layer = list[Patch](), 0
    for crop in chosen:
        subject = report.subjects.get(crop.square.source, "")
        patches.append(Patch(*crop.square, layer, len(crop.frames), crop.texture, subject=subject))
        layer += len(crop.frames)
    sources = {patch.source for patch in patches}
    return Atlas(
        opaque_layers([np.array(crop.frames) for crop in chosen]),
        tuple(patches),
        report,
        {name: digest for name, digest in painted.items() if name in sources},
    )


@dataclass(slots=True, eq=False)
class _ImageCrops:
    """An image or a clip: its subject, the names of its frames, all its crops, and its crops that are kept."""

    subject: int
    frames: list[str]
    crops: list[CropCandidate]
    kept: list[CropCandidate]


def _by_subject(opened: Mapping[int, _ImageCrops]) -> list[list[_ImageCrops]]:
    """Group images that have crops by subject; subjects are in the order in which they were first opened."""
    groups: dict[int, list[_ImageCrops]] = defaultdict(list)
    for image in opened.values():
        if image.crops:
            groups[image.subject].append(image)
    return list(groups.values())


def _patches(images: Iterable[_ImageCrops]) -> int:
    return sum(len(image.kept) for image in images)


def _settled(opened: Mapping[int, _ImageCrops], most: int) -> bool:
    """Return whether the atlas is full, and no subject has more than `PATCHES_PER_SUBJECT`."""
    sizes = [_patches(images) for images in _by_subject(opened)]
    return sum(sizes) == most and max(sizes) <= PATCHES_PER_SUBJECT


def _evict(opened: Mapping[int, _ImageCrops], most: int) -> None:
    """Reject the surplus: the fullest image of the fullest subject loses its last patch, until ``most`` are left.

    Once the atlas is full, the fullest subject never gets more patches, so an evicted patch is never wanted back.
    """
    subjects = _by_subject(opened)
    for _ in range(_patches(opened.values()) - most):
        fullest = max(subjects, key=_patches)
        max(fullest, key=lambda image: len(image.kept)).kept.pop().reject("surplus")


def _report(
    opened: Mapping[int, _ImageCrops], skipped: Iterable[SkippedFile], not_opened: int, patch_px: int
) -> TextureReport:
    """Report the outcome of all images and crops; ``not_opened`` is the number of files that were not opened."""
    images = [opened[number] for number in sorted(opened)]
    subjects: dict[int, list[str]] = defaultdict(list)
    for image in images:
        if image.kept:
            subjects[image.subject].append(image.frames[0])
    return TextureReport(
        images_used=sum(len(image.frames) for image in images if image.kept),
        images_unused=sum(len(image.frames) for image in images if image.crops and not image.kept),
        images_too_small=sum(len(image.frames) for image in images if not image.crops),
        images_skipped=tuple(sorted(skipped, key=lambda skipped: skipped.path.as_posix())),
        images_not_opened=not_opened,
        counts=tuple(chain.from_iterable(_counts(image.crops) for image in images)),
        subjects={name: names[0] for names in subjects.values() if len(names) > 1 for name in names},
        patch_px=patch_px,
    )


def _counts(crops: Sequence[CropCandidate]) -> Iterator[CropCount]:
    """Yield the numbers of an image's crops with each outcome, by increasing size."""
    for side, of_side in groupby(crops, lambda crop: crop.square.side_px):
        outcomes = Counter[str](crop.outcome for crop in of_side)
        yield CropCount(crops[0].square.source, side, **outcomes)


def _alternate_sides(crops: Sequence[CropCandidate], rng: np.random.Generator) -> list[CropCandidate]:
    """Return crops in random order with alternating sizes, beginning with a random size."""
    sides = np.array([crop.square.side_px for crop in crops], dtype=np.int64)
    queues = [rng.permutation(np.flatnonzero(sides == side)) for side in rng.permutation(np.unique(sides))]
    return [crops[i] for i in chain.from_iterable(zip_longest(*queues)) if i is not None]
