"""``semisynth-gl generate``."""

from pathlib import Path

import click

from semisynth_gl import pipeline
from semisynth_gl.cli.options import read_config, scene_options
from semisynth_gl.cli.progress import Progress
from semisynth_gl.engine import cores
from semisynth_gl.frame import OUTPUTS, TRUTHS, TruthOf
from semisynth_gl.render.context import Backend
from semisynth_gl.write.dataset import DatasetFolder

_REASONS_SHOWN = 5
# Above this share of a pair's pixels, what the encoding of disparity cannot say is worth a word.
_MUCH_BEYOND = 0.01
# A worker takes about as long to start as to make a few pairs.
_PAIRS_PER_WORKER = 8


@click.command()
@scene_options
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder to write to.  [default: out/ and the config's name]"
)
@click.option("--outputs", metavar="a,b", help=f"Beside images and disparities: {', '.join(OUTPUTS)}; or none.")
@click.option(
    "--truth", type=click.Choice(TRUTHS), help="Views to write disparity and outputs of.  [default: the config's]"
)
@click.option("--pairs", type=click.IntRange(min=1), default=24, show_default=True, help="How many pairs.")
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Processes that render; the files are the same whatever their number.  [default: a core each, at most one for "
    f"{_PAIRS_PER_WORKER} pairs]",
)
@click.option("--overwrite", is_flag=True, help="Replace the dataset that is in the folder.")
def generate(
    config_name: str,
    images: tuple[str, ...],
    models: tuple[str, ...],
    seed: int,
    settings: tuple[str, ...],
    backend: Backend,
    out: Path | None,
    outputs: str | None,
    truth: TruthOf | None,
    pairs: int,
    workers: int | None,
    overwrite: bool,  # noqa: FBT001 - click passes flags so
) -> None:
    """Write a dataset: left, right, both disparities, masks and calibration of each pair.

    Files stand as in Middlebury's evaluation set: MiddEval3/trainingF/<pair>/im0.png, im1.png, disp0GT.pfm,
    disp1GT.pfm, mask0nocc.png, mask1nocc.png, calib.txt, and pair.json, which says what made the pair. The outputs
    instances and depth add inst0.png, inst1.png, depth0.pfm and depth1.pfm. The config's section files chooses other
    encodings.
    """
    if outputs is not None:
        settings = (*settings, f"outputs=[{'' if outputs == 'none' else outputs}]")
    if truth is not None:
        settings = (*settings, f"truth={truth}")
    config = read_config(config_name, images, models, settings)
    folder = DatasetFolder(out if out is not None else Path("out") / config.name, overwrite=overwrite)

    def started(renderer: pipeline.PairRenderer) -> None:
        click.echo(renderer.atlas.report.summary(), err=True)
        for skipped in renderer.model_library.skipped:
            click.echo(f"model left out: {skipped}", err=True)
        click.echo(f"{len(renderer.model_library.models)} models; rendering with {renderer.renderer_name}", err=True)
        progress.begin()

    if workers is None:
        workers = max(1, min(cores(), pairs // _PAIRS_PER_WORKER))
    redrawn: list[str] = []
    beyond: list[float] = []

    def written(pair: pipeline.Written) -> None:
        beyond.append(pair.share_beyond)
        redrawn.extend(f"pair {pair.index}: {reason}" for reason in pair.redrawn)
        progress.advance()

    with Progress(pairs) as progress:
        scenes = pipeline.generate(
            config, folder, pairs, seed, backend, workers=workers, started=started, written=written
        )
    for reason in redrawn[:_REASONS_SHOWN]:
        click.echo(f"drawn again, {reason}", err=True)
    if redrawn:
        click.echo(f"{len(redrawn)} times a pair failed its checks and was drawn again (see pair.json)", err=True)
    _warn_of_lost(beyond, config.files.disparity)
    click.echo(f"{pairs} pairs in {scenes}")


def _warn_of_lost(shares: list[float], encoding: str) -> None:
    """Say of how many pairs the encoding loses much; ``shares`` has those of its pixels."""
    much = [share for share in shares if share > _MUCH_BEYOND]
    if much:
        click.echo(
            f"in {len(much)} pairs more than {_MUCH_BEYOND:.0%} of the pixels have a disparity that {encoding} cannot "
            f"hold, at worst {max(much):.1%}: they are invalid (disparity_beyond in pair.json counts them); "
            "files.disparity=pfm or tiff holds them",
            err=True,
        )
