"""Errors of rendered disparities: of a config's scenes against float64 rays, of a test plane against its equation."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from semisynth_gl.bench.scenes import ConfigScenes, TruthAtPixels, cast_truth, sample_scenes
from semisynth_gl.bench.summary import error_stats, machine_facts
from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.inputs.errors import counted
from semisynth_gl.listener import Listener
from semisynth_gl.render import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.catalogue import FACE
from semisynth_gl.scene.scene import make_scene


def measure(
    config: Config, seed: int, backend: Backend, pairs: int = 3, rays: int = 20_000, *, listener: Listener
) -> dict[str, Any]:
    """Compare the disparities of a config's first ``pairs`` pairs with ``rays`` rays for each eye.

    Returns a report in JSON's types: the keys of `scene_facts`, "machine", and "disparity", the result of
    `error_stats`. The listener gets messages. Raises SemisynthError if the config or OpenGL cannot be used.
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


def scene_facts(bench: ConfigScenes, seed: int, truths: Sequence[TruthAtPixels]) -> dict[str, Any]:
    """Return config, seed, number of scenes, sizes (width, height), and counts of compared and left-out pixels."""
    return {
        "config": bench.config.name,
        "config_sha256": bench.config.digest(),
        "seed": seed,
        "pairs": len(bench.scenes),
        "sizes_px": sorted({(scene.camera.width_px, scene.camera.height_px) for scene in bench.scenes}),
        "pixels_compared": sum(len(part.disparity_px) for part in truths),
        "pixels_left_out": sum(part.left_out for part in truths),
    }


def table(report: Mapping[str, Any]) -> str:
    """Return the report of `measure` as a line of text."""
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


def plane_error_px(backend: Backend) -> float:
    """Render a slanted plane; return the largest disparity error of both views, px; BackendError without OpenGL."""
    camera = StereoCamera(320, 240, 400.0, 0.2, 155.5, 163.5, 119.5)
    # The points p of the plane satisfy normal . p = 2, with x and y from -9 to 9 m.
    normal, matrix = np.array([0.3, -0.2, 1.0]), np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] = (18, 0, 18 * -0.3), (0, 18, 18 * 0.2), (-9, -9, 2 + 9 * 0.3 - 9 * 0.2)
    layers = np.full((1, 8, 8, 4), 255, np.uint8)
    with Renderer([FACE], layers, backend=backend) as renderer:
        frame = renderer.render(make_scene(camera, model=[0], world_from_model=[matrix], layer=[0]))
    y, x = np.mgrid[:240, :320]
    worst = 0.0
    for eye in EYES:
        depth = (2.0 - normal[0] * camera.offset_m(eye)) / (camera.rays(eye, x, y) @ normal)
        worst = max(worst, float(np.abs(frame.view(eye).disparity - camera.disparity_px(depth)).max()))
    return worst
