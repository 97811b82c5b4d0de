"""The forms in which a config may say how often each disparity shall be seen."""

import math
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from semisynth_gl.config.section import NotNegative, Positive, Section, Weight, as_tuple

# Measured histograms have a few pixels anywhere.
_OUT_OF_REACH = 0.02
# A gamma distribution is looked at as far as this, in this many blocks.
_SPREADS, _GAMMA_BLOCKS = 8, 100
# Points of a bin at which a density is evaluated.
_POINTS = 16


class UniformTarget(Section):
    """All disparities alike.

    Attributes:
        form: ``uniform``.
        low_px: where it begins; by default ``disparity.min_px``.
        high_px: where it ends; by default ``disparity.max_px``.
    """

    form: Literal["uniform"] = "uniform"
    low_px: NotNegative | None = None
    high_px: Positive | None = None

    @model_validator(mode="after")
    def _range(self) -> Self:
        if self.low_px is not None and self.high_px is not None and self.low_px >= self.high_px:
            raise ValueError(f"expected low_px < high_px, got {self.low_px:g} and {self.high_px:g}")
        return self


class UniformDepthTarget(Section):
    """All depths alike, between those of ``disparity.max_px`` and ``disparity.min_px``.

    Attributes:
        form: ``uniform-depth``.
    """

    form: Literal["uniform-depth"]


class GammaTarget(Section):
    """A gamma distribution: one hump with a long tail of near things.

    Attributes:
        form: ``gamma``.
        mean_px: its mean, before the limits of the section cut it.
        spread_px: its standard deviation, likewise.
    """

    form: Literal["gamma"]
    mean_px: Positive
    spread_px: Positive


class HistogramTarget(Section):
    """Shares of pixels in bins.

    Attributes:
        form: ``histogram``.
        bin_px: width of a bin.
        first_px: where the first bin begins.
        shares: share of pixels per bin; they are scaled to a sum of 1.
    """

    form: Literal["histogram"]
    bin_px: Positive
    first_px: Annotated[float, Field(allow_inf_nan=False)] = 0.0
    shares: Annotated[tuple[Weight, ...], BeforeValidator(as_tuple), Field(min_length=1)]

    @model_validator(mode="after")
    def _some_share(self) -> Self:
        if not sum(self.shares) > 0:
            raise ValueError("expected at least one share above 0")
        return self


class MixturePart(Section):
    """One part of a mixture.

    Attributes:
        weight: how much of it.
        target: its distribution.
    """

    weight: Weight = 1.0
    target: Annotated[UniformTarget | UniformDepthTarget | GammaTarget | HistogramTarget, Field(discriminator="form")]


class MixtureTarget(Section):
    """Several distributions, mixed by weights.

    Attributes:
        form: ``mixture``.
        parts: each with its weight.
    """

    form: Literal["mixture"]
    parts: Annotated[tuple[MixturePart, ...], BeforeValidator(as_tuple), Field(min_length=1)]

    @model_validator(mode="after")
    def _some_weight(self) -> Self:
        if not sum(part.weight for part in self.parts) > 0:
            raise ValueError("expected at least one weight above 0")
        return self


TargetSection = Annotated[
    UniformTarget | UniformDepthTarget | GammaTarget | HistogramTarget | MixtureTarget, Field(discriminator="form")
]


def check_reach(target: TargetSection, min_px: float, max_px: float, low_px: float) -> None:
    """Check that scenes can show what is wanted, but for two hundredths.

    Args:
        target: what is wanted.
        min_px: the section's.
        max_px: the section's, the largest disparity that scenes show.
        low_px: the least one that they show.

    Raises:
        ValueError: with the share and the bins that are out of reach.
    """
    parts = target.parts if isinstance(target, MixtureTarget) else (MixturePart(target=target),)
    blocks = []
    for part in parts:
        own = _blocks(part.target, min_px, max_px)
        whole = sum(share for _, _, share in own)
        blocks += [(first, last, part.weight * share / whole) for first, last, share in own]
    whole = sum(share for _, _, share in blocks)
    for begin, end, beyond in ((-math.inf, low_px, "below"), (max_px, math.inf, "above")):
        out = [
            (first, last, share * max(0.0, min(last, end) - max(first, begin)) / (last - first))
            for first, last, share in blocks
        ]
        out = [block for block in out if block[2] > 0]
        share = sum(block[2] for block in out) / whole
        if share > _OUT_OF_REACH:
            first, last = min(block[0] for block in out), max(block[1] for block in out)
            raise ValueError(
                f"disparity.target wants {share:.1%} of the pixels at {max(first, begin):g} to {min(last, end):g} "
                f"px, {beyond} what this config can show, {low_px:g} to {max_px:g} px: change the target, or "
                "disparity.min_px and max_px"
            )


def _blocks(
    target: UniformTarget | UniformDepthTarget | GammaTarget | HistogramTarget, min_px: float, max_px: float
) -> list[tuple[float, float, float]]:
    """Lowest and highest disparity and share of a form's bins, before limits cut it."""
    if isinstance(target, UniformTarget):
        low = min_px if target.low_px is None else target.low_px
        high = max_px if target.high_px is None else target.high_px
        if low >= high:
            raise ValueError(f"disparity.target: expected low_px < high_px, got {low:g} and {high:g}")
        return [(low, high, 1.0)]
    if isinstance(target, HistogramTarget):
        edges = [target.first_px + number * target.bin_px for number in range(len(target.shares) + 1)]
        return list(zip(edges[:-1], edges[1:], target.shares, strict=True))
    if isinstance(target, GammaTarget):
        first = max(0.0, target.mean_px - _SPREADS * target.spread_px)
        ends = np.linspace(first, target.mean_px + _SPREADS * target.spread_px, _GAMMA_BLOCKS + 1)
        return list(zip(ends[:-1].tolist(), ends[1:].tolist(), gamma_weights(target, ends).tolist(), strict=True))
    return [(min_px, max_px, 1.0)]


def gamma_weights(form: GammaTarget, edges_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Integrate a gamma distribution over bins of equal width, (K,) float64, up to a common factor.

    Its density is x^(k - 1) exp(-x / theta), with k = (mean / spread)^2 and theta = spread^2 / mean.

    Args:
        form: mean and spread.
        edges_px: (K + 1,), 0 or more.
    """
    shape, scale = (form.mean_px / form.spread_px) ** 2, form.spread_px**2 / form.mean_px
    width = np.diff(edges_px) / _POINTS
    at = edges_px[:-1, None] + (np.arange(_POINTS) + 0.5) * width[:, None]
    logarithm = (shape - 1) * np.log(at) - at / scale
    # Scaled by its largest value, which may lie far from 1.
    weights: NDArray[np.float64] = np.exp(logarithm - logarithm.max()).sum(axis=1)
    return weights
