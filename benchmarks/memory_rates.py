"""Pairs per second of a StereoStream in a DataLoader, by number of processes.

    python benchmarks/memory_rates.py --config sceneflow --workers 1,2,4,8,16
    python benchmarks/memory_rates.py --device cuda     # tensors on a GPU, rendered in this process

The time is from when every process has made its first pair until the last pair.
"""

import time

import click
import torch
from torch.utils.data import DataLoader

from semisynth_gl.config import load_config
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.torch import StereoStream


def rate(config: str, settings: tuple[str, ...], workers: int, pairs: int, device: str) -> float:
    """Return pairs per second; with 0 ``workers``, this process renders."""
    first = max(1, workers)
    stream = StereoStream(load_config(config, settings), 0, pairs + first, checked=False, device=device)
    # Forked processes cannot use OpenGL if this process has used OpenGL or CUDA.
    loader = iter(
        DataLoader(stream, batch_size=None, num_workers=workers, multiprocessing_context="spawn" if workers else None)
    )
    for _ in range(first):
        next(loader)
    start = time.perf_counter()
    made = sum(1 for _ in loader)
    if device == "cuda":
        torch.cuda.synchronize()
    return made / (time.perf_counter() - start)


@click.command()
@click.option("--config", default="middlebury", show_default=True, help="A name or a YAML file.")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="As for generate.")
@click.option("--pairs", type=click.IntRange(1), default=64, show_default=True, help="For each process.")
@click.option("--workers", default="1,2,4", show_default=True, help="Numbers of processes.")
@click.option("--device", type=click.Choice(["cpu", "cuda"]), default="cpu", show_default=True)
def main(config: str, settings: tuple[str, ...], pairs: int, workers: str, device: str) -> None:
    """Measure and print."""
    with PairRenderer(load_config(config, settings), 0) as renderer:
        click.echo(f"{config} {' '.join(settings)}: {renderer.renderer_name}")
    for number in [0] if device == "cuda" else map(int, workers.split(",")):
        made = rate(config, settings, number, pairs * max(1, number), device)
        click.echo(f"{max(1, number)} processes: {made:.1f} pairs/s")


if __name__ == "__main__":
    main()
