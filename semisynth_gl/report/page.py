"""The page: one HTML file that asks nothing of a server or the network."""

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from semisynth_gl.config.model import ImperfectionsSection
from semisynth_gl.dataset.reader import Index
from semisynth_gl.histogram import Histogram, total_variation, wasserstein_px
from semisynth_gl.report.measure import RAYS, Measurement, PairMeasures, Rays
from semisynth_gl.report.outliers import QUANTITIES, Outlier
from semisynth_gl.report.pictures import JPEG_QUALITY, Picture
from semisynth_gl.report.plots import bars_of, histogram_svg
from semisynth_gl.report.redraws import Redraws
from semisynth_gl.resources import data_root

_TITLE = "{name}: a stereo dataset"
# Shares of pixels are drawn in bins of equal width whatever those of the target.
_DISPARITY_BINS = 72
_MOST_REDRAWN = 20
_MEGA = 1e6

# Colours of the overlays, RGB. Blue is not in the colour map, nor are the masks' colours like each other to anyone.
_NO_DISPARITY = (64, 96, 192)
_OCCLUDED = (230, 97, 0)
_OUTSIDE = (93, 58, 155)


@dataclass(frozen=True, slots=True)
class ShownPair:
    """A pair that the page shows.

    Attributes:
        measures: what was measured of it.
        label: its number, and its split where there are several.
        picture: what is embedded.
        why: why it is shown, where it is not one of the evenly spread ones.
    """

    measures: PairMeasures
    label: str
    picture: Picture
    why: str | None


def write_page(
    index: Index,
    measurement: Measurement,
    redraws: Redraws,
    outliers: Sequence[Outlier],
    shown: Sequence[ShownPair],
    colours: Sequence[tuple[int, int, int]],
) -> str:
    """Write the page.

    Args:
        index: the dataset's.
        measurement: of a sample.
        redraws: of the whole dataset, or of the split that the sample is from.
        outliers: those to list, in their order.
        shown: the pairs to show.
        colours: the colour map of disparities, from the smallest to the largest, 8-bit RGB.
    """
    measured = measurement.pairs
    title = _TITLE.format(name=index.values.get("config"))
    number = {pair.measures.position: k for k, pair in enumerate(shown)}
    return _filled(
        data_root("assets").joinpath("report.html").read_text("utf-8"),
        {
            "title": escape(title),
            "style": data_root("assets").joinpath("report.css").read_text("utf-8"),
            "script": data_root("assets").joinpath("report.js").read_text("utf-8"),
            "summary": _summary(index),
            "facts": _facts(index, measurement),
            "warnings": _warnings(measurement, redraws),
            "shown": _about_shown(shown, measurement.of_pairs),
            "sampled": _about_sample(len(measured), measurement.of_pairs),
            "charts": "\n".join(_charts(index, measurement)),
            "outliers": _outliers(index, outliers, number, len(measured)),
            "redrawn": _redrawn(index, redraws, number, measured),
            "provenance": _provenance(index),
            "method": _method(measurement.rays),
            "data": _in_script(_data(shown, colours)),
            "blobs": "\n".join(_blobs(shown)),
        },
    )


def _filled(template: str, values: Mapping[str, str]) -> str:
    """Put values in the places of a template; what they hold is not looked at again."""
    return re.sub(r"\{\{(\w+)\}\}", lambda place: values[place[1]], template)


def _in_script(values: object) -> str:
    """Write JSON that no HTML parser takes for the end of a script."""
    return json.dumps(values, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


# What the viewer is given.


def _data(shown: Sequence[ShownPair], colours: Sequence[tuple[int, int, int]]) -> dict[str, Any]:
    return {
        "pairs": [
            {
                "label": pair.label,
                "caption": _caption(pair),
                "width": pair.picture.width_px,
                "height": pair.picture.height_px,
                "step": pair.picture.step,
                "low": pair.picture.low_px,
                "high": pair.picture.high_px,
                "focal_baseline": pair.picture.focal_baseline,
                "doffs": pair.picture.doffs_px,
            }
            for pair in shown
        ],
        "colours": [list(colour) for colour in colours],
        "none": _NO_DISPARITY,
        "occluded": _OCCLUDED,
        "outside": _OUTSIDE,
    }


def _caption(pair: ShownPair) -> str:
    measures = pair.measures
    parts = [f"{measures.name}: median disparity {measures.median_px:.4g} px"]
    if measures.occluded is not None:
        parts.append(f"{measures.occluded:.1%} occluded")
    parts.append(f"texture {measures.texture:.3g} levels")
    if measures.redraws:
        parts.append(f"drawn again {_times(measures.redraws)}")
    if pair.why:
        parts.append(pair.why)
    return ", ".join(parts)


def _blobs(shown: Sequence[ShownPair]) -> Iterable[str]:
    for number, pair in enumerate(shown):
        for name in ("thumbnail", "left", "right", "disparity", "visibility"):
            data = getattr(pair.picture, name)
            if data is not None:
                yield f'<script type="text/plain" id="pair-{number}-{name}">{data}</script>'


# Text around it.


def _summary(index: Index) -> str:
    values = index.values
    pairs = sum(index.pairs.values())
    return (
        f"{pairs:,} rectified pairs of {escape(str(values.get('program')))} {escape(str(values.get('version')))}, "
        f"config {escape(str(values.get('config')))}, seed {escape(str(values.get('seed')))}, layout "
        f"{escape(str(values.get('layout')))}."
    )


def _facts(index: Index, measurement: Measurement) -> str:
    width, height = index.number("camera", "width_px"), index.number("camera", "height_px")
    facts = [("pairs", f"{sum(index.pairs.values()):,}")]
    if width and height:
        facts.append(("image", f"{width:.0f} x {height:.0f} px"))
    disparity, target = measurement.disparity, measurement.target
    if disparity is not None:
        facts.append(("mean disparity", f"{disparity.mean_px:.4g} px"))
    if disparity is not None and target is not None:
        facts.append(("from the target: total variation", f"{total_variation(target, disparity):.3f}"))
        facts.append(("from the target: Wasserstein-1", f"{wasserstein_px(target, disparity):.3g} px"))
    medians = _finite(pair.median_px for pair in measurement.pairs)
    if medians.size:
        low, high = np.percentile(medians, [5, 95])
        facts.append(("medians of single pairs, 5 % to 95 %", f"{low:.4g} to {high:.4g} px"))
    if measurement.rays.texels_per_pixel.size:
        low, middle, high = np.percentile(measurement.rays.texels_per_pixel, [5, 50, 95])
        facts.append(("texels on a pixel: median (5 %, 95 %)", f"{middle:.2f} ({low:.2f}, {high:.2f})"))
    return "\n".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in facts)


def _warnings(measurement: Measurement, redraws: Redraws) -> str:
    texts = []
    if measurement.unread:
        texts.append(
            f"{len(measurement.unread)} sampled pairs could not be read and are left out; of the first: "
            f"{measurement.unread[0]}. semisynth-gl verify tells of all."
        )
    if redraws.unread:
        texts.append(f"{len(redraws.unread)} records of shards could not be read; of the first: {redraws.unread[0]}.")
    if measurement.target_fault is not None:
        texts.append(f"The target is not drawn: {measurement.target_fault}.")
    texts += [
        f"Slant, object size and texel density leave out {count} of {measurement.rays.asked} scenes: {reason}."
        for reason, count in measurement.rays.faults.items()
    ]
    return "\n".join(f'<p class="warning">{escape(text)}</p>' for text in texts)


def _about_shown(shown: Sequence[ShownPair], of_pairs: int) -> str:
    if not shown:
        return "None is shown, as was asked for."
    step = shown[0].picture.step
    spread = sum(1 for pair in shown if pair.why is None)
    more = len(shown) - spread
    added = f", and {more} {'outlier' if more == 1 else 'outliers'} beside them" if more else ""
    of = f"All {of_pairs:,} pairs" if spread == of_pairs else f"{spread} of {of_pairs:,} pairs, evenly spread"
    size = (
        "At the size they are stored in"
        if step == 1
        else f"Reduced to 1/{step} of their size to keep this page small: images are averaged, and disparities and "
        f"masks are those of every {step}{'nd' if step == 2 else 'rd' if step == 3 else 'th'} pixel"
    )
    return (
        f"{of}{added}. {size}. Images are JPEG of quality {JPEG_QUALITY}, for the "
        "eye; the disparity under the cursor is the stored float32, to the last bit. Keys: <kbd>F</kbd> flicker, "
        "<kbd>C</kbd> hold to compare, <kbd>O</kbd> next overlay, <kbd>N</kbd> and <kbd>P</kbd> next and previous "
        "pair, arrows move the cursor. Overlays belong to the left view; colours of disparity span 1 % to 99 % of its "
        "pixels. Between left and warped right nothing may move."
    )


def _about_sample(measured: int, of_pairs: int) -> str:
    if measured == of_pairs:
        return f"All {of_pairs:,} pairs were measured."
    return f"Of {of_pairs:,} pairs, {measured:,} were measured, evenly spread."


# Distributions.


def _charts(index: Index, measurement: Measurement) -> Iterable[str]:
    pairs, rays = measurement.pairs, measurement.rays
    if measurement.disparity is not None:
        yield _disparity_chart(measurement.disparity, measurement.target, len(pairs))
    yield _chart(
        "Median disparity of single pairs",
        _finite(pair.median_px for pair in pairs),
        "px",
        f"One value for each of {len(pairs)} pairs.",
        "No pair has a disparity.",
    )
    yield _chart(
        "Depth",
        measurement.depth_m,
        "m",
        f"Planar, from the disparities of {measurement.depth_m.size:,} pixels on a grid; logarithmic.",
        "No pair has a disparity.",
        log=True,
    )
    missing = "The scenes could not be made again; the reason stands at the top of this page."
    found = f"{rays.agreeing:,} rays in {rays.pairs} pairs, on a grid of {rays.spacing_px} px."
    yield _chart(
        "Slant",
        rays.slant_deg,
        "degrees",
        f"Angle between the surface's normal and the ray to the pixel: 0 faces the camera. {found}",
        missing,
        limits=(0.0, 90.0),
    )
    size_px = ("particles", "size_px")
    decides = _size_px_decides(index)
    yield _chart(
        "Object size",
        rays.diameter_px,
        "px",
        "Diameter of a model's bounding sphere on the screen, before it is stretched, once for each pair in which a "
        f"ray hits it; the background is none. Logarithmic. {_range_text(index, *size_px) if decides else ''}",
        missing,
        log=True,
        marks=_range_marks(index, *size_px) if decides else (),
    )
    yield _chart(
        "Texel density",
        rays.texels_per_pixel,
        "texels along the side of a pixel",
        "1 shows a patch at its own resolution, above 1 smaller, below 1 blown up. Logarithmic. "
        f"{_range_text(index, 'textures', 'texels_per_pixel', ' where a surface faces the camera')} {found}",
        missing,
        log=True,
        marks=_range_marks(index, "textures", "texels_per_pixel"),
    )
    occluded = [100 * pair.occluded for pair in pairs if pair.occluded is not None]
    yield _chart(
        "Occlusion share",
        np.array(occluded, np.float64),
        "% of the left view's pixels",
        f"What something hides from the right view, one value for each of {len(occluded)} pairs; pixels outside the "
        "right view are not counted.",
        "The dataset has no masks (output visibility).",
    )
    yield _chart(
        "Texture",
        np.array([pair.texture for pair in pairs], np.float64),
        "8-bit levels",
        f"Texture measure of a pair's flatter image, of every second pixel of every second row, {_textured(index)}.",
        "",
        marks=_range_marks(index, "checks", "min_texture"),
    )


def _disparity_chart(achieved: Histogram, target: Histogram | None, pairs: int) -> str:
    # Nobody sees bins beyond the last that holds anything.
    ends = [(each.quantile(1e-4), each.quantile(1 - 1e-4)) for each in (achieved, target) if each is not None]
    edges = np.linspace(min(low for low, _ in ends), max(high for _, high in ends), _DISPARITY_BINS + 1)
    bars = bars_of([edges[0]], bins=_DISPARITY_BINS, limits=(edges[0], edges[-1]))
    bars = type(bars)(edges, achieved.rebinned(edges).shares)
    outline = None if target is None else target.rebinned(edges).shares
    low, middle, high = (achieved.quantile(share) for share in (0.05, 0.5, 0.95))
    text = (
        f'<span class="key bars">■ achieved</span>, all pixels of {pairs} left views: mean {achieved.mean_px:.4g} px, '
        f"median {middle:.4g}, 5 % {low:.4g}, 95 % {high:.4g}."
    )
    if target is not None:
        text += (
            f' <span class="key">— target</span>: mean {target.mean_px:.4g} px. Total variation '
            f"<b>{total_variation(target, achieved):.3f}</b> in the target's {len(target.shares)} bins, Wasserstein-1 "
            f"distance <b>{wasserstein_px(target, achieved):.3g} px</b>."
        )
    svg = histogram_svg(bars, "Histogram of disparity", "disparity, px", outline=outline)
    return _figure("Disparity, target beside achieved" if target is not None else "Disparity", svg, text)


def _chart(
    name: str,
    values: NDArray[np.float64],
    unit: str,
    what: str,
    missing: str,
    *,
    log: bool = False,
    limits: tuple[float, float] | None = None,
    marks: Sequence[tuple[float, str]] = (),
) -> str:
    if not values.size:
        return _figure(name, "", f"Not drawn. {escape(missing)}")
    low, middle, high = np.percentile(values, [5, 50, 95])
    svg = histogram_svg(bars_of(values, log=log, limits=limits), f"Histogram: {name.lower()}", unit, marks=marks)
    numbers = f"Median <b>{middle:.3g}</b>, 5 % <b>{low:.3g}</b>, 95 % <b>{high:.3g}</b>."
    return _figure(name, svg, f"{numbers} {escape(what)}")


def _figure(name: str, svg: str, text: str) -> str:
    return f"<figure><h3>{escape(name)}</h3>{svg}<figcaption>{text}</figcaption></figure>"


def _size_px_decides(index: Index) -> bool:
    """Whether ``particles.size_px`` alone says how large models are on the screen."""
    particles = index.config.get("particles")
    if not isinstance(particles, dict) or particles.get("size_m") is not None:
        return False
    layers = [*(particles.get("layers") or ()), *(particles.get("clutter") or ())]
    return particles.get("density", "default") == "default" and all(each.get("size_px") is None for each in layers)


def _textured(index: Index) -> str:
    """Say of which images the texture measure is."""
    try:
        changed = not ImperfectionsSection.model_validate(index.config.get("imperfections", {})).none()
    except ValidationError:
        # Of another version, whose imperfections are not known here.
        changed = True
    return (
        "of the images as stored, with their imperfections; checks.min_texture (dashed) is for images without"
        if changed
        else "as checks.min_texture (dashed) takes it"
    )


def _range_of(index: Index, section: str, key: str) -> list[float]:
    """Ends of a range of the config, or its one number; none where there is none."""
    keys = index.config.get(section)
    value = keys.get(key) if isinstance(keys, dict) else None
    values = value if isinstance(value, list) else [value]
    return [float(each) for each in values if isinstance(each, int | float)]


def _range_text(index: Index, section: str, key: str, where: str = "") -> str:
    ends = _range_of(index, section, key)
    return f"The config's {section}.{key} is {' to '.join(f'{end:g}' for end in ends)}{where} (dashed)." if ends else ""


def _range_marks(index: Index, section: str, key: str) -> list[tuple[float, str]]:
    return [(end, f"{section}.{key}: {end:g}") for end in _range_of(index, section, key)]


# Tables.


def _outliers(index: Index, outliers: Sequence[Outlier], number: Mapping[int, int], measured: int) -> str:
    if not outliers:
        return "<p>All measured pairs are alike.</p>"
    rows = [
        (
            _pair_link(each.pair.name, number.get(each.pair.position)),
            escape(each.quantity.name),
            _number(format(each.value, each.quantity.form)),
            _number(format(each.typical, each.quantity.form)),
            _number(f"{each.deviations:.1f}"),
            _file_of(index, each.pair),
        )
        for each in outliers
    ]
    return (
        f"<p>Of the {measured:,} measured pairs, the three that are farthest from the median in each of "
        f"{len(QUANTITIES)} quantities, in standard deviations as the median absolute deviation tells them. A value of "
        "3 is nothing rare among many pairs.</p>"
        + _table(("pair", "quantity", "#value", "#median of all", "#deviations", "left image"), rows)
    )


def _redrawn(index: Index, redraws: Redraws, number: Mapping[int, int], measured: Sequence[PairMeasures]) -> str:
    if not redraws.attempts:
        return f"<p>Nothing: all {redraws.pairs:,} pairs passed the config's checks as they were drawn first.</p>"
    positions = {pair.key: pair.position for pair in measured}
    reasons = [(escape(each.name), _number(f"{each.attempts:,}"), escape(each.example)) for each in redraws.reasons]
    most = sorted(redraws.of_pair.items(), key=lambda item: -len(item[1]))[:_MOST_REDRAWN]
    pairs = [
        (
            _pair_link(_name(index, key), number.get(positions.get(key, -1))),
            _number(str(len(texts))),
            "<br>".join(escape(text) for text in texts),
        )
        for key, texts in most
    ]
    share = len(redraws.of_pair) / max(redraws.pairs, 1)
    return (
        f"<p>{_times(redraws.attempts).capitalize()} in all, a pair failed the config's checks and was drawn again: "
        f"{len(redraws.of_pair):,} of {redraws.pairs:,} pairs ({share:.2%}), told by the records of all shards. Frames "
        "of a sequence are drawn again together and count as one. An attempt may have several faults.</p>"
        + _table(("fault", "#attempts", "for example"), reasons)
        + f"<h3>Drawn again most often</h3>{_table(('pair', '#times', 'why'), pairs)}"
    )


def _name(index: Index, key: tuple[Any, int]) -> str:
    scene = index.key(*key).scene
    return scene if len(index.pairs) == 1 else f"{key[0]} {scene}"


def _pair_link(name: str, shown: int | None) -> str:
    return escape(name) if shown is None else f'<a href="#pairs" data-pair="{shown}">{escape(name)}</a>'


def _file_of(index: Index, pair: PairMeasures) -> str:
    path = index.files(*pair.key)["left"]
    if index.layout.packed:
        each = int(index.values["shard_pairs"])
        path += f" in shard {pair.key[1] // each} of {pair.key[0]}"
    return f"<code>{escape(path)}</code>"


def _provenance(index: Index) -> str:
    values = index.values
    splits = values.get("splits", {})
    encodings = index.encodings
    rows = [
        ("program", f"{values.get('program')} {values.get('version')}"),
        ("config", values.get("config")),
        ("SHA-256 of the config", values.get("config_sha256")),
        ("seed", values.get("seed")),
        ("layout", f"{values.get('layout')}; images {encodings.image}, disparities {encodings.disparity}"),
        ("pairs", ", ".join(f"{count:,} {split}" for split, count in index.pairs.items())),
        (
            "truth",
            f"of {'both views' if index.truth == 'both' else 'the left view'}; {', '.join(index.outputs) or 'none'}",
        ),
        ("shards", f"{len(values.get('shards', ())):,}, {values.get('bytes', 0) / _MEGA:,.0f} MB"),
        ("renderers", ", ".join(map(str, values.get("renderers", ())))),
        ("licence of the dataset", _licence_of(index)),
    ]
    described = _table(("", ""), [(escape(name), escape(str(value))) for name, value in rows])
    origins = [
        (escape(split), escape(what), _number(str(count)), escape(licence))
        for split, each in splits.items()
        for what, items in (("photographs", each.get("photographs", ())), ("models", each.get("models", ())))
        for licence, count in sorted(Counter(str(item.get("licence")) for item in items).items())
    ]
    patches = ", ".join(f"{len(each.get('patches', ())):,} in {split}" for split, each in splits.items())
    left_out = [f"{split}: {text}" for split, each in splits.items() for text in each.get("left_out", ())]
    parts = [
        described,
        f"<h3>What it was made of</h3><p>Patches of photographs or patterns: {escape(patches)}.</p>",
        _table(("split", "what", "#how many", "licence"), origins),
    ]
    if left_out:
        entries = "".join(f"<li>{escape(text)}</li>" for text in left_out)
        parts.append(f"<details><summary>Left out: {len(left_out)} files</summary><ul>{entries}</ul></details>")
    config = json.dumps(index.config, indent=1)
    parts.append(f"<details><summary>The whole config</summary><pre>{escape(config)}</pre></details>")
    return "\n".join(parts)


def _licence_of(index: Index) -> str:
    section = index.config.get("licences")
    return str(section.get("dataset")) if isinstance(section, dict) else "not told"


def _method(rays: Rays) -> str:
    agreed = (
        f"{rays.agreeing:,} of {rays.cast:,} rays ({rays.agreeing / rays.cast:.2%}) did; the others, beside edges, are "
        "left out."
        if rays.cast
        else "None could be cast."
    )
    return (
        "<p>Disparity is of the left view, in px, and valid where the file has a finite value; its histogram counts "
        "every pixel. Total variation is half the sum of the absolute differences of the shares in the target's bins; "
        "the Wasserstein-1 distance is the area between the two cumulative distributions.</p>"
        f"<p>Slant, object size and texel density come from the scenes, made again from config, seed and index: about "
        f"{RAYS:,} float64 rays in each pair, on a square grid over the left view. A ray counts if it finds the "
        f"disparity that the file has within 0.001 px and the encoding's rounding. {agreed} Texel density is the "
        "square root of the area of patch, in texels of the patch's own resolution, that a pixel sees: the geometric "
        "mean of the singular values of the map from pixels to texels.</p>"
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table; heads that begin with # stand over numbers. Cells are HTML."""
    heads = "".join(
        f'<th class="number">{name[1:]}</th>' if name.startswith("#") else f"<th>{name}</th>" for name in head
    )
    body = "".join(
        "<tr>" + "".join(cell if cell.startswith("<td") else f"<td>{cell}</td>" for cell in row) + "</tr>"
        for row in rows
    )
    top = f"<thead><tr>{heads}</tr></thead>" if any(head) else ""
    return f'<div class="table"><table>{top}<tbody>{body}</tbody></table></div>'


def _number(text: str) -> str:
    return f'<td class="number">{escape(text)}</td>'


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count:,} times"


def _finite(values: Iterable[float]) -> NDArray[np.float64]:
    array = np.array(list(values), np.float64)
    return array[np.isfinite(array)]
