"""Error and cost, side by side, of the ways to get the disparity, to store it and to antialias.

config -> scenes -> {ways, stores, images} -> report, a dictionary of JSON's types -> table, plot
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any

import numpy as np

from semisynth_gl.bench.images import DEFAULT_MODE, REFERENCE, ModeRow, default_images, measure_modes
from semisynth_gl.bench.machine import machine_facts
from semisynth_gl.bench.markdown import markdown
from semisynth_gl.bench.scenes import check_pixels, sample_scenes
from semisynth_gl.bench.stores import (
    DEFAULT_IMAGE_STORE,
    DEFAULT_STORE,
    ImageStoreRow,
    StoreRow,
    measure_image_stores,
    measure_stores,
)
from semisynth_gl.bench.ways import WayRow, measure_ways
from semisynth_gl.camera import EYES
from semisynth_gl.config import Config
from semisynth_gl.listener import Listener
from semisynth_gl.render.context import Backend
from semisynth_gl.render.variants import DEFAULT_WAY, DisparityVariants


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is measured.

    Attributes:
        pairs: how many pairs of the config.
        rays: pixels compared with the oracle, of each eye of each pair.
        repeats: how often each alternative takes its turn.
    """

    pairs: int = 3
    rays: int = 20_000
    repeats: int = 7


def measure(
    config: Config, seed: int, backend: Backend, effort: Effort, listener: Listener | None = None
) -> dict[str, Any]:
    """Measure everything.

    Args:
        config: where the scenes are from.
        seed: of scenes and of the choice of pixels.
        backend: "auto", "egl" or "osmesa".
        effort: how much.
        listener: hears a message at the start of each part.

    Returns:
        What was measured on, and under "get", "store", "images_store" and "antialias" the default and a row per
        alternative.

    Raises:
        SemisynthError: where the config or OpenGL cannot be used.
    """
    listener = listener or Listener()
    listener.on_message(f"making {effort.pairs} scenes of {config.name}")
    bench = sample_scenes(config, seed, effort.pairs)
    with DisparityVariants(bench.models, backend) as variants:
        listener.on_message(f"casting {effort.rays} rays for each eye of each pair")
        checked, outlines = check_pixels(bench, variants, effort.rays, np.random.default_rng(seed))
        listener.on_message("ways to get the disparity")
        ways = measure_ways(bench, variants, checked, effort.repeats)
        maps = [variants.disparity(scene, eye, DEFAULT_WAY) for scene in bench.scenes for eye in EYES]
        driver, ways_left_out = variants.facts, variants.left_out
    listener.on_message("ways to store it")
    kept = measure_stores(maps, effort.repeats)
    listener.on_message("ways to store images")
    images, images_left_out = measure_image_stores(default_images(bench, backend), effort.repeats)
    listener.on_message("ways to antialias")
    # Each turn opens a renderer anew: fewer of them do.
    modes, modes_left_out = measure_modes(bench, outlines, backend, max(1, effort.repeats // 2))
    disparity = np.concatenate([one[np.isfinite(one)] for one in maps])
    return {
        "config": config.name,
        "config_sha256": config.digest(),
        "seed": seed,
        **asdict(effort),
        "sizes_px": sorted({(scene.camera.width_px, scene.camera.height_px) for scene in bench.scenes}),
        "disparity_px": {
            "median": float(np.median(disparity)) if disparity.size else None,
            "largest": float(disparity.max()) if disparity.size else None,
        },
        "pixels_compared": sum(len(part.disparity_px) for part in checked),
        "pixels_left_out": sum(part.dropped for part in checked),
        "machine": machine_facts() | driver,
        "get": {"default": DEFAULT_WAY, "left_out": ways_left_out, "rows": _plain(ways)},
        "store": {"default": DEFAULT_STORE, "left_out": {}, "rows": _plain(kept)},
        "images_store": {"default": DEFAULT_IMAGE_STORE, "left_out": images_left_out, "rows": _plain(images)},
        "antialias": {
            "default": DEFAULT_MODE,
            "reference": REFERENCE,
            "left_out": modes_left_out,
            "rows": _plain(modes),
        },
    }


def table(report: Mapping[str, Any]) -> str:
    """Lay a report out as four tables in Markdown; a star marks the front, bold the default."""
    get, store, images, antialias = (report[part] for part in ("get", "store", "images_store", "antialias"))
    parts = [
        markdown(
            ("to get it", "ms a pair", "x", "median, px", "p99.9, px", "worst, px", "what it is"),
            [
                (_name(row, get), *_cost(row), *_errors(row["error"]), row["text"])
                for row in get["rows"]
            ],
        ),
        markdown(
            ("to store it", "ms a pair", "x", "ms to read", "kB a pair", "median, px", "p99.9, px", "worst, px",
             "what it is"),
            [
                (_name(row, store), *_cost(row), f"{1e3 * row['read_seconds_per_pair']:.1f}",
                 f"{row['bytes_per_pair'] / 1e3:.0f}", *_errors(row["error"]), row["text"])
                for row in store["rows"]
            ],
        ),
        markdown(
            ("to store images", "ms a pair", "x", "ms to read", "kB a pair", "lossless", "what it is"),
            [
                (_name(row, images), *_cost(row), f"{1e3 * row['read_seconds_per_pair']:.1f}",
                 f"{row['bytes_per_pair'] / 1e3:.0f}", "yes" if row["lossless"] else "no", row["text"])
                for row in images["rows"]
            ],
        ),
        markdown(
            ("to antialias", "ms a pair", "x", "PSNR, dB", "at outlines", "inside", "shift, px", "at outlines",
             "what it is"),
            [
                (_name(row, antialias), *_cost(row),
                 *(_number(row[key], ".1f") for key in ("psnr_db", "psnr_outline_db", "psnr_inside_db")),
                 _number(row["shift_px"], ".4f"), _number(row["outline_shift_px"], ".4f"), row["text"])
                for row in antialias["rows"]
            ],
        ),
    ]  # fmt: skip
    left_out = [
        f"{name} left out: {reason}"
        for part in (get, store, images, antialias)
        for name, reason in part["left_out"].items()
    ]  # fmt: skip
    return "\n\n".join([*parts, *left_out])


def _plain(
    rows: Sequence[WayRow] | Sequence[StoreRow] | Sequence[ImageStoreRow] | Sequence[ModeRow],
) -> list[dict[str, Any]]:
    return [_without_infinity(asdict(row)) for row in rows]


def _without_infinity(value: Any) -> Any:  # noqa: ANN401 - any of JSON's types
    """None for what JSON has no number for."""
    if isinstance(value, dict):
        return {key: _without_infinity(item) for key, item in value.items()}
    return None if isinstance(value, float) and not isfinite(value) else value


def _name(row: Mapping[str, Any], part: Mapping[str, Any]) -> str:
    name = f"**{row['name']}**" if row["name"] == part["default"] else row["name"]
    return f"{name} *" if row["on_front"] else name


def _cost(row: Mapping[str, Any]) -> tuple[str, str]:
    return f"{1e3 * row['seconds_per_pair']:.1f}", f"{row['time_ratio']:.2f}"


def _errors(error: Mapping[str, Any]) -> tuple[str, str, str]:
    median, p999, worst = (_number(error[key], ".1e") for key in ("median_px", "p999_px", "worst_px"))
    return median, p999, f"{worst}, {error['missing']} lost" if error["missing"] else worst


def _number(value: float | None, style: str) -> str:
    if value is None:
        return "-"
    return "0" if value == 0 else format(value, style)
