"""``semisynth-gl preview``."""

import io
from pathlib import Path

import click

from semisynth_gl.cli.options import read_config, scene_options
from semisynth_gl.cli.progress import Progress
from semisynth_gl.errors import InputError
from semisynth_gl.histogram import total_variation, wasserstein_px
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.context import Backend


@click.command()
@scene_options
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("preview.png"), show_default=True, help="PNG to write."
)
@click.option(
    "--pairs", type=click.IntRange(min=1, max=64), default=4, show_default=True, help="How many pairs to show."
)
def preview(
    config_name: str,
    images: tuple[str, ...],
    models: tuple[str, ...],
    seed: int,
    settings: tuple[str, ...],
    backend: Backend,
    out: Path,
    pairs: int,
) -> None:
    """Draw a contact sheet: the first pairs of a dataset, and their histogram against the config's."""
    # Imported here: matplotlib takes longer to load than a pair to render.
    from semisynth_gl.report.contact_sheet import draw_sheet  # noqa: PLC0415

    config = read_config(config_name, images, models, settings)
    if out.suffix.lower() != ".png":
        raise InputError(f"--out {out}: expected a name that ends in .png")
    if not out.absolute().parent.is_dir():
        raise InputError(f"--out {out}: the folder {out.absolute().parent} does not exist")
    with PairRenderer(config, seed, backend) as renderer, Progress() as progress:
        progress.begin(pairs)
        frames = []
        for index in range(pairs):
            frames.append(renderer.render(index).frame)
            progress.advance()
        expected = renderer.expected_histogram()
        title = f"{config.name}, seed {seed}, pairs 0 to {pairs - 1}, {renderer.renderer_name}"
    png = io.BytesIO()
    wanted = config.wanted_histogram()
    draw_sheet(frames, wanted, title).savefig(png, format="png")
    partial = out.with_name(f".{out.name}.partial")
    try:
        partial.write_bytes(png.getvalue())
        partial.replace(out)
    finally:
        partial.unlink(missing_ok=True)
    click.echo(f"{pairs} pairs in {out}")
    if expected is not None:
        click.echo(
            f"over many pairs, disparities are expected to come to a total variation of "
            f"{total_variation(expected, wanted):.3f} from the target, {wasserstein_px(wanted, expected):.2g} px "
            "(Wasserstein-1)"
        )
