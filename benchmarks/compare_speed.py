"""Speed of two checkouts of this project, in alternating turns.

    python benchmarks/compare_speed.py ../before . --config middlebury --turns 12

In a turn, each checkout makes the same pairs with ``semisynth-gl generate --engine serial``; they take turns to begin.
The time is from the writing of the first pair's left image to that of the last pair's, without start and first pair.
Both checkouts use the Python that runs this script.

The result is the median over the turns of the second checkout's time divided by the first checkout's time, with its
90 % confidence interval (bootstrap over the turns). Run it on an idle machine.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import click
import numpy as np

_WHERE = "import semisynth_gl; print(semisynth_gl.__file__)"
_RESAMPLES = 10_000


def run(checkout: Path, work: Path, *arguments: str) -> str:
    """Run Python with a checkout's package and a cache in ``work``; return its standard output."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "SEMISYNTH_GL_CACHE": str(work / "cache")}
    command = [sys.executable, *arguments]
    result = subprocess.run(command, cwd=checkout, env=environment, check=False, capture_output=True, text=True)
    if result.returncode:
        raise SystemExit(f"{checkout}: {arguments} ended with {result.returncode}:\n{result.stderr}")
    return result.stdout


def seconds(checkout: Path, work: Path, config: str, pairs: int) -> float:
    """Make ``pairs`` + 1 pairs, and return the seconds without the first pair."""
    out = work / "dataset"
    shutil.rmtree(out, ignore_errors=True)
    arguments = ("generate", "--config", config, "--pairs", str(pairs + 1), "--out", str(out), "--engine", "serial")
    run(checkout, work, "-m", "semisynth_gl", *arguments)
    written = sorted(path.stat().st_mtime for path in out.rglob("im0.png"))
    if len(written) != pairs + 1:
        raise SystemExit(f"{checkout}: expected {pairs + 1} files im0.png in {out}, got {len(written)}")
    return written[-1] - written[0]


def median_interval(ratios: np.ndarray) -> tuple[float, float, float]:
    """Return the median of ratios, and its 90 % confidence interval by bootstrap."""
    resamples = np.random.default_rng(0).choice(ratios, (_RESAMPLES, len(ratios)))
    least, most = np.quantile(np.median(resamples, axis=1), [0.05, 0.95])
    return float(np.median(ratios)), float(least), float(most)


@click.command()
@click.argument("before", type=click.Path(exists=True, path_type=Path, resolve_path=True))
@click.argument("after", type=click.Path(exists=True, path_type=Path, resolve_path=True))
@click.option("--config", default="middlebury", show_default=True, help="A config with the layout middlebury.")
@click.option("--turns", type=click.IntRange(1), default=12, show_default=True)
@click.option("--pairs", type=click.IntRange(1), default=24, show_default=True, help="Pairs per turn.")
def main(before: Path, after: Path, config: str, turns: int, pairs: int) -> None:
    """Compare the time of AFTER with that of BEFORE."""
    with tempfile.TemporaryDirectory() as folder:
        checkouts = [(before, Path(folder, "before")), (after, Path(folder, "after"))]
        for checkout, work in checkouts:
            imported = run(checkout, work, "-c", _WHERE).strip()
            if not Path(imported).is_relative_to(checkout):
                raise SystemExit(f"{checkout}: expected the project there, but Python imports {imported}")
        ratios = []
        for turn in range(turns):
            step = 1 if turn % 2 == 0 else -1
            first, second = [seconds(*each, config, pairs) for each in checkouts[::step]][::step]
            ratios.append(second / first)
            click.echo(f"turn {turn + 1}: {first:.3f} s, {second:.3f} s, ratio {second / first:.3f}", err=True)
    median, least, most = median_interval(np.array(ratios))
    click.echo(f"{config}: median ratio {median:.3f} ({least:.3f} to {most:.3f} with 90 % confidence)")


if __name__ == "__main__":
    main()
