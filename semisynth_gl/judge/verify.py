"""Reads a dataset's files back, and reports their faults."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from os import PathLike
from typing import Any

import numpy as np

from semisynth_gl.dataset.documents import INDEX, DatasetIndex
from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.dataset.reader import StoredIndex, read_index
from semisynth_gl.dataset.rebuild import RebuiltScenes
from semisynth_gl.frame.camera import EYES
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.files import check_index, check_shard, read_pair
from semisynth_gl.judge.findings import CheckResults, Finding
from semisynth_gl.judge.lens import check_lens
from semisynth_gl.judge.matching import check_frames, check_masks, check_views
from semisynth_gl.judge.rays import check_rays
from semisynth_gl.judge.single_view import check_calibration, check_view
from semisynth_gl.listener import Listener
from semisynth_gl.seeds.seeds import spread
from semisynth_gl.seeds.splits import SplitName

PAIRS_WITH_RAYS = 4
"""Default number of pairs that are compared with rays."""
# Checks whose findings are about missing or changed files, which `generate` can make again.
_OF_FILES = {"index", "shard", "files", "sha256", "size"}


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of all checks of a dataset.

    Attributes:
        pairs: number of pairs of the dataset.
        all_results: the results for the dataset as a whole, and then for each pair.
        no_rays: why `verify` could not cast rays; None if it cast rays, or the caller asked for none.
        remove: names of files, the index and records of shards; if the user removes them, `generate` makes missing and
            changed files again.
    """

    pairs: int
    all_results: Sequence[CheckResults]
    no_rays: str | None = None
    remove: Sequence[str] = ()

    @property
    def findings(self) -> list[Finding]:
        """All faults, in the order in which they were found."""
        return [finding for results in self.all_results for finding in results.findings]

    def values(self) -> dict[str, Any]:
        """Return the content of ``verify --json``: ``pairs``, ``findings``, ``remove``, and ``measures`` by pair."""
        return {
            "pairs": self.pairs,
            "findings": [asdict(finding) for finding in self.findings],
            "remove": [*self.remove],
            "measures": {results.scene: results.measures for results in self.all_results if results.measures},
        }


def verify(
    dataset: str | PathLike[str],
    *,
    rays: int | None = None,
    pixels: int = 500,
    listener: Listener | None = None,
    on_finding: Callable[[Finding], None] = lambda _: None,
) -> Verification:
    """Read a dataset back, and compare its files with each other, with the index and with the shards' records.

    Findings about a shard are in the results of the shard's first pair.

    Args:
        dataset: a folder, or an address that fsspec knows.
        rays: number of pairs, evenly spread, whose scenes are rebuilt and compared with float64 rays; by default 4, or
            none if the scenes cannot be rebuilt.
        pixels: number of rays of each of these pairs, half of them in each view.
        listener: is called with the number of pairs, and with each checked pair.
        on_finding: is called with each fault, when the checks of its pair are finished.

    Raises:
        InputError: where there is no finished dataset, or rays are asked for and its scenes cannot be rebuilt.
        ReadError: where the dataset's index is damaged.
    """
    pixels, listener = to_whole("pixels", pixels, least=1), listener or Listener()
    index = read_index(dataset)
    made = index.finished_index
    if made is None:
        raise InputError(f"{index.address}: {index.fault}")
    pairs_with_rays, scenes, no_rays = _scenes_for_rays(index, made, rays)
    all_results, remove = list[CheckResults](), dict[str, None]()

    def finish(results: CheckResults, record: str) -> None:
        all_results.append(results)
        for finding in results.findings:
            on_finding(finding)
            if finding.check in _OF_FILES:
                remove[record] = None

    results = CheckResults("dataset")
    check_index(index, results)
    finish(results, INDEX)
    listener.on_total(sum(made.pairs.values()))
    recent = deque[StoredFrame | None](maxlen=made.views)
    for shard, entry in zip(made.shards, made.shard_entries, strict=True):
        record = None
        for number in range(shard.first, shard.end):
            name = made.key(shard.split, number).name
            results = CheckResults(name if len(made.pairs) == 1 else f"{shard.split} {name}")
            if number == shard.first:
                record = check_shard(index, shard, entry, results)
            frame = read_pair(index, shard, record, number, results)
            if frame is not None:
                is_next = number // made.views % made.config.sequence.length > 0 and len(recent) == made.views
                # With V views per scene, the same view of the previous frame is V pairs back: the oldest of `recent`.
                _check_frame(frame, recent[0] if is_next else None, index, results)
                if len(all_results) - 1 in pairs_with_rays:
                    check_rays(frame, scenes[shard.split], pixels, results)
            recent.append(frame)
            finish(results, shard.record)
            listener.on_pair()
    return Verification(len(all_results) - 1, all_results, no_rays, list(remove))


def _scenes_for_rays(
    index: StoredIndex, made: DatasetIndex, rays: int | None
) -> tuple[frozenset[int], dict[SplitName, RebuiltScenes], str | None]:
    """Return the positions of the pairs to compare with rays, each split's scenes, and why no rays can be cast."""
    if rays is None and made.version != metadata.version("semisynth-gl"):
        # A different version may sample different scenes.
        return frozenset(), {}, f"version {made.version} made the dataset"
    count = PAIRS_WITH_RAYS if rays is None else to_whole("rays", rays, least=0)
    positions = frozenset(spread(sum(made.pairs.values()), count))
    try:
        return positions, {split: RebuiltScenes(index, split) for split in made.pairs if positions}, None
    except InputError as error:
        if rays is not None:
            raise
        return frozenset(), {}, str(error)


# Arrays have inf or NaN where nothing is known; computing with them is no fault.
@np.errstate(invalid="ignore", divide="ignore")
def _check_frame(frame: StoredFrame, before: StoredFrame | None, index: StoredIndex, results: CheckResults) -> None:
    """Check a pair, and compare it with the pair of the previous frame of its sequence, if there is one."""
    check_calibration(frame, results)
    for eye in EYES:
        check_view(frame, eye, index.plan.config.disparity.max_px, results)
        check_masks(frame, eye, results)
        check_lens(frame, eye, results)
    imperfect = not (index.plan.config.images_as_rendered and frame.encodings.image.lossless)
    check_views(frame, results, imperfect=imperfect)
    if before is not None:
        # Textures from image sequences and imperfections change the colour of a surface from frame to frame.
        check_frames(before, frame, results, images=not (imperfect or index.plan.config.textures.sequence))
