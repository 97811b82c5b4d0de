"""``semisynth-gl verify``."""

import sys
import time
from pathlib import Path

import click

from semisynth_gl.cli.options import COUNT, NATURAL, Command, option
from semisynth_gl.cli.outputs import OutputFileType, write_json
from semisynth_gl.cli.progress import Progress
from semisynth_gl.inputs.errors import abbreviate, counted
from semisynth_gl.judge.verify import PAIRS_WITH_RAYS, Verification
from semisynth_gl.judge.verify import verify as verify_dataset


@click.command(cls=Command)
@click.argument("directory", metavar="DIR_OR_ADDRESS")
@option(
    "--rays",
    type=NATURAL,
    help="Number of pairs, evenly spread, to compare with float64 rays through their scenes, which are rebuilt.  "
    f"[default: {PAIRS_WITH_RAYS}, or 0 if the scenes cannot be rebuilt]",
)
@option("--oracle", is_flag=True, help="Compare all pairs with rays.")
@option("--pixels", type=COUNT, default=500, help="Number of rays for each pair that is compared with rays.")
@option("--json", "json_file", type=OutputFileType(), help="JSON file for findings and measures.")
def verify(directory: str, json_file: Path | None, rays: int | None, pixels: int, *, oracle: bool) -> None:
    """Read a dataset's files back, and print their faults.

    Each line is a finding: pair, check and fault. The exit code is 1 if there are findings.
    """
    if oracle and rays is not None:
        raise click.UsageError("give --rays or --oracle, not both")
    start = time.monotonic()
    with Progress() as progress:
        rays = sys.maxsize if oracle else rays
        found = verify_dataset(directory, rays=rays, pixels=pixels, listener=progress, on_finding=click.echo)
    seconds = time.monotonic() - start
    write_json(json_file, found.values())
    if found.no_rays is not None:
        click.echo(f"note: no rays: {found.no_rays}", err=True)
    if found.findings:
        click.echo(f"{counted(len(found.findings), 'finding')} in {counted(found.pairs, 'pair')}", err=True)
        if found.remove:
            names = abbreviate([f"{directory.rstrip('/')}/{name}" for name in found.remove])
            click.echo(f"To make missing and changed files again, remove {names}; then run generate again.", err=True)
        click.get_current_context().exit(1)
    click.echo(_summary(found, seconds))


def _summary(found: Verification, seconds: float) -> str:
    """Return a line with the worst value of each measure, and the seconds per pair."""
    parts = []
    for name, text in {
        "left_right_left_median_px": "left against right {:.5f} px",
        "best_shift_x_px": "images fit within {:.3f} px",
        "visibility_left_disagree_share": "masks disagree in {:.3%}",
        "oracle_disparity_largest_px": "rays within {:.1e} px",
    }.items():
        values = [abs(results.measures[name]) for results in found.all_results if name in results.measures]
        if values:
            parts.append(text.format(max(values)))
    speed = f"{seconds / max(found.pairs, 1):.2f} s a pair"
    return f"{counted(found.pairs, 'pair')}, nothing found; at worst: {', '.join(parts)} ({speed})"
