"""A small stereo network: siamese features, a cost volume, regression, refinement.

A few minutes of training show whether networks can learn stereo matching from a dataset. Published networks are better.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

_DISPARITY_STEP_PX = 4  # stride of the matched features, and of the cost volume
_MULTIPLE_PX = 16  # stride of the coarsest features; inputs are padded to multiples of it
_CHANNELS = 64  # number of channels of the matched features
_GROUPS = 16  # number of groups of these channels, which are correlated separately
_GROUP = 8  # number of channels that are normalised together


class Estimates(NamedTuple):
    """Estimates of the left disparity.

    ``disparities`` are (B, H, W) px each, the final one last. ``scores``, (B, D, H/4, W/4) with sides rounded up, are
    logits of the disparities d * ``step_px``, d = 0 to D - 1; ``step_px`` is also their stride.
    """

    disparities: list[Tensor]
    scores: Tensor
    step_px: int = _DISPARITY_STEP_PX


def _conv(
    inputs: int, outputs: int, *, stride: int = 1, dilation: int = 1, kind: type[nn.Conv2d | nn.Conv3d] = nn.Conv2d
) -> nn.Sequential:
    """Return a 3 x 3 convolution with group normalisation, which does not depend on the batch, and ReLU."""
    return nn.Sequential(
        kind(inputs, outputs, 3, stride, padding=dilation, dilation=dilation, bias=False),
        nn.GroupNorm(outputs // _GROUP, outputs),
        nn.ReLU(inplace=True),
    )


_conv3d = partial(_conv, kind=nn.Conv3d)


class _Residual(nn.Module):
    """Two convolutions with a skip connection."""

    def __init__(self, channels: int, dilation: int = 1) -> None:
        super().__init__()
        self.first = _conv(channels, channels, dilation=dilation)
        self.second = _conv(channels, channels, dilation=dilation)

    def forward(self, values: Tensor) -> Tensor:
        changed: Tensor = values + self.second(self.first(values))
        return changed


class _Features(nn.Module):
    """Features for matching, and finer features for refinement."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.to_half = nn.Sequential(_conv(3, 16, stride=2), _conv(16, 16))
        self.to_quarter = nn.Sequential(_conv(16, 32, stride=2), _Residual(32))
        self.to_eighth = nn.Sequential(_conv(32, 64, stride=2), _Residual(64))
        self.to_sixteenth = nn.Sequential(_conv(64, 56, stride=2), _Residual(56))
        self.up_eighth = _conv(56 + 64, 48)
        self.up_quarter = _conv(48 + 32, channels)
        self.out = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Map (B, 3, H, W) to (B, C, H/4, W/4) for matching and (B, 16, H/2, W/2) for refinement."""
        half = self.to_half(image)
        quarter = self.to_quarter(half)
        eighth = self.to_eighth(quarter)
        sixteenth = self.to_sixteenth(eighth)
        eighth = self.up_eighth(torch.cat([_resized(sixteenth, eighth), eighth], 1))
        quarter = self.up_quarter(torch.cat([_resized(eighth, quarter), quarter], 1))
        # Subtracts each channel's mean, without which all correlations are high.
        return functional.instance_norm(self.out(quarter)), half


class _Aggregation(nn.Module):
    """Matching costs smoothed over space and disparity, in an hourglass."""

    def __init__(self, groups: int) -> None:
        super().__init__()
        self.enter = _conv3d(groups, 16)
        self.down = nn.Sequential(_conv3d(16, 32, stride=2), _conv3d(32, 32))
        self.deeper = nn.Sequential(_conv3d(32, 32, stride=2), _conv3d(32, 32))
        self.back = _conv3d(32, 32)
        self.leave = _conv3d(32, 16)
        self.cost = nn.Conv3d(16, 1, 1)
        # A skip connection from the raw correlation gives features a gradient from the first step on.
        self.likeness = nn.Parameter(torch.tensor(12.0))

    def forward(self, volume: Tensor) -> Tensor:
        """Map (B, groups, D, H, W) to scores (B, D, H, W), which are high for likely disparities."""
        entered = self.enter(volume)
        down = self.down(entered)
        down = self.back(down + _resized(self.deeper(down), down))
        scores: Tensor = self.cost(entered + _resized(self.leave(down), entered))
        return scores[:, 0] + self.likeness * volume.mean(1)


class _Refinement(nn.Module):
    """Corrects a disparity at half size by the left features and their difference from the warped right features."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(_conv(16 + 16 + 1, 24), *(_Residual(24, dilation) for dilation in (1, 3)))
        self.correction = nn.Conv2d(24, 1, 3, padding=1)
        self.weights = nn.Conv2d(24, 4 * 9, 3, padding=1)

    def forward(self, disparity: Tensor, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Map (B, H, W) px, and features (B, 16, H, W), to a corrected (B, H, W) and a doubled (B, 2H, 2W) map, px."""
        difference = left - warped(right, disparity)
        # Scaled so that disparities are numbers of the order of 1.
        known = self.body(torch.cat([left, difference, disparity[:, None] / 32], 1))
        corrected = functional.relu(disparity + self.correction(known)[:, 0])
        return corrected, _upsampled(corrected, self.weights(known))


class StereoNetwork(nn.Module):
    """Estimates the left disparity, from 0 to ``max_disparity`` px, which is rounded up to a multiple of 16 px."""

    def __init__(self, max_disparity: int = 80) -> None:
        super().__init__()
        self.levels = 4 * -(-max_disparity // _MULTIPLE_PX)
        self.features = _Features(_CHANNELS)
        self.aggregation = _Aggregation(_GROUPS)
        self.refinement = _Refinement()

    def forward(self, left: Tensor, right: Tensor) -> Estimates:
        """Estimate disparities from images (B, 3, H, W) float32 in [0, 1], of any H and W."""
        height, width = left.shape[-2:]
        # Below and to the right, so that the padding moves no pixel.
        padding = (0, -width % _MULTIPLE_PX, 0, -height % _MULTIPLE_PX)
        views = functional.pad(torch.cat([left, right]) * 2 - 1, padding, mode="replicate")
        matched, fine = self.features(views)
        scores = self.aggregation(correlated(matched.chunk(2), self.levels, _GROUPS))
        levels = torch.arange(self.levels, dtype=scores.dtype, device=scores.device)
        coarse = torch.einsum("bdhw,d->bhw", scores.softmax(1), levels)
        # Disparities are in pixels of their map, so they double with its size.
        at_half = 2 * _resized(coarse[:, None], fine)[:, 0]
        corrected, final = self.refinement(at_half, *fine.chunk(2))
        estimates = [
            _DISPARITY_STEP_PX * _resized(coarse[:, None], views)[:, 0],
            2 * _resized(corrected[:, None], views)[:, 0],
            final,
        ]
        return Estimates([estimate[:, :height, :width] for estimate in estimates], scores)


def cross_entropy_loss(found: Estimates, truth: Tensor, valid: Tensor) -> Tensor:
    """Return the cross-entropy of the scores where ``valid``; the truth (B, H, W) px is split between two levels.

    Networks learn faster by it than by the error of the mean over levels, which does not say which level is right.
    """
    # Takes the pixel next to the middle of each square, since a mean would mix surfaces at edges.
    step = found.step_px
    truth, valid = (each[:, step // 2 :: step, step // 2 :: step] for each in (truth, valid))
    height, width = truth.shape[1:]
    shares = found.scores[..., :height, :width].float().log_softmax(1)
    level = (torch.where(valid, truth, 0) / step).clamp(max=shares.shape[1] - 1)
    low = level.floor().long()
    high = (low + 1).clamp(max=shares.shape[1] - 1)
    found_low, found_high = (shares.gather(1, each[:, None])[:, 0] for each in (low, high))
    missed = -torch.lerp(found_low, found_high, level - low)
    return torch.where(valid, missed, 0).sum() / valid.sum().clamp(min=1)


def correlated(views: Sequence[Tensor], levels: int, groups: int) -> Tensor:
    """Correlate left features with right features at disparities from 0 to ``levels`` - 1, in groups of channels.

    Maps left and right features (B, C, H, W) to cosines (B, groups, levels, H, W), 0 outside the right view.
    """
    batch, channels, height, width = views[0].shape
    split = [view.reshape(batch, groups, channels // groups, height, width) for view in views]
    left, right = (each * torch.rsqrt(each.square().sum(2, keepdim=True) + 1e-6) for each in split)
    volume = left.new_zeros(batch, groups, levels, height, width)
    for level in range(min(levels, width)):
        volume[:, :, level, :, level:] = (left[..., level:] * right[..., : width - level]).sum(2)
    return volume


def warped(right: Tensor, disparity: Tensor) -> Tensor:
    """Warp features (B, C, H, W) of the right view to the left view, given its disparity (B, H, W) px.

    Values are interpolated linearly, and are 0 outside the right view.
    """
    height, width = disparity.shape[-2:]
    rows = torch.arange(height, dtype=right.dtype, device=right.device)
    columns = torch.arange(width, dtype=right.dtype, device=right.device)
    # grid_sample's coordinates are -1 and 1 at the image's borders.
    x = (2 * (columns - disparity) + 1) / width - 1
    y = ((2 * rows + 1) / height - 1)[:, None].expand_as(x)
    return functional.grid_sample(right, torch.stack([x, y], -1), align_corners=False)


def _upsampled(disparity: Tensor, weights: Tensor) -> Tensor:
    """Double the size and values of a disparity (B, H, W) px by convex upsampling, which keeps edges sharp.

    Each of the 4 new pixels is a mean of the 3 x 3 pixels around it; ``weights`` (B, 4 * 9, H, W) are logits.
    """
    batch, height, width = disparity.shape
    padded = functional.pad(2 * disparity[:, None], (1, 1, 1, 1), mode="replicate")
    around = functional.unfold(padded, 3).reshape(batch, 1, 9, height, width)
    parts = (weights.reshape(batch, 4, 9, height, width).softmax(2) * around).sum(2)
    return functional.pixel_shuffle(parts, 2)[:, 0]


def _resized(values: Tensor, like: Tensor) -> Tensor:
    """Interpolate linearly to the size of ``like``."""
    mode = "trilinear" if values.ndim == 5 else "bilinear"
    return functional.interpolate(values, size=like.shape[2:], mode=mode, align_corners=False)
