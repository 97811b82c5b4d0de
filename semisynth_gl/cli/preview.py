"""``semisynth-gl preview``."""

import io
from pathlib import Path

import click

from semisynth_gl.cli.options import OutputFile, SceneOptions, option, scene_options, write_output
from semisynth_gl.cli.progress import Progress
from semisynth_gl.histogram import total_variation, wasserstein_px
from semisynth_gl.pairs.pipeline import PairRenderer


@click.command()
@scene_options
@option("--out", type=OutputFile(".png"), default=Path("preview.png"), help="PNG to write.")
@option("--pairs", type=click.IntRange(min=1, max=64), default=4, help="How many pairs to show.")
def preview(scene: SceneOptions, out: Path, pairs: int) -> None:
    """Draw a contact sheet: the first pairs of a dataset, and their histogram against the config's."""
    # Imported here: matplotlib takes longer to load than a pair to render.
    from semisynth_gl.report.contact_sheet import draw_sheet  # noqa: PLC0415

    config = scene.config()
    with PairRenderer(config, scene.seed, scene.backend) as renderer, Progress() as progress:
        progress.on_total(pairs)
        frames = []
        for index in range(pairs):
            frames.append(renderer.render(index).frame)
            progress.advance()
        expected = renderer.expected_histogram()
        title = f"{config.name}, seed {scene.seed}, pairs 0 to {pairs - 1}, {renderer.renderer_name}"
    png = io.BytesIO()
    target = config.wanted_histogram()
    draw_sheet(frames, target, title).savefig(png, format="png")
    write_output(out, png.getvalue())
    click.echo(f"{pairs} pairs in {out}")
    if expected is not None:
        click.echo(
            f"over many pairs, disparities are expected to come to a total variation of "
            f"{total_variation(expected, target):.3f} from the target, {wasserstein_px(target, expected):.2g} px "
            "(Wasserstein-1)"
        )
