"""Speed against error of alternatives: ways to get a pixel's disparity, and antialiasing modes.

    python benchmarks/alternatives.py --json alternatives.json

All alternatives render the same scenes in turns. In the tables, the default is bold, and a star marks the Pareto front
of time and error.
"""

import json
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
from disparity_variants import RENDERERS_VARIANT, VARIANTS, DisparityVariants, Variant
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from semisynth_gl.bench.accuracy import errors_text, scene_facts
from semisynth_gl.bench.scenes import ConfigScenes, TruthAtPixels, cast_truth, sample_scenes
from semisynth_gl.bench.summary import error_stats, headline, machine_facts, markdown
from semisynth_gl.config import Config, load_config
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.frame import as_rgb
from semisynth_gl.render import BACKENDS, Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import Scene

MODES: Mapping[str, str] = {
    "none": "one sample at the pixel's centre",
    "edges": "shares of pixels along outlines",
    "ssaa2": "4 samples, averaged",
    "ssaa3": "9 samples, averaged",
}
"""The measured antialiasing modes, with their descriptions."""
DEFAULT_MODE, REFERENCE = "none", "ssaa8"
# Relative differences up to this are ties, since repeated timings differ as much.
_TIE = 0.05


def measure(config: Config, seed: int, backend: Backend, pairs: int, rays: int, repeats: int) -> dict[str, Any]:
    """Measure all alternatives on the first pairs of a config.

    Returns in JSON's types the scenes, the machine, and rows of `timed_rows` under "get" and "antialias".
    """
    bench = sample_scenes(config, seed, pairs)
    with bench.open_renderer(backend, outputs=("instances",), truth="both") as renderer:
        frames, driver = [renderer.render(scene) for scene in bench.scenes], renderer.facts
    outlines = [_outlines(frame.view(eye).instances) for frame in frames for eye in EYES]
    truths = cast_truth(bench, rays, np.random.default_rng(seed))
    with DisparityVariants(bench.models, backend) as variants:
        disparities = measure_variants(bench, variants, truths, repeats)
    return {
        **scene_facts(bench, seed, truths),
        "machine": machine_facts() | driver,
        "get": disparities,
        "antialias": measure_modes(bench, outlines, backend, repeats),
    }


def measure_variants(
    bench: ConfigScenes, variants: DisparityVariants, truths: Sequence[TruthAtPixels], repeats: int
) -> list[dict[str, Any]]:
    """Measure the usable variants: the time to render and read back both disparities, and the error."""
    truth = np.concatenate([part.disparity_px for part in truths])

    def draw(variant: Variant) -> None:
        for scene in bench.scenes:
            for eye in EYES:
                variants.disparity(scene, eye, variant)

    def error(variant: Variant) -> dict[str, Any]:
        drawn = [
            variants.disparity(bench.scenes[part.scene], part.eye, variant)[part.row, part.column] for part in truths
        ]
        return error_stats(np.concatenate(drawn), truth)

    errors = {variant: error(variant) for variant in variants.usable}
    return timed_rows(
        {variant: partial(draw, variant) for variant in errors},
        {
            variant: {"text": VARIANTS[variant], "error": each, "weight": each["p999_px"]}
            for variant, each in errors.items()
        },
        RENDERERS_VARIANT,
        repeats,
        len(bench.scenes),
    )


def measure_modes(
    bench: ConfigScenes, outlines: Sequence[NDArray[np.bool_]], backend: Backend, repeats: int
) -> list[dict[str, Any]]:
    """Measure the antialiasing modes: the time to render both images with both disparities, and PSNR.

    ``outlines`` has, for each scene, the left and then the right eye's mask of `_outlines`. Returns rows with
    "psnr_db", "psnr_outline_db" and "psnr_inside_db" against `REFERENCE` (64 samples per pixel): over all pixels, over
    outline pixels and their eight neighbours, and over the rest.
    """
    near = np.concatenate([_dilated(outline).ravel() for outline in outlines])
    with ExitStack() as stack:
        renderers = {
            mode: stack.enter_context(bench.open_renderer(backend, outputs=(), antialias=mode))
            for mode in (*MODES, REFERENCE)
        }
        reference = _pixels(renderers.pop(REFERENCE), bench.scenes)
        figures = {}
        for mode, renderer in renderers.items():
            squares = (_pixels(renderer, bench.scenes).astype(np.float64) - reference) ** 2
            errors = {"db": squares.mean(), "outline_db": squares[near].mean(), "inside_db": squares[~near].mean()}
            psnr = {f"psnr_{name}": float(10 * np.log10(255**2 / error)) for name, error in errors.items()}
            figures[mode] = {"text": MODES[mode], **psnr, "weight": float(squares.mean())}
        calls = {mode: partial(_pixels, renderer, bench.scenes) for mode, renderer in renderers.items()}
        return timed_rows(calls, figures, DEFAULT_MODE, repeats, len(bench.scenes))


def timed_rows(
    calls: Mapping[str, Callable[[], object]],
    figures: Mapping[str, Mapping[str, Any]],
    default: str,
    repeats: int,
    pairs: int,
) -> list[dict[str, Any]]:
    """Time alternatives in turns, and compare time and error. Each turn begins with a different alternative.

    Args:
        calls: for each alternative, by name, a function that renders the pairs.
        figures: for each alternative, keys and values of its row; "weight" is its error.
        default: the alternative with which the others are compared.
        repeats: number of turns.
        pairs: number of pairs that a call renders.

    Returns:
        Rows with "name", the figures, "default", "seconds_per_pair" (median over the turns), "time_ratio" (median of
        the time over the default's time in the same turn), and "on_front": whether no other alternative is better by
        more than 5 % in time or error, and not worse by more than 5 % in either.
    """
    names, seconds = list(calls), {name: np.zeros(repeats) for name in calls}
    for turn in range(repeats):
        for number in range(len(names)):
            name = names[(turn + number) % len(names)]
            start = time.perf_counter()
            calls[name]()
            seconds[name][turn] = time.perf_counter() - start
    ratios = {name: float(np.median(own / seconds[default])) for name, own in seconds.items()}

    def dominates(other: str, name: str) -> bool:
        both = [(ratios[other], ratios[name]), (figures[other]["weight"], figures[name]["weight"])]
        return all(a <= b * (1 + _TIE) for a, b in both) and any(a * (1 + _TIE) < b for a, b in both)

    return [
        {
            "name": name,
            **figures[name],
            "default": name == default,
            "seconds_per_pair": float(np.median(seconds[name])) / pairs,
            "time_ratio": ratios[name],
            "on_front": not any(dominates(other, name) for other in names),
        }
        for name in names
    ]


def table(report: Mapping[str, Any]) -> str:
    """Return a report as two tables in Markdown."""

    def rows(part: str, cells: Callable[[Mapping[str, Any]], Sequence[str]]) -> list[tuple[str, ...]]:
        return [
            (
                (f"**{row['name']}**" if row["default"] else row["name"]) + " *" * row["on_front"],
                f"{1e3 * row['seconds_per_pair']:.1f}",
                f"{row['time_ratio']:.2f}",
                *cells(row),
                row["text"],
            )
            for row in report[part]
        ]

    errors, psnr = ("median, px", "p99.9, px", "worst, px"), ("PSNR, dB", "at outlines", "inside")
    got = rows("get", lambda row: errors_text(row["error"]))
    modes = rows("antialias", lambda row: [f"{row[f'psnr_{key}']:.1f}" for key in ("db", "outline_db", "inside_db")])
    return "\n\n".join(
        markdown((first, "ms a pair", "x", *figures, "what it is"), cells)
        for first, figures, cells in (("to get disparity", errors, got), ("to antialias", psnr, modes))
    )


def _pixels(renderer: Renderer, scenes: Sequence[Scene]) -> NDArray[np.uint8]:
    """Render scenes; return the pixels of all images, (N, 3)."""
    frames = [renderer.render(scene) for scene in scenes]
    return np.concatenate([as_rgb(frame.view(eye).image).reshape(-1, 3) for frame in frames for eye in EYES])


def _outlines(instances: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Return the (H, W) mask of pixels next to, above or below a pixel of a different instance."""
    mask = np.zeros(instances.shape, bool)
    beside, below = instances[:, 1:] != instances[:, :-1], instances[1:] != instances[:-1]
    mask[:, 1:] |= beside
    mask[:, :-1] |= beside
    mask[1:] |= below
    mask[:-1] |= below
    return mask


def _dilated(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (H, W) dilated by a pixel in all directions."""
    return np.asarray(Image.fromarray(mask.astype(np.uint8)).filter(ImageFilter.MaxFilter(3)), bool)


@click.command()
@click.option("--config", "name", default="eth3d", show_default=True)
@click.option("--set", "settings", multiple=True, metavar="dotted.key=value")
@click.option("--seed", default=0, show_default=True)
@click.option("--backend", type=click.Choice(BACKENDS), default="auto", show_default=True)
@click.option("--pairs", default=3, show_default=True)
@click.option("--rays", default=20_000, show_default=True, help="Rays cast for each eye of a pair.")
@click.option("--repeats", default=7, show_default=True)
@click.option("--json", "out", type=click.Path(path_type=Path), help="Also write the report here.")
def main(
    name: str,
    settings: tuple[str, ...],
    seed: int,
    backend: Backend,
    pairs: int,
    rays: int,
    repeats: int,
    out: Path | None,
) -> None:
    """Measure, and print the tables."""
    report = measure(load_config(name, settings), seed, backend, pairs, rays, repeats)
    report["command"] = shlex.join(["python", "benchmarks/alternatives.py", *sys.argv[1:]])
    if out is not None:
        out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    click.echo(f"{headline(report)}\n\n{table(report)}")


if __name__ == "__main__":
    main()
