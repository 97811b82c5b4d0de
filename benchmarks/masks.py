"""What masks cost, and how many of their pixels are those of float64 rays.

    python benchmarks/masks.py cost --turns 5
    python benchmarks/masks.py agreement
    python benchmarks/masks.py agreement --scale 0.5

`cost` draws pairs of a config with both disparities alone, and with both masks too, in turns, and prints the ratio of
their user and system seconds: these hardly feel what else the machine does. `agreement` casts rays to random pixels of
both views of the first scenes of the packaged configs. It counts pixels that the mask has wrong, and among them those
that show another surface than the ray meets, which no mask can have right.
"""

import os
import time

os.environ.setdefault("LP_NUM_THREADS", "0")  # before OpenGL: the driver draws in this thread

import click
import numpy as np

from semisynth_gl import oracle
from semisynth_gl.bench.scenes import sample_scenes
from semisynth_gl.config import load_config
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.channels import VISIBLE
from semisynth_gl.scene.raycast import cast_rays

_SAME_SURFACE_PX = 0.01


@click.group()
def main() -> None:
    """Measure masks."""


@main.command()
@click.option("--config", default="middlebury", show_default=True)
@click.option("--pairs", default=12, show_default=True, help="Pairs in a turn.")
@click.option("--turns", default=5, show_default=True)
def cost(config: str, pairs: int, turns: int) -> None:
    """Compare pairs with both masks to pairs without."""
    bench = sample_scenes(load_config(config), 0, pairs)
    renderers = {outputs: bench.open_renderer("auto", outputs=outputs) for outputs in ((), ("visibility",))}
    for renderer in renderers.values():
        renderer.render(bench.scenes[0])
    ratios = []
    for turn in range(turns):
        seconds = dict.fromkeys(renderers, 0.0)
        for number, scene in enumerate(bench.scenes):
            for outputs in list(renderers)[:: 1 if (turn + number) % 2 else -1]:
                start = time.process_time()
                renderers[outputs].render(scene)
                seconds[outputs] += time.process_time() - start
        ratios.append(seconds[("visibility",)] / seconds[()])
        milliseconds = [f"{1e3 * each / pairs:.0f}" for each in seconds.values()]
        click.echo(f"turn {turn + 1}: {milliseconds[0]} ms, with masks {milliseconds[1]} ms, ratio {ratios[-1]:.3f}")
    low, high = np.quantile(ratios, [0.05, 0.95])
    click.echo(f"{config}: median ratio {np.median(ratios):.3f}, 90 % of {turns} turns {low:.3f} to {high:.3f}")


@main.command()
@click.option("--rays", default=100_000, show_default=True, help="Rays to each view.")
@click.option("--scenes", default=2, show_default=True, help="Scenes of each config.")
@click.option("--scale", default=1.0, show_default=True, help="Size of the images, as the key `scale` has it.")
@click.argument("configs", nargs=-1)
def agreement(configs: tuple[str, ...], rays: int, scenes: int, scale: float) -> None:
    """Compare masks with rays."""
    rng = np.random.default_rng(5)
    for name in configs or ("middlebury", "kitti", "eth3d", "sceneflow", "zero-shot"):
        bench = sample_scenes(load_config(name, {"scale": scale}), 0, scenes)
        total = wrong = elsewhere = seen = 0
        with bench.open_renderer("auto", outputs=("visibility", "instances")) as renderer:
            for scene in bench.scenes:
                frame, camera = renderer.render(scene), scene.camera
                for eye in EYES:
                    view = frame.view(eye)
                    row, column = np.divmod(rng.choice(view.disparity.size, rays, replace=False), camera.width_px)
                    x, y = column.astype(np.float64), row.astype(np.float64)
                    hits = cast_rays(scene, bench.models, eye, x, y)
                    differs = view.visibility[row, column] != oracle.visibility(scene, bench.models, eye, x, y, hits)
                    with np.errstate(invalid="ignore"):
                        error = np.abs(view.disparity[row, column] - oracle.disparity_px(camera, hits))
                    other = (view.instances[row, column] != hits.instance + 1) | (error > _SAME_SURFACE_PX)
                    total, wrong = total + rays, wrong + int(differs.sum())
                    elsewhere += int((differs & other).sum())
                    seen += int((differs & (view.visibility[row, column] == VISIBLE)).sum())
        click.echo(
            f"{name:12} {100 * (1 - wrong / total):.3f} % of {total}: {wrong} wrong, {seen} of them said to be "
            f"visible, {elsewhere} on another surface"
        )


if __name__ == "__main__":
    main()
