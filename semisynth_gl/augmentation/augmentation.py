"""Random changes of pairs for training, sampled for each sequence and epoch: `Augmentation`, and `PRESETS`."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, inf, pi, radians, sin
from typing import Annotated, Any

import numpy as np

from semisynth_gl.augmentation.colour import mean_luminance, recoloured
from semisynth_gl.augmentation.geometry import Warp, mirrored, occluded
from semisynth_gl.frame.camera import EYES, Crop, Eye
from semisynth_gl.frame.channels import CHANNELS, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.arguments import CheckedFields, Interval
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.seeds.seeds import Purpose, generator

Share = Annotated[float, 0, 1]
Sides = tuple[int, int]


@dataclass(frozen=True, kw_only=True, slots=True)
class Augmentation(CheckedFields):
    """Changes of pairs for training. The default changes nothing.

    Ranges are (low, high), from which values are sampled evenly; shares are of samples. The seed, the sequence and the
    epoch decide all values; the noise depends on the pair, too. All frames of a sequence change alike, so that flow
    leads from frame to frame.

    The truth stays that of the changed pair at the centre of each pixel, see `semisynth_gl.augmentation.resampling`.
    Raw images and maps into them are left out: they show the unchanged pair.

    Attributes:
        scale: factors of both sides; sampled evenly in the logarithm, and raised where the crop would not fit.
        stretch: further factors of the width; likewise.
        mirrored: share of samples that are mirrored; left and right change places. Needs truth of both
            views and a rectified rig.
        right_y_px: shifts of the right image, px down, as in a badly rectified rig. The disparity stays the horizontal
            part; the output ``correspondence``, where the pairs have it, has the vertical one too. Needs rectified
            rigs.
        right_roll_deg: rotations of the right image about its principal point, clockwise. Needs rectified rigs.
        brightness: factors of all levels.
        contrast: factors of the distance from the mean luminance of both images.
        saturation: factors of the distance from grey.
        hue_turns: turns of the hue, as shares of the colour circle.
        white_balance: factors of red, green and blue, each sampled by itself.
        gamma: exponents of the tone curve.
        asymmetric: share in which each eye's colours (from brightness to gamma) are sampled by themselves.
        blur_px: standard deviations of a blur, px; of each eye by itself, as is noise.
        noise: standard deviations of noise, levels.
        occluded: share of pairs with one or two rectangles in the right image that hide the scene, see `occlusion`.
        rectangle_px: their sides.

    Raises:
        InputError: where a value cannot be used.
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

    def check(self, crop: Sides | None, sides: Sides) -> None:
        """Check that crops of a size can be made of images of a size, both (height, width) in px.

        Raises InputError where a change needs a crop, or the crop does not fit at the largest scale.
        """
        if not self._moves:
            return
        if crop is None:
            raise InputError("expected crop=(height, width): scale, stretch, right_y_px and right_roll_deg need it")
        least = self._least_scale(crop, sides)
        if least > self.scale[1]:
            raise InputError(
                f"expected an upper end of {least:.3g} or more, got {self.scale[1]:g}: a crop of {crop[1]} x {crop[0]} "
                f"px, with {self._margin(sides)} px around it, must fit into {sides[1]} x {sides[0]} px",
                argument="scale",
            )

    def sample(self, crop: Sides | None, sides: Sides, seed: int, sequence: int, epoch: int = 0) -> "SequenceChanges":
        """Sample the changes of a sequence's pairs, from the split's seed, the sequence's number and the epoch.

        `check` must accept the size ``crop`` of the result, None for whole images, and ``sides``, that of the images.
        """
        rng = generator(seed, Purpose.AUGMENTATION, sequence, epoch)
        scale, stretch = (float(np.exp(rng.uniform(*np.log(each)))) for each in (self.scale, self.stretch))
        is_mirrored, is_asymmetric, is_occluded = rng.random(3) < (self.mirrored, self.asymmetric, self.occluded)
        size, margin = sides if crop is None else crop, self._margin(sides)
        least = self._least_scale(size, sides) if self._moves else 0.0
        high, wide = max(scale, least), max(scale * stretch, least)
        right_y_px, right_roll_deg = rng.uniform(*self.right_y_px), rng.uniform(*self.right_roll_deg)
        warp = Warp(wide, high, right_y_px, radians(right_roll_deg), margin)
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
        """Whether pixels move but for the mirror; then the result is a crop."""
        return self.scale != (1, 1) or self.stretch != (1, 1) or self._moves_right

    @property
    def _moves_right(self) -> bool:
        return self.right_y_px != (0, 0) or self.right_roll_deg != (0, 0)

    def _least_scale(self, crop: Sides, sides: Sides) -> float:
        """Return the least scale of images at which a crop fits; inf where none is large enough."""
        room = [side - 2 * self._margin(sides) - 1 for side in sides]  # a part of a pixel takes a whole one
        return max(side / most for side, most in zip(crop, room, strict=True)) if min(room) > 0 else inf

    def _margin(self, sides: Sides) -> int:
        """Return the margin of a moved right image, px: the largest movement at scale 1, and the filters' radius."""
        if not self._moves_right:
            return 0
        turned = sin(radians(max(map(abs, self.right_roll_deg)))) * sum(sides)
        return ceil(turned + max(map(abs, self.right_y_px)) / self.scale[0]) + 5

    def _tone(self, rng: np.random.Generator) -> dict[str, Any]:
        names = ("brightness", "contrast", "saturation", "hue_turns", "gamma")
        tone = {name: float(rng.uniform(*getattr(self, name))) for name in names}
        return tone | {"white_balance": tuple(rng.uniform(*self.white_balance, 3).tolist())}

    def _rectangles(self, rng: np.random.Generator, size: Sides) -> tuple[Crop, ...]:
        """Sample rectangles whose first corner lies in the image, as RAFT-Stereo does."""
        rectangles = []
        for _ in range(rng.integers(1, 3)):
            y, x = (int(rng.integers(side)) for side in size)
            width, height = rng.integers(int(self.rectangle_px[0]), int(self.rectangle_px[1]) + 1, 2).tolist()
            rectangles.append(Crop(x, y, min(width, size[1] - x), min(height, size[0] - y)))
        return tuple(rectangles)


@dataclass(frozen=True, slots=True)
class SequenceChanges:
    """The changes of a sequence's pairs, in the order in which they are made."""

    mirrored: bool
    warp: Warp
    size: Sides | None  # of the result; None for that of the image
    rectangles: tuple[Crop, ...]
    colours: Mapping[Eye, Mapping[str, Any]]  # the keyword arguments of `recoloured`

    @property
    def source(self) -> Sides | None:
        """Height and width of the part of the image that the result is made of, px; None for all of it."""
        return None if self.size is None else self.warp.source(self.size)

    def applied(self, frame: Frame, rng: np.random.Generator) -> Frame:
        """Return the changed pair, from one as large as `source` says; ``rng`` is the source of the noise.

        Raises InputError, which names the change, where the pair lacks what a change needs.
        """
        kept = [name for name, channel in CHANNELS.items() if channel.is_truth or name == "image"]
        frame = Frame(frame.camera, *(ViewArrays({n: v[n] for n in kept if n in v}) for v in (frame.left, frame.right)))
        if self.mirrored:
            frame = mirrored(frame)
        if self.size is not None:
            frame = self.warp.applied(frame, self.size).with_own_masks()
        frame = occluded(frame, self.rectangles)
        images = {eye: frame.view(eye).image for eye in EYES}
        # One mean for both eyes, so that changes that are alike leave them alike.
        contrasts = any(each["contrast"] != 1 for each in self.colours.values())
        mean = mean_luminance(list(images.values())) if contrasts else 0.0
        left, right = (
            frame.view(eye).with_channels({"image": recoloured(images[eye], mean, rng, **self.colours[eye])})
            for eye in EYES
        )
        return Frame(frame.camera, left, right)


PRESETS: Mapping[str, Augmentation] = {
    # RAFT-Stereo's augmentor with the options of its training (--spatial_scale -0.2 0.4 --saturation_range 0 1.4), also
    # IGEV-Stereo's. Its right image moves by whole rows, and its width and height stretch by 2 ** +-0.2 each in
    # four of five samples; here all samples stretch.
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
    # Ours, as benchmarks/training/compare_sets.py chose it: each camera has another exposure, white balance, tone
    # curve and noise. It does not scale: rendered pairs show many scales already, and scaling them taught no more.
    "semisynth": Augmentation(
        brightness=(0.8, 1.2), white_balance=(0.95, 1.05), gamma=(0.75, 1.33), noise=(0, 5), asymmetric=1.0
    ),
    # PSMNet trains on crops that are not changed.
    "psmnet": Augmentation(),
}
"""Augmentations by name; comments say where each comes from."""
