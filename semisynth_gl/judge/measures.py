"""Measures of views, such as the share of depth jumps, and the config's keys that change each measure.

A dataset is compared with photographs and disparity maps of the place where the network will work. The report names the
keys if a measure differs much. `calibrate` chooses recipes and textures by the measures.

The functions measure one array of a `MeasureInput`: ``disparity``, nan where unknown; ``surfaces``, the disparity with
its holes filled; or ``luminance``.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.judge.measure_input import DENSE, MeasureInput

JUMP_PX = 1.0
"""A larger difference between the disparities of neighbours is a jump: two surfaces, or one surface seen edge-on."""

# Slants are measured over this distance: disparities may be rounded to 1/2 px, so that 1 px would be too short.
_SLANT_SPAN_PX = 16
# A square with this side, px, is flat if the standard deviation of its levels is smaller than the second number.
_FLAT_SIDE, _FLAT_LEVELS = 9, 4.0
# The "largest" disparity is this quantile, since predictions and measured maps have a few gross errors.
_LARGEST = 0.995

Floats = NDArray[np.float32]


def jumps(surfaces: Floats) -> float:
    """Return the share of horizontal neighbours between which the disparity jumps, %."""
    return 100 * float((np.abs(np.diff(surfaces)) > JUMP_PX).mean())


def run_length(surfaces: Floats) -> float:
    """Return the mean length, px, of the runs of pixels of an image row between neighbouring jumps.

    A run's weight is its length.
    """
    ends = np.pad(np.abs(np.diff(surfaces)) > JUMP_PX, ((0, 0), (0, 1)), constant_values=True)
    lengths = np.diff(np.flatnonzero(ends), prepend=-1)
    return float(np.average(lengths, weights=lengths))


def hidden(disparity: Floats) -> NDArray[np.bool_]:
    """Return which pixels of a left view the right view cannot show, (H, W) bool, given only the left disparity.

    A pixel is hidden if a nearer pixel maps to the same pixel of the right view, or if its point is outside the right
    image. A pixel without a disparity is not hidden. Masks of a dataset are not used, since maps of a place have none.
    """
    height, width = disparity.shape
    known = np.isfinite(disparity)
    x_right = np.arange(width) - np.where(known, disparity, 0)
    outside: NDArray[np.bool_] = known & ((x_right < -0.5) | (x_right >= width - 0.5))
    inside = known & ~outside
    column = np.clip(np.rint(x_right), 0, width - 1).astype(np.int64)
    # Disparity of the nearest surface in each pixel of the right view.
    nearest = np.full((height, width + 2), float(disparity[inside].min(initial=0.0)), np.float32)
    np.maximum.at(nearest, (np.nonzero(inside)[0], column[inside] + 1), disparity[inside])
    # Close gaps of one pixel: a surface that is wider in the right view leaves pixels without a left pixel.
    closed = np.maximum(nearest[:, 1:-1], np.minimum(nearest[:, :-2], nearest[:, 2:]))
    return outside | (inside & (np.take_along_axis(closed, column, axis=1) > disparity + JUMP_PX))


def occluded(disparity: Floats) -> float:
    """Return the share of the pixels with a disparity that are `hidden`, %; nan for sparse maps."""
    known = np.isfinite(disparity)
    return 100 * float(hidden(disparity).sum() / known.sum()) if known.mean() >= DENSE else float("nan")


def slant(surfaces: Floats) -> float:
    """Return the mean length of the disparity's gradient, px per px, measured over 16 px without a jump."""
    half, slopes = _SLANT_SPAN_PX // 2, []
    for values in (surfaces, surfaces.T):
        jumps_before = np.pad(np.cumsum(np.abs(np.diff(values)) > JUMP_PX, axis=1), ((0, 0), (1, 0)))
        slope = (values[:, _SLANT_SPAN_PX:] - values[:, :-_SLANT_SPAN_PX]) / _SLANT_SPAN_PX
        slope[jumps_before[:, _SLANT_SPAN_PX:] != jumps_before[:, :-_SLANT_SPAN_PX]] = np.nan
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
    """Return the contrast of the finest octave divided by that of the third: 4 for noise, about 0.6 for a photograph.

    An octave's contrast is the root mean square deviation within blocks of 2 x 2 values. The finest octave's values are
    the pixels. The next octaves' values are the means of the blocks of the octave before.
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
        of: name of the array of a `MeasureInput` from which the value is computed.
        value: computes the value from this array; returns nan if the array does not determine it.
        moves: keys of the config that change the measure, the most effective first. The number is 1 if a larger key
            raises the measure, -1 if it lowers the measure.
        fine: whether the measure depends on the finest detail, which images narrower than the working width lack;
            all views are resized to this width.
    """

    key: str
    name: str
    unit: str
    of: str
    value: Callable[[Floats], float]
    moves: Mapping[str, int]
    fine: bool = False

    @property
    def of_images(self) -> bool:
        """Whether the measure is computed from an image; other measures are computed from a disparity map."""
        return self.of == "luminance"


# Keys that make scenes fuller, and, with the sign reversed, emptier.
_BUSY = {
    "scenes": 1, "particles.density": 1, "particles.size_px": -1, "models.complex": 1, "background.room": -1,
    "background.street": -1, "room.furniture": 1, "room.small": 1,
}  # fmt: skip
_CALM = {key: -sign for key, sign in _BUSY.items()}
_STREET = {"street.tall": 1, "street.low": 1, "street.houses": -1}
_SHARP = {"antialias": -1, "imperfections.blur_px": -1}
_TEXTURE = {"textures.texels_per_pixel": 1, "textures.min_texture": 1}
_SLANTED = {
    "structures.panel_slant_deg": 1, "structures.panels": -1, "particles.thinness": -1, "background.street": 1,
    "street.vehicles": -1,
}  # fmt: skip
_NEAR = {"disparity.target": 1, "room.pillars": 1}

MEASURES: tuple[Measure, ...] = (
    Measure(
        "jumps", "depth jumps above 1 px", "per 100 px", "surfaces", jumps,
        {**_BUSY, **_STREET, "structures.panels": -1, "particles.thinness": -1},
    ),
    Measure(
        "runs", "length of smooth runs", "px", "surfaces", run_length,
        {**_CALM, "structures.panels": 1, "room.pillars": -1, "street.houses": 1},
    ),
    Measure(
        "occluded", "occluded, of known", "%", "disparity", occluded,
        {**_BUSY, **_STREET, "room.pillars": 1, "street.vehicles": 1},
    ),
    Measure("slant", "slant, mean", "px per px", "surfaces", slant, _SLANTED),
    Measure("disparity", "disparity, mean", "% of width", "disparity", mean_disparity, {**_NEAR, "street.vehicles": 1}),
    Measure(
        "largest_disparity", "disparity, largest", "% of width", "disparity", largest_disparity,
        {**_NEAR, "disparity.max_px": 1},
    ),
    Measure(
        "flat", "local contrast below 4 levels", "%", "luminance", flat,
        {key: -sign for key, sign in (_TEXTURE | _BUSY).items()}, fine=True,
    ),
    Measure(
        "octaves", "contrast, finest over third octave", "ratio", "luminance", fine_detail, _SHARP | _BUSY, fine=True
    ),
    Measure("gradient", "gradient, mean", "levels per px", "luminance", gradient, _TEXTURE | _SHARP | _BUSY, fine=True),
    Measure(
        "luminance", "luminance, mean", "levels", "luminance", lambda levels: float(levels.mean()),
        {"imperfections.exposure_stops": 1, "imperfections.gamma": -1},
    ),
    Measure(
        "contrast", "luminance, deviation", "levels", "luminance", lambda levels: float(levels.std()),
        {"imperfections.exposure_stops": 1},
    ),
)  # fmt: skip
"""All measures, in the order of tables."""

# For keys that are not numbers: the advice for a larger and for a smaller value.
_ADVICE = {
    "scenes": tuple(f"in scenes, give more weight to recipes with {count} objects" for count in ("many", "few")),
    "antialias": ("antialias: edges", "antialias: none"),
    "particles.density": ("particles.density: dense", "particles.density: sparse"),
    "disparity.target": tuple(
        f"in disparity.target, give more weight to {size} disparities" for size in ("large", "small")
    ),
}
# Keys that have no effect if the section ``particles`` sets the key on the right.
_REPLACED = {"particles.density": "layers", "disparity.target": "layers", "particles.size_px": "size_m"}
_BACKGROUNDS = ("cuboid", "plane", "room", "street")
# The backgrounds of scenes on which a section has an effect; other sections have an effect on all scenes.
_BACKGROUNDS_OF = {"room": {"room"}, "street": {"street"}, "structures": {"cuboid", "plane"}}


def measure_view(view: MeasureInput, measures: Iterable[Measure] = MEASURES) -> dict[str, float]:
    """Compute the measures that a view determines, by their keys."""
    values = {}
    for measure in measures:
        array = getattr(view, measure.of)
        if array is not None and not (measure.fine and view.enlarged):
            values[measure.key] = measure.value(array)
    return {key: value for key, value in values.items() if np.isfinite(value)}


def advice(measure: Measure, recipes: Sequence[Mapping[str, Any]], *, more: bool) -> str:
    """Return what to change in a config for a larger value of a measure, or for a smaller one unless ``more``.

    ``recipes`` are the config of each recipe, in JSON's types. Keys without effect on any recipe are left out, and so
    is the mode of ``antialias`` that is already set.
    """
    changes = list[str]()
    for verb, sign in (("raise", 1), ("lower", -1)):
        keys = [key for key, moves in measure.moves.items() if (moves == sign) == more and _has_effect(key, recipes)]
        numbers = [key for key in keys if key not in _ADVICE]
        changes += [_ADVICE[key][sign < 0] for key in keys if key in _ADVICE]
        changes += [f"{verb} {', '.join(numbers)}"] if numbers else []
    return "; ".join(text for text in changes if text != f"antialias: {recipes[0].get('antialias')}")


def _has_effect(key: str, recipes: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether a key has an effect on the scenes of any recipe."""
    section, _, name = key.rpartition(".")
    backgrounds = [{each for each in _BACKGROUNDS if recipe["background"][each] > 0} for recipe in recipes]
    if key == "scenes":
        return len(recipes) > 1
    if section == "background":
        return any(name in each and len(each) > 1 for each in backgrounds)
    if key in _REPLACED:
        return any(recipe["particles"][_REPLACED[key]] is None for recipe in recipes)
    return section not in _BACKGROUNDS_OF or any(each & _BACKGROUNDS_OF[section] for each in backgrounds)


def _squares(values: Floats, side: int) -> Floats:
    """Divide an array into adjacent squares, (rows, side, columns, side)."""
    rows, columns = (count // side for count in values.shape)
    return values[: rows * side, : columns * side].reshape(rows, side, columns, side)
