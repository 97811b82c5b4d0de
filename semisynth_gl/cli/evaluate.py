"""``semisynth-gl evaluate``."""

from dataclasses import replace
from pathlib import Path

import click

from semisynth_gl.cli.options import Command, FilesType, UserPath, option
from semisynth_gl.cli.outputs import OutputFile, write_json
from semisynth_gl.cli.progress import Progress
from semisynth_gl.codecs.png import RGB8
from semisynth_gl.inputs.errors import InputError, abbreviate, counted
from semisynth_gl.judge.confirmation import evaluate_views
from semisynth_gl.judge.evaluate import REGIONS, SIGN_HINT, Evaluation, evaluate_pair, report_json, report_table
from semisynth_gl.judge.predictions import find_predictions
from semisynth_gl.judge.protocol import PROTOCOL_NAMES, PROTOCOLS, Protocol, ProtocolName
from semisynth_gl.judge.truth import find_truth
from semisynth_gl.seeds.splits import SPLITS, SplitName

_PATH = UserPath()
# Most pairs with a row in a table, unless --all is given.
_WORST = 10


@click.command(cls=Command)
@option("--pred", "predictions", type=_PATH, required=True, help="Folder of predictions.")
@option(
    "--gt",
    "truth",
    type=FilesType(home=True),
    metavar="DIR_OR_ADDRESS",
    help="Truth of the predicted pairs: a dataset of this program, or a folder of Middlebury, ETH3D or KITTI.",
)
@option(
    "--pred-right",
    "predictions_right",
    type=_PATH,
    help="Folder of predictions for the right views, to measure without truth how far they confirm those of --pred.",
)
@option(
    "--protocol",
    "protocol_name",
    type=click.Choice(PROTOCOL_NAMES),
    help="Benchmark whose definitions to use; by default, the benchmark in whose format --gt is.",
)
@option("--mask", "masks", type=_PATH, help="Folder of masks to use instead of --gt's; 255 means not occluded.")
@option("--split", type=click.Choice(SPLITS), help="Evaluate only this split of --gt.")
@option("--partial", is_flag=True, help="Evaluate the predictions that exist, even if others are missing.")
@option("--json", "json_file", type=OutputFile(), help="Also write all figures, unrounded, to this JSON file.")
@option("--all", "show_all", is_flag=True, help=f"Print a row for every pair, not only for the {_WORST} worst.")
@option("--maps", type=_PATH, help="Also write an error map of each pair into this folder.")
def evaluate(
    predictions: Path,
    truth: str | None,
    predictions_right: Path | None,
    protocol_name: ProtocolName | None,
    masks: Path | None,
    split: SplitName | None,
    partial: bool,
    json_file: Path | None,
    show_all: bool,
    maps: Path | None,
) -> None:
    """Compare predicted disparities with the truth, as a benchmark does.

    Prints the figures over all pairs, and those of each pair or, where there are many, of the worst pairs.

    Predictions are .pfm, .npy or 16-bit .png files with the pair's name or the name of the truth's file.
    """
    if predictions_right is not None:
        of_truth = {"--gt": truth, "--protocol": protocol_name, "--mask": masks, "--split": split, "--maps": maps}
        refused = [name for name, value in {**of_truth, "--partial": partial or None}.items() if value is not None]
        _evaluate_views(predictions, predictions_right, refused, json_file, show_all=show_all)
        return
    if truth is None:
        raise InputError("expected --gt, the truth, or --pred-right, which judges without truth")
    truth_set = find_truth(truth, split, masks)
    for name, folder in (("--pred", predictions), ("--gt", Path(truth)), ("--mask", masks)):
        if maps is not None and folder is not None and maps.resolve() == folder.resolve():
            raise InputError(f"--maps {maps}: is the folder of {name}; name another folder")
    found, missing = find_predictions(predictions, truth_set.pairs, partial=partial)
    protocol = PROTOCOLS[protocol_name or truth_set.protocol]
    evaluations: list[Evaluation] = []
    with Progress() as progress:
        progress.on_total(len(found))
        for pair, prediction in found:
            evaluation = evaluate_pair(pair, prediction, protocol, draw=maps is not None)
            if maps is not None and evaluation.error_map is not None:
                path = maps / f"{pair.name}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(RGB8.encode(evaluation.error_map))
            # Without the map: the maps of a large set would fill the memory.
            evaluations.append(replace(evaluation, error_map=None))
            progress.advance()
    if json_file is not None:
        write_json(json_file, report_json(evaluations, protocol, missing))
    click.echo(f"{len(evaluations)} of {counted(len(truth_set.pairs), 'pair')} by the definitions of {protocol.source}")
    _print_tables(evaluations, protocol, None if show_all else _WORST)
    if missing:
        click.echo(f"No prediction for {counted(len(missing), 'pair')}: {abbreviate(missing)}", err=True)


def _print_tables(evaluations: list[Evaluation], protocol: Protocol, most: int | None) -> None:
    """Print a table for each region, with at most ``most`` pairs (None for all), and a note on negative predictions."""
    for region in REGIONS:
        if any((region,) in evaluation.scores for evaluation in evaluations):
            click.echo()
            for line in report_table(evaluations, region, protocol, most):
                click.echo(line)
    if most is not None and len(evaluations) > most:
        click.echo("\n--all prints a row for every pair, and --json writes all figures")
    negative = [each.prediction for each in evaluations if each.negative]
    if negative:
        click.echo(f"note: {len(negative)} of the predictions, such as {negative[0]}: {SIGN_HINT}", err=True)


def _evaluate_views(
    predictions: Path, predictions_right: Path, refused: list[str], json_file: Path | None, *, show_all: bool
) -> None:
    """Print the share of pixels that the right views' predictions do not confirm, worst pairs first.

    ``refused`` are the given options that need a truth; if there are any, the command is refused.
    """
    if refused:
        raise InputError(f"--pred-right judges without truth: leave {', '.join(refused)} out")
    report = evaluate_views(predictions, predictions_right)
    if json_file is not None:
        write_json(json_file, report)
    click.echo(f"{counted(report['pairs'], 'pair')} without truth: % of pixels that the right view does not confirm\n")
    images = sorted(report["images"], key=lambda image: -image["unconfirmed"])
    rows = [(image["name"], image["unconfirmed"]) for image in (images if show_all else images[:_WORST])]
    rows.append(("mean", report["mean"]["unconfirmed"]))
    for name, share in rows:
        click.echo(f"{name.ljust(max(len(name) for name, _ in rows))}  {share:11.2f}")
