"""``semisynth-gl evaluate``."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from semisynth_gl.cli.options import Command, option
from semisynth_gl.cli.outputs import OutputFileType, table, write_json
from semisynth_gl.cli.progress import Progress
from semisynth_gl.inputs.errors import counted
from semisynth_gl.judge.evaluate import evaluate as evaluate_predictions
from semisynth_gl.judge.evaluate import evaluate_views
from semisynth_gl.judge.protocol import PROTOCOLS
from semisynth_gl.seeds.splits import SPLITS

_PATH = click.Path(path_type=Path)
# Maximum number of pairs in a table.
_WORST = 10


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
    help="Folder of predictions for the right views, instead of --gt: count the pixels of --pred that disagree.",
)
@option(
    "--protocol",
    type=click.Choice(tuple(PROTOCOLS)),
    help="Benchmark whose definitions to use.  [default: kitti or eth3d if --gt has that format, else middlebury]",
)
@option("--split", type=click.Choice(SPLITS), help="Evaluate only this split of --gt.")
@option("--json", "json_file", type=OutputFileType(), help="JSON file for the figures of every pair.")
@option("--maps", type=_PATH, help="Folder for an error map of each pair.")
def evaluate(
    predictions: Path,
    truth: str | None,
    predictions_right: Path | None,
    json_file: Path | None,
    **options: Any,  # noqa: ANN401 - of the function that evaluates
) -> None:
    """Score predicted disparities by a benchmark's definitions.

    Prints the figures of all pairs together, and of the ten worst pairs. Predictions are .pfm, .npy or 16-bit .png
    files. Each has the name of its pair, or of the truth's file.
    """
    if predictions_right is not None and not (truth or any(options.values())):
        report = evaluate_views(predictions, predictions_right)
        head = "without truth: % of pixels that the right view does not confirm"
        lines = ["", *_table([(each["name"], each) for each in report["images"]], report["mean"], "unconfirmed")]
    elif truth is not None and predictions_right is None:
        with Progress() as progress:
            report = evaluate_predictions(predictions, truth, **options, listener=progress)
        head, lines = f"by the definitions of {report['source']}", []
        for region, mean in report["mean"].items():
            figures = [
                (each["name"], each["figures"][region]) for each in report["images"] if region in each["figures"]
            ]
            lines += ["", f"{region} pixels; shares in {report['unit']}, errors in px", *_table(figures, mean, "bad-2")]
    else:
        raise click.UsageError("give either --gt or --pred-right; with --pred-right, only --json is allowed")
    write_json(json_file, report)
    click.echo("\n".join([f"{counted(report['pairs'], 'pair')} {head}", *lines]))


def _table(pairs: list[tuple[str, Mapping[str, Any]]], mean: Mapping[str, Any], by: str) -> list[str]:
    """Return a row for each of the worst pairs by the figure ``by``, and one for all pairs, which is the ``mean``."""
    pairs.sort(key=lambda pair: -math.inf if pair[1][by] is None else -pair[1][by])
    rows = [["", *mean]]
    for name, figures in (*pairs[:_WORST], ("all pairs", mean)):
        values = (figures.get(figure) for figure in mean)
        rows.append([name, *("-" if value is None else f"{value:.4g}" for value in values)])
    more = f"the {_WORST} worst of {len(pairs)} by {by}; --json has all"
    return [*table(rows), *[more] * (len(pairs) > _WORST)]
