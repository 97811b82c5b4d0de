"""Render the page: one HTML file that needs neither server nor network. Its template is assets/report.html."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from semisynth_gl.dataset.documents import SplitSources
from semisynth_gl.dataset.reader import StoredIndex
from semisynth_gl.histogram import Histogram, total_variation, wasserstein_px
from semisynth_gl.inputs.resources import data_root
from semisynth_gl.inputs.templates import template_environment
from semisynth_gl.judge.comparison import Comparison
from semisynth_gl.judge.measured_pairs import QUANTITIES, Measurement, Outlier, PairKey, PairMeasures, Redraws
from semisynth_gl.judge.pictures import BEYOND, HIDDEN, JPEG_QUALITY, NO_DISPARITY, EncodedPair
from semisynth_gl.judge.plots import count_bars, draw_histogram
from semisynth_gl.seeds.splits import SplitName

_MOST_REDRAWN = 20
_DISPARITY_BINS = 72


def render_page(
    index: StoredIndex,
    measurement: Measurement,
    comparison: Comparison | None,
    outliers: Sequence[Outlier],
    shown: Sequence[tuple[PairMeasures, str | None]],
    pictures: Sequence[EncodedPair],
) -> str:
    """Return the page of a dataset, or of the split that the measurement is from, as HTML.

    Args:
        index: the dataset's index.
        measurement: the measures of the sample.
        comparison: the measures beside those of the place; None without a place.
        outliers: the outliers to list.
        shown: the pairs to show, each outlier with the reason to show it, and evenly spread pairs with None.
        pictures: the images and arrays of these pairs.
    """
    assets = data_root("assets")
    environment = template_environment()
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    disparity, target = measurement.disparity, measurement.target
    sources = {} if index.made is None else index.made.split_sources
    configs = [recipe.config.model_dump(mode="json") for recipe in index.plan.config.recipes()]
    return environment.get_template("report.html").render(
        plan=index.plan,
        measurement=measurement,
        comparison=comparison,
        target_variation=total_variation(target, disparity) if target and disparity else None,
        target_wasserstein_px=wasserstein_px(target, disparity) if target and disparity else None,
        charts=_charts(configs, measurement),
        compared_charts=[] if comparison is None else _compared_charts(comparison),
        imperfect=index.imperfect,
        outliers=[(outlier, _left_file(index, outlier.pair.key)) for outlier in outliers],
        quantities=len(QUANTITIES),
        redraws=measurement.redraws,
        most_redrawn=_most_redrawn(index, measurement.redraws, measurement.pairs),
        sources=sources,
        licences=_licences(sources),
        unused_files=[(split, text) for split, source in sources.items() for text in source.left_out],
        config_json=json.dumps(index.plan.config.model_dump(mode="json"), indent=1),
        pictures=pictures,
        spread=sum(reason is None for _, reason in shown),
        shown_numbers={pair.position: number for number, (pair, _) in enumerate(shown)},
        jpeg_quality=JPEG_QUALITY,
        colours={"hidden": HIDDEN, "beyond": BEYOND, "none": NO_DISPARITY},
        viewed=[_viewed(index, *each, picture) for each, picture in zip(shown, pictures, strict=True)],
        style=assets.joinpath("report.css").read_text("utf-8"),
        script=assets.joinpath("report.js").read_text("utf-8"),
    )


def _viewed(index: StoredIndex, measures: PairMeasures, reason: str | None, picture: EncodedPair) -> dict[str, Any]:
    """Return the values that report.js needs for a pair, except images and arrays."""
    split, number = measures.key
    caption = [f"{measures.name}: median disparity {measures.median_px:.4g} px"]
    if measures.recipe is not None:
        caption.insert(0, f"recipe {measures.recipe}")
    if measures.occluded is not None:
        caption.append(f"{measures.occluded:.1%} occluded")
    caption.append(f"texture {measures.texture:.3g} levels")
    if measures.redraws:
        caption.append(f"drawn again {'once' if measures.redraws == 1 else f'{measures.redraws} times'}")
    if picture.low_px is not None:
        caption.append(f"colours from {picture.low_px:.1f} to {picture.high_px:.1f} px")
    if reason is not None:
        caption.append(reason)
    return {
        "label": f"{number:06d}" if len(index.plan.pairs) == 1 else f"{split} {number:06d}",
        "caption": ", ".join(caption),
        "width": picture.width_px,
        "height": picture.height_px,
        "step": picture.step,
        "focal_baseline": picture.camera.focal_baseline,
        "doffs": picture.camera.doffs_px,
    }


def _charts(configs: Sequence[Mapping[str, Any]], measurement: Measurement) -> dict[str, dict[str, Any] | None]:
    """Draw the distributions, by the names under which the template uses them; a chart without values is None.

    A chart is its ``svg`` element, and the quantiles ``low`` (5 %), ``median`` and ``high`` (95 %) of its values.
    """
    pairs, disparity = measurement.pairs, measurement.disparity

    def chart(values: Iterable[float], label: str, marks: Sequence[tuple[float, str]] = ()) -> dict[str, Any] | None:
        array = np.array([value for value in values if np.isfinite(value)], np.float64)
        if not array.size:
            return None
        low, median, high = np.percentile(array, [5, 50, 95])
        svg = draw_histogram(*count_bars(array), label, marks=marks)
        return {"svg": svg, "low": low, "median": median, "high": high}

    least = {float(config["checks"]["min_texture"]) for config in configs}
    marks = [(value, f"checks.min_texture: {value:g}") for value in sorted(least)]
    occluded = (100 * pair.occluded for pair in pairs if pair.occluded is not None)
    return {
        "disparity": _disparity_chart(disparity, measurement.target) if disparity else None,
        "median": chart((pair.median_px for pair in pairs), "px"),
        "occlusion": chart(occluded, "% of the left view's pixels"),
        "texture": chart((pair.texture for pair in pairs), "8-bit levels", marks),
    }


def _disparity_chart(achieved: Histogram, target: Histogram | None) -> dict[str, Any]:
    # The outermost 0.01 % of pixels on either side would make the axis too long.
    both = [achieved] if target is None else [achieved, target]
    low = min(histogram.quantile(1e-4) for histogram in both)
    high = max(histogram.quantile(1 - 1e-4) for histogram in both)
    edges = np.linspace(low, high, _DISPARITY_BINS + 1)
    outline = None if target is None else target.rebinned(edges).shares
    svg = draw_histogram(edges, achieved.rebinned(edges).shares, "disparity, px", outline=outline)
    quantiles = {"low": 0.05, "median": 0.5, "high": 0.95}
    return {"svg": svg} | {name: achieved.quantile(share) for name, share in quantiles.items()}


def _compared_charts(comparison: Comparison) -> list[tuple[str, str]]:
    """Return the name and the drawing of each measure that both sides have; the place is the outline."""
    charts = []
    for row in comparison.rows:
        ours, theirs = (side.values[row.measure.key] for side in (comparison.dataset, comparison.place.side))
        if len(ours) and len(theirs):
            edges, _ = count_bars(np.concatenate([ours, theirs]))
            _, outline = count_bars(theirs, edges)
            svg = draw_histogram(*count_bars(ours, edges), row.measure.unit, outline=outline)
            charts.append((row.measure.name, svg))
    return charts


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
