"""Read a dataset back, with nothing but its files, and report its faults."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import metadata
from os import PathLike
from typing import Any

import numpy as np

from semisynth_gl.dataset.reader import DamagedIndexError, StoredIndex, read_index
from semisynth_gl.dataset.root import names_below
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.files import StoredShard, check_index, check_origin, is_of_one_size, read_pair, unmade_pairs
from semisynth_gl.judge.findings import DATASET, Finding, Verdict
from semisynth_gl.judge.flow import check_change, check_flow, check_frames
from semisynth_gl.judge.lens import check_lens
from semisynth_gl.judge.rays import RayJudge
from semisynth_gl.judge.single_view import (
    check_calibration,
    check_depth,
    check_disparity,
    check_instances,
    check_normals,
    check_sky,
)
from semisynth_gl.judge.views import check_correspondence, check_lefts, check_views
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.seeds.spread import spread

RAYED_PAIRS = 4
"""Default number of pairs with rays."""

# Arrays hold inf or NaN where nothing is known, and no check judges values that are computed from these.
_UNKNOWN_VALUES = np.errstate(invalid="ignore", divide="ignore")


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of all checks of a dataset.

    Attributes:
        pairs: number of pairs of the dataset; 0 where neither index nor plan can be read.
        verdicts: the verdict on the dataset as a whole, and then one for each pair.
        no_rays: why no rays were cast, though nobody forbade it; None where there is no such reason.
    """

    pairs: int
    verdicts: Sequence[Verdict]
    no_rays: str | None = None

    @property
    def findings(self) -> list[Finding]:
        """All faults, in the order in which they were found."""
        return [finding for verdict in self.verdicts for finding in verdict.findings]

    @property
    def faulty_pairs(self) -> int:
        """Number of pairs with a fault; a shard's faults count as its first pair's."""
        return sum(1 for verdict in self.verdicts[1:] if verdict.findings)

    def values(self) -> dict[str, Any]:
        """Return the content of ``semisynth-gl verify --json``, in JSON's types.

        The keys are the number of ``pairs``; ``findings``, each with ``scene``, ``check`` and ``message``; and
        ``measures`` by scene and name.
        """
        return {
            "pairs": self.pairs,
            "findings": [asdict(finding) for finding in self.findings],
            "measures": {verdict.scene: verdict.measures for verdict in self.verdicts if verdict.measures},
        }


def verify(
    dataset: str | PathLike[str],
    *,
    rays: int | None = None,
    oracle: bool = False,
    pixels: int = 500,
    listener: Listener | None = None,
    on_finding: Callable[[Finding], None] | None = None,
) -> Verification:
    """Read a dataset back, and compare its files with each other, with the index and with the shards' records.

    Args:
        dataset: a folder, or an address that fsspec knows.
        rays: number of pairs, evenly spread, whose scenes are sampled again and compared with float64 rays; by default
            4, or none where the scenes cannot be sampled again.
        oracle: whether to compare all pairs with rays.
        pixels: number of rays for each of these pairs.
        listener: is told the number of pairs, and each checked pair.
        on_finding: is called with each fault as soon as it is found.

    Raises:
        InputError: where there is no dataset, or rays are asked for and its scenes cannot be sampled again.
    """
    pixels, listener = to_whole("pixels", pixels, least=1), listener or Listener()
    if rays is not None:
        rays = to_whole("rays", rays, least=0)
    keys: list[FinishedPair] = []
    no_rays = None
    found: Iterator[Verdict]
    try:
        index = read_index(dataset)
    except DamagedIndexError as error:
        damaged = Verdict(DATASET)
        for fault in error.faults:
            damaged.add("index", fault)
        found = iter([damaged])
    else:
        keys = [FinishedPair(each.split, n) for each in index.plan.shards for n in range(each.first, each.end)]
        if oracle or rays is not None:
            found = verify_dataset(index, pixels, None if oracle else rays)
        else:
            found, no_rays = _with_rays_if_possible(index, pixels)
    listener.on_total(len(keys))
    verdicts: list[Verdict] = []
    for verdict in found:
        if on_finding is not None:
            for finding in verdict.findings:
                on_finding(finding)
        if verdicts:  # the first verdict is about the dataset, not about a pair
            listener.on_pair(keys[len(verdicts) - 1])
        verdicts.append(verdict)
    return Verification(len(keys), verdicts, no_rays)


def _with_rays_if_possible(index: StoredIndex, pixels: int) -> tuple[Iterator[Verdict], str | None]:
    """Return the verdicts on a dataset, and the reason if no rays are cast, else None."""
    if index.plan.version != metadata.version("semisynth-gl"):
        # Another version may sample other scenes.
        return verify_dataset(index), f"version {index.plan.version} made the dataset"
    try:
        return verify_dataset(index, pixels, RAYED_PAIRS), None
    except InputError as error:
        return verify_dataset(index), str(error)


def verify_dataset(index: StoredIndex, pixels: int = 0, pairs: int | None = None) -> Iterator[Verdict]:
    """Check a dataset: yield a verdict on the dataset itself, and then one on each pair, in the order of the shards.

    The verdict on a shard's first pair also has the findings about the shard.

    Args:
        index: the dataset's index.
        pixels: number of pixels of a pair to check with rays; with 0, no scene is sampled again.
        pairs: number of pairs, evenly spread, to check with rays; None for all.

    Raises:
        InputError: where rays are asked for, and the scenes cannot be sampled again.
    """
    total = sum(index.plan.pairs.values())
    rayed = frozenset(spread(total, total if pairs is None else pairs) if pixels else ())
    judges = {split: RayJudge(index, split, pixels) for split in index.plan.pairs} if rayed else {}
    return _verdicts(index, judges, rayed)


def _verdicts(index: StoredIndex, judges: Mapping[SplitName, RayJudge], rayed: frozenset[int]) -> Iterator[Verdict]:
    verdict = Verdict(DATASET)
    present = frozenset(names_below(index.root))
    unmade = [unmade_pairs(index, shard, present) for shard in index.plan.shards]
    check_index(index, present, sum(map(len, unmade)), verdict)
    yield verdict
    recent: dict[int, StoredFrame] = {}
    position = -1
    for planned, still_unmade in zip(index.plan.shards, unmade, strict=True):
        shard = StoredShard(index, planned)
        for number in shard.numbers:
            position += 1
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
                if position in rayed:
                    judges[shard.split].check(frame, verdict)
                if fits:
                    _check_against(frame, recent, index, verdict)
                    recent[number] = frame
            recent = {at: pair for at, pair in recent.items() if at > number - index.plan.views}
            yield verdict


@_UNKNOWN_VALUES
def _check_frame(frame: StoredFrame, index: StoredIndex, verdict: Verdict) -> bool:
    """Check a pair by itself; return whether all its arrays have the size of its camera."""
    check_origin(frame, index, verdict)
    check_calibration(frame, verdict)
    if not is_of_one_size(frame):
        # The checks that follow compare pixel with pixel.
        return False
    largest_px = index.plan.config.disparity.max_px
    checks: tuple[Callable[[StoredFrame, Eye, Verdict], None], ...] = (
        partial(check_disparity, largest_px=largest_px),
        *(check_depth, check_instances, check_sky, check_normals, check_flow),
        partial(check_change, largest_px=largest_px),
        *(check_lens, check_correspondence),
    )
    for check in checks:
        for eye in EYES:
            check(frame, eye, verdict)
    # Imperfections make the images of both views differ, as a real rig does.
    check_views(frame, verdict, imperfect=index.imperfect or not frame.encodings.image.lossless)
    return True


@_UNKNOWN_VALUES
def _check_against(frame: StoredFrame, recent: Mapping[int, StoredFrame], index: StoredIndex, verdict: Verdict) -> None:
    """Compare a pair with the same view's pair one frame earlier, and with the first pair of its own scene.

    Pairs of another size are passed over.
    """
    views, sizes = index.plan.views, frame.left.image.shape
    scene, view = divmod(frame.index, views)
    before = {frame.index - views} if scene % index.plan.config.sequence.length else set()
    for number in before | ({frame.index - view} if view else set()):
        other = recent.get(number)
        if other is None or other.split != frame.split or other.left.image.shape != sizes:
            continue
        if number // views == scene:
            check_lefts(frame, other, verdict)
        else:
            # A surface point has the same colour in all frames, unless textures or imperfections change it.
            changing = index.imperfect or index.plan.config.textures.sequence
            check_frames(other, frame, verdict, images=not changing and frame.encodings.image.lossless)
