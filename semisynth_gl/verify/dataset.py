"""All checks of a dataset, shard after shard and pair after pair."""

from collections.abc import Iterator

from semisynth_gl.dataset.reader import Index
from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.splits import SplitName
from semisynth_gl.verify.consistency import check_left_right, check_mask, match_views, one_surface, visible_pixels
from semisynth_gl.verify.disparity import VIEWS, check_calibration, check_depth, check_disparity, check_instances
from semisynth_gl.verify.files import check_index, check_pair, check_sizes, read_pair
from semisynth_gl.verify.finding import DATASET, Verdict
from semisynth_gl.verify.flow import OPPOSITE, check_change, check_flow, check_views
from semisynth_gl.verify.frames import check_frames
from semisynth_gl.verify.photometry import check_images
from semisynth_gl.verify.recast import Recaster
from semisynth_gl.verify.shards import StoredShard, open_shards


def verify_dataset(index: Index, oracle_pixels: int = 0) -> Iterator[Verdict]:
    """Check a dataset.

    Args:
        index: the dataset, as `read_index` opened it.
        oracle_pixels: also make each pair's scene again and cast rays at this many of its pixels.

    Yields:
        The verdict on the dataset as a whole, then one for each pair, in the order of the shards. What is wrong with a
        shard as a whole is told of its first pair.

    Raises:
        InputError: where the oracle is asked for and the scenes cannot be made again.
    """
    recasters: dict[SplitName, Recaster] = {}
    if oracle_pixels:
        recasters = {split: Recaster(index, split) for split in index.pairs}
    verdict = Verdict(DATASET)
    check_index(index, verdict)
    yield verdict
    before: StoredFrame | None = None
    for shard in open_shards(index):
        with shard:
            for number in shard.numbers:
                verdict = Verdict(_name(index, shard, number))
                if number == shard.numbers.start:
                    shard.check(verdict)
                frame = read_pair(index, shard, number, verdict)
                fits = frame is not None and _check_frame(frame, index, verdict)
                if frame is not None and oracle_pixels:
                    recasters[shard.split].check(frame, oracle_pixels, verdict)
                if before is not None and frame is not None and fits and _follows(frame, before, index):
                    check_frames(before, frame, verdict, images=_exact(frame, index))
                before = frame if fits else None
                yield verdict


def _name(index: Index, shard: StoredShard, number: int) -> str:
    name = index.key(shard.split, number).scene
    return name if len(index.pairs) == 1 else f"{shard.split} {name}"


def _follows(frame: StoredFrame, before: StoredFrame, index: Index) -> bool:
    """Whether a pair is the next frame of another one's sequence, and of the same size."""
    length = int(index.number("sequence", "length") or 1)
    return (
        frame.split == before.split
        and frame.index == before.index + 1
        and frame.index % max(length, 1) > 0
        and frame.left.shape == before.left.shape
    )


def _exact(frame: StoredFrame, index: Index) -> bool:
    """Whether a point looks alike in all frames of a sequence."""
    textures = index.config.get("textures")
    changing = isinstance(textures, dict) and bool(textures.get("sequence"))
    return not (index.imperfect or changing) and frame.exact_images


def _check_frame(frame: StoredFrame, index: Index, verdict: Verdict) -> bool:
    """Check a pair by itself; return whether all its arrays are of one size."""
    check_pair(frame, index, verdict)
    check_calibration(frame, verdict)
    if not check_sizes(frame, index, verdict):
        # The checks that follow compare pixel with pixel.
        return False
    most = index.number("disparity", "max_px")
    check_disparity(frame, most, verdict)
    check_depth(frame, verdict)
    check_instances(frame, verdict)
    for view in VIEWS:
        for kind in OPPOSITE:
            check_flow(frame, kind, view, verdict)
        check_change(frame, view, most, verdict)
    if frame.disparity_right is None:
        # What follows compares the views with each other.
        return True
    left = match_views(frame.disparity_left, frame.disparity_right, -1)
    if frame.visibility_left is not None:
        check_mask("visibility_left", frame.visibility_left, left, verdict)
    if frame.visibility_right is not None:
        right = match_views(frame.disparity_right, frame.disparity_left, +1)
        check_mask("visibility_right", frame.visibility_right, right, verdict)
    visible = visible_pixels(left, frame.visibility_left)
    check_left_right(left, visible, verdict)
    check_views(frame, left, visible, verdict)
    # Images that are not exact differ between the views as those of a real rig do.
    imperfect = index.imperfect or not frame.exact_images
    check_images(frame.left, frame.right, left, one_surface(left, visible), verdict, imperfect=imperfect)
    return True
