"""From image files to an atlas: which crops become patches."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.errors import InputError, Skipped
from semisynth_gl.textures.atlas import Atlas, Patch, TextureReport, opaque_layers
from semisynth_gl.textures.crops import (
    CropBox,
    crop_boxes,
    cut_crop,
    fingerprint,
    sharpness_measure,
    texture_measure,
)
from semisynth_gl.textures.duplicates import Seen
from semisynth_gl.textures.images import ImageError, read_image
from semisynth_gl.textures.outcome import Outcome, crop_counts, left_out_examples
from semisynth_gl.textures.sequences import find_runs

PATCHES_PER_IMAGE = 4
"""Once the atlas is full and no image holds more patches than this, no further image is opened. Fewer would make an
atlas of more different photographs, but decoding is what takes the time: 512 patches from 512 photographs take four
times as long as from 128."""

_MIN_PATCH_PX = 16
_REASONS_SHOWN = 5


def build_atlas(
    images: Sequence[Path],
    *,
    patch_px: int,
    scales: Sequence[float],
    min_texture: float,
    min_sharpness: float,
    min_difference: float,
    flat_share: float,
    max_patches: int,
    sequence: bool,
    rng: np.random.Generator,
    max_layers: int = 2048,
    max_frames: int = 16,
    opened: list[Path] | None = None,
) -> Atlas:
    """Crop squares out of images and keep those with texture that are sharp and unlike each other.

    Images are opened one at a time in random order. Each offers its crops that are good enough in random order, scales
    taking turns; one that hardly differs from a good one before it, of any image, is left out as a duplicate. Whenever
    there are more than wanted, the image that holds most gives one up; so no image and no scale crowds out the others,
    and an image that has few is made up for by the rest. Once the atlas is full and no image holds more than
    `PATCHES_PER_IMAGE`, the remaining images are not opened. In memory are one decoded image, those of its crops that
    may be kept, and the patches of the atlas.

    With ``sequence``, runs of successive frames (see `find_runs`) take the place of images: a patch holds the same
    square from each frame of its run, and a crop counts as flat or blurred if it is so in any frame. There are no
    duplicates then: successive runs of one video show much the same. A run has at most
    ``max_frames`` frames, and fewer where the patches would not fit into ``max_layers``: ask for fewer patches to get
    longer runs. A frame that cannot be read is left out of its run. Frames are read twice, to measure and to
    cut, so that one is in memory at a time.

    With ``flat_share``, that share of the patches is set aside for crops without texture, which are chosen in the same
    way. Where photographs have too few of them, there are fewer patches; where they have too few others, flat ones are
    given up until the share is right. All images are opened as long as some are missing.

    Args:
        images: files, as from `find_images`; their order does not matter.
        patch_px: side of a patch, pixels; at least 16.
        scales: image pixels per patch pixel, each at least 1.
        min_texture: least `texture_measure` of a patch, 8-bit levels; below it a crop is flat.
        min_sharpness: least `sharpness_measure` of a patch that is not flat.
        min_difference: least difference of two such patches, see `fingerprint`; 0 keeps duplicates.
        flat_share: share of flat patches among all, below 1.
        max_patches: patches at most.
        sequence: whether images of one folder are successive frames.
        rng: source of every random choice.
        max_layers: layers at most; 2048 is what every OpenGL 4 driver has.
        max_frames: frames of one patch at most.
        opened: filled with the images that were opened: no other one has a part in the result.

    Returns:
        The atlas, its patches ordered by image, side, row and column.

    Raises:
        InputError: where a number is out of range, or no patch is left.
    """
    if patch_px < _MIN_PATCH_PX or max_patches < 1 or max_layers < 1 or max_frames < 1:
        raise InputError(
            f"expected patch_px >= {_MIN_PATCH_PX} and max_patches, max_layers, max_frames >= 1, got "
            f"patch_px={patch_px}, max_patches={max_patches}, max_layers={max_layers}, max_frames={max_frames}"
        )
    wanted = _Wanted(min_texture, min_sharpness, 0.0 if sequence else min_difference)
    if not (min_texture >= 0 and min_sharpness >= 0 and 0 <= min_difference <= 1 and 0 <= flat_share < 1):
        raise InputError(
            f"expected min_texture, min_sharpness >= 0, min_difference from 0 to 1 and flat_share below 1, got "
            f"min_texture={min_texture}, min_sharpness={min_sharpness}, min_difference={min_difference}, "
            f"flat_share={flat_share}"
        )
    crop_boxes(1, 1, patch_px, scales)  # refuses bad scales before any image is opened
    images = sorted(images, key=Path.as_posix)
    limit = min(max_patches, max_layers)
    runs: Sequence[tuple[Path, ...]] = [(path,) for path in images]
    tally = _Tally()
    if sequence:
        found = find_runs(
            images,
            patch_px=patch_px,
            scales=scales,
            max_patches=limit,
            max_layers=max_layers,
            max_frames=max_frames,
        )
        runs = found.runs
        tally.skipped.extend(found.skipped)

    flat_limit = min(round(flat_share * limit), limit - 1)
    shares, flat_shares = _Shares(limit - flat_limit), _Shares(flat_limit)
    seen = Seen(wanted.min_difference)
    names = names_of(images) if images else {}
    order = [int(i) for i in rng.permutation(len(runs))]
    outcomes: dict[int, Outcome] = {}
    while order and not (shares.settled and flat_shares.settled):
        index = order.pop(0)
        survey = _survey(runs[index], patch_px, scales, wanted, tally)
        if survey is None:
            continue
        good = [survey.good[i] for i in _taking_turns([survey.boxes[i].side_px for i in survey.good], rng)]
        duplicates = seen.sort_out(index, survey.boxes, survey.fingerprints, good)
        offered = [i for i in good if i not in duplicates][: shares.room]
        flat: list[int] = []
        if flat_limit:
            taking_turns = _taking_turns([survey.boxes[i].side_px for i in survey.flat], rng)
            flat = [survey.flat[i] for i in taking_turns][: flat_shares.room]
        crops = _cut(survey, offered + flat, patch_px)
        shares.add(index, crops[: len(offered)])
        flat_shares.add(index, crops[len(offered) :])
        outcomes[index] = Outcome(
            names[survey.frames[0]], len(survey.frames), survey.boxes, survey.flat, survey.blurred, duplicates
        )
        del survey  # and the decoded image with it, before the next one is read
    if flat_limit:
        flat_shares.shrink(round(shares.total * flat_share / (1 - flat_share)))

    if opened is not None:
        # Of successive frames all headers are read.
        unopened = frozenset() if sequence else frozenset(path for index in order for path in runs[index])
        opened.extend(path for path in images if path not in unopened)
    kept_flat = flat_shares.kept()
    kept = _both(shares.kept(), kept_flat)
    used = sum(outcomes[index].frames for index in kept)
    flat_squares = _squares(kept_flat)
    report = TextureReport(
        images_used=used,
        images_unused=sum(outcome.frames for outcome in outcomes.values()) - used,
        too_small=tuple(sorted(names[path] for path in tally.too_small)),
        images_skipped=tuple(sorted(tally.skipped, key=lambda skipped: skipped.path.as_posix())),
        images_not_opened=sum(len(runs[index]) for index in order),
        counts=crop_counts(outcomes, _squares(kept), flat_squares),
        examples=left_out_examples(outcomes, flat_squares),
        patch_px=patch_px,
        min_texture=min_texture,
        flat_share=flat_share,
        longest_run=max((len(crop.frames) for crops in kept.values() for crop in crops), default=0),
    )
    if not shares.total:
        raise InputError(_nothing_left(len(images), report))
    return _assemble(kept, outcomes, report)


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What a crop has to reach."""

    min_texture: float
    min_sharpness: float
    min_difference: float  # 0 where duplicates are not looked for


@dataclass(slots=True)
class _Tally:
    """Counts that grow while images are opened."""

    skipped: list[Skipped] = field(default_factory=list)
    too_small: list[Path] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class _Survey:
    """What was found in one run: its readable frames, its squares, and which of them, by index, are how."""

    frames: tuple[Path, ...]
    boxes: list[CropBox]
    textures: list[float]  # the least over the frames
    good: list[int]
    flat: list[int]
    blurred: list[int]
    fingerprints: dict[int, NDArray[np.float32]]  # of those that are good, where duplicates are looked for
    only_image: NDArray[np.uint8] | None  # the decoded frame where there is just one: no need to read it again


@dataclass(frozen=True, slots=True, eq=False)
class _Crop:
    """A crop that may become a patch; ``frames`` is (F, P, P, 3) uint8 RGB."""

    box: CropBox
    texture: float
    frames: NDArray[np.uint8]


class _Shares:
    """Crops by run, never more than a limit; the run with most gives up its last one first.

    What is given up would not come back whatever followed, because the largest share only ever shrinks: so dropping
    early gives the same as holding everything and dropping at the end.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._crops: dict[int, list[_Crop]] = {}
        self.total = 0

    @property
    def _largest(self) -> int:
        return max(map(len, self._crops.values()), default=0)

    @property
    def settled(self) -> bool:
        return self.total == self._limit and self._largest <= PATCHES_PER_IMAGE

    def shrink(self, limit: int) -> None:
        """Lower the limit, and give up what is beyond it."""
        self._limit = limit
        self._give_up()

    @property
    def room(self) -> int:
        """How many crops a further run can end up with at most."""
        return self._limit if self.total < self._limit else self._largest

    def add(self, run: int, crops: list[_Crop]) -> None:
        self._crops[run] = crops
        self.total += len(crops)
        self._give_up()

    def _give_up(self) -> None:
        while self.total > self._limit:
            max(self._crops.values(), key=len).pop()
            self.total -= 1

    def kept(self) -> dict[int, list[_Crop]]:
        """Return the runs that hold crops, in their own order, and the crops by side, row and column."""
        return {run: sorted(crops, key=_place_of) for run, crops in sorted(self._crops.items()) if crops}


def _survey(
    run: Sequence[Path], patch_px: int, scales: Sequence[float], wanted: _Wanted, tally: _Tally
) -> _Survey | None:
    frames: list[Path] = []
    boxes: list[CropBox] = []
    textures: list[float] = []
    sharpness: list[float] = []
    prints: dict[int, NDArray[np.float32]] = {}
    shape: tuple[int, ...] | None = None
    for path in run:
        try:
            image = read_image(path)
        except ImageError as error:
            tally.skipped.append(Skipped(path, error.reason))
            continue
        if shape is None:
            shape = image.shape
            boxes = crop_boxes(image.shape[0], image.shape[1], patch_px, scales)
            textures = [np.inf] * len(boxes)
            sharpness = [np.inf] * len(boxes)
        elif image.shape != shape:  # equal as stored, but turned by EXIF
            reason = f"is {image.shape[1]} x {image.shape[0]} upright, frames before it {shape[1]} x {shape[0]}"
            tally.skipped.append(Skipped(path, reason))
            continue
        frames.append(path)
        for i, box in enumerate(boxes):
            crop = cut_crop(image, box, patch_px)
            textures[i] = min(textures[i], texture_measure(crop))
            # What is left out already needs no further measure.
            if textures[i] >= wanted.min_texture and sharpness[i] >= wanted.min_sharpness:
                sharpness[i] = min(sharpness[i], sharpness_measure(crop))
                if wanted.min_difference and sharpness[i] >= wanted.min_sharpness:
                    prints[i] = fingerprint(crop)
    if frames and not boxes:
        tally.too_small += frames
    if not boxes:
        return None
    flat = [i for i, texture in enumerate(textures) if texture < wanted.min_texture]
    textured = [i for i, texture in enumerate(textures) if texture >= wanted.min_texture]
    return _Survey(
        frames=tuple(frames),
        boxes=boxes,
        textures=textures,
        good=[i for i in textured if sharpness[i] >= wanted.min_sharpness],
        flat=flat,
        blurred=[i for i in textured if sharpness[i] < wanted.min_sharpness],
        fingerprints=prints,
        only_image=image if len(run) == 1 else None,
    )


def _cut(survey: _Survey, chosen: Sequence[int], patch_px: int) -> list[_Crop]:
    if not chosen:
        return []
    stacks = np.empty((len(chosen), len(survey.frames), patch_px, patch_px, 3), dtype=np.uint8)
    for frame, path in enumerate(survey.frames):
        image = read_image(path) if survey.only_image is None else survey.only_image
        for stack, i in zip(stacks, chosen, strict=True):
            stack[frame] = cut_crop(image, survey.boxes[i], patch_px)
    # Copies, so that a crop that is given up gives up its memory.
    return [_Crop(survey.boxes[i], survey.textures[i], stack.copy()) for stack, i in zip(stacks, chosen, strict=True)]


def _taking_turns(sides: Sequence[int], rng: np.random.Generator) -> list[int]:
    """Return indexes into ``sides`` in random order, one of each side in turn, beginning with a random side."""
    array = np.asarray(sides, dtype=np.int64)
    queues = [rng.permutation(np.flatnonzero(array == side)) for side in rng.permutation(np.unique(array))]
    return [int(i) for i in chain.from_iterable(zip_longest(*queues)) if i is not None]


def names_of(images: Sequence[Path]) -> dict[Path, str]:
    """Return names relative to the folder that all share: the same wherever that folder lies."""
    absolute = [os.path.abspath(path) for path in images]  # noqa: PTH100  # links keep the user's names
    folders = {os.path.dirname(path) for path in absolute}  # noqa: PTH120  # of strings: there may be thousands
    start = len(os.path.join(os.path.commonpath(folders), ""))  # noqa: PTH118
    return {path: full[start:] for path, full in zip(images, absolute, strict=True)}


def _both(one: dict[int, list[_Crop]], other: dict[int, list[_Crop]]) -> dict[int, list[_Crop]]:
    """Join crops by run, in the order of `_Shares.kept`."""
    return {
        run: sorted(one.get(run, []) + other.get(run, []), key=_place_of) for run in sorted(one.keys() | other.keys())
    }


def _place_of(crop: _Crop) -> tuple[int, int, int]:
    return crop.box.side_px, crop.box.top_px, crop.box.left_px


def _squares(kept: Mapping[int, Sequence[_Crop]]) -> dict[int, list[CropBox]]:
    return {run: [crop.box for crop in crops] for run, crops in kept.items()}


def _assemble(kept: Mapping[int, list[_Crop]], outcomes: Mapping[int, Outcome], report: TextureReport) -> Atlas:
    patches: list[Patch] = []
    layer = 0
    for run, crops in kept.items():
        for crop in crops:
            patches.append(Patch(outcomes[run].source, *crop.box, layer, len(crop.frames), crop.texture))
            layer += len(crop.frames)
    layers = opaque_layers([crop.frames for crops in kept.values() for crop in crops])
    return Atlas(layers, tuple(patches), report)


def _nothing_left(given: int, report: TextureReport) -> str:
    if given == 0:
        return "no patch can be cut: no images were given"
    reasons = Counter(skipped.reason for skipped in report.images_skipped)
    if report.images_too_small:
        reasons[f"smaller than a patch of {report.patch_px} pixels along a side (try a smaller patch_px)"] = (
            report.images_too_small
        )
    if report.images_unused:
        reasons[
            f"without texture: none of {report.crops_flat} crops reaches {report.min_texture:g} levels "
            f"(try a smaller min_texture, or other images)"
            if not report.crops_blurred
            else f"without a sharp crop: {report.crops_blurred} are blurred, {report.crops_flat} flat (below "
            f"{report.min_texture:g} levels; try smaller min_sharpness and min_texture, or other images)"
        ] = report.images_unused
    shown = [f"{count} {reason}" for reason, count in reasons.most_common(_REASONS_SHOWN)]
    rest = len(reasons) - len(shown)
    more = f"; and {rest} more reasons" if rest else ""
    named = "".join(f"\n  {skipped}" for skipped in report.images_skipped[:_REASONS_SHOWN])
    return f"no patch can be cut from {given} images: {'; '.join(shown)}{more}{named}"
