"""A pair as a dictionary of tensors."""

from typing import Any

import torch

from semisynth_gl.pairs.pipeline import Pair

Sample = dict[str, Any]
"""What a stream yields for a pair, before `transform`: see `to_sample`."""

_CAMERA = ("focal_px", "baseline_m", "doffs_px", "cx_left_px", "cx_right_px", "cy_px")


def to_sample(pair: Pair) -> Sample:
    """Make a dictionary of a pair that default_collate can batch.

    Returns:
        ``index``, int; ``camera``, a dictionary of floats (``focal_px``, ``baseline_m``, ``doffs_px`` and the principal
        points; of a crop, the crop's); and each array of `Frame.arrays`, under its role: images as (3, H, W)
        uint8, normals as (3, H, W) float32, flow as (2, H, W) float32, ids as (H, W) int32, the rest as (H, W) of its
        own type.
    """
    frame = pair.frame
    camera = {name: float(getattr(frame.camera, name)) for name in _CAMERA}
    tensors = {role: _tensor(array) for role, array in frame.arrays().items()}
    return {"index": pair.index, "camera": camera, **tensors}


def _tensor(array: Any) -> torch.Tensor:  # noqa: ANN401 - an array, or what a reader has made instead
    tensor = torch.as_tensor(array)
    if tensor.dtype == torch.uint16:
        # torch can do next to nothing with it.
        tensor = tensor.to(torch.int32)
    return tensor.permute(2, 0, 1).contiguous() if tensor.ndim == 3 else tensor.contiguous()
