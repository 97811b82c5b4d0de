"""Builds an atlas from images: chooses the crops that become patches."""

import hashlib
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, groupby, zip_longest
from pathlib import Path
from typing import TypeVar

import numpy as np

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.errors import InputError, Skipped, counted
from semisynth_gl.textures.atlas import Atlas, Patch, opaque_layers
from semisynth_gl.textures.borders import Inside
from semisynth_gl.textures.clips import Crop, cut_clips, cut_frame, find_crops, read_clip
from semisynth_gl.textures.crop_report import CropCount, TextureReport
from semisynth_gl.textures.crops import DuplicateFinder
from semisynth_gl.textures.image_files import relative_names
from semisynth_gl.textures.pictures import Picture
from semisynth_gl.textures.subjects import subject_numbers

PATCHES_PER_SUBJECT = 4
"""Once the atlas is full and no subject has more patches than this, no further image is opened: decoding takes most of
the time."""

_Item = TypeVar("_Item")


def build_atlas(
    images: Sequence[Path],
    section: TexturesSection,
    rng: np.random.Generator,
    pictures: Iterable[Picture] | None = None,
    remember: Callable[[Picture], None] | None = None,
) -> Atlas:
    """Crop squares out of images and keep crops with texture that are sharp and unlike each other.

    Images are opened one at a time in random order. Each offers its good crops in random order, with scales taking
    turns. A crop that hardly differs from an earlier good crop of any image is a duplicate. When there are more patches
    than wanted, one is evicted from the fullest image of the fullest subject (see `subject_numbers`). Once the atlas is
    full and no subject has more than `PATCHES_PER_SUBJECT`, the remaining images are not opened. Files and pictures
    take turns while both last.

    With ``section.sequence``, clips of successive frames (see `cut_clips`) take the place of images, and each clip is a
    subject. Crops are not compared, since successive clips of a video look much the same.

    Args:
        images: the files, in any order.
        section: the config's section.
        rng: source of all random choices.
        pictures: painted pictures, asked for one at a time, in their order; None where the source has none.
        remember: called with each picture that patches come from.

    Returns:
        The atlas, with its patches ordered by image, side, row and column, files before pictures.

    Raises:
        InputError: where there is no patch, or two pictures have one name.
    """
    images = sorted(images, key=Path.as_posix)
    names = relative_names(images)
    clips = cut_clips(images, section, alone=pictures is None) if section.sequence else [[path] for path in images]
    skipped = list[Skipped]()
    selection = _Selection(section, rng, [] if section.sequence else subject_numbers(images))
    pending = {int(number): clips[number] for number in rng.permutation(len(clips))}
    painted: dict[str, str] = {}
    for number, image in _in_turn(list(pending.items()), enumerate(pictures or (), start=len(clips))):
        if isinstance(image, Picture):
            if image.name in painted:
                raise InputError(f"expected pictures with different names, got two with the name {image.name!r}")
            painted[image.name] = hashlib.sha256(image.pixels.tobytes()).hexdigest()
            height, width = image.pixels.shape[:2]
            used, crops = [image.name], find_crops(image.name, Inside(0, 0, width, height), section)
            cut_frame(crops, image.pixels, section)
        else:
            used, crops, unread = read_clip(pending.pop(number), names, section)
            skipped += unread
        selection.add(number, used, crops)
        # A picture never loses its last patch: the atlas would have been settled before.
        if remember and isinstance(image, Picture) and any(crop.outcome == "kept" for crop in crops):
            remember(image)
        if selection.settled:
            break
    report = selection.report(skipped, not_opened=sum(map(len, pending.values())))
    chosen = selection.patches()
    if not chosen:
        given = counted(len(images) + len(painted), "image")
        raise InputError(
            f"no patch can be cut from {given}: try other images, or smaller textures.patch_px, min_texture and "
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


class _Selection:
    """The patches chosen among the crops of all images opened so far, and what became of the other crops.

    The largest share only ever shrinks, so a patch that is evicted would never be needed again.

    ``subjects`` has the subject of each of the first images; each image beyond them is a subject.
    """

    def __init__(self, section: TexturesSection, rng: np.random.Generator, subjects: Sequence[int]) -> None:
        self._section, self._rng, self._subjects = section, rng, dict(enumerate(subjects))
        self._duplicates = DuplicateFinder(section.min_difference)
        # By the number of the image or clip.
        self._frames: dict[int, list[str]] = {}
        self._crops: dict[int, list[Crop]] = {}
        self._kept: dict[int, list[Crop]] = {}

    @property
    def settled(self) -> bool:
        """Whether the atlas is full, and no subject has more than its `PATCHES_PER_SUBJECT`."""
        sizes = [sum(map(len, kept)) for kept in self._by_subject().values()]
        return sum(sizes) == self._section.max_patches and max(sizes) <= PATCHES_PER_SUBJECT

    def add(self, number: int, frames: list[str], crops: list[Crop]) -> None:
        """Choose among the crops of a further image or clip, and make room for them."""
        self._frames[number], self._crops[number] = frames, crops
        if not crops:
            return
        good = _alternate_sides([crop for crop in crops if crop.outcome == "kept"], self._rng)
        if self._section.min_difference and not self._section.sequence:
            duplicates = self._duplicates.find({crop.square: crop.frames[0] for crop in good})
            for crop in good:
                if crop.square in duplicates:
                    crop.reject("duplicate")
        self._kept[number] = [crop for crop in good if crop.outcome == "kept"]
        by_subject = self._by_subject()
        for _ in range(sum(map(len, self._kept.values())) - self._section.max_patches):
            fullest = max(by_subject.values(), key=lambda kept: sum(map(len, kept)))
            max(fullest, key=len).pop().reject("surplus")

    def _by_subject(self) -> dict[int, list[list[Crop]]]:
        """Return the kept crops of each image, by subject."""
        kept: dict[int, list[list[Crop]]] = defaultdict(list)
        for number, crops in self._kept.items():
            kept[self._subjects.get(number, number)].append(crops)
        return kept

    def patches(self) -> list[Crop]:
        """Return the chosen crops by image, side, row and column."""
        return [crop for _, crops in sorted(self._crops.items()) for crop in crops if crop.outcome == "kept"]

    def report(self, skipped: Sequence[Skipped], not_opened: int) -> TextureReport:
        """Return what became of all images and crops, given the files that were not read."""
        images = [(number, crops) for number, crops in sorted(self._crops.items()) if crops]
        used = [number for number, kept in sorted(self._kept.items()) if kept]
        by_subject: dict[int, list[str]] = defaultdict(list)
        for number in used:
            by_subject[self._subjects.get(number, number)].append(self._frames[number][0])
        return TextureReport(
            images_used=sum(len(self._frames[number]) for number in used),
            images_unused=sum(len(self._frames[number]) for number, _ in images if number not in used),
            images_too_small=sum(len(self._frames[number]) for number, crops in self._crops.items() if not crops),
            images_skipped=tuple(sorted(skipped, key=lambda skipped: skipped.path.as_posix())),
            images_not_opened=not_opened,
            counts=tuple(chain.from_iterable(_counts(crops) for _, crops in images)),
            subjects={name: names[0] for names in by_subject.values() if len(names) > 1 for name in names},
            patch_px=self._section.patch_px,
        )


def _counts(crops: Sequence[Crop]) -> Iterator[CropCount]:
    """Yield the numbers of an image's crops, by increasing side."""
    for side, of_side in groupby(crops, lambda crop: crop.square.side_px):
        outcomes = Counter[str](crop.outcome for crop in of_side)
        yield CropCount(crops[0].square.source, side, **outcomes)


def _in_turn(*sources: Iterable[_Item]) -> Iterator[_Item]:
    """Yield one item of each source in turn; a source is not asked for an item before its turn."""
    waiting = deque(map(iter, sources))
    while waiting:
        source = waiting.popleft()
        for item in source:
            yield item
            waiting.append(source)
            break


def _alternate_sides(crops: Sequence[Crop], rng: np.random.Generator) -> list[Crop]:
    """Return crops in random order, taking one of each side in turn, from a random side on."""
    sides = np.array([crop.square.side_px for crop in crops], dtype=np.int64)
    queues = [rng.permutation(np.flatnonzero(sides == side)) for side in rng.permutation(np.unique(sides))]
    return [crops[i] for i in chain.from_iterable(zip_longest(*queues)) if i is not None]
