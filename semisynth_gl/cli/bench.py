"""``semisynth-gl bench``: what the choices cost and gain on this machine."""

import io
import json
import sys
from pathlib import Path

import click

from semisynth_gl.config import load_config
from semisynth_gl.errors import InputError
from semisynth_gl.render.context import BACKENDS, Backend


@click.group()
def bench() -> None:
    """Measure, on this machine, what the choices cost and gain."""


@bench.command()
@click.option(
    "--config", "config_name", default="eth3d", show_default=True, help="Whose scenes: a name or a YAML file."
)
@click.option("--set", "settings", multiple=True, metavar="dotted.key=value", help="Override a key of the config.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Other scenes and pixels.")
@click.option("--backend", type=click.Choice(BACKENDS), default="auto", show_default=True, help="As for generate.")
@click.option("--pairs", type=click.IntRange(min=1), default=3, show_default=True, help="How many pairs.")
@click.option(
    "--rays", type=click.IntRange(min=1), default=20_000, show_default=True, help="Rays cast for each eye of a pair."
)
@click.option(
    "--repeats", type=click.IntRange(min=1), default=7, show_default=True, help="Times each alternative is timed."
)
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Also write everything here.")
@click.option("--plot", "plot_path", type=click.Path(path_type=Path), help="Also draw it: a name that ends in .png.")
def accuracy(
    config_name: str,
    settings: tuple[str, ...],
    seed: int,
    backend: Backend,
    pairs: int,
    rays: int,
    repeats: int,
    json_path: Path | None,
    plot_path: Path | None,
) -> None:
    """Compare ways to get the disparity, to store it and to antialias: error against a float64 oracle, time, bytes.

    Three tables. The default of each is bold; a star marks what no other way beats.
    """
    # Imported here: matplotlib takes longer to load than other commands to run.
    from semisynth_gl.bench.accuracy import Effort, measure, table  # noqa: PLC0415
    from semisynth_gl.bench.plot import draw_plot  # noqa: PLC0415

    for option, path in (("--json", json_path), ("--plot", plot_path)):
        if path is not None and not path.absolute().parent.is_dir():
            raise InputError(f"{option} {path}: the folder {path.absolute().parent} does not exist")
    if plot_path is not None and plot_path.suffix.lower() != ".png":
        raise InputError(f"--plot {plot_path}: expected a name that ends in .png")
    config = load_config(config_name, settings)
    report = measure(
        config, seed, backend, Effort(pairs, rays, repeats), lambda stage: click.echo(f"{stage} ...", err=True)
    )
    report["command"] = " ".join(["semisynth-gl", *sys.argv[1:]])
    if json_path is not None:
        json_path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    if plot_path is not None:
        png = io.BytesIO()
        draw_plot(report).savefig(png, format="png")
        plot_path.write_bytes(png.getvalue())
    machine, (width, height) = report["machine"], report["sizes_px"][0]
    click.echo(
        f"{config.name}, {width} x {height} px, {pairs} pairs, {report['pixels_compared']} pixels against the oracle; "
        f"{machine['renderer']}, {machine['processor']}, {machine['cores']} cores\n"
    )
    click.echo(table(report))
