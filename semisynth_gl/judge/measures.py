"""The table of measures with which the views of a dataset and of its place are compared, and the keys that change them.

The report names these keys if a dataset is far from its place. `calibrate` chooses recipes and textures by the
measures. Below, ``surfaces`` is (H, W) float32 px without holes, ``disparity`` the same with nan where it is unknown,
and ``luminance`` (H, W) float32 8-bit levels, as in a `MeasuredView`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.judge.measured_view import MeasuredView

JUMP_PX = 1.0
"""A larger difference between the disparities of neighbours is a jump: two surfaces, or one surface seen edge-on."""

# Slants are measured over this distance: in maps that are rounded to 1/2 px, 1 px is too short.
_SLANT_SPAN_PX = 16
# Squares with this side are flat if the standard deviation of their levels is smaller than this.
_FLAT_SIDE, _FLAT_LEVELS = 9, 4.0
# The "largest" disparity is this quantile, since predictions and measured maps have a few gross errors.
_LARGEST = 0.995

Floats = NDArray[np.float32]


def jumps(surfaces: Floats) -> float:
    """Return the share of neighbours in a row between which the disparity jumps, %."""
    return 100 * float((np.abs(np.diff(surfaces)) > JUMP_PX).mean())


def run_length(surfaces: Floats) -> float:
    """Return the mean over pixels of the length, px, of the pixel's run, which ends at the next jumps in its row."""
    ends = np.pad(np.abs(np.diff(surfaces)) > JUMP_PX, ((0, 0), (0, 1)), constant_values=True)
    lengths = np.diff(np.flatnonzero(ends), prepend=-1)
    return float(np.average(lengths, weights=lengths))


def hidden(disparity: Floats) -> NDArray[np.bool_]:
    """Return which pixels of a left view the right view cannot show, (H, W) bool, given only the left disparity.

    A pixel is hidden if a nearer pixel maps to the same position in the right view, or if the position is outside the
    image. A pixel without a disparity is not hidden. Masks are not used, so pairs and maps of a place are comparable.
    """
    height, width = disparity.shape
    known = np.isfinite(disparity)
    place = np.arange(width) - np.where(known, disparity, 0)
    outside: NDArray[np.bool_] = known & ((place < -0.5) | (place >= width - 0.5))
    inside = known & ~outside
    column = np.clip(np.rint(place), 0, width - 1).astype(np.int64)
    # Disparity of the nearest surface in each pixel of the right view. Surfaces that face left have gaps of one pixel.
    nearest = np.full((height, width + 2), float(disparity[inside].min(initial=0.0)), np.float32)
    np.maximum.at(nearest, (np.nonzero(inside)[0], column[inside] + 1), disparity[inside])
    closed = np.maximum(nearest[:, 1:-1], np.minimum(nearest[:, :-2], nearest[:, 2:]))
    return outside | (inside & (np.take_along_axis(closed, column, axis=1) > disparity + JUMP_PX))


def occluded(disparity: Floats, _: Floats) -> float:
    """Return the share of the pixels with a disparity that are `hidden`, %; only dense maps have a meaningful value."""
    return 100 * float(hidden(disparity).sum() / np.isfinite(disparity).sum())


def slant(surfaces: Floats) -> float:
    """Return the mean length of disparity's gradient, px per px, over 16 px of rows and columns without jumps."""
    half, slopes = _SLANT_SPAN_PX // 2, []
    for values in (surfaces, surfaces.T):
        passed = np.pad(np.cumsum(np.abs(np.diff(values)) > JUMP_PX, axis=1), ((0, 0), (1, 0)))
        slope = (values[:, _SLANT_SPAN_PX:] - values[:, :-_SLANT_SPAN_PX]) / _SLANT_SPAN_PX
        slope[passed[:, _SLANT_SPAN_PX:] != passed[:, :-_SLANT_SPAN_PX]] = np.nan
        slopes.append(slope[half:-half])
    lengths = np.hypot(slopes[0], slopes[1].T)
    smooth = lengths[np.isfinite(lengths)]
    return float(smooth.mean()) if smooth.size else float("nan")


def largest_disparity(disparity: Floats) -> float:
    """Return the disparity below which 99.5 % of the pixels lie, % of the width."""
    known = disparity[np.isfinite(disparity)]
    return 100 * float(np.quantile(known, _LARGEST)) / disparity.shape[1] if known.size else float("nan")


def mean_disparity(disparity: Floats) -> float:
    """Return the mean disparity, % of the width."""
    known = np.isfinite(disparity)
    return 100 * float(disparity[known].mean()) / disparity.shape[1] if known.any() else float("nan")


def flat(luminance: Floats) -> float:
    """Return the share of squares of 9 x 9 pixels whose standard deviation is below 4 levels, %."""
    return 100 * float((_squares(luminance, _FLAT_SIDE).std(axis=(1, 3)) < _FLAT_LEVELS).mean())


def fine_detail(luminance: Floats) -> float:
    """Return the contrast of the finest octave divided by that of the third; noise has 4, a photograph about 0.6.

    An octave's contrast is the root mean square deviation within blocks of 2 x 2 values. The values of the first octave
    are pixels; those of each further octave are the means of the previous octave's blocks.
    """
    levels, contrasts = luminance, list[float]()
    for _ in range(3):
        blocks = _squares(levels, 2)
        levels = blocks.mean(axis=(1, 3))
        contrasts.append(float(np.sqrt(np.mean((blocks - levels[:, None, :, None]) ** 2))))
    finest, _, third = contrasts
    return finest / third if third > 0 else float("nan")


def gradient(luminance: Floats) -> float:
    """Return the mean length of the luminance's gradient between neighbouring pixels, levels per px."""
    return float(np.hypot(np.diff(luminance, axis=1)[1:], np.diff(luminance, axis=0)[:, 1:]).mean())


@dataclass(frozen=True, slots=True)
class Measure:
    """A quantity with one value for each view.

    Attributes:
        key: the measure's name in JSON.
        name: the measure's name in tables and plots.
        unit: the unit of the number.
        of: names of the arrays of a `MeasuredView` from which the value is computed.
        value: computes the value from the arrays ``of``; returns nan if they do not determine it.
        moves: keys of the config that change the measure, the most effective first: 1 if the measure rises with the
            key, -1 if it falls.
        fine: whether the measure depends on the finest detail, which images narrower than the working width lack.
    """

    key: str
    name: str
    unit: str
    of: tuple[str, ...]
    value: Callable[..., float]
    moves: Mapping[str, int]
    fine: bool = False

    @property
    def of_images(self) -> bool:
        """Whether the measure is computed from an image; other measures are computed from a disparity map."""
        return self.of == _IMAGE


_IMAGE, _MAP, _SURFACES = ("luminance",), ("disparity",), ("surfaces",)
_BUSY = {
    "scenes": 1, "particles.density": 1, "particles.size_px": -1, "models.complex": 1, "background.room": -1,
    "background.street": -1, "room.furniture": 1, "room.small": 1,
}  # fmt: skip
_ON_ROADS = {"street.tall": 1, "street.low": 1, "street.houses": -1}
_CALM = {key: -sign for key, sign in _BUSY.items()}
_SOFT = {"antialias": -1, "imperfections.blur_px": -1}
_TEXTURE = {"textures.texels_per_pixel": 1, "textures.min_texture": 1}
_SLANTED = {
    "structures.panel_slant_deg": 1, "structures.panels": -1, "particles.thinness": -1, "background.street": 1,
    "street.vehicles": -1,
}  # fmt: skip
_NEAR = {"disparity.target": 1, "room.pillars": 1}

MEASURES: tuple[Measure, ...] = (
    Measure(
        "jumps", "depth jumps above 1 px", "per 100 px", _SURFACES, jumps,
        {**_BUSY, **_ON_ROADS, "structures.panels": -1, "particles.thinness": -1},
    ),
    Measure(
        "runs", "length of smooth runs", "px", _SURFACES, run_length,
        {**_CALM, "structures.panels": 1, "room.pillars": -1, "street.houses": 1},
    ),
    Measure(
        "occluded", "occluded, of known", "%", _MAP + _SURFACES, occluded,
        {**_BUSY, **_ON_ROADS, "room.pillars": 1, "street.vehicles": 1},
    ),
    Measure("slant", "slant, mean", "px per px", _SURFACES, slant, _SLANTED),
    Measure("disparity", "disparity, mean", "% of width", _MAP, mean_disparity, {**_NEAR, "street.vehicles": 1}),
    Measure(
        "largest_disparity", "disparity, largest", "% of width", _MAP, largest_disparity,
        {**_NEAR, "disparity.max_px": 1},
    ),
    Measure(
        "flat", "local contrast below 4 levels", "%", _IMAGE, flat,
        {key: -sign for key, sign in (_TEXTURE | _BUSY).items()}, fine=True,
    ),
    Measure(
        "octaves", "contrast, finest over third octave", "ratio", _IMAGE, fine_detail, _SOFT | _BUSY, fine=True
    ),
    Measure("gradient", "gradient, mean", "levels per px", _IMAGE, gradient, _TEXTURE | _SOFT | _BUSY, fine=True),
    Measure(
        "luminance", "luminance, mean", "levels", _IMAGE, lambda levels: float(levels.mean()),
        {"imperfections.exposure_stops": 1, "imperfections.gamma": -1},
    ),
    Measure(
        "contrast", "luminance, deviation", "levels", _IMAGE, lambda levels: float(levels.std()),
        {"imperfections.exposure_stops": 1},
    ),
)  # fmt: skip
"""All measures, in the order of tables."""

# Advice for a larger and for a smaller value of keys that are not numbers.
_CHANGES = {
    "scenes": tuple(f"in scenes, give more weight to recipes with {count} objects" for count in ("many", "few")),
    "antialias": ("antialias: edges", "antialias: none"),
    "particles.density": ("particles.density: dense", "particles.density: sparse"),
    "disparity.target": tuple(
        f"in disparity.target, give more weight to {size} disparities" for size in ("large", "small")
    ),
}
# Keys that have no effect if ``particles`` has the key on the right.
_REPLACED = {"particles.density": "layers", "disparity.target": "layers", "particles.size_px": "size_m"}
# All kinds of background; for each section, the kinds of background for which it is used.
_BACKGROUNDS = ("cuboid", "plane", "room", "street")
_KINDS = {"room": {"room"}, "street": {"street"}, "structures": {"cuboid", "plane"}}


def measure_view(view: MeasuredView, measures: Iterable[Measure] = MEASURES) -> dict[str, float]:
    """Compute the measures that a view determines, by their keys."""
    values = {}
    for measure in measures:
        arrays = [array for name in measure.of if (array := getattr(view, name)) is not None]
        if len(arrays) == len(measure.of) and not (measure.fine and view.enlarged):
            values[measure.key] = measure.value(*arrays)
    return {key: value for key, value in values.items() if np.isfinite(value)}


def advice(measure: Measure, recipes: Sequence[Mapping[str, Any]], *, more: bool) -> str:
    """Return what to change in a config for a larger or smaller value of a measure.

    The text has no keys of backgrounds that no recipe has, and not the value of ``antialias`` that is already set.

    Args:
        measure: the measure to move.
        recipes: the config of each recipe, in JSON's types; at least one.
        more: True for a larger value, False for a smaller one.
    """
    changes = list[str]()
    for verb, sign in (("raise", 1), ("lower", -1)):
        keys = [key for key, moves in measure.moves.items() if (moves == sign) == more and _has_effect(key, recipes)]
        numbers = [key for key in keys if key not in _CHANGES]
        changes += [_CHANGES[key][sign < 0] for key in keys if key in _CHANGES]
        changes += [f"{verb} {', '.join(numbers)}"] if numbers else []
    return "; ".join(text for text in changes if text != f"antialias: {recipes[0].get('antialias')}")


def _has_effect(key: str, recipes: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether a key has an effect in the scenes of any recipe."""
    section, _, name = key.rpartition(".")
    kinds = [{kind for kind in _BACKGROUNDS if recipe["background"][kind] > 0} for recipe in recipes]
    if key == "scenes":
        return len(recipes) > 1
    if section == "background":
        return any(name in each and len(each) > 1 for each in kinds)
    if key in _REPLACED:
        return any(recipe["particles"][_REPLACED[key]] is None for recipe in recipes)
    return section not in _KINDS or any(each & _KINDS[section] for each in kinds)


def _squares(values: Floats, side: int) -> Floats:
    """Divide an array into adjacent squares, (rows, side, columns, side)."""
    rows, columns = (count // side for count in values.shape)
    return values[: rows * side, : columns * side].reshape(rows, side, columns, side)
