"""A small stereo network: siamese features, a cost volume, regression, refinement.

It learns in minutes what it takes to show that a dataset teaches stereo matching. It is no rival of published networks.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

_DISPARITY_STEP_PX = 4
"""Features and cost volume have a quarter of the image's size."""
_MULTIPLE_PX = 16
"""Inputs are padded to multiples of this: the coarsest features have a stride of 16 px."""
_CHANNELS = 64
"""Of the features that are matched."""
_GROUPS = 16
"""Of these channels, which are correlated group by group."""
_GROUP = 8
"""Channels that are normalised together."""


class Estimates(NamedTuple):
    """Left disparities (B, H, W) px, the final one last; logits (B, D, H/4, W/4), rounded up, of disparities 4 d px.

    ``step_px`` is the step from channel to channel of the scores, and their stride.
    """

    disparities: list[Tensor]
    scores: Tensor
    step_px: int = _DISPARITY_STEP_PX


def _conv(
    inputs: int, outputs: int, *, stride: int = 1, dilation: int = 1, kind: type[nn.Conv2d | nn.Conv3d] = nn.Conv2d
) -> nn.Sequential:
    """A 3 x 3 convolution, normalised by image: batches are small, and crops differ from whole images."""
    return nn.Sequential(
        kind(inputs, outputs, 3, stride, padding=dilation, dilation=dilation, bias=False),
        nn.GroupNorm(outputs // _GROUP, outputs),
        nn.ReLU(inplace=True),
    )


_conv3d = partial(_conv, kind=nn.Conv3d)


class _Residual(nn.Module):
    """Two convolutions and a way around them."""

    def __init__(self, channels: int, dilation: int = 1) -> None:
        super().__init__()
        self.first = _conv(channels, channels, dilation=dilation)
        self.second = _conv(channels, channels, dilation=dilation)

    def forward(self, values: Tensor) -> Tensor:
        changed: Tensor = values + self.second(self.first(values))
        return changed


class _Features(nn.Module):
    """What is compared between the views, and what edges are refined with."""

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
        """Take (B, 3, H, W) to (B, C, H/4, W/4) for matching and (B, 16, H/2, W/2) for refining."""
        half = self.to_half(image)
        quarter = self.to_quarter(half)
        eighth = self.to_eighth(quarter)
        sixteenth = self.to_sixteenth(eighth)
        eighth = self.up_eighth(torch.cat([_resized(sixteenth, eighth), eighth], 1))
        quarter = self.up_quarter(torch.cat([_resized(eighth, quarter), quarter], 1))
        # Each channel's mean goes: otherwise all correlations are high.
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
        """Take (B, groups, D, H, W) to scores (B, D, H, W); the higher, the likelier."""
        entered = self.enter(volume)
        down = self.down(entered)
        down = self.back(down + _resized(self.deeper(down), down))
        scores: Tensor = self.cost(entered + _resized(self.leave(down), entered))
        return scores[:, 0] + self.likeness * volume.mean(1)


class _Refinement(nn.Module):
    """Correct a disparity at half size by what the left image looks like and how well the right one fits."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(_conv(16 + 16 + 1, 24), *(_Residual(24, dilation) for dilation in (1, 3)))
        self.correction = nn.Conv2d(24, 1, 3, padding=1)
        self.weights = nn.Conv2d(24, 4 * 9, 3, padding=1)

    def forward(self, disparity: Tensor, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Take (B, H, W) px, and features (B, 16, H, W), to a corrected (B, H, W), and (B, 2H, 2W) of twice the px."""
        difference = left - warped(right, disparity)
        # Disparities of a few dozen pixels come in as numbers about one.
        known = self.body(torch.cat([left, difference, disparity[:, None] / 32], 1))
        corrected = functional.relu(disparity + self.correction(known)[:, 0])
        return corrected, _upsampled(corrected, self.weights(known))


class StereoNetwork(nn.Module):
    """Left and right image to the disparity of the left view, from 0 to ``max_disparity`` px, rounded up to 16 px."""

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
        # Disparities are in pixels of the size at hand: twice as large at twice the size.
        at_half = 2 * _resized(coarse[:, None], fine)[:, 0]
        corrected, final = self.refinement(at_half, *fine.chunk(2))
        estimates = [
            _DISPARITY_STEP_PX * _resized(coarse[:, None], views)[:, 0],
            2 * _resized(corrected[:, None], views)[:, 0],
            final,
        ]
        return Estimates([estimate[:, :height, :width] for estimate in estimates], scores)


def cross_entropy_loss(found: Estimates, truth: Tensor, valid: Tensor) -> Tensor:
    """Compare scores with the truth (B, H, W) px, where ``valid``; it counts for the levels on both its sides.

    A mean over levels teaches slowly: where it is wrong, it does not say which level is the right one.
    """
    # The pixel next to the middle of each square: a mean would mix what lies before and behind an edge.
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
    """Compare each left feature with the right ones at disparities from 0 to ``levels`` - 1, in groups of channels.

    Takes left and right features (B, C, H, W) to cosines (B, groups, levels, H, W), 0 outside the right view.
    """
    batch, channels, height, width = views[0].shape
    split = [view.reshape(batch, groups, channels // groups, height, width) for view in views]
    one, other = (each * torch.rsqrt(each.square().sum(2, keepdim=True) + 1e-6) for each in split)
    volume = one.new_zeros(batch, groups, levels, height, width)
    for level in range(min(levels, width)):
        volume[:, :, level, :, level:] = (one[..., level:] * other[..., : width - level]).sum(2)
    return volume


def warped(right: Tensor, disparity: Tensor) -> Tensor:
    """Take features (B, C, H, W) of the right view to the left view's pixels, by its disparity (B, H, W) px.

    Values are interpolated linearly, and 0 outside the right view.
    """
    height, width = disparity.shape[-2:]
    rows = torch.arange(height, dtype=right.dtype, device=right.device)
    columns = torch.arange(width, dtype=right.dtype, device=right.device)
    # Corners of the image at -1 and 1, centres of pixels in between.
    x = (2 * (columns - disparity) + 1) / width - 1
    y = ((2 * rows + 1) / height - 1)[:, None].expand_as(x)
    return functional.grid_sample(right, torch.stack([x, y], -1), align_corners=False)


def _upsampled(disparity: Tensor, weights: Tensor) -> Tensor:
    """Double the size of a disparity (B, H, W) px: each pixel is a mean of the 3 x 3 around it, so edges stay sharp.

    ``weights`` (B, 4 * 9, H, W) are logits of what each of 4 pixels takes from its 9 neighbours.
    """
    batch, height, width = disparity.shape
    padded = functional.pad(2 * disparity[:, None], (1, 1, 1, 1), mode="replicate")
    around = functional.unfold(padded, 3).reshape(batch, 1, 9, height, width)
    parts = (weights.reshape(batch, 4, 9, height, width).softmax(2) * around).sum(2)
    return functional.pixel_shuffle(parts, 2)[:, 0]


def _resized(values: Tensor, like: Tensor) -> Tensor:
    """Interpolate linearly to the size of another tensor."""
    mode = "trilinear" if values.ndim == 5 else "bilinear"
    return functional.interpolate(values, size=like.shape[2:], mode=mode, align_corners=False)
