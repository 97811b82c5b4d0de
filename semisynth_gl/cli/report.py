"""``semisynth-gl report``."""

import time
from pathlib import Path
from typing import Any

import click

from semisynth_gl.cli.options import COUNT, Command, images_option, map_options, option
from semisynth_gl.cli.outputs import OutputFileType, table, write_json
from semisynth_gl.cli.progress import Progress
from semisynth_gl.dataset.root import open_root
from semisynth_gl.inputs.errors import counted


@click.command(cls=Command)
@click.argument("directory", metavar="DIR_OR_ADDRESS")
@images_option(
    help="Photographs of the place where the network will work: a file, folder or glob. May be repeated.",
)
@map_options
@option(
    "--out",
    type=OutputFileType(".html", ".htm"),
    help="HTML file to write.  [default: DATASET_NAME-report.html in the current folder]",
)
@option("--json", "json_file", type=OutputFileType(), help="JSON file for the measures.")
@option(
    "--pairs",
    type=click.IntRange(min=0, max=64),
    default=12,
    help="Number of pairs to show, evenly spread over the dataset; outliers are added.",
)
@option("--sample", type=COUNT, default=200, help="Number of pairs to measure, evenly spread over the dataset.")
def report(directory: str, out: Path | None, json_file: Path | None, **options: Any) -> None:  # noqa: ANN401 - options of `judge.report.report`
    """Write an HTML page about a dataset.

    It shows pairs, distributions, outliers, and the settings that made the dataset. With --images and --disparity, the
    page and the terminal also show how the dataset differs from the place where the network will work, and which keys
    of the config to change. A browser opens the page from disk, without server or network.
    """
    # Imported here: loading matplotlib takes longer than reading a pair.
    from semisynth_gl.judge import comparison  # noqa: PLC0415
    from semisynth_gl.judge.report import report as report_on  # noqa: PLC0415

    if out is None:
        out = Path(f"{open_root(directory).absolute().name}-report.html")
    start = time.monotonic()
    with Progress() as progress:
        built = report_on(directory, **options, listener=progress)
    data = built.page.encode("utf-8", "backslashreplace")  # file names may have bytes that are not text
    out.write_bytes(data)
    write_json(json_file, built.values())
    measured = counted(len(built.pairs), "pair")
    beside = "" if built.place is None else f" beside {built.place.summary}"
    click.echo(f"{measured}{beside}, at a width of {built.width_px} px\n")
    # Leave out the last column, the advice: the summary shows it.
    columns = len(comparison.HEAD) - 1
    for line in (*table(row[:columns] for row in comparison.table(built.rows)), "", *comparison.summary(built.rows)):
        click.echo(line)
    for note in () if built.place is None else built.place.notes:
        click.echo(f"note: {note}", err=True)
    click.echo(f"{out}: {measured} measured, {len(data) / 1e6:.1f} MB, {time.monotonic() - start:.0f} s")
