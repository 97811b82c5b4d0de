"""``semisynth-gl report``."""

import time
from pathlib import Path

import click

from semisynth_gl.cli.options import COUNT, Command, FilesType, option
from semisynth_gl.cli.outputs import OutputFile
from semisynth_gl.cli.progress import Progress
from semisynth_gl.cli.streams import say
from semisynth_gl.dataset.root import open_root
from semisynth_gl.inputs.errors import counted
from semisynth_gl.seeds.splits import SPLITS, SplitName


@click.command(cls=Command)
@click.argument("directory", type=FilesType(), metavar="DIR_OR_ADDRESS")
@option(
    "--out",
    type=OutputFile(".html", ".htm"),
    help="HTML file to write.  [default: the dataset's name and -report.html, in the current folder]",
)
@option(
    "--pairs",
    type=click.IntRange(min=0, max=64),
    default=12,
    help="How many pairs to show, evenly spread over the dataset; outliers are added to these.",
)
@option("--sample", type=COUNT, default=200, help="How many pairs to measure, evenly spread over the dataset.")
@option("--split", type=click.Choice(SPLITS), help="Report only on this split.")
def report(directory: str, out: Path | None, pairs: int, sample: int, split: SplitName | None) -> None:
    """Write one HTML page about a dataset: pairs, distributions, outliers, and the settings that made it.

    The page needs no server and no network: it opens from disk in a browser.
    """
    # Imported here: matplotlib takes longer to load than a pair to read.
    from semisynth_gl.reporting.build import report as report_on  # noqa: PLC0415

    if out is None:
        out = Path(f"{open_root(directory).absolute().name}-report.html")
    start = time.monotonic()
    with Progress() as progress:
        built = report_on(directory, pairs=pairs, sample=sample, split=split, listener=progress)
    data = built.page.encode("utf-8", "backslashreplace")  # file names may hold bytes that are not text
    out.write_bytes(data)
    measured, total = len(built.measurement.pairs), built.measurement.dataset_pairs
    size = f" at 1/{built.step} of their size" if built.step > 1 else ""
    say(
        f"{out}: {measured} of {counted(total, 'pair')} measured, {built.shown} shown{size}, "
        f"{len(data) / 1e6:.1f} MB, {time.monotonic() - start:.0f} s"
    )
