"""Render the page: one HTML file that needs neither server nor network. Its template is assets/report.html."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from semisynth_gl.dataset.documents import SplitSources
from semisynth_gl.dataset.reader import StoredIndex
from semisynth_gl.histogram import Histogram, total_variation, wasserstein_px
from semisynth_gl.inputs.resources import data_root
from semisynth_gl.inputs.templates import template_environment
from semisynth_gl.reporting.measure import QUANTITIES, RAYS, Measurement, Outlier, PairMeasures
from semisynth_gl.reporting.pictures import JPEG_QUALITY, EncodedPair
from semisynth_gl.reporting.plots import COLOUR_MAP, Bars, count_bars, draw_histogram
from semisynth_gl.reporting.redraws import PairKey, Redraws
from semisynth_gl.seeds.splits import SplitName

Values = Mapping[str, Any]

_MOST_REDRAWN = 20
_DISPARITY_BINS = 72

# Colours of the overlays, RGB. The colour map has no blue, and readers of any colour vision can tell the masks apart.
_NO_DISPARITY = (64, 96, 192)
_OCCLUDED = (230, 97, 0)
_OUTSIDE = (93, 58, 155)


@dataclass(frozen=True, slots=True)
class ShownPair:
    """A pair that the page shows.

    Attributes:
        measures: the pair's measures.
        label: the pair's number, with its split in a dataset of several splits.
        picture: the pair's images and arrays.
        reason: why an outlier is shown; None for an evenly spread pair.
    """

    measures: PairMeasures
    label: str
    picture: EncodedPair
    reason: str | None


@dataclass(frozen=True, slots=True)
class Chart:
    """A histogram as an SVG element, with the 5 %, 50 % and 95 % quantiles of its values."""

    svg: str
    low: float
    median: float
    high: float


def render_page(
    index: StoredIndex,
    measurement: Measurement,
    redraws: Redraws,
    outliers: Sequence[Outlier],
    shown: Sequence[ShownPair],
) -> str:
    """Return the page of a dataset, or of the split that measurement and redraws are from, as HTML.

    Args:
        index: the dataset's index.
        measurement: the measures of the sample.
        redraws: the failed attempts of the dataset or split.
        outliers: the outliers to list.
        shown: the pairs to show.
    """
    assets = data_root("assets")
    environment = template_environment()
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    disparity, target = measurement.disparity, measurement.target
    medians = _finite(pair.median_px for pair in measurement.pairs)
    sources = {} if index.made is None else index.made.split_sources
    configs = [recipe.config.model_dump(mode="json") for recipe in index.plan.config.recipes()]
    return environment.get_template("report.html").render(
        plan=index.plan,
        measurement=measurement,
        target_variation=total_variation(target, disparity) if target and disparity else None,
        target_wasserstein_px=wasserstein_px(target, disparity) if target and disparity else None,
        medians_px=np.percentile(medians, [5, 95]) if medians.size else None,
        charts=_charts(configs, measurement),
        size_range_px=_size_range_px(configs),
        texels_range=_config_range(configs, "textures", "texels_per_pixel"),
        imperfect=index.imperfect,
        rays_per_pair=RAYS,
        outliers=[(outlier, _left_file(index, outlier.pair.key)) for outlier in outliers],
        quantities=len(QUANTITIES),
        redraws=redraws,
        most_redrawn=_most_redrawn(index, redraws, measurement.pairs),
        sources=sources,
        licences=_licences(sources),
        unused_files=[(split, text) for split, source in sources.items() for text in source.left_out],
        config_json=json.dumps(index.plan.config.model_dump(mode="json"), indent=1),
        shown=shown,
        shown_numbers={pair.measures.position: number for number, pair in enumerate(shown)},
        jpeg_quality=JPEG_QUALITY,
        viewer={
            "pairs": [_viewed(pair) for pair in shown],
            # The colours of disparities, from the smallest to the largest.
            "colours": colormaps[COLOUR_MAP](range(256), bytes=True)[:, :3].tolist(),
            "none": _NO_DISPARITY,
            "occluded": _OCCLUDED,
            "outside": _OUTSIDE,
        },
        style=assets.joinpath("report.css").read_text("utf-8"),
        script=assets.joinpath("report.js").read_text("utf-8"),
    )


def _viewed(pair: ShownPair) -> dict[str, Any]:
    """Return the values that report.js needs for a pair, except images and arrays."""
    measures, picture = pair.measures, pair.picture
    caption = [f"{measures.name}: median disparity {measures.median_px:.4g} px"]
    if measures.recipe is not None:
        caption.insert(0, f"recipe {measures.recipe}")
    if measures.occluded is not None:
        caption.append(f"{measures.occluded:.1%} occluded")
    caption.append(f"texture {measures.texture:.3g} levels")
    if measures.redraws:
        caption.append(f"drawn again {'once' if measures.redraws == 1 else f'{measures.redraws} times'}")
    if pair.reason:
        caption.append(pair.reason)
    return {
        "label": pair.label,
        "caption": ", ".join(caption),
        "width": picture.width_px,
        "height": picture.height_px,
        "step": picture.step,
        "low": picture.low_px,
        "high": picture.high_px,
        "focal_baseline": picture.camera.focal_baseline,
        "doffs": picture.camera.doffs_px,
        "rectified": picture.camera.rectified,
    }


def _charts(configs: Sequence[Values], measurement: Measurement) -> dict[str, Chart | None]:
    """Draw the distributions, by the names under which the template uses them; a chart without values is None."""
    pairs, rays, disparity = measurement.pairs, measurement.rays, measurement.disparity

    def chart(
        name: str,
        values: NDArray[np.float64],
        label: str,
        *,
        log: bool = False,
        limits: tuple[float, float] | None = None,
        marks: Sequence[tuple[float, str]] = (),
    ) -> Chart | None:
        if not values.size:
            return None
        svg = draw_histogram(name, count_bars(values, log=log, limits=limits), label, marks=marks)
        return Chart(svg, *np.percentile(values, [5, 50, 95]))

    def marks(key: str, ends: Sequence[float]) -> list[tuple[float, str]]:
        return [(end, f"{key}: {end:g}") for end in ends]

    occluded = np.array([100 * pair.occluded for pair in pairs if pair.occluded is not None], np.float64)
    texture = np.array([pair.texture for pair in pairs], np.float64)
    texels = marks("textures.texels_per_pixel", _config_range(configs, "textures", "texels_per_pixel"))
    least = marks("checks.min_texture", _config_range(configs, "checks", "min_texture"))
    sizes = marks("particles.size_px", _size_range_px(configs))
    return {
        "disparity": _disparity_chart(disparity, measurement.target) if disparity else None,
        "median": chart("median", _finite(pair.median_px for pair in pairs), "px"),
        "depth": chart("depth", measurement.depth_m, "m", log=True),
        "slant": chart("slant", rays.slant_deg, "degrees", limits=(0.0, 90.0)),
        "size": chart("size", rays.diameter_px, "px", log=True, marks=sizes),
        "texels": chart("texels", rays.texels_per_pixel, "texels along the side of a pixel", log=True, marks=texels),
        "occlusion": chart("occlusion", occluded, "% of the left view's pixels"),
        "texture": chart("texture", texture, "8-bit levels", marks=least),
    }


def _disparity_chart(achieved: Histogram, target: Histogram | None) -> Chart:
    # The outermost 0.01 % of pixels on either side would make the axis too long.
    both = [achieved] if target is None else [achieved, target]
    low = min(histogram.quantile(1e-4) for histogram in both)
    high = max(histogram.quantile(1 - 1e-4) for histogram in both)
    edges = np.linspace(low, high, _DISPARITY_BINS + 1)
    bars = Bars(edges, achieved.rebinned(edges).shares)
    outline = None if target is None else target.rebinned(edges).shares
    svg = draw_histogram("disparity", bars, "disparity, px", outline=outline)
    return Chart(svg, *(achieved.quantile(share) for share in (0.05, 0.5, 0.95)))


def _config_range(configs: Sequence[Values], section: str, key: str) -> list[float]:
    """Return the two ends of a config's range over all recipes, or its only number.

    The result is empty where a recipe has no number for this key.
    """
    found = []
    for config in configs:
        keys = config.get(section)
        value = keys.get(key) if isinstance(keys, dict) else None
        ends = [float(end) for end in (value if isinstance(value, list) else [value]) if isinstance(end, int | float)]
        if not ends:
            return []
        found.append(ends)
    return found[0] if len(found) == 1 else sorted({min(min(ends) for ends in found), max(max(ends) for ends in found)})


def _size_range_px(configs: Sequence[Values]) -> list[float]:
    """Return the range ``particles.size_px`` over all recipes; [] where a recipe has another key that sizes models."""
    for config in configs:
        particles = config.get("particles")
        if not isinstance(particles, dict) or particles.get("size_m") is not None:
            return []
        if particles.get("density", "default") != "default":
            return []
        layers = [*(particles.get("layers") or ()), *(particles.get("clutter") or ())]
        if any(layer.get("size_px") is not None for layer in layers):
            return []
    return _config_range(configs, "particles", "size_px")


def _left_file(index: StoredIndex, key: PairKey) -> str:
    split, number = key
    path = index.plan.files(split, number)["left"]
    if index.plan.layout.packed:
        path += f" in shard {number // index.plan.shard_pairs} of {split}"
    return path


def _most_redrawn(
    index: StoredIndex, redraws: Redraws, measured: Sequence[PairMeasures]
) -> list[tuple[str, int | None, tuple[str, ...]]]:
    """Return name, position and messages of each of the pairs with the most failed attempts.

    The position is that of `PairMeasures`, or None for a pair outside the sample.
    """
    positions = {pair.key: pair.position for pair in measured}
    most = sorted(redraws.messages.items(), key=lambda item: -len(item[1]))[:_MOST_REDRAWN]
    prefixes = {split: f"{split} " if len(index.plan.pairs) > 1 else "" for split in index.plan.pairs}
    return [(f"{prefixes[key[0]]}{index.plan.key(*key).name}", positions.get(key), messages) for key, messages in most]


def _licences(sources: Mapping[SplitName, SplitSources]) -> list[tuple[str, str, int, str]]:
    """Return rows of split, kind (``photographs`` or ``models``), number of sources, and their licence."""
    return [
        (split, kind, count, licence)
        for split, source in sources.items()
        for kind in ("photographs", "models")
        for licence, count in sorted(Counter(item.licence for item in getattr(source, kind)).items())
    ]


def _finite(values: Iterable[float]) -> NDArray[np.float64]:
    array = np.array(list(values), np.float64)
    return array[np.isfinite(array)]
