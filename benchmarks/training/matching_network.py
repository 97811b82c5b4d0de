"""A stereo network that learns in minutes on one thread of a processor, and tells training sets apart.

The right disparity is chosen among bins of 2 px, at a quarter of the image's size; the place within a bin is the mean
of the likeliest bins around the best one. What is left is corrected at half size, by what the images show there once
the right one is warped.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

sys.path.append(str(Path(__file__).resolve().parents[2] / "examples"))

from stereo_network import warped

BIN_PX = 2
_STEP = 4
"""Pixels of the image from one choice among the bins to the next, each way."""
_MULTIPLE_PX = 8
"""Sides that every level of the network divides."""
GROUPS = 4
_GROUP_NORM = 8
_WINDOW = 2
"""Bins to each side of the best one that its mean is taken of."""
_NEAR_LOSS = 0.7
"""Weight of the disparity before it is corrected."""
_LARGEST_ERROR_PX = 8.0


class Matched(NamedTuple):
    """What the network says of a batch of pairs.

    Attributes:
        scores: (B, D, H/4, W/4), rounded up: logits of the bins, the middle of bin i being at 2 i px.
        near: (B, H/4, W/4) px of the whole size, the place within the best bins.
        final: (B, H, W) px.
    """

    scores: Tensor
    near: Tensor
    final: Tensor


Stride = int | tuple[int, ...]


def _conv(inputs: int, outputs: int, *, stride: Stride = 1, dilation: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, padding=dilation, dilation=dilation, bias=False),
        nn.GroupNorm(outputs // _GROUP_NORM, outputs),
        nn.ReLU(inplace=True),
    )


def _conv3d(inputs: int, outputs: int, *, stride: Stride = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(inputs, outputs, 3, stride, padding=1, bias=False),
        nn.GroupNorm(outputs // _GROUP_NORM, outputs),
        nn.ReLU(inplace=True),
    )


class _Residual(nn.Module):
    def __init__(self, body: nn.Module) -> None:
        super().__init__()
        self.body = body

    def forward(self, values: Tensor) -> Tensor:
        changed: Tensor = values + self.body(values)
        return changed


class _Features(nn.Module):
    """Images (B, 3, H, W) to what is matched, (B, 32 w, H/4, W/2), and what is corrected with, (B, 16 w, H/2, W/2).

    Columns are what disparities are read from, so there are twice as many of them as of rows.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        fine, middle, coarse = 16 * width, 32 * width, 48 * width
        self.fine = nn.Sequential(nn.PixelUnshuffle(2), _conv(12, fine))
        self.middle = nn.Sequential(_conv(fine, middle, stride=(2, 1)), _Residual(_conv(middle, middle)))
        self.coarse = nn.Sequential(
            _conv(middle, coarse, stride=2), _Residual(_conv(coarse, coarse)), _Residual(_conv(coarse, coarse))
        )
        # Larger by turning channels into pixels, which takes a processor less time than interpolation.
        self.up = nn.Sequential(nn.Conv2d(coarse, 4 * middle, 1), nn.PixelShuffle(2))
        self.out = nn.Conv2d(middle, middle, 3, padding=1)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        fine = self.fine(images)
        middle = self.middle(fine)
        return self.out(middle + self.up(self.coarse(middle))), fine


class _Aggregation(nn.Module):
    """Likenesses (B, G, D, H/4, W/4) to scores (B, D, H/4, W/4), smoothed over space and disparity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        quarter, eighth = 8 * width, 24 * width
        self.enter = _conv3d(GROUPS, quarter, stride=(2, 1, 1))
        self.at_quarter = _Residual(_conv3d(quarter, quarter))
        self.to_eighth = nn.Sequential(
            _conv3d(quarter, eighth, stride=2), _Residual(_conv3d(eighth, eighth)), _Residual(_conv3d(eighth, eighth))
        )
        self.up_quarter = nn.Conv3d(eighth, 8 * quarter, 1)
        self.leave = _conv3d(quarter, quarter)
        # Two scores for each level of the pairs that the first layer made.
        self.cost = nn.Conv3d(quarter, 2, 3, padding=1)
        self.likeness = nn.Parameter(torch.tensor(8.0))

    def forward(self, volume: Tensor) -> Tensor:
        quarter = self.at_quarter(self.enter(volume))
        quarter = self.leave(quarter + _shuffled(self.up_quarter(self.to_eighth(quarter))))
        cost = self.cost(quarter).transpose(1, 2).flatten(1, 2)
        return cost + self.likeness * volume.mean(1)


def _shuffled(values: Tensor) -> Tensor:
    """Turn (B, 8 C, D, H, W) into (B, C, 2 D, 2 H, 2 W)."""
    batch, channels, levels, height, width = values.shape
    parts = values.reshape(batch, channels // 8, 2, 2, 2, levels, height, width)
    return parts.permute(0, 1, 5, 2, 6, 3, 7, 4).reshape(batch, channels // 8, 2 * levels, 2 * height, 2 * width)


def likenesses(left: Tensor, right: Tensor, levels: int) -> Tensor:
    """Compare every second feature of a row of the left view with those of the right view to its left.

    Args:
        left: (B, C, H, W), W even.
        right: likewise.
        levels: how many disparities, from 0 on.

    Returns:
        Cosines (B, groups, levels, H, W/2), 0 where the point would lie outside the right view.
    """
    batch, channels, height, width = left.shape
    shape = batch, GROUPS, channels // GROUPS, height, -1
    one, other = (_unit(each.reshape(shape)) for each in (left[..., ::2], right))
    other = functional.pad(other, (levels - 1, 0))
    # All of a row with all of a row, of which a band is kept: on a processor faster than shifting level by level.
    rows = torch.einsum("bgchx,bgchy->bghxy", one, other).contiguous()
    strides = (*rows.stride()[:3], width + levels - 1 + 2, 1)
    band = rows.as_strided((batch, GROUPS, height, width // 2, levels), strides, rows.storage_offset())
    return band.flip(-1).permute(0, 1, 4, 2, 3)


def _unit(features: Tensor) -> Tensor:
    """Scale vectors (B, groups, C, H, W) to length 1 along C."""
    return features * torch.rsqrt(features.square().sum(2, keepdim=True) + 1e-6)


class _Correction(nn.Module):
    """A disparity at half size to one at the image's size, by both views' features there."""

    def __init__(self, width: int) -> None:
        super().__init__()
        inner = 16 * width
        self.body = nn.Sequential(
            _conv(2 * 16 * width + 1, inner),
            _Residual(_conv(inner, inner, dilation=2)),
            _Residual(_conv(inner, inner)),
        )
        # For each of the 2 x 2 pixels: weights of the 3 x 3 around, so that edges can stay sharp, and a correction.
        self.out = nn.Conv2d(inner, 4 * (9 + 1), 3, padding=1)

    def forward(self, near: Tensor, left: Tensor, right: Tensor) -> Tensor:
        """Take (B, H/4, W/4) px of the whole size to (B, H, W).

        Args:
            near: the disparity so far.
            left: (B, C, H/2, W/2).
            right: the same of the right view.
        """
        near = functional.interpolate(near[:, None], scale_factor=2.0, mode="nearest")[:, 0]
        difference = left - warped(right, near / 2)
        told = self.out(self.body(torch.cat([left, difference, near[:, None] / 16], 1))).float()
        batch, height, width = near.shape
        told = told.reshape(batch, 4, 10, height, width)
        around = functional.unfold(functional.pad(near[:, None], (1, 1, 1, 1), mode="replicate"), 3)
        around = around.reshape(batch, 1, 9, height, width)
        parts = (told[:, :, :9].softmax(2) * around).sum(2) + told[:, :, 9]
        return functional.relu(functional.pixel_shuffle(parts, 2)[:, 0])


class MatchingNetwork(nn.Module):
    """Left and right image to the disparity of the left view.

    Args:
        max_disparity: px; what is searched is [0, max_disparity), rounded up to a multiple of 8.
        width: factor of all numbers of channels.
    """

    def __init__(self, max_disparity: int = 40, width: int = 1) -> None:
        super().__init__()
        self.levels = 4 * -(-max_disparity // (4 * BIN_PX))
        self.features = _Features(width)
        self.aggregation = _Aggregation(width)
        self.correction = _Correction(width)

    def forward(self, left: Tensor, right: Tensor) -> Matched:
        """Estimate disparities.

        Args:
            left: (B, 3, H, W) float32 in [0, 1], any H and W.
            right: likewise.
        """
        height, width = left.shape[-2:]
        # Below and to the right, so that the padding moves no pixel.
        padding = (0, -width % _MULTIPLE_PX, 0, -height % _MULTIPLE_PX)
        views = functional.pad(torch.cat([left, right]) * 2 - 1, padding, mode="replicate")
        matched, fine = self.features(views)
        one, other = matched.float().chunk(2)
        scores = self.aggregation(likenesses(one, other, self.levels)).float()
        near = BIN_PX * local_level(scores)
        # The scores learn by themselves: what is corrected should not depend on how it came about.
        final = self.correction(near.detach(), *fine.float().chunk(2))
        rows, columns = -(-height // _STEP), -(-width // _STEP)
        return Matched(scores[:, :, :rows, :columns], near[:, :rows, :columns], final[:, :height, :width])


def local_level(scores: Tensor) -> Tensor:
    """Return the mean level (B, H, W) of the bins next to the best of scores (B, D, H, W), weighted by softmax."""
    levels = torch.arange(scores.shape[1], dtype=scores.dtype, device=scores.device)[:, None, None]
    far = (levels - scores.argmax(1, keepdim=True)).abs() > _WINDOW
    shares = scores.masked_fill(far, -torch.inf).softmax(1)
    return (shares * levels).sum(1)


def matching_loss(matched: Matched, truth: Tensor, max_disparity: float) -> Tensor:
    """Cross-entropy of the bins, and L1 of the disparities.

    Args:
        matched: of the network.
        truth: (B, H, W) px; pixels that are not finite, not positive, or not below max_disparity are left out.
        max_disparity: px.

    Returns:
        A number; 0 where there is no pixel to learn from.
    """
    valid = torch.isfinite(truth) & (truth > 0) & (truth < max_disparity)
    # Left-out pixels are set equal before they are compared: infinite ones would make gradients NaN, though weighted 0.
    filled = torch.where(valid, truth, 0)
    # One pixel of each 4 x 4: a mean would mix what lies before and behind an edge.
    few_valid, few = valid[:, ::_STEP, ::_STEP], filled[:, ::_STEP, ::_STEP]
    level = (few / BIN_PX).clamp(max=matched.scores.shape[1] - 1)
    low = level.floor().long()
    high = (low + 1).clamp(max=matched.scores.shape[1] - 1)
    shares = matched.scores.log_softmax(1)
    found_low, found_high = (shares.gather(1, each[:, None])[:, 0] for each in (low, high))
    missed = -torch.lerp(found_low, found_high, level - low)
    loss = _mean(missed, few_valid)
    loss = loss + _NEAR_LOSS * _mean((matched.near - few).abs().clamp(max=_LARGEST_ERROR_PX), few_valid)
    return loss + _mean((matched.final - filled).abs().clamp(max=_LARGEST_ERROR_PX), valid)


def _mean(values: Tensor, counted: Tensor) -> Tensor:
    return torch.where(counted, values, 0).sum() / counted.sum().clamp(min=1)
