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
from semisynth_gl.textures.crops import (
    Square,
    crop_boxes,
    cut_crop,
    fingerprint,
    sharpness_measure,
    texture_measure,
)
from semisynth_gl.textures.images import ImageError, read_image, stored_size
from semisynth_gl.textures.pictures import Picture, TextureImage, pixels_of

Clip = tuple[Path, ...]
"""The frames in their order, at least one."""


@dataclass(frozen=True, slots=True)
class AtlasLimits:
    """The most that an atlas may have.

    Attributes:
        layers: layers; 2048 is what every OpenGL 4 driver has.
        frames: frames of one patch.
    """

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
    """Group images into image sequences and cut those into clips, decoding nothing.

    Images of one folder with equal size form one image sequence, sorted naturally by name. It is cut into successive
    clips of nearly equal length, of as many frames as leaves room for all patches: the number of crops times frames, or
    ``max_patches`` times frames where that is less, stays within the limit of layers.

    Args:
        images: files, in any order.
        section: the config's section; its ``patch_px``, ``scales`` and ``max_patches`` count.
        limits: the most layers and frames.
        alone: whether all patches come from these images; else others may fill ``max_patches``.

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
    """A crop with its measures.

    Attributes:
        square: the square; of several frames that of the first one.
        texture: least `texture_measure` over the frames.
        sharpness: least `sharpness_measure` over the frames, up to the first in which the crop is flat or blurred.
        fingerprint: (112,) float32 of a good crop, see `crops.fingerprint`; empty where no duplicates are wanted.
    """

    square: Square
    texture: float = np.inf
    sharpness: float = np.inf
    fingerprint: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class PatchFrames:
    """The pixels of a crop that may become a patch, (F, P, P, 3) uint8 RGB; the rest is as in `Patch`."""

    square: Square
    texture: float
    frames: NDArray[np.uint8]
    contrast: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ClipSurvey:
    """A clip that was read, or a picture, and its crops.

    Attributes:
        frames: the readable frames, or the picture.
        skipped: the other frames, and why.
        good: crops that are neither flat nor blurred; this list and the next two are ordered by side, row and column.
        flat: crops with less texture than ``min_texture`` in any frame.
        blurred: crops with enough texture, but less sharp than ``min_sharpness`` in any frame.
        still: the pixels of a picture or of a clip of one frame, so that it is not read again.
    """

    frames: tuple[TextureImage, ...]
    skipped: Sequence[Skipped]
    good: list[MeasuredCrop]
    flat: list[MeasuredCrop]
    blurred: list[MeasuredCrop]
    still: NDArray[np.uint8] | None

    @property
    def too_small(self) -> bool:
        """True where the frames have no crop."""
        return not (self.good or self.flat or self.blurred)

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
    """Read the frames of a clip one at a time, and measure their crops.

    A frame that cannot be read is skipped, as is one whose upright size differs from the frames before it.

    Args:
        clip: the frames.
        names: names of the frames, for the squares.
        section: the config's section, with the sizes of the crops and the least measures.
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
            crops = _crops(names[path], image, section)
        elif image.shape != shape:  # equal as stored, but turned by EXIF
            reason = f"is {image.shape[1]} x {image.shape[0]} upright, frames before it {shape[1]} x {shape[0]}"
            skipped.append(Skipped(path, reason))
            continue
        frames.append(path)
        for crop in crops:
            _measure(crop, cut_crop(image, crop.square.box, section.patch_px), section)
    return _survey(tuple(frames), skipped, crops, image if len(clip) == 1 else None, section)


def survey_picture(picture: Picture, section: TexturesSection) -> ClipSurvey:
    """Measure the crops of a picture, as `survey_clip` does for an image file."""
    crops = _crops(picture.name, picture.pixels, section)
    for crop in crops:
        _measure(crop, cut_crop(picture.pixels, crop.square.box, section.patch_px), section)
    return _survey((picture,), [], crops, picture.pixels, section)


def _crops(name: str, image: NDArray[np.uint8], section: TexturesSection) -> list[MeasuredCrop]:
    boxes = crop_boxes(image.shape[0], image.shape[1], section.patch_px, section.scales)
    return [MeasuredCrop(Square(name, *box)) for box in boxes]


def _survey(
    frames: tuple[TextureImage, ...],
    skipped: Sequence[Skipped],
    crops: Sequence[MeasuredCrop],
    still: NDArray[np.uint8] | None,
    section: TexturesSection,
) -> ClipSurvey:
    textured = [crop for crop in crops if crop.texture >= section.min_texture]
    return ClipSurvey(
        frames=frames,
        skipped=skipped,
        good=[crop for crop in textured if crop.sharpness >= section.min_sharpness],
        flat=[crop for crop in crops if crop.texture < section.min_texture],
        blurred=[crop for crop in textured if crop.sharpness < section.min_sharpness],
        still=still,
    )


def _measure(crop: MeasuredCrop, pixels: NDArray[np.uint8], section: TexturesSection) -> None:
    """Update the measures of a crop by a further frame, unless the crop is rejected already."""
    crop.texture = min(crop.texture, texture_measure(pixels))
    if crop.texture < section.min_texture or crop.sharpness < section.min_sharpness:
        return
    crop.sharpness = min(crop.sharpness, sharpness_measure(pixels))
    # Successive clips of a video show much the same, so clips are not compared.
    if section.min_difference and not section.sequence and crop.sharpness >= section.min_sharpness:
        crop.fingerprint = fingerprint(pixels)
