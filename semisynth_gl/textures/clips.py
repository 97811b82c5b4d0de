"""Clips: the files of an image, or of successive frames of an image sequence, and the crops of their frames."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.errors import Skipped
from semisynth_gl.textures.borders import Inside, inside_borders
from semisynth_gl.textures.crop_report import Outcome
from semisynth_gl.textures.crops import Square, cover, cut_crop, sharpness_measure, texture_measure
from semisynth_gl.textures.images import ImageError, read_image, stored_size

MOST_LAYERS = 2048
"""Largest number of layers of an atlas: that of every OpenGL 4 driver."""
MOST_FRAMES = 16
"""Largest number of frames of a clip."""


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Return a sort key under which numbers in names count as numbers: frame2 before frame10."""
    parts = re.findall(r"(\d+)|(\D+)", path.name)
    # The name itself comes last, so that frame01 and frame1 have an order too.
    return *((0, int(digits), "") if digits else (1, 0, text) for digits, text in parts), (2, 0, path.name)


def cut_clips(
    images: Sequence[Path], section: TexturesSection, *, alone: bool
) -> tuple[list[list[Path]], list[Skipped]]:
    """Group images into image sequences and cut the sequences into clips, decoding nothing.

    Images of one folder with equal size form one image sequence, sorted naturally by name. It is cut into successive
    clips of nearly equal length. All clips are as long as the limits allow: the number of crops of all clips, but at
    most ``max_patches``, times the frames of a clip is not above `MOST_LAYERS`. Where the images are not ``alone``,
    patches of pictures may fill up ``max_patches``, so that number counts.

    Returns:
        The clips, by folder and name, and the files whose headers could not be read.
    """
    image_sequences: dict[tuple[Path, tuple[int, int]], list[Path]] = {}
    skipped = []
    for path in sorted(images, key=lambda path: (path.parent.as_posix(), natural_key(path))):
        try:
            image_sequences.setdefault((path.parent, stored_size(path)), []).append(path)
        except ImageError as error:
            skipped.append(Skipped(path, error.reason))
    crops = {size: len(cover("", *size, section.patch_px, section.scales)) for _, size in image_sequences}

    def layers(frames: int) -> int:
        patches = sum(crops[size] * -(-len(paths) // frames) for (_, size), paths in image_sequences.items())
        return frames * (min(patches, section.max_patches) if alone else section.max_patches)

    frames = next((frames for frames in range(MOST_FRAMES, 1, -1) if layers(frames) <= MOST_LAYERS), 1)
    clips = []
    for paths in image_sequences.values():
        count = -(-len(paths) // frames)
        ends = [number * len(paths) // count for number in range(count + 1)]
        clips += [paths[start:end] for start, end in pairwise(ends)]
    return clips, skipped


@dataclass(slots=True, eq=False)
class Crop:
    """A square of a clip.

    Attributes:
        square: the square, under the name of the clip's first frame.
        frames: its pixels in each frame, (P, P, 3) uint8 each; none once it is rejected.
        texture: least `texture_measure` of all frames.
        outcome: "kept", or why the crop is rejected: "flat" where any frame has less texture than ``min_texture``,
            else "blurred" where any is less sharp than ``min_sharpness``; else "duplicate" or "surplus".
        like: the crop that a duplicate looks most like.
    """

    square: Square
    frames: list[NDArray[np.uint8]] = field(default_factory=list)
    texture: float = np.inf
    outcome: Outcome = "kept"
    like: Square | None = None

    def reject(self, reason: Outcome, like: Square | None = None) -> None:
        """Reject the crop, and free its pixels."""
        self.outcome, self.like, self.frames = reason, like, []


def find_crops(name: str, inside: Inside, section: TexturesSection) -> list[Crop]:
    """Return the crops of a part of an image, by side, row and column, with no frames yet; none where it is too small.

    Args:
        name: of the image, or of a clip's first frame.
        inside: the part.
        section: the config's section.
    """
    squares = cover(name, inside.height_px, inside.width_px, section.patch_px, section.scales)
    return [Crop(Square(name, left + inside.left_px, top + inside.top_px, side)) for _, left, top, side in squares]


def cut_frame(crops: Sequence[Crop], image: NDArray[np.uint8], section: TexturesSection) -> None:
    """Cut crops out of a further frame, (H, W, 3), and judge them; rejected crops lose their frames."""
    for crop in crops:
        patch = cut_crop(image, crop.square, section.patch_px)
        crop.texture = min(crop.texture, texture_measure(patch))
        if crop.texture < section.min_texture:
            crop.reject("flat")
        elif crop.outcome == "kept" and sharpness_measure(patch) < section.min_sharpness:
            crop.reject("blurred")
        elif crop.outcome == "kept":
            crop.frames.append(patch)


def read_clip(
    clip: Sequence[Path], names: Mapping[Path, str], section: TexturesSection
) -> tuple[list[str], list[Crop], list[Skipped]]:
    """Read a clip, one frame at a time.

    Args:
        clip: the files of its frames; a still image has one.
        names: the name of each file.
        section: the config's section.

    Returns:
        The names of the frames, the crops, and the files that were left out: unreadable ones, and those that EXIF turns
        otherwise than the first.
    """
    used, crops, skipped = list[str](), list[Crop](), list[Skipped]()
    shape: tuple[int, ...] = ()
    for path in clip:
        try:
            image = read_image(path)
        except ImageError as error:
            skipped.append(Skipped(path, error.reason))
            continue
        if not used:
            shape = image.shape
            # Squares of a rectified photograph keep clear of its black borders.
            crops = find_crops(names[path], inside_borders(image), section)
        if image.shape != shape:
            skipped.append(Skipped(path, "is turned by its EXIF orientation, unlike the frames before it"))
            continue
        used.append(names[path])
        cut_frame(crops, image, section)
    return used, crops, skipped
