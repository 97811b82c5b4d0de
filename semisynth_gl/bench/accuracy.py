"""The error of the rendered disparity against float64 rays."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from semisynth_gl.bench.scenes import BenchScenes, TruthAtPixels, cast_truth, sample_scenes
from semisynth_gl.bench.summary import error_stats, machine_facts
from semisynth_gl.config import Config
from semisynth_gl.inputs.errors import counted
from semisynth_gl.listener import Listener
from semisynth_gl.render.backends import Backend


def measure(
    config: Config, seed: int, backend: Backend, pairs: int = 3, rays: int = 20_000, *, listener: Listener
) -> dict[str, Any]:
    """Compare ``pairs`` pairs with ``rays`` rays for each eye; the listener gets a message before each part.

    Returns a report in JSON's types: the keys of `scene_facts`, "machine", and "disparity", the result of
    `error_stats`. Raises SemisynthError if the config or OpenGL cannot be used.
    """
    listener.on_message(f"making {counted(pairs, 'scene')} of {config.name}")
    bench = sample_scenes(config, seed, pairs)
    with bench.open_renderer(backend, outputs=(), truth="both") as renderer:
        frames, driver = [renderer.render(scene) for scene in bench.scenes], renderer.facts
    listener.on_message(f"casting {counted(rays, 'ray')} for each eye of each pair")
    truths = cast_truth(bench, rays, np.random.default_rng(seed))
    rendered = [frames[part.scene].view(part.eye).disparity[part.row, part.column] for part in truths]
    error = error_stats(np.concatenate(rendered), np.concatenate([part.disparity_px for part in truths]))
    return {**scene_facts(bench, seed, truths), "machine": machine_facts() | driver, "disparity": error}


def scene_facts(bench: BenchScenes, seed: int, truths: Sequence[TruthAtPixels]) -> dict[str, Any]:
    """Describe the measured scenes: config, seed, sizes (width, height), and numbers of pixels.

    "pixels_left_out" is the number of sampled pixels that were not compared.
    """
    return {
        "config": bench.config.name,
        "config_sha256": bench.config.digest(),
        "seed": seed,
        "pairs": len(bench.scenes),
        "sizes_px": sorted({(scene.camera.width_px, scene.camera.height_px) for scene in bench.scenes}),
        "pixels_compared": sum(len(part.disparity_px) for part in truths),
        "pixels_left_out": sum(part.dropped for part in truths),
    }


def table(report: Mapping[str, Any]) -> str:
    """Return a report as one line."""
    median, p999, worst = errors_text(report["disparity"])
    return (
        f"Disparity against float64 rays, {report['pixels_compared']} pixels (without {report['pixels_left_out']} "
        f"within 1/16 px of a different triangle): median error {median} px, 99.9 % {p999} px, worst {worst} px."
    )


def errors_text(error: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return the median, the 99.9th percentile and the worst of `error_stats`, px, as text; "-" stands for None."""
    values = (error[key] for key in ("median_px", "p999_px", "worst_px"))
    median, p999, worst = ("-" if value is None else f"{value:.1e}" for value in values)
    return median, p999, f"{worst}, {error['missing']} missing" if error["missing"] else worst
