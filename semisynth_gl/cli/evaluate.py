"""``semisynth-gl evaluate``."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from semisynth_gl.cli.options import Command, option
from semisynth_gl.cli.outputs import OutputFile, table, write_json
from semisynth_gl.cli.progress import Progress
from semisynth_gl.inputs.errors import abbreviate, counted
from semisynth_gl.judge.evaluate import evaluate as evaluate_predictions
from semisynth_gl.judge.evaluate import evaluate_views
from semisynth_gl.judge.protocol import PROTOCOL_NAMES
from semisynth_gl.seeds.splits import SPLITS

_PATH = click.Path(path_type=Path)
# Most pairs with a row in a table, and the figure that they are sorted by.
_WORST, _BY = 10, "bad-2"


@click.command(cls=Command)
@option("--pred", "predictions", type=_PATH, required=True, help="Folder of predictions.")
@option(
    "--gt",
    "truth",
    metavar="DIR_OR_ADDRESS",
    help="Truth of the predicted pairs: a dataset of this program, or a folder of Middlebury, ETH3D or KITTI.",
)
@option(
    "--pred-right",
    "predictions_right",
    type=_PATH,
    help="Folder of predictions for the right views, to measure without truth how far they confirm --pred.",
)
@option(
    "--protocol",
    type=click.Choice(PROTOCOL_NAMES),
    help="Benchmark whose definitions to use; by default, the benchmark in whose format --gt is.",
)
@option("--split", type=click.Choice(SPLITS), help="Evaluate only this split of --gt.")
@option("--partial", is_flag=True, help="Evaluate the predictions that exist, even if others are missing.")
@option("--json", "json_file", type=OutputFile(), help="Also write the figures of every pair to this JSON file.")
@option("--maps", type=_PATH, help="Also write an error map of each pair into this folder.")
def evaluate(
    predictions: Path,
    truth: str | None,
    predictions_right: Path | None,
    json_file: Path | None,
    **options: Any,  # noqa: ANN401 - of the function that evaluates
) -> None:
    """Compare predicted disparities with the truth, as a benchmark does.

    Prints the figures over all pairs, and of each pair or, where there are many, of the worst pairs.

    Predictions are .pfm, .npy or 16-bit .png files with the pair's name or the name of the truth's file.
    """
    if predictions_right is not None and not (truth or any(options.values())):
        report = evaluate_views(predictions, predictions_right)
    elif truth is not None and predictions_right is None:
        with Progress() as progress:
            report = evaluate_predictions(predictions, truth, **options, progress=progress.track)
    else:
        raise click.UsageError("expected --gt, the truth, or --pred-right, which goes only with --json")
    write_json(json_file, report)
    for line in _confirmation_lines(report) if truth is None else _table_lines(report):
        click.echo(line)
    if missing := report.get("missing"):
        click.echo(f"No prediction for {counted(len(missing), 'pair')}: {abbreviate(missing)}", err=True)


def _table_lines(report: Mapping[str, Any]) -> list[str]:
    """Return a table for each region: the pairs with most bad pixels, the worst first, and all pairs together."""
    lines = [f"{counted(report['pairs'], 'pair')} by the definitions of {report['source']}"]
    for region, mean in report["mean"].items():
        pairs = [(image["name"], image["figures"][region]) for image in report["images"] if region in image["figures"]]
        pairs.sort(key=lambda pair: -math.inf if pair[1][_BY] is None else -pair[1][_BY])
        which = f"; the {_WORST} worst by {_BY}, --json has all" if len(pairs) > _WORST else ""
        lines += ["", f"{region} pixels; shares in {report['unit']}, errors in px{which}"]
        names = [name for name in mean if name != "epe"]
        rows = [["", *names]]
        for pair, figures in (*pairs[:_WORST], ("all pairs", mean)):
            values = [figures.get(name) for name in names]
            rows.append([pair, *("-" if value is None else f"{value:.4g}" for value in values)])
        lines += table(rows)
    return lines


def _confirmation_lines(report: Mapping[str, Any]) -> list[str]:
    images = sorted(report["images"], key=lambda image: -image["unconfirmed"])[:_WORST]
    rows = [(image["name"], image["unconfirmed"]) for image in images] + [("mean", report["mean"]["unconfirmed"])]
    head = f"{counted(report['pairs'], 'pair')} without truth: % of pixels that the right view does not confirm"
    return [head, "", *table([[name, f"{share:.2f}"] for name, share in rows])]
