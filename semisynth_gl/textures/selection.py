"""From images to an atlas: the choice of the crops that become patches."""

import hashlib
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, chain, cycle, islice, zip_longest
from pathlib import Path
from typing import TypeVar

import numpy as np

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.errors import InputError, counted
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
from semisynth_gl.textures.crops import DuplicateFinder, Square
from semisynth_gl.textures.flat import flat_count, lower_contrast
from semisynth_gl.textures.image_files import relative_names
from semisynth_gl.textures.pictures import Picture

PATCHES_PER_IMAGE = 4
"""Once the atlas is full and no image holds more patches than this, no further image is opened. Fewer would make an
atlas of more different photographs, but decoding is what takes the time: 512 patches from 512 photographs take four
times as long as from 128."""

_REASONS_SHOWN = 5

_Item = TypeVar("_Item")


def build_atlas(
    images: Sequence[Path],
    section: TexturesSection,
    limits: AtlasLimits,
    rng: np.random.Generator,
    pictures: Iterable[Picture] | None = None,
) -> tuple[Atlas, list[Path]]:
    """Crop squares out of images and keep those with texture that are sharp and unlike each other.

    Images are opened one at a time in random order. Each offers its good crops in random order, scales taking turns; a
    crop that hardly differs from a good one before it, of any image, is rejected as a duplicate. Whenever there are
    more than wanted, the image with most gives one up; so no image and no scale crowds out the others, and the rest
    makes up for an image with few crops. Once the atlas is full and no image has more than `PATCHES_PER_IMAGE`, the
    remaining images are not opened. In memory are one decoded image, those of its crops that may be kept, and the
    patches of the atlas.

    Pictures are judged by the same measures. Files and pictures take turns, as long as there are both; pictures come in
    their own order, and are asked for one at a time.

    With ``section.sequence``, clips of successive frames (see `cut_clips`) take the place of images: a patch has the
    same square from each frame of its clip, and a crop counts as flat or blurred if it is so in any frame. No crops are
    duplicates then: successive clips of one video show much the same. Ask for fewer patches to get longer clips. A
    frame that cannot be read is left out of its clip. Frames are read twice, to measure and to cut, so that one is in
    memory at a time.

    With ``section.flat_share``, that share of the patches is set aside for flat ones, at least one. They are crops
    without texture, chosen in the same way; images that have too few of them for their part give patches once more with
    their contrast lowered. Where there are too few others, flat ones are given up until the share is right. All images
    are opened as long as flat crops are missing.

    Args:
        images: files, as from `find_images`; their order does not matter.
        section: the config's section.
        limits: the most layers and frames.
        rng: source of every random choice.
        pictures: pictures beside the files, or instead of them.

    Returns:
        The atlas, its patches ordered by image, side, row and column, files before pictures; and the files that were
        opened: no other one has a part in the atlas.

    Raises:
        InputError: where there is no patch, or two pictures have one name.
    """
    images = sorted(images, key=Path.as_posix)
    names = relative_names(images)
    clips: list[Clip]
    clips, skipped = (
        cut_clips(images, section, limits, alone=pictures is None)
        if section.sequence
        else ([(path,) for path in images], [])
    )
    patch_limit = min(section.max_patches, limits.layers)
    flat_limit = flat_count(section.flat_share, patch_limit)
    textured, flat = _Quota(patch_limit - flat_limit), _Quota(flat_limit)
    duplicate_finder = DuplicateFinder(section.min_difference)
    judged: dict[int, JudgedClip] = {}
    too_small: list[str] = []
    pending = {int(i): clips[i] for i in rng.permutation(len(clips))}
    drawn: dict[str, str] = {}
    numbered = enumerate(pictures or (), start=len(clips))
    for index, image in _in_turn(list(pending.items()), numbered):
        if isinstance(image, Picture):
            if image.name in drawn:
                raise InputError(f"expected pictures with a name each, got two with the name {image.name!r}")
            drawn[image.name] = hashlib.sha256(image.pixels.tobytes()).hexdigest()
            survey = survey_picture(image, section)
        else:
            survey = survey_clip(pending.pop(index), names, section)
        skipped += survey.skipped
        if survey.too_small:
            too_small += [frame.name if isinstance(frame, Picture) else names[frame] for frame in survey.frames]
            continue
        good = _alternate_sides(survey.good, rng)
        duplicates = duplicate_finder.find(
            [crop.square for crop in good], np.array([crop.fingerprint for crop in good])
        )
        offered = [crop for crop in good if crop.square not in duplicates][: textured.room]
        offered_flat = _alternate_sides(survey.flat, rng)[: flat.room] if flat_limit else []
        patches = survey.cut(offered + offered_flat, section.patch_px)
        textured.add(index, patches[: len(offered)])
        flat.add(index, patches[len(offered) :])
        judged[index] = _judged(survey, duplicates)
        del survey, image  # and the pixels with them, before the next one is read or drawn
        if textured.settled and flat.settled:
            break
    # The number that makes the share of all patches what it is to be.
    wanted = min(flat_limit, max(1, round(textured.total * section.flat_share / (1 - section.flat_share))))
    without = _flat_patches(textured, flat, section.min_texture, rng, wanted) if textured.total and wanted else {}

    chosen = [
        patch
        for index in sorted(judged)
        # By side, row and column; what was made of a patch stands behind it.
        for patch in sorted(
            [*textured.patches[index], *without.get(index, [])],
            key=lambda patch: (patch.square.box[::-1], -patch.contrast),
        )
    ]
    kept = {patch.square for patch in chosen}
    sources = {square.source for square in kept}
    all_judged = [judged[index] for index in sorted(judged)]
    used = sum(clip.frame_count for clip in all_judged if clip.source in sources)
    report = TextureReport(
        images_used=used,
        images_unused=sum(clip.frame_count for clip in all_judged) - used,
        too_small=tuple(sorted(too_small)),
        images_skipped=tuple(sorted(skipped, key=lambda skipped: skipped.path.as_posix())),
        images_not_opened=sum(map(len, pending.values())),
        counts=crop_counts(all_judged, kept, [patch.square for patch in chosen if patch.contrast < 1]),
        examples=rejected_examples(all_judged, kept),
        patch_px=section.patch_px,
        min_texture=section.min_texture,
        flat_share=section.flat_share,
        longest_clip=max((len(patch.frames) for patch in chosen), default=0),
    )
    if not chosen:
        raise InputError(_no_patch_message(len(images) + len(drawn), report))
    # The headers of all successive frames are read.
    unopened = set() if section.sequence else set(chain.from_iterable(pending.values()))
    shown = {name: digest for name, digest in drawn.items() if name in sources}
    atlas = Atlas(opaque_layers([patch.frames for patch in chosen]), _described(chosen), report, shown)
    return atlas, [path for path in images if path not in unopened]


def _described(chosen: Sequence[PatchFrames]) -> tuple[Patch, ...]:
    first_layers = accumulate((len(patch.frames) for patch in chosen), initial=0)
    return tuple(
        Patch(*patch.square, layer, len(patch.frames), patch.texture, contrast=patch.contrast)
        for patch, layer in zip(chosen, first_layers, strict=False)
    )


def _flat_patches(
    textured: "_Quota", flat: "_Quota", min_texture: float, rng: np.random.Generator, wanted: int
) -> dict[int, list[PatchFrames]]:
    """Choose flat patches by clip: flat crops, evenly over the clips, and patches made flat for clips with too few."""

    def made(patches: Sequence[PatchFrames]) -> Iterator[PatchFrames]:
        for patch in cycle(patches):
            frames, contrast, texture = lower_contrast(patch.frames, min_texture, rng)
            yield PatchFrames(patch.square, texture, frames, contrast)

    order = [sorted(textured.patches)[place] for place in rng.permutation(len(textured.patches))]
    most = -(-wanted // len(order))
    own = ([(index, patch) for patch in flat.patches[index][:most]] for index in order)
    chosen = {index: list[PatchFrames]() for index in order}
    for index, patch in islice(_in_turn(*own), wanted):
        chosen[index].append(patch)
    rest = {index: chain(flat.patches[index][most:], made(textured.patches[index])) for index in order}
    while sum(map(len, chosen.values())) < wanted:
        index = min(rest, key=lambda index: len(chosen[index]))
        following = next(rest[index], None)
        if following is None:
            del rest[index]
        else:
            chosen[index].append(following)
    return chosen


class _Quota:
    """Patches by clip, never more than a limit; the clip with most patches gives up its last one first.

    A patch that is given up would not come back whatever followed, because the largest share only ever shrinks: so
    giving up early has the same result as collecting everything and giving up at the end.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self.patches: dict[int, list[PatchFrames]] = {}
        self.total = 0

    @property
    def _largest(self) -> int:
        return max(map(len, self.patches.values()), default=0)

    @property
    def settled(self) -> bool:
        return self.total == self._limit and self._largest <= PATCHES_PER_IMAGE

    @property
    def room(self) -> int:
        """The most patches that a further clip can end up with."""
        return self._limit if self.total < self._limit else self._largest

    def add(self, clip: int, patches: list[PatchFrames]) -> None:
        self.patches[clip] = patches
        self.total += len(patches)
        while self.total > self._limit:
            max(self.patches.values(), key=len).pop()
            self.total -= 1


def _in_turn(*sources: Iterable[_Item]) -> Iterator[_Item]:
    """Yield one item of each source in turn; a source is asked for no item before its turn."""
    waiting = deque(map(iter, sources))
    while waiting:
        source = waiting.popleft()
        for item in source:
            yield item
            waiting.append(source)
            break


def _alternate_sides(crops: Sequence[MeasuredCrop], rng: np.random.Generator) -> list[MeasuredCrop]:
    """Return crops in random order, one of each side in turn, beginning with a random side."""
    sides = np.array([crop.square.side_px for crop in crops], dtype=np.int64)
    queues = [rng.permutation(np.flatnonzero(sides == side)) for side in rng.permutation(np.unique(sides))]
    return [crops[i] for i in chain.from_iterable(zip_longest(*queues)) if i is not None]


def _judged(survey: ClipSurvey, duplicates: Mapping[Square, Square]) -> JudgedClip:
    crops = [
        *(JudgedCrop("flat", crop.square) for crop in survey.flat),
        *(JudgedCrop("blurred", crop.square) for crop in survey.blurred),
        *(JudgedCrop("duplicate", square, like) for square, like in duplicates.items()),
        *(JudgedCrop(None, crop.square) for crop in survey.good if crop.square not in duplicates),
    ]
    return JudgedClip(len(survey.frames), crops)


def _no_patch_message(images_given: int, report: TextureReport) -> str:
    if images_given == 0:
        return "no patch can be cut: no images were given"
    reasons = Counter(skipped.reason for skipped in report.images_skipped)
    small = f"smaller than a patch of {report.patch_px} pixels along a side (try a smaller patch_px)"
    flat, blurred = report.total("flat"), report.total("blurred")
    unused = (
        f"without a sharp crop: {blurred} are blurred, {flat} flat (below {report.min_texture:g} levels; try smaller "
        "min_sharpness and min_texture, or other images)"
        if blurred
        else f"without texture: none of {counted(flat, 'crop')} reaches {report.min_texture:g} levels (try a smaller "
        "min_texture, or other images)"
    )
    reasons += Counter({small: len(report.too_small), unused: report.images_unused})
    shown = [f"{count} {reason}" for reason, count in reasons.most_common(_REASONS_SHOWN)]
    more = f"; and {counted(len(reasons) - len(shown), 'more reason')}" if len(reasons) > len(shown) else ""
    unreadable = "".join(f"\n  {skipped}" for skipped in report.images_skipped[:_REASONS_SHOWN])
    return f"no patch can be cut from {counted(images_given, 'image')}: {'; '.join(shown)}{more}{unreadable}"
