"""``semisynth-gl verify``."""

import json
import time
from collections.abc import Iterable
from dataclasses import asdict

import click

from semisynth_gl.cli.options import COUNT, FilesType, option
from semisynth_gl.cli.outputs import Output, json_report, output_option
from semisynth_gl.cli.progress import Progress
from semisynth_gl.dataset.reader import DamagedIndexError, read_index
from semisynth_gl.inputs.errors import counted
from semisynth_gl.verify.dataset import damaged_index, verify_dataset
from semisynth_gl.verify.verdict import Verdict

_REPORT = json_report("semisynth-gl verify", pairs=int, findings=list, measures=dict)


@click.command()
@click.argument("directory", type=FilesType(), metavar="DIR_OR_ADDRESS")
@option("--oracle", is_flag=True, help="Also make each scene again and compare with float64 rays.")
@option("--pixels", type=COUNT, default=500, help="Rays per pair, with --oracle.")
@output_option("--json", _REPORT, help="Also write findings and measures here.")
def verify(directory: str, oracle: bool, pixels: int, output: Output) -> None:
    """Read a dataset back as a stranger would, and tell what is wrong with it.

    One line per finding: scene, check, what was expected and what came. Exit code 1 where there is any.
    """
    output.check()
    start = time.monotonic()
    pairs, verdicts = 0, []
    with Progress() as progress:
        try:
            index = read_index(directory)
        except DamagedIndexError as error:
            found: Iterable[Verdict] = [damaged_index(error.faults)]
        else:
            pairs, found = sum(index.pairs.values()), verify_dataset(index, pixels if oracle else 0)
        progress.on_total(pairs)
        for number, verdict in enumerate(found):
            verdicts.append(verdict)
            for finding in verdict.findings:
                click.echo(str(finding))
            if number > 0:  # the first verdict is about the dataset, not about a pair
                progress.advance()
    seconds = time.monotonic() - start
    output.write(f"{json.dumps(_report(pairs, verdicts), indent=1)}\n".encode())
    findings = sum(len(verdict.findings) for verdict in verdicts)
    if findings:
        faulty_pairs = sum(1 for verdict in verdicts[1:] if verdict.findings)
        suffix = " and in the dataset as a whole" if verdicts[0].findings else ""
        click.echo(f"{counted(findings, 'finding')} in {faulty_pairs} of {counted(pairs, 'pair')}{suffix}", err=True)
        click.get_current_context().exit(1)
    click.echo(_summary(pairs, verdicts, seconds))


def _report(pairs: int, verdicts: list[Verdict]) -> dict[str, object]:
    return {
        "pairs": pairs,
        "findings": [asdict(finding) for verdict in verdicts for finding in verdict.findings],
        "measures": {verdict.scene: verdict.measures for verdict in verdicts if verdict.measures},
    }


def _summary(count: int, verdicts: list[Verdict], seconds: float) -> str:
    """Return a line with the worst of each measure."""
    parts = []
    for name, text in (
        ("left_right_median_px", "left against right {:.5f} px"),
        ("best_shift_px", "images fit within {:.4f} px"),
        ("visibility_left_disagree_share", "masks disagree in {:.3%}"),
        ("invalid_share", "{:.3%} of the pixels without disparity"),
        ("oracle_largest_px", "rays within {:.1e} px"),
        ("oracle_normals_largest_deg", "normals of rays within {:.1e} degrees"),
        ("oracle_flow_largest_px", "flow of rays within {:.1e} px"),
    ):
        values = [abs(verdict.measures[name]) for verdict in verdicts if name in verdict.measures]
        if values:
            parts.append(text.format(max(values)))
    speed = f"{seconds / max(count, 1):.2f} s a pair"
    return f"{counted(count, 'pair')}, nothing found; at worst: {', '.join(parts)} ({speed})"
