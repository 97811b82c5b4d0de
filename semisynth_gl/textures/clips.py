"""Reads clips, an image or successive frames of a video, and cuts crops out of them."""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.errors import SkippedFile
from semisynth_gl.textures.borders import Rectangle, inside_borders
from semisynth_gl.textures.crop_report import Outcome
from semisynth_gl.textures.crops import Square, cover, cut_crop, sharpness_measure, texture_measure
from semisynth_gl.textures.images import ImageError, read_image, stored_size

MOST_LAYERS = 2048
"""Maximum number of layers of an atlas, which every OpenGL 4 driver supports."""
MOST_FRAMES = 16
"""Maximum number of frames of a clip."""


def natural_key(path: Path) -> tuple[str, list[str | int], str]:
    """Return a sort key by folder, then by name, with numbers in numeric order: frame2 before frame10."""
    # Text and numbers alternate, beginning with text. The name itself decides between frame01 and frame1.
    parts = re.split(r"(\d+)", path.name)
    return path.parent.as_posix(), [int(part) if number % 2 else part for number, part in enumerate(parts)], path.name


def cut_clips(images: Sequence[Path], section: TexturesSection, *, alone: bool) -> list[list[Path]]:
    """Cut the images of each folder, sorted naturally by name, into successive clips of nearly equal length.

    Clips have as many frames as fit into `MOST_LAYERS`, if the atlas gets ``max_patches`` patches. With ``alone``,
    there are no painted pictures, and the number of crops limits the patches, too. All images of a folder are taken to
    have as many crops as its largest readable image.
    """
    folders, crops = defaultdict[Path, list[Path]](list), defaultdict[Path, int](int)
    for path in sorted(images, key=natural_key):
        folders[path.parent].append(path)
        with suppress(ImageError):
            height, width = stored_size(path)
            squares = cover("", Rectangle(0, 0, width, height), section.patch_px, section.scales)
            crops[path.parent] = max(crops[path.parent], len(squares))

    def layers(frames: int) -> int:
        patches = sum(crops[folder] * -(-len(paths) // frames) for folder, paths in folders.items())
        return frames * (min(patches, section.max_patches) if alone else section.max_patches)

    frames = next((frames for frames in range(MOST_FRAMES, 1, -1) if layers(frames) <= MOST_LAYERS), 1)
    clips = []
    for paths in folders.values():
        count = -(-len(paths) // frames)
        clips += [paths[start:end] for start, end in pairwise(n * len(paths) // count for n in range(count + 1))]
    return clips


@dataclass(slots=True, eq=False)
class CropCandidate:
    """A square of an image or a clip that may become a patch.

    Attributes:
        square: the square; its ``source`` is the name of the image, or of the clip's first frame.
        frames: its pixels in each frame, (P, P, 3) uint8 each; empty once the crop is rejected.
        texture: smallest `texture_measure` of all frames.
        outcome: "kept", or why the crop is rejected: "flat" if any frame has less texture than ``min_texture``, else
            "blurred" if any frame is less sharp than ``min_sharpness``; else "duplicate" or "surplus".
    """

    square: Square
    frames: list[NDArray[np.uint8]] = field(default_factory=list)
    texture: float = np.inf
    outcome: Outcome = "kept"

    def reject(self, reason: Outcome) -> None:
        """Reject the crop, and free its pixels."""
        self.outcome, self.frames = reason, []

    def add_frame(self, image: NDArray[np.uint8], section: TexturesSection) -> None:
        """Cut the square out of one more frame, (H, W, 3), and reject the crop if it is flat or blurred there."""
        patch = cut_crop(image, self.square, section.patch_px)
        self.texture = min(self.texture, texture_measure(patch))
        if self.texture < section.min_texture:
            self.reject("flat")
        elif self.outcome == "kept" and sharpness_measure(patch) < section.min_sharpness:
            self.reject("blurred")
        elif self.outcome == "kept":
            self.frames.append(patch)


def cut_crops(name: str, part: Rectangle, image: NDArray[np.uint8], section: TexturesSection) -> list[CropCandidate]:
    """Return the crops of a part of an image, sorted by side, row and column; none if the part is too small."""
    crops = [CropCandidate(square) for square in cover(name, part, section.patch_px, section.scales)]
    for crop in crops:
        crop.add_frame(image, section)
    return crops


def read_clip(
    clip: Sequence[Path], names: Mapping[Path, str], section: TexturesSection
) -> tuple[list[str], list[CropCandidate], list[SkippedFile]]:
    """Read a clip, one frame at a time.

    ``clip`` has the files of its frames (a still image has one), and ``names`` has the name of each file. Returns the
    names of the frames, the crops, and the files that were skipped: unreadable files, and frames whose size or EXIF
    orientation differs from the first frame's.
    """
    used, crops, skipped = list[str](), list[CropCandidate](), list[SkippedFile]()
    shape: tuple[int, ...] = ()
    for path in clip:
        try:
            image = read_image(path)
        except ImageError as error:
            skipped.append(SkippedFile(path, error.reason))
            continue
        if not used:
            shape = image.shape
            # Squares of a rectified photograph keep clear of its black borders.
            crops = cut_crops(names[path], inside_borders(image), image, section)
        elif image.shape == shape:
            for crop in crops:
                crop.add_frame(image, section)
        else:
            skipped.append(SkippedFile(path, "differs in size or EXIF orientation from the first frame of its clip"))
            continue
        used.append(names[path])
    return used, crops, skipped
