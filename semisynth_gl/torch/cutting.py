"""From a pair to a sample: the part that is cut out of it, and the changes of an augmentation."""

from collections.abc import Sequence
from numbers import Integral
from typing import Any

import numpy as np
import torch

from semisynth_gl.augmentation import Augmentation, Drawn
from semisynth_gl.frame.camera import EYES, Crop
from semisynth_gl.frame.channels import CHANNELS, View
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError, shown
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.torch.samples import Sample, to_sample


class Cutting:
    """What a stream or a dataset does to each pair before it becomes a sample: it cuts a crop out and changes it.

    Args:
        crop: height and width, px; None for whole images.
        augmentation: changes; None for none.
        sides: height and width of the images, px.
        whose: the owner of the images in messages.

    Raises:
        InputError: where the crop does not fit, or an argument is of another type.
    """

    def __init__(
        self, crop: tuple[int, int] | None, augmentation: Augmentation | None, sides: tuple[int, int], whose: str
    ) -> None:
        if crop is not None:
            check_crop(crop, sides, whose)
        if augmentation is not None:
            augmentation.check(crop, sides)
        self._crop, self._augmentation, self._sides = crop, augmentation, sides

    @property
    def identity(self) -> dict[str, Any]:
        """What decides the samples, in JSON's types; without an augmentation there is no such key."""
        crop = {"crop": self._crop and [int(side) for side in self._crop]}
        return crop if self._augmentation is None else crop | {"augmentation": self._augmentation.values}

    def draw(self, seed: int, sequence: int, epoch: int = 0) -> tuple[Crop | None, Drawn | None]:
        """Draw the part of the images that the samples of a sequence are made of, and their changes; None for neither.

        Args:
            seed: of the split.
            sequence: number of the sequence.
            epoch: from 0.
        """
        drawn, size = None, self._crop
        if self._augmentation is not None:
            drawn = self._augmentation.draw(self._crop, self._sides, seed, sequence, epoch)
            size = drawn.source
        return None if size is None else draw_crop(size, self._sides, seed, sequence, epoch), drawn

    def sample(self, frame: Frame, drawn: Drawn | None, seed: int, index: int, epoch: int = 0) -> Sample:
        """Return a sample.

        Args:
            frame: the part of a pair that `draw` says.
            drawn: the changes that it says.
            seed: of the split.
            index: the pair's number in its split.
            epoch: from 0.

        Raises:
            InputError: where the pair lacks what a change needs.
        """
        if self._augmentation is None or drawn is None:
            return to_sample(index, frame if self._crop is None else _with_own_masks(frame))
        sample = to_sample(index, drawn.applied(frame, self._augmentation.noise_rng(seed, index, epoch)))
        return sample | {"augmentation": drawn.record()} if self._augmentation.recorded else sample


def _with_own_masks(frame: Frame) -> Frame:
    """Return a crop with masks of its own; those of tensors on a GPU take the way through the computer's memory."""
    if isinstance(frame.left.image, np.ndarray):
        return frame.with_own_masks()
    views = [{name: tensor.cpu().numpy() for name, tensor in frame.view(eye).items()} for eye in EYES]
    masked = Frame(frame.camera, *map(View, views)).with_own_masks()
    masks = {channel.mask for channel in CHANNELS.values()}
    left, right = (
        view.with_channels(
            {name: torch.from_numpy(masked.view(eye)[name]).to(view.image.device) for name in masks & set(view)}
        )
        for eye, view in zip(EYES, (frame.left, frame.right), strict=True)
    )
    return Frame(frame.camera, left, right)


def check_crop(crop: Any, sides: tuple[int, int], whose: str) -> None:  # noqa: ANN401 - that is what it checks
    """Check that a crop (height, width) fits into images of ``sides`` (height, width), px; otherwise raise InputError.

    ``whose`` names the owner of the images in the message.
    """
    whole = isinstance(crop, Sequence) and len(crop) == 2 and all(isinstance(side, Integral) for side in crop)
    if not whole or not all(1 <= side <= most for side, most in zip(crop, sides, strict=True)):
        raise InputError(
            f"crop: expected (height, width), whole numbers of up to {sides} px, the image size of {whose}, got "
            f"{shown(crop)}"
        )


def draw_crop(crop: tuple[int, int], sides: tuple[int, int], seed: int, sequence: int, epoch: int = 0) -> Crop:
    """Draw the place of a crop (height, width) in images of ``sides`` (height, width), px.

    The place depends on the split's ``seed``, the number of the ``sequence`` and the ``epoch``. All frames of a
    sequence get the same place, so that flow leads from frame to frame.
    """
    rng = generator(seed, Purpose.CROP, sequence, *([epoch] if epoch else []))
    height, width = crop
    x, y = rng.integers(sides[1] - width + 1), rng.integers(sides[0] - height + 1)
    return Crop(int(x), int(y), int(width), int(height))
