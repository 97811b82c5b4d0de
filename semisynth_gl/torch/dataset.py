"""`StereoDataset` reads the pairs of a written dataset as dictionaries of tensors, cropped and augmented if asked."""

from collections.abc import Callable
from os import PathLike
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from semisynth_gl.augmentation.augmentation import Augmentation
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.frame.camera import Crop
from semisynth_gl.frame.channels import CHANNELS, ROLES
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError, shown
from semisynth_gl.seeds.seeds import LARGEST_NUMBER, Purpose, generator
from semisynth_gl.seeds.splits import Split, SplitName

Sample = dict[str, Any]
"""A sample before ``transform``, see `to_sample`."""
Transform = Callable[[Sample], Any]

_CAMERA = ("focal_px", "focal_y_px", "baseline_m", "doffs_px", "cx_left_px", "cx_right_px", "cy_px")


class PairDatasetBase(Dataset[Any]):
    """Base of both datasets: crops, augments and transforms each pair into a sample.

    ``image_size`` is height and width of the images, px; `StereoStream` describes the other arguments. Raises
    InputError if the crop does not fit.
    """

    def __init__(
        self,
        image_size: tuple[int, int],
        crop: tuple[int, int] | None,
        augmentation: Augmentation | None,
        transform: Transform | None,
    ) -> None:
        if crop is not None:
            if np.shape(crop) != (2,):
                raise InputError(f"expected (height, width), got {shown(crop)}", argument="crop")
            crop = to_whole("crop", crop[0], 1, image_size[0]), to_whole("crop", crop[1], 1, image_size[1])
        if augmentation is not None:
            augmentation.check(crop, image_size)
        self._image_size, self._crop, self._augmentation, self._transform = image_size, crop, augmentation, transform
        # In shared memory, so that persistent workers see a new epoch. PyTorch has no types for share_memory_.
        epoch: Any = torch.zeros((), dtype=torch.int64)
        self._epoch = epoch.share_memory_()

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch, which is 0 at first: each epoch has other crops and changes. Running workers use it at once.

        Raises InputError if the epoch is not a whole number of 0 or more.
        """
        self._epoch.fill_(to_whole("epoch", epoch, 0, LARGEST_NUMBER))

    def _sample(self, index: int, sequence: int, seed: int, read: Callable[[Crop | None], Frame]) -> Any:  # noqa: ANN401 - what the transform returns
        """Make a sample, whose crop and changes depend on the split's ``seed``, the sequence and the epoch.

        All frames of a sequence have the same crop, so that flow is valid between them. ``read`` returns the pair, or
        the given crop of it. Raises InputError if the pair lacks something that a change needs.
        """
        epoch, size, crop, changes = int(self._epoch), self._crop, None, None
        if self._augmentation is not None:
            changes = self._augmentation.sample(size, self._image_size, seed, sequence, epoch)
            size = changes.source_size
        if size is not None:
            rng = generator(seed, Purpose.CROP, sequence, *([epoch] if epoch else []))
            x, y = (int(rng.integers(self._image_size[axis] - size[axis] + 1)) for axis in (1, 0))
            crop = Crop(x, y, size[1], size[0])
        frame = read(crop)
        if changes is not None:
            frame = changes.applied(frame, generator(seed, Purpose.AUGMENTATION, index, epoch, "noise"))
        elif crop is not None:
            frame = _with_own_masks(frame)
        sample = to_sample(index, frame)
        return sample if self._transform is None else self._transform(sample)


def _with_own_masks(frame: Frame) -> Frame:
    """Recompute the masks of a crop, as `Frame.with_own_masks` does; the channels may be arrays or tensors."""
    if isinstance(frame.left.image, np.ndarray):
        return frame.with_own_masks()
    tensors: dict[str, Any] = frame.arrays()
    arrays = {role: tensor.cpu().numpy() for role, tensor in tensors.items()}
    masks = {channel.mask for channel in CHANNELS.values()}
    for role, array in Frame.from_arrays(frame.camera, arrays).with_own_masks().arrays().items():
        if ROLES[role][1].name in masks:
            tensors[role] = torch.from_numpy(array).to(tensors[role].device)
    return Frame.from_arrays(frame.camera, tensors)


def to_sample(index: int, frame: Frame) -> Sample:
    """Return a pair as a dictionary that default_collate can batch; ``index`` is the pair's number in its split.

    Returns:
        ``index``, an int; ``camera``, a dictionary of floats; and each array of `Frame.arrays` as a tensor under its
        role. The camera has ``focal_px``, ``focal_y_px``, ``baseline_m``, ``doffs_px``, the principal points
        ``cx_left_px``, ``cx_right_px`` and ``cy_px`` (in pixels of the crop), and the right camera's deviation:
        ``right_roll_rad``, ``right_pitch_rad``, ``right_y_px`` and ``focal_ratio``.

        Images are (3, H, W) uint8, or (1, H, W) from a monochrome camera. Normals are (3, H, W) float32; flow,
        correspondences and maps into raw images are (2, H, W) float32; ids are (H, W) int32. All other arrays are
        (H, W) with their dtype in `Frame`. Raw images have the sensor's H and W.
    """
    deviation = frame.camera.deviation
    camera = {name: float(getattr(frame.camera, name)) for name in _CAMERA}
    camera |= {f"right_{name}": float(getattr(deviation, name)) for name in ("roll_rad", "pitch_rad", "y_px")}
    camera["focal_ratio"] = float(deviation.focal_ratio)
    tensors = {role: _tensor(array) for role, array in frame.arrays().items()}
    images = {role: tensor for role, tensor in tensors.items() if ROLES[role][1].is_image}
    tensors |= {role: image.reshape(-1, *image.shape[-2:]) for role, image in images.items()}
    return {"index": index, "camera": camera, **tensors}


def _tensor(array: Any) -> torch.Tensor:  # noqa: ANN401 - an array or, from `CudaPixelReader`, a tensor
    if isinstance(array, np.ndarray):
        # Codecs may return negative strides, which torch refuses, and read-only arrays, of which it warns.
        array = np.require(array, requirements=("C", "W"))
    tensor = torch.as_tensor(array)
    if tensor.dtype == torch.uint16:  # torch has few operations for uint16
        tensor = tensor.to(torch.int32)
    return tensor.permute(2, 0, 1).contiguous() if tensor.ndim == 3 else tensor.contiguous()


class StereoDataset(PairDatasetBase):
    """A map-style dataset of the pairs of a written dataset in any layout.

    A sample is a dictionary, see `to_sample`. It equals the sample of a `StereoStream`, except for values that files
    round, as JPEG and 16-bit PNG do. Each access opens and closes the pair's files, so the dataset can be pickled, and
    workers may be forked or spawned. OpenGL is not needed.

    Args:
        address: the dataset's folder, or an address that fsspec knows.
        split: a split of the dataset; None for all pairs, training pairs first.
        crop: height and width, px, of a random crop of each pair; None for whole images.
        seed: seed of crops and augmentation. By default it is the dataset's seed, which gives the same crops and
            changes as a `StereoStream`.
        augmentation: changes of each pair, before the transform.
        transform: a function of the sample; its result replaces the sample.

    Attributes:
        pairs: the result of `open_dataset`; ``dataset.pairs[i].provenance`` says how a pair was made.

    Raises:
        InputError: if the address has no dataset, the dataset is not finished or has no such split, or an argument
            cannot be used.
        ReadError: if the dataset's index is damaged.
    """

    def __init__(
        self,
        address: str | PathLike[str],
        split: SplitName | None = "train",
        *,
        crop: tuple[int, int] | None = None,
        seed: int | None = None,
        augmentation: Augmentation | None = None,
        transform: Transform | None = None,
    ) -> None:
        self.pairs = open_dataset(address, split)
        plan = self.pairs.index.plan
        self._seed = plan.seed if seed is None else to_whole("seed", seed, least=0)
        self._pairs_in_sequence = plan.config.sequence.length * plan.views
        super().__init__(plan.size, crop, augmentation, transform)

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, number: int) -> Any:  # noqa: ANN401 - what the transform returns
        """Read a sample; its ``index`` is the pair's number in its split.

        Raises:
            InputError: if ``number`` is not a whole number, or a codec needs a package that is not installed.
            IndexError: if the dataset has fewer pairs.
            ReadError: if a file is missing, truncated or cannot be read.
        """
        split, index = self.pairs.pair(number)

        def read(crop: Crop | None) -> Frame:
            frame = self.pairs[number]
            return frame if crop is None else frame.cropped(crop)

        return self._sample(index, index // self._pairs_in_sequence, Split(self._seed, split).seed, read)
