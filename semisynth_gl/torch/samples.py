"""A pair as a dictionary of tensors; batches of dictionaries."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.nn.functional import pad
from torch.utils.data import default_collate

from semisynth_gl.frame.channels import ROLES
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError

Sample = dict[str, Any]
"""A pair as `StereoStream` and `StereoDataset` make it, before `transform`: see `to_sample`."""

_CAMERA = ("focal_px", "focal_y_px", "baseline_m", "doffs_px", "cx_left_px", "cx_right_px", "cy_px")


def to_sample(index: int, frame: Frame) -> Sample:
    """Return a pair as a dictionary that default_collate can batch.

    Args:
        index: the pair's number in its split.
        frame: a pair, rendered or read from files.

    Returns:
        ``index``, an int; ``camera``, a dictionary of floats; and each array of `Frame.arrays` as a tensor under its
        role. The camera has ``focal_px``, ``focal_y_px`` (which differs in a stretched pair, and where
        ``camera.fy_over_fx`` is not 1), ``baseline_m``, ``doffs_px``, the principal points ``cx_left_px``,
        ``cx_right_px`` and ``cy_px`` (in a crop, in the crop's pixels), and the right camera's deviation:
        ``right_roll_rad``, ``right_pitch_rad``, ``right_y_px`` and ``focal_ratio``.

        Images are (3, H, W) uint8, or (1, H, W) from a monochrome camera, and raw images have H and W of the sensor;
        normals are (3, H, W) float32; flow, correspondences and maps into raw images are (2, H, W) float32; ids are
        (H, W) int32; all other arrays are (H, W) of their own dtype.
    """
    deviation = frame.camera.deviation
    camera = {name: float(getattr(frame.camera, name)) for name in _CAMERA}
    camera |= {f"right_{name}": float(getattr(deviation, name)) for name in ("roll_rad", "pitch_rad", "y_px")}
    camera["focal_ratio"] = float(deviation.focal_ratio)
    tensors = {role: _tensor(array) for role, array in frame.arrays().items()}
    images = {role: tensor for role, tensor in tensors.items() if ROLES[role][1].is_image}
    tensors |= {role: image.reshape(-1, *image.shape[-2:]) for role, image in images.items()}
    return {"index": index, "camera": camera, **tensors}


def collate(samples: Sequence[Sample]) -> Sample:
    """Batch samples whose sizes or keys differ: ``DataLoader(..., collate_fn=collate)``.

    Smaller arrays get columns on the right and rows at the bottom, filled with the value that stands for "nothing": inf
    for disparity, depth, flow and the like, 0 for images, masks, normals and ids. Since padding moves no pixel, the
    cameras stay true. Grey images in a batch with colour images get three equal channels. Keys that some of the samples
    lack are left out. In all other respects this is PyTorch's default_collate.

    Args:
        samples: dictionaries, as `to_sample` makes them; further keys are batched by default_collate.

    Returns:
        ``left`` (B, 3, H, W), ``disparity_left`` (B, H, W) and so on, with the largest H and W of the batch.

    Raises:
        InputError: where there is no sample.
    """
    if not samples:
        raise InputError("expected one or more, got none", argument="samples")
    return {
        name: default_collate(_of_one_size(name, [sample[name] for sample in samples]))
        for name in samples[0]
        if all(name in sample for sample in samples)
    }


def _tensor(array: Any) -> torch.Tensor:  # noqa: ANN401 - an array, or what a reader has made instead
    if isinstance(array, np.ndarray):
        # Arrays read from files may be views of the bytes, upside down or read-only; torch takes neither.
        array = np.require(array, requirements=("C", "W"))
    tensor = torch.as_tensor(array)
    if tensor.dtype == torch.uint16:
        # torch has hardly any operations for uint16.
        tensor = tensor.to(torch.int32)
    return tensor.permute(2, 0, 1).contiguous() if tensor.ndim == 3 else tensor.contiguous()


def _of_one_size(name: str, values: list[Any]) -> list[Any]:
    """Pad the arrays of a role to the largest height and width; return the values of other keys as they are."""
    if name not in ROLES:
        return values
    channel = ROLES[name][1]
    if channel.is_image and len({value.shape[0] for value in values}) > 1:
        values = [value.expand(3, -1, -1) for value in values]
    height, width = (max(value.shape[axis] for value in values) for axis in (-2, -1))
    return [
        pad(value, (0, width - value.shape[-1], 0, height - value.shape[-2]), value=channel.nothing)
        if value.shape[-2:] != (height, width)
        else value
        for value in values
    ]
