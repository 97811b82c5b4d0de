"""All checks of a dataset, shard by shard and pair by pair."""

from collections.abc import Iterator, Mapping

import numpy as np

from semisynth_gl.dataset.reader import StoredIndex
from semisynth_gl.dataset.root import names_below
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES
from semisynth_gl.verification.correspondence import check_correspondence, check_deviating_views
from semisynth_gl.verification.files import (
    StoredShard,
    check_index,
    check_origin,
    is_of_one_size,
    read_pair,
    unmade_pairs,
)
from semisynth_gl.verification.flow_consistency import check_flow_views, check_frames
from semisynth_gl.verification.lens import check_lens, find_borders
from semisynth_gl.verification.oracle_check import OracleCheck
from semisynth_gl.verification.photometry import check_images
from semisynth_gl.verification.shared_left import check_lefts
from semisynth_gl.verification.single_view import check_calibration, check_single_views
from semisynth_gl.verification.verdict import DATASET, Verdict
from semisynth_gl.verification.view_consistency import (
    check_left_right,
    check_matched_mask,
    match_views,
    one_surface,
    visible_pixels,
)

# Arrays hold inf or NaN where nothing is known, and no check judges values that are computed from these.
_UNKNOWN_VALUES = np.errstate(invalid="ignore", divide="ignore")


def verify_dataset(index: StoredIndex, oracle_pixels: int = 0) -> Iterator[Verdict]:
    """Check a dataset: yield a verdict on the dataset itself, and then one on each pair, in the order of the shards.

    The verdict on a shard's first pair also has the findings about the shard.

    Args:
        index: the dataset's index.
        oracle_pixels: number of pixels of each pair to check with rays; with 0, no scene is sampled again.

    Raises:
        InputError: where rays are asked for, and the scenes cannot be sampled again.
    """
    oracles = {split: OracleCheck(index, split) for split in index.plan.pairs} if oracle_pixels else {}
    verdict = Verdict(DATASET)
    present = frozenset(names_below(index.root))
    unmade = [unmade_pairs(index, shard, present) for shard in index.plan.shards]
    check_index(index, present, sum(map(len, unmade)), verdict)
    yield verdict
    recent: dict[int, StoredFrame] = {}
    for planned, still_unmade in zip(index.plan.shards, unmade, strict=True):
        shard = StoredShard(index, planned)
        for number in shard.numbers:
            scene = index.plan.key(shard.split, number).name
            verdict = Verdict(scene if len(index.plan.pairs) == 1 else f"{shard.split} {scene}")
            if number in still_unmade:
                yield verdict
                continue
            if number == shard.numbers.start:
                shard.check(verdict)
            frame = read_pair(index, shard, number, verdict)
            if frame is not None:
                fits = _check_frame(frame, index, verdict)
                if oracle_pixels:
                    oracles[shard.split].check(frame, oracle_pixels, verdict)
                if fits:
                    _check_against(frame, recent, index, verdict)
                    recent[number] = frame
            recent = {at: pair for at, pair in recent.items() if at in _still_needed(number, index)}
            yield verdict


def _looked_back_at(number: int, index: StoredIndex) -> set[int]:
    """Return the numbers of the earlier pairs that a pair is compared with.

    These are the same view's pair one frame earlier, and the first pair of the same scene.
    """
    scene, view = divmod(number, index.plan.views)
    before = {number - index.plan.views} if scene % index.plan.config.sequence.length else set()
    return before | ({number - view} if view else set())


def _still_needed(number: int, index: StoredIndex) -> set[int]:
    """Return the numbers of the pairs with which pairs after ``number`` are yet to be compared."""
    return {at for later in range(number + 1, number + 1 + index.plan.views) for at in _looked_back_at(later, index)}


@_UNKNOWN_VALUES
def _check_against(frame: StoredFrame, recent: Mapping[int, StoredFrame], index: StoredIndex, verdict: Verdict) -> None:
    """Compare a pair with earlier pairs of its sequence or scene; pairs of another size are passed over."""
    sizes = frame.left.image.shape
    for number in _looked_back_at(frame.index, index):
        other = recent.get(number)
        if other is None or other.split != frame.split or other.left.image.shape != sizes:
            continue
        if number // index.plan.views == frame.index // index.plan.views:
            check_lefts(frame, other, verdict)
        else:
            check_frames(other, frame, verdict, images=_same_textures(frame, index))


def _same_textures(frame: StoredFrame, index: StoredIndex) -> bool:
    """Return whether a surface point has the same colour in all frames of a sequence."""
    changing = bool(index.plan.config.textures.sequence)
    return not (index.imperfect or changing) and frame.encodings.image.lossless


@_UNKNOWN_VALUES
def _check_frame(frame: StoredFrame, index: StoredIndex, verdict: Verdict) -> bool:
    """Check a pair by itself; return whether all its arrays have the size of its camera."""
    check_origin(frame, index, verdict)
    check_calibration(frame, verdict)
    if not is_of_one_size(frame):
        # The checks that follow compare pixel with pixel.
        return False
    check_single_views(frame, index.plan.config.disparity.max_px, verdict)
    # Imperfections make the images of both views differ, as a real rig does.
    imperfect = index.imperfect or not frame.encodings.image.lossless
    for eye in EYES:
        check_lens(frame, eye, verdict)
        check_correspondence(frame, eye, verdict)
    left, right = frame.view("left"), frame.view("right")
    if "disparity" not in right:
        # The checks that follow compare the views with each other.
        return True
    if not frame.camera.rectified:
        check_deviating_views(frame, verdict, imperfect=imperfect)
        return True
    disparity, right_disparity = left["disparity"], right["disparity"]
    signed = frame.encodings.signed
    match = match_views(disparity, right_disparity, -1, signed=signed)
    if "visibility" in left:
        check_matched_mask("visibility_left", left["visibility"], match, find_borders(frame, "left"), verdict)
    if "visibility" in right:
        match_right = match_views(right_disparity, disparity, +1, signed=signed)
        borders = find_borders(frame, "right")
        check_matched_mask("visibility_right", right["visibility"], match_right, borders, verdict)
    visible = visible_pixels(match, left.get("visibility"))
    check_left_right(disparity, right_disparity, match, visible, verdict, signed=signed)
    surface = one_surface(match, visible)
    check_flow_views(frame, match, visible, surface, verdict)
    check_images(left["image"], right["image"], match, surface, verdict, imperfect=imperfect)
    return True
