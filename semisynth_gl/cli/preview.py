"""``semisynth-gl preview``."""

import io

import click

from semisynth_gl.cli.loading import stopped_by_interrupts
from semisynth_gl.cli.options import SceneOptions, option, scene_options
from semisynth_gl.cli.outputs import Output, marked_png, output_option
from semisynth_gl.cli.progress import Progress
from semisynth_gl.cli.streams import say
from semisynth_gl.histogram import total_variation, wasserstein_px
from semisynth_gl.textures.reach import photograph_sources


@click.command()
@scene_options
@output_option("--out", marked_png("semisynth-gl preview"), ".png", default="preview.png", help="PNG to write.")
@option("--pairs", type=click.IntRange(min=1, max=64), default=4, help="How many pairs to show.")
def preview(scene: SceneOptions, output: Output, pairs: int) -> None:
    """Draw a contact sheet: the first pairs of a dataset, and their histogram against the config's."""
    # Imported here: help and completion need no renderer, and matplotlib takes longer to load than a pair to render.
    with stopped_by_interrupts():
        from semisynth_gl.pairs.pipeline import PairRenderer  # noqa: PLC0415
        from semisynth_gl.report.contact_sheet import draw_sheet  # noqa: PLC0415

    config = scene.config()
    output.check((scene.config_name, *config.models.folders), photograph_sources(config.textures))
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
    output.write(png.getvalue())
    say(f"{pairs} pairs in {output.file}")
    if expected is not None:
        say(
            f"over many pairs, disparities are expected to come to a total variation of "
            f"{total_variation(expected, target):.3f} from the target, {wasserstein_px(target, expected):.2g} px "
            "(Wasserstein-1)"
        )
