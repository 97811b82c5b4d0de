"""How exact optical flow is against float64 rays, at about a hundred pixels of motion, and what it costs.

    python benchmarks/flow.py --out flow.json

Two tables: errors by config, and seconds of a pair by what is made. docs/accuracy.md and
docs/performance.md quote from them.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from timing import alternated

from semisynth_gl import oracle
from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.config import Config, load_config
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.frame import Frame
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.scene import Motion

Floats = NDArray[np.float64]

# Sways that take the middle of the pixels some hundred pixels from a frame to the next.
_FAST = {
    "middlebury": ["camera.sway_deg=3", "camera.sway_m=0.05"],
    "kitti": ["camera.sway_deg=7", "camera.sway_m=1"],
    "eth3d": ["camera.sway_deg=9", "camera.sway_m=0.05"],
    "sceneflow": ["camera.sway_deg=5", "camera.sway_m=0.05"],
}
_ALL = ("camera.sway_s=1", "sequence.length=2", "sequence.frame_s=0.15")
_COSTS: dict[str, tuple[str, ...]] = {
    "masks": ("visibility",),
    "masks, flow": ("visibility", "flow"),
    "masks, flow, disparity change": ("visibility", "flow", "disparity_change"),
    "masks, flow to both frames, disparity change": ("visibility", "flow", "flow_backward", "disparity_change"),
}
# Beside an edge a rasteriser may see the surface on its other side.
_SAME_PX = 1e-3


def fast(name: str, outputs: tuple[str, ...]) -> Config:
    """Return a packaged config with a camera in a hurry."""
    return load_config(name, [*_FAST[name], *_ALL]).model_copy(update={"outputs": outputs})


def measure(name: str, pairs: int, pixels: int, seed: int) -> dict[str, Any]:
    """Compare flow and change of disparity of both views with rays at randomly chosen pixels."""
    motion, error, naive, change, alike, others = [], [], [], [], [], 0
    with PairRenderer(fast(name, _COSTS["masks, flow to both frames, disparity change"]), seed) as renderer:
        for index in range(0, 2 * pairs, 2):
            pair = renderer.render(index)
            sampled = renderer.sampler.sample(index, len(pair.provenance.get("redrawn", ())))
            rng = np.random.default_rng(index)
            height, width = pair.frame.left.disparity.shape
            x, y = rng.integers(0, width, pixels), rng.integers(0, height, pixels)
            for eye in EYES:
                hits = cast_rays(sampled.scene, renderer.sampler.models, eye, x.astype(float), y.astype(float))
                disparity = pair.frame.view(eye).disparity[y, x]
                same = np.abs(disparity - oracle.disparity_px(sampled.scene.camera, hits)) < _SAME_PX
                others += int((~same).sum())
                for output, step in (("flow", 1), ("flow_backward", -1)):
                    moved = renderer.sampler.motion(sampled, step)
                    rays = oracle.flow(
                        sampled.scene, renderer.sampler.models, moved, eye, x.astype(float), y.astype(float), hits
                    )
                    flow = pair.frame.view(eye)[output][y, x].astype(float)
                    seen = same & np.isfinite(rays.flow_px).all(axis=1) & np.isfinite(flow).all(axis=1)
                    motion.append(np.linalg.norm(rays.flow_px[seen], axis=1))
                    error.append(np.abs(flow[seen] - rays.flow_px[seen]).max(axis=1))
                    places = as_places(pair.frame, sampled, moved, eye, x[seen], y[seen], hits.instance[seen])
                    naive.append(np.abs(places - rays.flow_px[seen]).max(axis=1))
                    alike.append((pair.frame.view(eye)[f"{output}_visibility"][y, x] == rays.visibility)[same])
                    if step == 1:
                        both = seen & np.isfinite(rays.disparity_change_px)
                        got = pair.frame.view(eye).disparity_change[y, x].astype(float)
                        change.append(np.abs(got[both] - rays.disparity_change_px[both]))
    found = {
        "motion_px": _quantiles(motion, 0.5, 0.95),
        "flow_px": _quantiles(error, 0.5, 0.999, 1),
        "as_places_px": _quantiles(naive, 0.5, 0.999, 1),
        "disparity_change_px": _quantiles(change, 0.5, 0.999, 1),
        "masks_alike": float(np.concatenate(alike).mean()),
        "pixels": int(sum(map(len, error))),
        "other_surface": others,
    }
    return {"config": name, "pairs": pairs} | found


def as_places(
    frame: Frame,
    sampled: SampledScene,
    motion: Motion,
    eye: Eye,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    instance: NDArray[np.int64],
) -> Floats:
    """Work flow out the customary way, in float32: the difference of two places, each with a rounding of its size."""
    camera = frame.camera
    depth = (camera.focal_baseline / (frame.view(eye).disparity[y, x] + camera.doffs_px)).astype(np.float32)
    point = (camera.rays(eye, x, y).astype(np.float32) * depth[:, None]).astype(np.float32)
    aside = np.array([camera.offset_m(eye), 0, 0])
    now = sampled.scene.camera_from_world @ sampled.scene.world_from_model[instance]
    then = motion.scene.camera_from_world @ motion.world_from_model[instance]
    now[:, :3, 3] -= aside
    then[:, :3, 3] -= aside
    then_from_now = (then @ np.linalg.inv(now)).astype(np.float32)
    moved = (then_from_now[:, :3, :3] @ point[:, :, None])[:, :, 0] + then_from_now[:, :3, 3]
    centre = np.array([camera.cx_px(eye), camera.cy_px], np.float32)
    place = np.float32(camera.focal_px) * moved[:, :2] / moved[:, 2:] + centre
    return (place - np.stack([x, y], 1).astype(np.float32)).astype(np.float64)


def cost(name: str, repeats: int, seed: int) -> dict[str, float]:
    """Seconds of a pair with each set of outputs, the median, taken turn by turn in one run; nothing is written."""
    with ExitStack() as stack:
        calls = {}
        for title, outputs in _COSTS.items():
            renderer = stack.enter_context(PairRenderer(fast(name, outputs), seed))
            renderer.render(0)  # it compiles shaders
            calls[title] = partial(_render, renderer, count(2, 2))
        seconds = alternated(calls, repeats)
    return {title: float(np.median(values)) for title, values in seconds.items()}


def _render(renderer: PairRenderer, numbers: Iterator[int]) -> None:
    renderer.render(next(numbers))


def errors_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Lay the errors of all configs out in Markdown."""
    head = ("config", "motion, median and 95 %, px", "median, px", "p99.9, px", "worst, px",
            "as places, median and p99.9, px", "change of disparity, p99.9, px", "masks alike")  # fmt: skip
    cells = [
        (row["config"], "{:.0f}, {:.0f}".format(*row["motion_px"]), *(f"{error:.1e}" for error in row["flow_px"]),
         "{:.1e}, {:.1e}".format(*row["as_places_px"]), f"{row['disparity_change_px'][1]:.1e}",
         f"{row['masks_alike']:.2%}")
        for row in rows
    ]  # fmt: skip
    return markdown(head, cells, text_last=False)


def costs_table(costs: Mapping[str, float]) -> str:
    """Lay the seconds of a pair out in Markdown, by what is made."""
    rows = [(title, f"{value:.2f}", f"{value / costs['masks']:.2f}") for title, value in costs.items()]
    return markdown(("outputs", "s a pair", "x"), rows, text_last=False)


def _quantiles(parts: list[Floats], *at: float) -> list[float]:
    return [float(value) for value in np.quantile(np.concatenate(parts), at)]


@click.command()
@click.option("--pairs", type=click.IntRange(1), default=4, show_default=True)
@click.option("--pixels", type=click.IntRange(1), default=10_000, show_default=True, help="Of each view and pair.")
@click.option("--repeats", type=click.IntRange(1), default=5, show_default=True)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), required=True)
def main(pairs: int, pixels: int, repeats: int, seed: int, out: Path) -> None:
    """Measure the packaged configs, print tables, and write JSON."""
    rows = [measure(name, pairs, pixels, seed) for name in _FAST]
    click.echo(errors_table(rows))
    costs = cost("sceneflow", repeats, seed)
    click.echo(f"\n{costs_table(costs)}")
    report = {"machine": machine_facts(), "seed": seed, "pixels": pixels, "error": rows, "cost": {"sceneflow": costs}}
    out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
