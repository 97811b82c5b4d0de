"""Random changes of training pairs, sampled for each sequence and epoch: `Augmentation` and `PRESETS`."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, inf, pi, radians, sin
from typing import Annotated, Any

import numpy as np

from semisynth_gl.augmentation.colour import mean_luminance, recoloured
from semisynth_gl.augmentation.geometry import PairWarp, mirrored, occluded
from semisynth_gl.frame.camera import EYES, Crop, Eye
from semisynth_gl.frame.channels import CHANNELS, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.arguments import CheckedFields, Interval
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.seeds.seeds import Purpose, generator

Share = Annotated[float, 0, 1]
Size = tuple[int, int]  # height and width, px


@dataclass(frozen=True, slots=True)
class SequenceChanges:
    """The changes of a sequence's pairs, in the order in which they are applied."""

    mirrored: bool
    warp: PairWarp
    size: Size | None  # of the result; None for the image's size
    rectangles: tuple[Crop, ...]
    colours: Mapping[Eye, Mapping[str, Any]]  # the keyword arguments of `recoloured`

    @property
    def source_size(self) -> Size | None:
        """Size of the crop that the result is made from; None for the whole image."""
        return None if self.size is None else self.warp.source_size(self.size)

    def applied(self, frame: Frame, rng: np.random.Generator) -> Frame:
        """Return the changed pair; ``frame`` has the size `source_size`, and ``rng`` samples the noise.

        Raises InputError if the pair lacks something that a change needs.
        """
        kept = [name for name, channel in CHANNELS.items() if channel.is_truth or name == "image"]
        frame = Frame(frame.camera, *(ViewArrays({n: v[n] for n in kept if n in v}) for v in (frame.left, frame.right)))
        if self.mirrored:
            frame = mirrored(frame)
        if self.size is not None:
            frame = self.warp.applied(frame, self.size).with_own_masks()
        frame = occluded(frame, self.rectangles)
        images = {eye: frame.view(eye).image for eye in EYES}
        # Both eyes share one mean luminance: otherwise, equal contrasts would change a colour differently in each eye.
        contrasts = any(each["contrast"] != 1 for each in self.colours.values())
        mean = mean_luminance(list(images.values())) if contrasts else 0.0
        images = {eye: recoloured(image, mean, rng, **self.colours[eye]) for eye, image in images.items()}
        return Frame(frame.camera, *(frame.view(eye).with_channels({"image": images[eye]}) for eye in EYES))


@dataclass(frozen=True, kw_only=True, slots=True)
class Augmentation(CheckedFields):
    """Changes of training pairs. The default changes nothing.

    Values are sampled uniformly from ranges (low, high). They depend on the seed, the sequence and the epoch; the noise
    also depends on the pair. All frames of a sequence change alike, so that flow is valid between them.

    Truth is that of the changed pair at the centre of each pixel, see `semisynth_gl.augmentation.resampling`. Raw
    images and maps into them are dropped, since they show the unchanged pair.

    Attributes:
        scale: factors of width and height, sampled log-uniformly, and raised if the crop would not fit.
        stretch: factors of the width in addition to ``scale``, sampled log-uniformly.
        mirrored: share of samples that are mirrored, which swaps left and right. Needs truth of both views and a
            rectified rig.
        right_y_px: shifts of the right image, px down, as in a badly rectified rig. The disparity is then the
            horizontal displacement only; the output ``correspondence`` also has the vertical one. Needs rectified rigs.
        right_roll_deg: rotations of the right image about its principal point, clockwise. Needs rectified rigs.
        brightness: factors of all levels.
        contrast: factors of the distance from the mean luminance of both images.
        saturation: factors of the distance from grey.
        hue_turns: rotations of the hue, as shares of the colour circle.
        white_balance: factors of red, green and blue, sampled independently.
        gamma: exponents of the tone curve.
        asymmetric: share of samples whose eyes have independent colours (from brightness to gamma).
        blur_px: standard deviations of a blur, px, independent in each eye.
        noise: standard deviations of noise, levels, independent in each eye.
        occluded: share of samples with one or two rectangles in the right image that hide the scene.
        rectangle_px: sides of these rectangles.

    Raises:
        InputError: if a value cannot be used.
    """

    scale: Annotated[Interval, 0.1, 10] = (1, 1)
    stretch: Annotated[Interval, 0.5, 2] = (1, 1)
    mirrored: Share = 0.0
    right_y_px: Annotated[Interval, -20, 20] = (0, 0)
    right_roll_deg: Annotated[Interval, -5, 5] = (0, 0)
    brightness: Annotated[Interval, 0, 10] = (1, 1)
    contrast: Annotated[Interval, 0, 10] = (1, 1)
    saturation: Annotated[Interval, 0, 10] = (1, 1)
    hue_turns: Annotated[Interval, -0.5, 0.5] = (0, 0)
    white_balance: Annotated[Interval, 0.1, 10] = (1, 1)
    gamma: Annotated[Interval, 0.1, 10] = (1, 1)
    asymmetric: Share = 0.0
    blur_px: Annotated[Interval, 0, 20] = (0, 0)
    noise: Annotated[Interval, 0, 100] = (0, 0)
    occluded: Share = 0.0
    rectangle_px: Annotated[Interval, 1, 10000] = (50, 100)

    def check(self, crop: Size | None, image_size: Size) -> None:
        """Raise InputError if pixels move without a crop, or the crop does not fit at the largest scale."""
        if not self._moves:
            return
        if crop is None:
            raise InputError("expected crop=(height, width): scale, stretch, right_y_px and right_roll_deg need it")
        least = self._least_scale(crop, image_size)
        if least > self.scale[1]:
            needed = "smaller movements"
            if least < inf:
                needed = f"an upper end of {ceil(1000 * least) / 1000:g} or more, got {self.scale[1]:g}"
            raise InputError(
                f"expected {needed}: a crop of {crop[1]} x {crop[0]} px, with {self._margin(image_size)} px around it, "
                f"must fit into {image_size[1]} x {image_size[0]} px",
                argument="scale",
            )

    def sample(self, crop: Size | None, image_size: Size, seed: int, sequence: int, epoch: int = 0) -> SequenceChanges:
        """Sample the changes of a sequence's pairs; ``seed`` is the split's.

        ``crop`` is the size of the result, None for whole images; `check` must accept the sizes.
        """
        rng = generator(seed, Purpose.AUGMENTATION, sequence, epoch)
        scale, stretch = (float(np.exp(rng.uniform(*np.log(each)))) for each in (self.scale, self.stretch))
        is_mirrored, is_asymmetric, is_occluded = rng.random(3) < (self.mirrored, self.asymmetric, self.occluded)
        size, margin = image_size if crop is None else crop, self._margin(image_size)
        least = self._least_scale(size, image_size) if self._moves else 0.0
        scale_x, scale_y = max(scale * stretch, least), max(scale, least)
        right_y_px, right_roll_deg = rng.uniform(*self.right_y_px), rng.uniform(*self.right_roll_deg)
        warp = PairWarp(scale_x, scale_y, right_y_px, radians(right_roll_deg), margin)
        tone = self._tone(rng)
        tones = tone, self._tone(rng) if is_asymmetric else tone
        colours = {
            eye: of_eye | {"blur_px": rng.uniform(*self.blur_px), "noise": rng.uniform(*self.noise)}
            for eye, of_eye in zip(EYES, tones, strict=True)
        }
        rectangles = self._rectangles(rng, size) if is_occluded else ()
        return SequenceChanges(bool(is_mirrored), warp, crop, rectangles, colours)

    @property
    def _moves(self) -> bool:
        """Whether pixels move, other than by mirroring; then the result is a crop."""
        return self.scale != (1, 1) or self.stretch != (1, 1) or self._moves_right

    @property
    def _moves_right(self) -> bool:
        return self.right_y_px != (0, 0) or self.right_roll_deg != (0, 0)

    def _least_scale(self, crop: Size, image_size: Size) -> float:
        """Return the smallest scale of images at which a crop fits; inf if it fits at none."""
        available = [side - 2 * self._margin(image_size) - 1 for side in image_size]  # sizes are rounded up
        return max(side / most for side, most in zip(crop, available, strict=True)) if min(available) > 0 else inf

    def _margin(self, image_size: Size) -> int:
        """Return the margin around a moved right image, px before scaling: largest movement plus filters' radius."""
        if not self._moves_right:
            return 0
        by_roll = sin(radians(max(map(abs, self.right_roll_deg)))) * sum(image_size)
        return ceil(by_roll + max(map(abs, self.right_y_px)) / self.scale[0]) + 5

    def _tone(self, rng: np.random.Generator) -> dict[str, Any]:
        names = ("brightness", "contrast", "saturation", "hue_turns", "gamma")
        tone = {name: float(rng.uniform(*getattr(self, name))) for name in names}
        return tone | {"white_balance": tuple(rng.uniform(*self.white_balance, 3).tolist())}

    def _rectangles(self, rng: np.random.Generator, size: Size) -> tuple[Crop, ...]:
        """Sample rectangles whose top left corner is in the image, as RAFT-Stereo does."""
        rectangles = []
        for _ in range(rng.integers(1, 3)):
            y, x = (int(rng.integers(side)) for side in size)
            width, height = rng.integers(int(self.rectangle_px[0]), int(self.rectangle_px[1]) + 1, 2).tolist()
            rectangles.append(Crop(x, y, min(width, size[1] - x), min(height, size[0] - y)))
        return tuple(rectangles)


PRESETS: Mapping[str, Augmentation] = {
    # The augmentation with which RAFT-Stereo and IGEV-Stereo train (--spatial_scale -0.2 0.4 --saturation_range 0 1.4).
    # RAFT-Stereo moves right images by whole rows, and stretches only 80 % of the samples: width and height, each by
    # 2 ** -0.2 to 2 ** 0.2. This preset stretches all samples, and only their width.
    "raft-stereo": Augmentation(
        scale=(2**-0.2, 2**0.4),
        stretch=(2**-0.2, 2**0.2),
        right_y_px=(-2, 2),
        brightness=(0.6, 1.4),
        contrast=(0.6, 1.4),
        saturation=(0, 1.4),
        hue_turns=(-0.5 / pi, 0.5 / pi),
        asymmetric=0.2,
        occluded=0.5,
    ),
    # Chosen by benchmarks/training/compare_sets.py: each camera has its exposure, white balance, tone curve and noise.
    # Scaling did not help, since rendered pairs have many scales already.
    "semisynth": Augmentation(
        brightness=(0.8, 1.2), white_balance=(0.95, 1.05), gamma=(0.75, 1.33), noise=(0, 5), asymmetric=1.0
    ),
    # PSMNet trains on unchanged crops.
    "psmnet": Augmentation(),
}
"""Augmentations by name."""
