"""``semisynth-gl report``."""

import time
from pathlib import Path

import click

from semisynth_gl.cli.options import COUNT, Command, FilesType, images_option, map_options, option
from semisynth_gl.cli.outputs import OutputFile, write_json
from semisynth_gl.cli.progress import Progress
from semisynth_gl.cli.streams import say
from semisynth_gl.dataset.root import open_root
from semisynth_gl.inputs.errors import counted
from semisynth_gl.seeds.splits import SPLITS, SplitName
from semisynth_gl.textures.image_files import find_files
from semisynth_gl.textures.images import image_extensions


@click.command(cls=Command)
@click.argument("directory", type=FilesType(), metavar="DIR_OR_ADDRESS")
@images_option(
    help="Photographs of the place that the dataset is made for, to compare it with: a file, folder or glob. May be "
    "repeated.",
)
@map_options("of the place")
@option(
    "--width",
    "width_px",
    type=click.IntRange(min=32, max=4096),
    help="Width in px to which all images and maps are scaled before they are compared. By default 512, or the width "
    "of the pairs where that is smaller.",
)
@option(
    "--out",
    type=OutputFile(".html", ".htm"),
    help="HTML file to write.  [default: the dataset's name and -report.html, in the current folder]",
)
@option("--json", "json_file", type=OutputFile(), help="Also write the comparison's figures to this JSON file.")
@option(
    "--pairs",
    type=click.IntRange(min=0, max=64),
    default=12,
    help="How many pairs to show, evenly spread over the dataset; outliers are added to these.",
)
@option("--sample", type=COUNT, default=200, help="How many pairs to measure, evenly spread over the dataset.")
@option("--split", type=click.Choice(SPLITS), help="Report only on this split.")
def report(
    directory: str,
    images: tuple[str, ...],
    disparity: tuple[str, ...],
    png_scale: float,
    width_px: int | None,
    out: Path | None,
    json_file: Path | None,
    pairs: int,
    sample: int,
    split: SplitName | None,
) -> None:
    """Write one HTML page about a dataset: pairs, distributions, outliers, and the settings that made it.

    With --images and --disparity, the page and the terminal also say how far the dataset is from its place, and which
    keys of the config to change. The page needs no server and no network: it opens from disk in a browser.
    """
    # Imported here: matplotlib takes longer to load than a pair to read.
    from semisynth_gl.judge.place import left_out, map_files  # noqa: PLC0415
    from semisynth_gl.judge.report import report as report_on  # noqa: PLC0415

    if json_file is not None and not images:
        raise click.UsageError("--json writes the figures of a comparison, which needs --images")
    if out is None:
        out = Path(f"{open_root(directory).absolute().name}-report.html")
    start = time.monotonic()
    with Progress() as progress:
        built = report_on(
            directory,
            images=images,
            disparity=disparity,
            png_scale=png_scale,
            width_px=width_px,
            pairs=pairs,
            sample=sample,
            split=split,
            listener=progress,
        )
    data = built.page.encode("utf-8", "backslashreplace")  # file names may hold bytes that are not text
    out.write_bytes(data)
    if built.comparison is not None:
        if json_file is not None:
            write_json(json_file, built.comparison.values())
        for line in (*built.comparison.lines(), ""):
            click.echo(line)
        passed_over = left_out(find_files(images, image_extensions()), map_files(disparity))
        for note in filter(None, (passed_over, *built.comparison.notes())):
            click.echo(f"note: {note}", err=True)
    measured, total = len(built.measurement.pairs), built.measurement.dataset_pairs
    size = f" at 1/{built.step} of their size" if built.step > 1 else ""
    say(
        f"{out}: {measured} of {counted(total, 'pair')} measured, {built.shown} shown{size}, "
        f"{len(data) / 1e6:.1f} MB, {time.monotonic() - start:.0f} s"
    )
