"""How near datasets come to their wanted distribution of disparity.

    python benchmarks/targets.py --pairs 200 --out benchmarks/results/targets.json

Pairs are rendered at an eighth of their size, with all lengths in pixels scaled alike: the same scenes seen by a
smaller sensor.
"""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.config import Config, load_config
from semisynth_gl.histogram import PixelCount, total_variation, wasserstein_px
from semisynth_gl.pairs.pipeline import PairRenderer

_SCALE = 1 / 8
_UNIFORM = {"min_px": 0.5, "max_px": 200.0, "target": {"form": "uniform", "low_px": 0.0, "high_px": 192.0}}
_HUMPS = {
    "min_px": 4.0,
    "max_px": 220.0,
    "target": {
        "form": "mixture",
        "parts": [
            {"weight": 0.6, "target": {"form": "gamma", "mean_px": 30.0, "spread_px": 10.0}},
            {"weight": 0.4, "target": {"form": "gamma", "mean_px": 130.0, "spread_px": 20.0}},
        ],
    },
}
_TARGETS: dict[str, tuple[str, dict[str, Any]]] = {
    "Middlebury": ("middlebury", {}),
    "KITTI-like": ("kitti", {}),
    "ETH3D": ("eth3d", {}),
    "SceneFlow": ("sceneflow", {}),
    "uniform, 0 to 192 px": ("sceneflow", {"disparity": _UNIFORM, "background": {"wall_disparity_px": [1.0, 30.0]}}),
    "two humps, at 30 and 130 px": (
        "sceneflow",
        {"disparity": _HUMPS, "background": {"wall_disparity_px": [6.0, 20.0]}},
    ),
}


def _scaled(values: Any) -> Any:  # noqa: ANN401 - whatever a config holds
    """Scale all that is in pixels, by the names of keys."""
    if not isinstance(values, dict):
        return values
    made = {}
    for key, value in values.items():
        if key.endswith("_px") and key != "patch_px" and value is not None:
            made[key] = [each * _SCALE for each in value] if isinstance(value, list) else value * _SCALE
            if key in ("width_px", "height_px"):
                made[key] = int(made[key])
        elif isinstance(value, list):
            made[key] = [_scaled(each) for each in value]
        else:
            made[key] = _scaled(value)
    return made


def small(name: str, sections: dict[str, Any]) -> Config:
    """A config with sections' keys replaced, at an eighth of its size."""
    values = load_config(name).model_dump(mode="json")
    for section, keys in sections.items():
        values[section] |= keys
    values = _scaled(values) | {"truth": "left", "outputs": []}
    values["textures"]["patch_px"] = 64
    return Config.model_validate(values)


def measure(name: str, sections: dict[str, Any], pairs: int, seed: int) -> dict[str, Any]:
    """Render pairs and compare their disparities with the target."""
    config = small(name, sections)
    wanted = config.shown_histogram()
    count, medians, objects = PixelCount(wanted.edges_px), [], []
    start = time.perf_counter()
    with PairRenderer(config, seed) as renderer:
        for index in range(pairs):
            pair = renderer.render(index)
            count.add(pair.frame.left.disparity)
            medians.append(float(np.median(pair.frame.left.disparity)) / _SCALE)
            objects.append(sum(pair.provenance["models"].values()))
    achieved = count.histogram
    return {
        "config": config.name,
        "pairs": pairs,
        "total_variation": total_variation(wanted, achieved),
        "wasserstein_px": wasserstein_px(wanted, achieved) / _SCALE,
        "mean_px": wanted.mean_px / _SCALE,
        "wasserstein_share": wasserstein_px(wanted, achieved) / wanted.mean_px,
        "medians_px": [float(value) for value in np.percentile(medians, [5, 50, 95])],
        "instances": float(np.mean(objects)),
        "seconds": time.perf_counter() - start,
        "edges_px": (wanted.edges_px / _SCALE).tolist(),
        "wanted": wanted.shares.tolist(),
        "achieved": achieved.shares.tolist(),
    }


def table(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Lay the distances from all targets out in Markdown."""
    head = ("target", "total variation", "W1, px", "W1, share of the mean", "medians of pairs, 5, 50, 95 %, px")
    cells = [
        (title, f"{row['total_variation']:.3f}", f"{row['wasserstein_px']:.2f}", f"{row['wasserstein_share']:.1%}",
         ", ".join(f"{median:.0f}" for median in row["medians_px"]))
        for title, row in rows.items()
    ]  # fmt: skip
    return markdown(head, cells, text_last=False)


@click.command()
@click.option("--pairs", type=click.IntRange(1), default=200, show_default=True)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--config", "configs", multiple=True, help="Measure these, such as calibrate writes, and no others.")
@click.option("--out", type=click.Path(path_type=Path), required=True)
def main(pairs: int, seed: int, configs: tuple[str, ...], out: Path) -> None:
    """Measure all targets, print a table, and write JSON."""
    targets = {load_config(path).name: (path, {}) for path in configs} if configs else _TARGETS
    rows = {title: measure(name, sections, pairs, seed) for title, (name, sections) in targets.items()}
    click.echo(table(rows))
    report = {"machine": machine_facts(), "seed": seed, "targets": rows}
    out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
