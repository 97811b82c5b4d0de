"""Builds an atlas from images: chooses the crops that become patches."""

import hashlib
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, chain, zip_longest
from pathlib import Path
from typing import TypeVar

import numpy as np

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.errors import InputError, Skipped, counted
from semisynth_gl.textures.atlas import Atlas, Patch, opaque_layers
from semisynth_gl.textures.clips import (
    AtlasLimits,
    Clip,
    ClipSurvey,
    MeasuredCrop,
    PatchFrames,
    cut_clips,
    survey_clip,
    survey_picture,
)
from semisynth_gl.textures.crop_report import JudgedClip, JudgedCrop, TextureReport, crop_counts, rejected_examples
from semisynth_gl.textures.crops import DuplicateFinder
from semisynth_gl.textures.image_files import relative_names
from semisynth_gl.textures.pictures import Picture
from semisynth_gl.textures.subjects import subject_numbers

PATCHES_PER_SUBJECT = 4
"""Once the atlas is full and no subject has more patches than this, no further image is opened. A smaller number would
draw on more photographs, but decoding takes most of the time: 512 patches from 512 photographs take four times as long
as from 128."""

_REASONS_SHOWN = 5

_Item = TypeVar("_Item")


def build_atlas(
    images: Sequence[Path],
    section: TexturesSection,
    limits: AtlasLimits,
    rng: np.random.Generator,
    pictures: Iterable[Picture] | None = None,
) -> Atlas:
    """Crop squares out of images and keep crops with texture that are sharp and unlike each other.

    Images are opened one at a time in random order. Each offers its good crops in random order, with scales taking
    turns. A crop that hardly differs from an earlier good crop of any image is rejected as a duplicate. When there are
    more patches than wanted, one is evicted from the fullest image of the fullest subject. So no
    subject or scale crowds out the others, and other subjects fill the place of a subject with few crops. Files are of
    one subject where `subject_numbers` says so. Once the atlas is full and no subject has more than
    `PATCHES_PER_SUBJECT`, the remaining images are not opened. Memory holds one decoded image, those of its crops that
    may be kept, and the patches of the atlas.

    Pictures are judged by the same measures. Files and pictures take turns while both last; pictures come in their own
    order, and are asked for one at a time.

    With ``section.sequence``, clips of successive frames (see `cut_clips`) take the place of images. A patch then has
    the same square from each frame of its clip, a crop counts as flat or blurred if it is so in any frame, and each
    clip is a subject. Crops are not compared, since successive clips of a video look much the same. Ask for fewer
    patches to get longer clips. A frame that cannot be read is left out of its clip. Frames are read twice, to measure
    and to cut, so that only one is in memory at a time.

    Args:
        images: the files, in any order.
        section: the config's section.
        limits: limits of the atlas.
        rng: source of all random choices.
        pictures: drawn pictures, iterated over once; None where the source has none.

    Returns:
        The atlas, with its patches ordered by image, side, row and column, files before pictures.

    Raises:
        InputError: where there is no patch, or two pictures have one name.
    """
    images = sorted(images, key=Path.as_posix)
    names = relative_names(images)
    clips: list[Clip] = [(path,) for path in images]
    skipped: list[Skipped] = []
    if section.sequence:
        clips, skipped = cut_clips(images, section, limits, alone=pictures is None)
    selection = _Selection(section, limits, rng, [] if section.sequence else subject_numbers(images))
    pending = {int(i): clips[i] for i in rng.permutation(len(clips))}
    drawn: dict[str, str] = {}
    numbered = enumerate(pictures or (), start=len(clips))
    for index, image in _in_turn(list(pending.items()), numbered):
        if isinstance(image, Picture):
            _note_digest(image, drawn)
            survey = survey_picture(image, section)
        else:
            survey = survey_clip(pending.pop(index), names, section)
        skipped += survey.skipped
        selection.add(index, survey)
        del survey, image  # frees the pixels before the next image is read or drawn
        if selection.settled:
            break
    chosen = selection.patches()
    report = selection.report(chosen, skipped, not_opened=sum(map(len, pending.values())))
    if not chosen:
        raise InputError(_no_patch_message(len(images) + len(drawn), report))
    sources = {patch.square.source for patch in chosen}
    return Atlas(
        opaque_layers([patch.frames for patch in chosen]),
        _described(chosen, report.subjects),
        report,
        {name: digest for name, digest in drawn.items() if name in sources},
    )


def _note_digest(picture: Picture, drawn: dict[str, str]) -> None:
    """Add a picture's SHA-256 to ``drawn``, by its name; raise InputError where another picture has the name."""
    if picture.name in drawn:
        raise InputError(f"expected pictures with different names, got two with the name {picture.name!r}")
    drawn[picture.name] = hashlib.sha256(picture.pixels.tobytes()).hexdigest()


def _described(chosen: Sequence[PatchFrames], subjects: Mapping[str, str]) -> tuple[Patch, ...]:
    first_layers = accumulate((len(patch.frames) for patch in chosen), initial=0)
    return tuple(
        Patch(
            *patch.square,
            layer,
            len(patch.frames),
            patch.texture,
            subject=subjects.get(patch.square.source, ""),
        )
        for patch, layer in zip(chosen, first_layers, strict=False)
    )


class _Selection:
    """The patches chosen among the crops of all images opened so far, and what became of the other crops.

    ``subjects`` has the subject of each of the first images; each image beyond them is a subject.
    """

    def __init__(
        self, section: TexturesSection, limits: AtlasLimits, rng: np.random.Generator, subjects: Sequence[int]
    ) -> None:
        self._section, self._rng, self._subjects = section, rng, subjects
        self._quota = _Quota(min(section.max_patches, limits.layers), self._subject)
        self._duplicates = DuplicateFinder(section.min_difference)
        self._judged: dict[int, JudgedClip] = {}
        self._too_small: list[str] = []

    def _subject(self, index: int) -> int:
        return self._subjects[index] if index < len(self._subjects) else index

    @property
    def settled(self) -> bool:
        return self._quota.settled

    def add(self, index: int, survey: ClipSurvey) -> None:
        """Choose among the crops of a further clip or picture, and make room for them."""
        if not survey.crops:
            self._too_small += survey.names
            return
        good = _alternate_sides(survey.good, self._rng)
        duplicates = self._duplicates.find(
            [crop.square for crop in good], np.array([crop.fingerprint for crop in good])
        )
        offered = [crop for crop in good if crop.square not in duplicates][: self._quota.room]
        self._quota.add(index, survey.cut(offered, self._section.patch_px))
        crops = [
            *(JudgedCrop("duplicate", square, like) for square, like in duplicates.items()),
            *(JudgedCrop(crop.reason, crop.square) for crop in survey.crops if crop.square not in duplicates),
        ]
        self._judged[index] = JudgedClip(len(survey.frames), crops)

    def patches(self) -> list[PatchFrames]:
        """Return all patches by clip, side, row and column."""
        return [
            patch
            for index in sorted(self._judged)
            for patch in sorted(self._quota.patches[index], key=lambda patch: patch.square.box[::-1])
        ]

    def report(self, chosen: Sequence[PatchFrames], skipped: Sequence[Skipped], not_opened: int) -> TextureReport:
        """Return what became of all images and crops, given the chosen patches and the files that were not read."""
        judged = [clip for _, clip in sorted(self._judged.items())]
        kept = {patch.square for patch in chosen}
        sources = {square.source for square in kept}
        used = sum(clip.frame_count for clip in judged if clip.source in sources)
        return TextureReport(
            images_used=used,
            images_unused=sum(clip.frame_count for clip in judged) - used,
            too_small=tuple(sorted(self._too_small)),
            images_skipped=tuple(sorted(skipped, key=lambda skipped: skipped.path.as_posix())),
            images_not_opened=not_opened,
            counts=crop_counts(judged, kept),
            subjects=self._shared_subjects(sources),
            examples=rejected_examples(judged),
            patch_px=self._section.patch_px,
            min_texture=self._section.min_texture,
            longest_clip=max((len(patch.frames) for patch in chosen), default=0),
        )

    def _shared_subjects(self, sources: Collection[str]) -> dict[str, str]:
        """Return the name of the subject's first image for each of the images that share their subject with another."""
        by_subject: dict[int, list[str]] = defaultdict(list)
        for index, clip in sorted(self._judged.items()):
            if clip.source in sources:
                by_subject[self._subject(index)].append(clip.source)
        return {source: names[0] for names in by_subject.values() if len(names) > 1 for source in names}


class _Quota:
    """Patches by clip, never more than a limit: beyond it, the subject with most patches gives one up.

    That subject's clip with most patches gives up its last patch. Because the largest share only ever shrinks, a patch
    that is given up would never be needed again, so giving up early has the same result as collecting everything and
    giving up at the end.
    """

    def __init__(self, limit: int, subject: Callable[[int], int]) -> None:
        self._limit = limit
        self._subject = subject
        self.patches: dict[int, list[PatchFrames]] = {}
        self.total = 0

    @property
    def _clips(self) -> dict[int, list[list[PatchFrames]]]:
        """The patches of each clip, by subject."""
        clips: dict[int, list[list[PatchFrames]]] = defaultdict(list)
        for clip, patches in self.patches.items():
            clips[self._subject(clip)].append(patches)
        return clips

    @property
    def _largest(self) -> int:
        return max((sum(map(len, clips)) for clips in self._clips.values()), default=0)

    @property
    def settled(self) -> bool:
        return self.total == self._limit and self._largest <= PATCHES_PER_SUBJECT

    @property
    def room(self) -> int:
        """The largest number of patches that a further clip can end up with."""
        return self._limit if self.total < self._limit else self._largest

    def add(self, clip: int, patches: list[PatchFrames]) -> None:
        self.patches[clip] = patches
        self.total += len(patches)
        of_subjects = self._clips if self.total > self._limit else {}
        while self.total > self._limit:
            most = max(of_subjects.values(), key=lambda clips: sum(map(len, clips)))
            max(most, key=len).pop()
            self.total -= 1


def _in_turn(*sources: Iterable[_Item]) -> Iterator[_Item]:
    """Yield one item of each source in turn; a source is not asked for an item before its turn."""
    waiting = deque(map(iter, sources))
    while waiting:
        source = waiting.popleft()
        for item in source:
            yield item
            waiting.append(source)
            break


def _alternate_sides(crops: Sequence[MeasuredCrop], rng: np.random.Generator) -> list[MeasuredCrop]:
    """Return crops in random order, taking one of each side in turn, from a random side on."""
    sides = np.array([crop.square.side_px for crop in crops], dtype=np.int64)
    queues = [rng.permutation(np.flatnonzero(sides == side)) for side in rng.permutation(np.unique(sides))]
    return [crops[i] for i in chain.from_iterable(zip_longest(*queues)) if i is not None]


def _no_patch_message(images_given: int, report: TextureReport) -> str:
    if images_given == 0:
        return "no patch can be cut: no images were given"
    reasons = Counter(skipped.reason for skipped in report.images_skipped)
    small = f"smaller than a patch of {report.patch_px} pixels along a side (try a smaller patch_px)"
    flat, blurred = report.total("flat"), report.total("blurred")
    unused = (
        f"without a sharp crop: {blurred} are blurred, {flat} flat (texture below {report.min_texture:g}; try smaller "
        "min_sharpness and min_texture, or other images)"
        if blurred
        else f"without texture: none of {counted(flat, 'crop')} has a texture of {report.min_texture:g} (try a smaller "
        "min_texture, or other images)"
    )
    reasons += Counter({small: len(report.too_small), unused: report.images_unused})
    shown = [f"{count} {reason}" for reason, count in reasons.most_common(_REASONS_SHOWN)]
    more = f"; and {counted(len(reasons) - len(shown), 'more reason')}" if len(reasons) > len(shown) else ""
    unreadable = "".join(f"\n  {skipped}" for skipped in report.images_skipped[:_REASONS_SHOWN])
    return f"no patch can be cut from {counted(images_given, 'image')}: {'; '.join(shown)}{more}{unreadable}"
