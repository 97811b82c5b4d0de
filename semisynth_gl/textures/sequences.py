"""Image sequences: which files are successive frames, and into runs of which length they are cut."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from semisynth_gl.errors import Skipped
from semisynth_gl.textures.crops import crop_boxes
from semisynth_gl.textures.images import ImageError, stored_size


@dataclass(frozen=True, slots=True)
class Runs:
    """Images, cut into runs of successive frames.

    Attributes:
        runs: the frames of each run, at least one.
        skipped: files whose headers could not be read, and why.
    """

    runs: tuple[tuple[Path, ...], ...]
    skipped: tuple[Skipped, ...]


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Return a sort key under which numbers in names count as numbers: frame2 before frame10."""
    parts = re.findall(r"(\d+)|(\D+)", path.name)
    # The name itself comes last, so that frame01 and frame1 have an order too.
    return *((0, int(digits), "") if digits else (1, 0, text) for digits, text in parts), (2, 0, path.name)


def find_runs(
    images: Sequence[Path],
    *,
    patch_px: int,
    scales: Sequence[float],
    max_patches: int,
    max_layers: int,
    max_frames: int,
) -> Runs:
    """Group images into sequences and cut those into runs, decoding nothing.

    Images of one folder with equal size form one sequence, sorted naturally by name. A sequence is cut into successive
    runs of nearly equal length, of as many frames as leaves room for every patch that may come to be: the number of
    crop squares times frames, or ``max_patches`` times frames where that is less, stays within ``max_layers``.

    Args:
        images: files, in any order.
        patch_px: side of a patch, pixels.
        scales: image pixels per patch pixel.
        max_patches: patches that the atlas may have at most.
        max_layers: layers that it may have at most.
        max_frames: frames that a run may have at most.

    Returns:
        The runs, by folder and name.
    """
    sequences: dict[tuple[Path, tuple[int, int]], list[Path]] = {}
    skipped = []
    for path in sorted(images, key=lambda path: (path.parent.as_posix(), natural_key(path))):
        try:
            size = stored_size(path)
        except ImageError as error:
            skipped.append(Skipped(path, error.reason))
        else:
            sequences.setdefault((path.parent, size), []).append(path)

    squares = {size: len(crop_boxes(*size, patch_px, scales)) for _, size in sequences}

    def layers(frames: int) -> int:
        found = sum(squares[size] * -(-len(paths) // frames) for (_, size), paths in sequences.items())
        return frames * min(found, max_patches)

    fitting = (frames for frames in range(max(max_frames, 1), 1, -1) if layers(frames) <= max_layers)
    frames = next(fitting, 1)
    runs = tuple(run for paths in sequences.values() for run in _cut(paths, frames))
    return Runs(runs, tuple(skipped))


def _cut(paths: Sequence[Path], frames: int) -> list[tuple[Path, ...]]:
    count = -(-len(paths) // frames)
    borders = [i * len(paths) // count for i in range(count + 1)]
    return [tuple(paths[start:end]) for start, end in pairwise(borders)]
