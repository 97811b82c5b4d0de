"""From a pair to a sample: cut to a crop, changed by an augmentation, and given to a transform."""

from collections.abc import Callable, Sequence
from numbers import Integral
from typing import Any

import numpy as np
import torch

from semisynth_gl.augmentation import Augmentation
from semisynth_gl.frame.camera import EYES, Crop
from semisynth_gl.frame.channels import CHANNELS, View
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError, shown
from semisynth_gl.seeds.seeds import LARGEST_NUMBER, Purpose, generator
from semisynth_gl.torch.samples import Sample, to_sample

Transform = Callable[[Sample], Any]


class SampleMaker:
    """What a dataset makes of a pair.

    Args:
        sides: height and width of the images, px.
        crop: height and width, px; None for whole images.
        augmentation: changes of each pair; None for none.
        transform: gets the sample and returns the object to use instead.

    Raises:
        InputError: where the crop does not fit, or an argument is of another type.
    """

    def __init__(
        self,
        sides: tuple[int, int],
        crop: tuple[int, int] | None,
        augmentation: Augmentation | None,
        transform: Transform | None,
    ) -> None:
        fits = crop is None or (
            isinstance(crop, Sequence)
            and len(crop) == 2
            and all(isinstance(side, Integral) and 1 <= side <= most for side, most in zip(crop, sides, strict=True))
        )
        if not fits:
            raise InputError(f"crop: expected (height, width), whole numbers of up to {sides} px, got {shown(crop)}")
        if augmentation is not None:
            augmentation.check(crop, sides)
        if transform is not None and not callable(transform):
            raise InputError(f"transform must be a function of a sample, got {shown(transform)}")
        self._sides, self._crop, self._augmentation, self._transform = sides, crop, augmentation, transform
        # In shared memory, for workers that outlive an epoch. PyTorch has no types for the method that puts it there.
        epoch: Any = torch.zeros((), dtype=torch.int64)
        self._epoch = epoch.share_memory_()

    def set_epoch(self, epoch: int) -> None:
        """Choose the crops and changes of an epoch, from 0; copies of this object in worker processes follow.

        Raises:
            InputError: where the epoch is not a whole number of 0 or more.
        """
        self._epoch.fill_(to_whole("epoch", epoch, 0, LARGEST_NUMBER))

    def make(self, index: int, sequence: int, seed: int, pair: Callable[[Crop | None], Frame]) -> Any:  # noqa: ANN401 - what the transform returns
        """Make a sample; the seed, the sequence and the epoch decide its crop and its changes.

        Args:
            index: the pair's number in its split.
            sequence: number of the pair's sequence, whose frames all get the same crop, so that flow leads from frame
                to frame.
            seed: of the split.
            pair: returns the pair, cut to a crop where it gets one.

        Raises:
            InputError: where the pair lacks what a change needs.
        """
        epoch, changes, size = int(self._epoch), None, self._crop
        if self._augmentation is not None:
            changes = self._augmentation.sample(self._crop, self._sides, seed, sequence, epoch)
            size = changes.source
        frame = pair(None if size is None else _choose_crop(size, self._sides, seed, sequence, epoch))
        if self._augmentation is None or changes is None:
            sample = to_sample(index, frame if size is None else _with_own_masks(frame))
        else:
            noise = generator(seed, Purpose.AUGMENTATION, index, epoch, "noise")
            sample = to_sample(index, changes.applied(frame, noise))
        return sample if self._transform is None else self._transform(sample)


def _choose_crop(crop: tuple[int, int], sides: tuple[int, int], seed: int, sequence: int, epoch: int) -> Crop:
    """Choose the place of a crop (height, width) at random in images of ``sides`` (height, width), px."""
    rng = generator(seed, Purpose.CROP, sequence, *([epoch] if epoch else []))
    height, width = crop
    x, y = rng.integers(sides[1] - width + 1), rng.integers(sides[0] - height + 1)
    return Crop(int(x), int(y), int(width), int(height))


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
