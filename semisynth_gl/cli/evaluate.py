"""``semisynth-gl evaluate``."""

import json
from pathlib import Path

import click

from semisynth_gl.cli.progress import Progress
from semisynth_gl.errors import InputError
from semisynth_gl.metrics.evaluate import REGIONS, Evaluation, evaluate_pair, report_json, report_table
from semisynth_gl.metrics.predictions import find_predictions, missing_predictions
from semisynth_gl.metrics.protocol import PROTOCOL_NAMES, PROTOCOLS, ProtocolName
from semisynth_gl.metrics.truth import TrueSet, find_truth
from semisynth_gl.splits import SPLITS, SplitName
from semisynth_gl.write.png import encode_png


@click.command()
@click.option("--pred", type=click.Path(path_type=Path), required=True, help="Folder of predictions.")
@click.option(
    "--gt",
    "truth",
    required=True,
    metavar="DIR_OR_ADDRESS",
    help="Their truth: a dataset of this program, or a folder of Middlebury, ETH3D or KITTI.",
)
@click.option(
    "--protocol",
    "protocol_name",
    type=click.Choice(PROTOCOL_NAMES),
    help="Whose definitions to use; by default those of the benchmark whose form --gt has.",
)
@click.option(
    "--mask",
    "masks",
    type=click.Path(path_type=Path),
    help="Folder of masks, 255 where not occluded, instead of --gt's.",
)
@click.option("--split", type=click.Choice(SPLITS), help="Of this split of --gt alone.")
@click.option("--partial", is_flag=True, help="Evaluate what is there, though predictions are missing.")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Also write all figures here, unrounded.")
@click.option("--maps", type=click.Path(path_type=Path), help="Also write an error map per pair into this folder.")
def evaluate(
    pred: Path,
    truth: str,
    protocol_name: ProtocolName | None,
    masks: Path | None,
    split: SplitName | None,
    partial: bool,  # noqa: FBT001 - click passes flags so
    json_path: Path | None,
    maps: Path | None,
) -> None:
    """Compare predicted disparities with the truth, as a benchmark does.

    Predictions are .pfm, .npy or 16-bit .png, under the pair's name or under the truth's.
    """
    found = find_truth(truth, split, masks)
    _check_outputs(json_path, maps, pred, found, truth)
    predictions = find_predictions(pred, found.pairs)
    missing = missing_predictions(pred, found.pairs, predictions, partial=partial)
    protocol = PROTOCOLS[protocol_name or found.protocol]
    evaluations: list[Evaluation] = []
    with Progress() as progress:
        progress.begin(len(predictions))
        for pair in found.pairs:
            if pair.name not in predictions:
                continue
            evaluation = evaluate_pair(pair, predictions[pair.name], protocol, draw=maps is not None)
            if maps is not None and evaluation.error_map is not None:
                picture = maps / f"{pair.name}.png"
                picture.parent.mkdir(parents=True, exist_ok=True)
                picture.write_bytes(encode_png(evaluation.error_map))
            # Without the map: the maps of a large set would fill the memory.
            evaluations.append(Evaluation(pair.name, evaluation.scores))
            progress.advance()
    if json_path is not None:
        paths = {name: prediction.path for name, prediction in predictions.items()}
        text = json.dumps(report_json(evaluations, protocol, missing, paths), indent=1, allow_nan=False)
        json_path.write_text(text + "\n", encoding="utf-8")
    click.echo(f"{len(evaluations)} of {len(found.pairs)} pairs by the definitions of {protocol.source}")
    for region in REGIONS:
        if any((region,) in evaluation.scores for evaluation in evaluations):
            click.echo()
            for line in report_table(evaluations, region, protocol):
                click.echo(line)
    if missing:
        click.echo(f"No prediction for {len(missing)} pairs: {', '.join(missing)}", err=True)


def _check_outputs(json_path: Path | None, maps: Path | None, pred: Path, found: TrueSet, truth: str) -> None:
    """Refuse places where results cannot go, before anything is computed.

    Raises:
        InputError: with the reason.
    """
    if json_path is not None and not json_path.absolute().parent.is_dir():
        raise InputError(f"--json {json_path}: the folder {json_path.absolute().parent} does not exist")
    if maps is None:
        return
    if maps.exists() and not maps.is_dir():
        raise InputError(f"--maps {maps}: is a file; name a folder")
    if maps.resolve() == pred.resolve():
        raise InputError(f"--maps {maps}: is the folder of predictions, which error maps would be taken for")
    inside = found.local is not None and maps.resolve().is_relative_to(found.local.resolve())
    if inside or ("://" not in truth and maps.resolve() == Path(truth).resolve()):
        raise InputError(f"--maps {maps}: lies in --gt, which is left as it is; name another folder")
