"""Clips, each an image or successive frames of an image sequence: grouping image files, and judging their crops."""

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
from semisynth_gl.textures.crop_report import Reason
from semisynth_gl.textures.crops import Square, crop_boxes, cut_crop, fingerprint, sharpness_measure, texture_measure
from semisynth_gl.textures.images import ImageError, read_image, stored_size
from semisynth_gl.textures.pictures import Picture, TextureImage, pixels_of

Clip = tuple[Path, ...]
"""The files of a clip's frames in their order, at least one."""


@dataclass(frozen=True, slots=True)
class AtlasLimits:
    """The largest number of layers of an atlas, 2048 in every OpenGL 4 driver, and of frames of one patch."""

    layers: int = 2048
    frames: int = 16


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Return a sort key under which numbers in names count as numbers: frame2 before frame10."""
    parts = re.findall(r"(\d+)|(\D+)", path.name)
    # The name itself comes last, so that frame01 and frame1 have an order too.
    return *((0, int(digits), "") if digits else (1, 0, text) for digits, text in parts), (2, 0, path.name)


def cut_clips(
    images: Sequence[Path], section: TexturesSection, limits: AtlasLimits, *, alone: bool = True
) -> tuple[list[Clip], list[Skipped]]:
    """Group images into image sequences and cut the sequences into clips, decoding nothing.

    Images of one folder with equal size form one image sequence, sorted naturally by name. It is cut into successive
    clips of nearly equal length. All clips are as long as the limits of frames and layers allow: the number of crops of
    all clips, but at most ``max_patches``, times the frames of a clip is not above the limit of layers. Where the
    images are not ``alone``, patches of pictures may fill up ``max_patches``, so that number counts.

    Returns:
        The clips, by folder and name, and the files whose headers could not be read.
    """
    image_sequences: dict[tuple[Path, tuple[int, int]], list[Path]] = {}
    skipped = []
    for path in sorted(images, key=lambda path: (path.parent.as_posix(), natural_key(path))):
        try:
            size = stored_size(path)
        except ImageError as error:
            skipped.append(Skipped(path, error.reason))
        else:
            image_sequences.setdefault((path.parent, size), []).append(path)

    crops = {size: len(crop_boxes(*size, section.patch_px, section.scales)) for _, size in image_sequences}

    def layers(frames: int) -> int:
        most = min(section.max_patches, limits.layers)
        patches = sum(crops[size] * -(-len(paths) // frames) for (_, size), paths in image_sequences.items())
        return frames * (min(patches, most) if alone else most)

    frames = next((frames for frames in range(limits.frames, 1, -1) if layers(frames) <= limits.layers), 1)
    clips = []
    for paths in image_sequences.values():
        count = -(-len(paths) // frames)
        borders = [i * len(paths) // count for i in range(count + 1)]
        clips += [tuple(paths[start:end]) for start, end in pairwise(borders)]
    return clips, skipped


@dataclass(slots=True, eq=False)
class MeasuredCrop:
    """A crop and its measures over all frames of its clip.

    Attributes:
        square: the square, under the name of the clip's first frame.
        texture: least `texture_measure` of all frames.
        reason: "flat" where any frame has less texture than ``min_texture``, else "blurred" where any is less sharp
            than ``min_sharpness``; None where the crop is good.
        fingerprint: (112,) float32 of a good crop, see `crops.fingerprint`; empty where duplicates are not looked for.
    """

    square: Square
    texture: float = np.inf
    reason: Reason | None = None
    fingerprint: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class PatchFrames:
    """A crop that may become a patch: ``frames`` are its pixels, (F, P, P, 3) uint8 RGB; the rest is as in `Patch`."""

    square: Square
    texture: float
    frames: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class ClipSurvey:
    """A clip or a picture that was read and measured.

    Attributes:
        frames: the readable frames, or the picture.
        names: the names of ``frames``.
        skipped: the frames that were left out, and why.
        crops: ordered by side, row and column; none where the frames are smaller than a patch.
        still: the pixels, (H, W, 3), of a picture or of a clip of one frame, so that it is not read again.
    """

    frames: Sequence[TextureImage]
    names: Sequence[str]
    skipped: Sequence[Skipped]
    crops: Sequence[MeasuredCrop]
    still: NDArray[np.uint8] | None

    @property
    def good(self) -> list[MeasuredCrop]:
        """The crops that nothing speaks against, in their order."""
        return [crop for crop in self.crops if crop.reason is None]

    def cut(self, crops: Sequence[MeasuredCrop], patch_px: int) -> list[PatchFrames]:
        """Cut crops out of all frames, which are read again, one at a time."""
        shape = (len(self.frames), patch_px, patch_px, 3)
        patches = [PatchFrames(crop.square, crop.texture, np.empty(shape, np.uint8)) for crop in crops]
        for number, image in enumerate(self.frames if crops else ()):
            pixels = pixels_of(image) if self.still is None else self.still
            for patch in patches:
                patch.frames[number] = cut_crop(pixels, patch.square.box, patch_px)
        return patches


def survey_clip(clip: Clip, names: Mapping[Path, str], section: TexturesSection) -> ClipSurvey:
    """Read the frames of a clip one at a time, and measure their crops; ``names`` maps each file to its name.

    Frames that cannot be read are skipped, and so are frames whose upright size differs from that of the frames before.
    """
    frames: list[Path] = []
    skipped: list[Skipped] = []
    crops: list[MeasuredCrop] = []
    shape: tuple[int, ...] | None = None
    image: NDArray[np.uint8] | None = None
    for path in clip:
        try:
            image = read_image(path)
        except ImageError as error:
            skipped.append(Skipped(path, error.reason))
            continue
        if shape is None:
            shape = image.shape
            # Squares of a rectified photograph keep clear of its black borders.
            crops = _crops(names[path], inside_borders(image), section)
        elif image.shape != shape:  # equal as stored, but turned by EXIF
            reason = f"is {image.shape[1]} x {image.shape[0]} upright, frames before it {shape[1]} x {shape[0]}"
            skipped.append(Skipped(path, reason))
            continue
        frames.append(path)
        _measure(crops, image, section)
    return ClipSurvey(frames, [names[path] for path in frames], skipped, crops, image if len(clip) == 1 else None)


def survey_picture(picture: Picture, section: TexturesSection) -> ClipSurvey:
    """Measure the crops of a picture, as `survey_clip` does for an image file."""
    height, width = picture.pixels.shape[:2]
    crops = _crops(picture.name, Inside(0, 0, width, height), section)
    _measure(crops, picture.pixels, section)
    return ClipSurvey([picture], [picture.name], [], crops, picture.pixels)


def _crops(name: str, inside: Inside, section: TexturesSection) -> list[MeasuredCrop]:
    boxes = crop_boxes(inside.height_px, inside.width_px, section.patch_px, section.scales)
    return [MeasuredCrop(Square(name, left + inside.left_px, top + inside.top_px, side)) for left, top, side in boxes]


def _measure(crops: Sequence[MeasuredCrop], image: NDArray[np.uint8], section: TexturesSection) -> None:
    """Judge crops by a further frame. A crop that was blurred in an earlier frame may still turn out flat."""
    # Successive clips of a video look much the same, so clips are not compared.
    compared = section.min_difference and not section.sequence
    for crop in crops:
        pixels = cut_crop(image, crop.square.box, section.patch_px)
        crop.texture = min(crop.texture, texture_measure(pixels))
        if crop.texture < section.min_texture:
            crop.reason = "flat"
        elif crop.reason is None and sharpness_measure(pixels) < section.min_sharpness:
            crop.reason = "blurred"
        elif crop.reason is None and compared:
            crop.fingerprint = fingerprint(pixels)
