"""The distributions of disparity that a config may ask for in ``disparity.target``.

A target of form ``file`` becomes a target of form ``histogram`` when a config is read. The config alone then determines
its pairs: a later change of the file does not affect a dataset that was begun before.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from semisynth_gl.config.fields import (
    FROM_LIST,
    LARGEST,
    SMALLEST,
    ConfigError,
    Finite,
    Positive,
    Section,
    Weight,
    not_signed,
)
from semisynth_gl.histogram import Histogram, mix_histograms
from semisynth_gl.inputs.errors import InputError, did_you_mean, near, shown
from semisynth_gl.inputs.user_files import read_file

# Largest share of a target that may be out of reach: measured histograms have a few stray pixels anywhere.
_OUT_OF_REACH = 0.02
# Reach of a gamma distribution's check on either side of the mean, in standard deviations, and its number of bins.
_SPREADS, _GAMMA_BINS = 8, 100
# Number of points per bin at which a density is evaluated.
_POINTS = 16
# Number of bins of the wanted histogram where the target has no bins of its own.
_BINS = 24
# Largest number of bins of a target. A file's bins are cut into equal bins as wide as their common divisor.
_MOST_BINS = 4096
_MOST_PARTS = 100
_LARGEST_BYTES = 1 << 20
_RESOLUTION_PX = 1e-3


class UniformTarget(Section):
    """Equally many pixels at each disparity from ``low_px`` to ``high_px``, by default ``min_px`` to ``max_px``."""

    form: Literal["uniform"] = "uniform"
    low_px: Finite | None = None
    high_px: Finite | None = None

    def _faults(self) -> Iterator[ConfigError]:
        if self.low_px is not None and self.high_px is not None and self.low_px >= self.high_px:
            text = f"expected low_px < high_px, got {self.low_px:g} and {self.high_px:g}"
            yield ConfigError(text, ("low_px", "high_px"))


class UniformDepthTarget(Section):
    """Every depth from ``disparity.max_px`` to ``disparity.min_px`` has the same share of the pixels."""

    form: Literal["uniform-depth"]


class GammaTarget(Section):
    """A gamma distribution: one hump with a long tail of large disparities.

    The distribution begins at ``origin_px``. ``mean_px`` and ``spread_px``, the standard deviation, hold before it
    is cut at ``disparity.min_px`` and ``disparity.max_px``.
    """

    form: Literal["gamma"]
    origin_px: Finite = 0.0
    mean_px: Finite
    spread_px: Positive

    def _faults(self) -> Iterator[ConfigError]:
        if self.mean_px - self.origin_px < SMALLEST:
            text = f"expected mean_px above origin_px, got {self.mean_px:g} and {self.origin_px:g}"
            yield ConfigError(text, ("mean_px", "origin_px"))

    def histogram(self, edges_px: NDArray[np.float64]) -> Histogram:
        """Integrate the distribution over bins of equal width with edges (K + 1,).

        Its density is x^(k - 1) exp(-x / theta), with x and the mean counted from the origin, k = (mean / spread)^2 and
        theta = spread^2 / mean. If all bins lie below the origin, the last bin gets all pixels.
        """
        mean_px = self.mean_px - self.origin_px
        shape, scale = (mean_px / self.spread_px) ** 2, self.spread_px**2 / mean_px
        width = np.diff(edges_px) / _POINTS
        at = edges_px[:-1, None] + (np.arange(_POINTS) + 0.5) * width[:, None] - self.origin_px
        if at[-1, -1] <= 0:
            return Histogram.from_counts(edges_px, np.arange(1 - len(width), 1) == 0)
        after = np.maximum(at, np.finfo(np.float64).tiny)
        logarithm = np.where(at > 0, (shape - 1) * np.log(after) - after / scale, -np.inf)
        # The largest density may be far from 1, so it is scaled to 1.
        return Histogram.from_counts(edges_px, np.exp(logarithm - logarithm.max()).sum(axis=1))


class HistogramTarget(Section):
    """Shares of pixels in bins of width ``bin_px``, the first from ``first_px``; shares are scaled to a sum of 1."""

    form: Literal["histogram"]
    bin_px: Positive
    first_px: Finite = 0.0
    shares: Annotated[tuple[Weight, ...], FROM_LIST, Field(min_length=1, max_length=_MOST_BINS)]

    def _faults(self) -> Iterator[ConfigError]:
        if not sum(self.shares) > 0:
            yield ConfigError("expected at least one share above 0", ("shares",))


Distribution = UniformTarget | UniformDepthTarget | GammaTarget | HistogramTarget

_FORMS = ("uniform", "uniform-depth", "gamma", "histogram")


def _known_form(*names: str) -> BeforeValidator:
    """Return a validator of targets that accepts only forms with these names."""

    def check(target: Any) -> Any:  # noqa: ANN401 - any YAML value
        if isinstance(target, dict) and target.get("form") not in names:
            hint = did_you_mean(near(str(target.get("form")), names))
            came = f"got {shown(target['form'])}" if "form" in target else "which is missing"
            text = f"expected one of {', '.join(names)}, {came}{'; ' if hint else ''}{hint}"
            raise ConfigError(text, ("form",))
        return target

    return BeforeValidator(check)


class MixturePart(Section):
    """One part of a mixture, with its weight."""

    weight: Weight = 1.0
    target: Annotated[Distribution, Field(discriminator="form"), _known_form(*_FORMS)]


class MixtureTarget(Section):
    """Several distributions, mixed by weights."""

    form: Literal["mixture"]
    parts: Annotated[tuple[MixturePart, ...], FROM_LIST, Field(min_length=1, max_length=_MOST_PARTS)]

    def _faults(self) -> Iterator[ConfigError]:
        if not sum(part.weight for part in self.parts) > 0:
            yield ConfigError("expected at least one weight above 0", ("parts",))


TargetSection = Annotated[
    Distribution | MixtureTarget,
    Field(discriminator="form"),
    _known_form(*_FORMS, "mixture", "file"),
]


def positive_faults(target: TargetSection) -> Iterator[ConfigError]:
    """Yield a fault for each key of a target that asks for disparities below 0, by its key in the section."""
    for number, part in enumerate(_parts(target)):
        at = f"target.parts.{number}.target" if isinstance(target, MixtureTarget) else "target"
        for key, least in (("low_px", 0.0), ("high_px", SMALLEST), ("origin_px", 0.0)):
            value = getattr(part.target, key, None)
            if value is not None and value < least:
                yield ConfigError(not_signed(least, value), (f"{at}.{key}",))


def _parts(target: TargetSection) -> tuple[MixturePart, ...]:
    return target.parts if isinstance(target, MixtureTarget) else (MixturePart(target=target),)


def target_faults(
    target: TargetSection, min_px: float, max_px: float, low_px: float, note: str = ""
) -> Iterator[ConfigError]:
    """Yield a fault where scenes cannot show all but 2 % of the pixels of a target, by keys of the config.

    ``min_px`` and ``max_px`` are those of the section ``disparity``; scenes show ``low_px`` to ``max_px``. ``note`` is
    appended to the message where the pixels that cannot be shown lie below ``low_px``.
    """
    keys = "disparity.target", "disparity.min_px", "disparity.max_px"
    parts = _parts(target)
    for part in parts:
        if isinstance(part.target, UniformTarget):
            low, high = _ends(part.target, min_px, max_px)
            if low >= high:
                yield ConfigError(f"disparity.target: expected low_px < high_px, got {low:g} and {high:g}", keys)
                return
    histograms = [_uncut_histogram(part.target, min_px, max_px) for part in parts]
    lows, highs = (np.concatenate([bins.edges_px[ends] for bins in histograms]) for ends in (slice(-1), slice(1, None)))
    shares = np.concatenate([part.weight * bins.shares for part, bins in zip(parts, histograms, strict=True)])
    shares /= shares.sum()
    for begin, end, side in ((-math.inf, low_px, "below"), (max_px, math.inf, "above")):
        outside = shares * np.maximum(np.minimum(highs, end) - np.maximum(lows, begin), 0) / (highs - lows)
        if outside.sum() > _OUT_OF_REACH:
            first, last = max(lows[outside > 0].min(), begin), min(highs[outside > 0].max(), end)
            yield ConfigError(
                f"disparity.target wants {outside.sum():.1%} of the pixels at {first:g} to {last:g} px, {side} the "
                f"range that this config can show, {low_px:g} to {max_px:g} px: change the target, or disparity.min_px "
                f"and disparity.max_px{note if side == 'below' else ''}",
                keys,
            )


def wanted_histogram(target: TargetSection, min_px: float, max_px: float, doffs_px: float) -> Histogram:
    """Return a target as a histogram of disparity, px; see `semisynth_gl.config.model.Config.wanted_histogram`.

    ``doffs_px`` is the mean cx_right - cx_left of the cameras. Raises InputError where a target uniform in depth
    reaches beyond infinity.
    """
    if isinstance(target, HistogramTarget):
        return _uncut_histogram(target, min_px, max_px)
    edges = np.linspace(min_px, max_px, _BINS + 1, dtype=np.float64)
    if not isinstance(target, MixtureTarget):
        return _cut_histogram(target, edges, doffs_px)
    total = sum(part.weight for part in target.parts)
    parts = [(part.weight / total, _cut_histogram(part.target, edges, doffs_px)) for part in target.parts]
    return mix_histograms(parts, edges)


def _cut_histogram(target: Distribution, edges_px: NDArray[np.float64], doffs_px: float) -> Histogram:
    """Return a distribution in bins from ``disparity.min_px`` to ``disparity.max_px``."""
    low, high = float(edges_px[0]), float(edges_px[-1])
    match target:
        case UniformDepthTarget():
            if low + doffs_px <= 0:
                raise InputError(
                    f"disparity.min_px: {low:g} px lies beyond infinity for cameras whose doffs is {doffs_px:g} px on "
                    f"average: a target uniform in depth needs a min_px above {-doffs_px:g}"
                )
            # Depth is f B / (d + doffs): a bin's share of the depths is a difference of 1 / (d + doffs), scaled.
            return Histogram.from_counts(edges_px, -np.diff(1 / (edges_px + doffs_px)))
        case GammaTarget():
            return target.histogram(edges_px)
        case _:
            return _uncut_histogram(target, low, high).rebinned(edges_px)


def _ends(target: UniformTarget, min_px: float, max_px: float) -> tuple[float, float]:
    low_px, high_px = target.low_px, target.high_px
    return min_px if low_px is None else low_px, max_px if high_px is None else high_px


def _uncut_histogram(target: Distribution, min_px: float, max_px: float) -> Histogram:
    """Return a distribution before it is cut at the limits of the section ``disparity``."""
    match target:
        case UniformTarget():
            return Histogram.from_counts(_ends(target, min_px, max_px), [1.0])
        case UniformDepthTarget():
            # A placeholder: callers need only the range.
            return Histogram.from_counts([min_px, max_px], [1.0])
        case GammaTarget():
            reach_px = _SPREADS * target.spread_px
            first = max(target.origin_px, target.mean_px - reach_px)
            return target.histogram(np.linspace(first, target.mean_px + reach_px, _GAMMA_BINS + 1))
        case HistogramTarget():
            edges = target.first_px + np.arange(len(target.shares) + 1) * target.bin_px
            return Histogram.from_counts(edges, target.shares)


def read_histogram(path: Path) -> dict[str, Any]:
    """Read the keys of a target of form ``histogram`` from a CSV file.

    The lines ``low_px,high_px,share`` must be in rising order without gaps; a heading and # comments are allowed.
    Raises InputError where the file cannot be read or breaks this form.
    """
    try:
        lines = read_file(path, _LARGEST_BYTES).decode("utf-8").splitlines()
    except OSError as error:
        raise InputError(f"{path}: the wanted histogram cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: the wanted histogram cannot be read: {error}") from None
    bins: list[tuple[float, float, float]] = []
    for number, line in enumerate(lines, 1):
        text, expected = line.partition("#")[0].strip(), f"{path}:{number}: expected"
        if not text or (not bins and text.replace(" ", "") == "low_px,high_px,share"):
            continue
        try:
            low, high, share = (float(part) for part in text.split(","))
        except ValueError:
            raise InputError(f"{expected} three numbers, low_px,high_px,share, got {shown(text)}") from None
        if not (-LARGEST <= low < high <= LARGEST and 0 <= share <= LARGEST):
            limits = f"low_px < high_px and a share of 0 or more, all at most {LARGEST:g}"
            raise InputError(f"{expected} {limits}, got {shown(text)}")
        if bins and abs(bins[-1][1] - low) > _RESOLUTION_PX:
            raise InputError(f"{expected} the bin to begin at {bins[-1][1]:g} px, where the previous bin ends")
        bins.append((low, high, share))
    if not bins:
        raise InputError(f"{path}: no bins: expected lines low_px,high_px,share")
    widths = [max(1, round((high - low) / _RESOLUTION_PX)) for low, high, _ in bins]
    common = math.gcd(*widths)
    if sum(widths) // common > _MOST_BINS:
        fault = f"the bins' widths have no common divisor of at least 1/{_MOST_BINS} of the range"
        raise InputError(f"{path}: {fault}: expected widths such as 5 and 10")
    parts = [width // common for width in widths]
    shares = [share / part for (_, _, share), part in zip(bins, parts, strict=True) for _ in range(part)]
    return {"form": "histogram", "bin_px": round(common * _RESOLUTION_PX, 6), "first_px": bins[0][0], "shares": shares}
