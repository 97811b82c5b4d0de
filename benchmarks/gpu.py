"""Everything that is to be known of a GPU, in one run: gpu.sh sets up what this needs, and starts it.

    benchmarks/gpu.sh                      # all parts, ten minutes
    benchmarks/gpu.sh doctor tests         # these parts alone
    benchmarks/gpu.sh --quick              # least effort: whether all parts run, not how fast
    benchmarks/gpu.sh --software --quick   # on a machine without a GPU, which is refused otherwise

Each part is a command of its own, which ends when its time is up. What it prints goes to OUT/PART.log, what it measures
to OUT/PART.json; OUT/README.md is the page of all parts that the folder has.
"""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import choices
import click
import hard_cases
import memory_rates
import readback

from semisynth_gl.bench import accuracy, speed
from semisynth_gl.bench.summary import markdown
from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.backends import is_software
from semisynth_gl.render.devices import (
    NVIDIA_CONTROL,
    NVIDIA_VENDOR_FILE,
    context_facts,
    egl_devices,
    nvidia_fault,
    nvidia_is_named,
)

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "benchmarks" / "training"))

import training_report  # noqa: E402 - found once the path above is set

_PARTS_FILE = "parts.json"
_NO_TIME = "no time was left"
_FAILED = 1
_LEAST_S = 5.0
_LAST_LINES = 12

Text = Callable[[Mapping[str, Any]], str]


@dataclass(frozen=True, slots=True)
class Part:
    """A part of the run.

    Attributes:
        title: on the page.
        command: arguments of Python.
        quick: further ones with --quick.
        at_most: share of the time that is left when it begins.
        report: headline and table of its JSON; None where it prints only.
        plot: whether plot.py draws its JSON.
        minutes: whether it takes --minutes and ends by itself.
    """

    title: str
    command: tuple[str, ...]
    quick: tuple[str, ...] = ()
    at_most: float = 0.5
    report: tuple[Text, Text] | None = None
    plot: bool = False
    minutes: bool = False


_CLI = ("-m", "semisynth_gl")
_TESTS = ("-m", "pytest", "-q", "-m", "opengl", "--numprocesses", "auto", "--dist", "worksteal")
_TRAINING = ("benchmarks/training/compare_sets.py", "--budget", "gpu")
# The parts that say whether all else is right come first; training takes what is left.
PARTS: Mapping[str, Part] = {
    "doctor": Part("What OpenGL there is", (*_CLI, "doctor"), at_most=0.1),
    "memory": Part(
        "Pairs per second into memory",
        ("benchmarks/memory_rates.py", "--config", "middlebury"),
        ("--set", "scale=0.1", "--pairs", "1", "--rounds", "1", "--workers", "1"),
        at_most=0.3,
        report=(speed.headline, memory_rates.table),
    ),
    "readback": Part(
        "Reading back, by components",
        ("benchmarks/readback.py",),
        ("--width", "64", "--height", "48", "--repeats", "1"),
        at_most=0.1,
        report=(readback.headline, readback.table),
    ),
    "speed": Part(
        "Stages, and workers to disk",
        (*_CLI, "bench", "speed", "--pairs", "64", "--repeats", "1"),
        ("--set", "scale=0.1", "--pairs", "1", "--repeats", "1", "--workers", "1"),
        at_most=0.4,
        report=(speed.headline, speed.table),
        plot=True,
    ),
    "accuracy": Part(
        "Accuracy, and cost of antialiasing",
        ("benchmarks/choices.py",),
        ("--set", "scale=0.2", "--pairs", "1", "--rays", "500", "--repeats", "1"),
        at_most=0.4,
        report=(accuracy.headline, choices.table),
        plot=True,
    ),
    "hard-cases": Part(
        "Hard cases", ("benchmarks/hard_cases.py",), report=(hard_cases.headline, hard_cases.table)
    ),
    "tests": Part("Tests of all that draws", _TESTS, ("-k", "test_frame or test_crop"), at_most=0.6),
    "training": Part(
        "What networks learn from which pairs",
        _TRAINING,
        ("--steps", "1", "--seeds", "1", "--set", "real", "--set", "clutter"),
        at_most=1.0,
        report=(training_report.headline, training_report.table),
        minutes=True,
    ),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a part.

    Attributes:
        status: "done", "failed (exit code)" or "cut off".
        seconds: it took.
        command: as a person would type it.
        date: UTC.
    """

    status: str
    seconds: float
    command: str
    date: str


def do_part(name: str, out: Path, seconds: float, arguments: Sequence[str], *, quick: bool) -> Outcome:
    """Run a part until it ends, or its time does.

    Args:
        name: of `PARTS`.
        out: folder of its log and JSON.
        seconds: at most.
        arguments: further ones.
        quick: with least effort.
    """
    part = PARTS[name]
    command = [*part.command, *arguments, *(part.quick if quick else ())]
    report = out / f"{name}.json"
    if part.report:
        report.unlink(missing_ok=True)
        command += ["--json", str(report)]
    if part.minutes:
        command += ["--minutes", f"{seconds / 60:.2f}"]
        # It ends by itself with what it has; the rest is for what it began.
        seconds += 60
    start = time.perf_counter()
    with (out / f"{name}.log").open("wb") as log:
        running = subprocess.Popen(
            [sys.executable, *command], cwd=ROOT, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
            start_new_session=True,
        )  # fmt: skip
        try:
            code = running.wait(seconds)
        except subprocess.TimeoutExpired:
            status = f"cut off after {seconds:.0f} s"
        else:
            status = f"failed (exit code {code})" if code else "done"
        finally:
            # Its workers too: they would draw on while the next part is timed.
            with suppress(ProcessLookupError):
                os.killpg(running.pid, signal.SIGKILL)
            running.wait()
    today = datetime.now(UTC).date().isoformat()
    return Outcome(status, time.perf_counter() - start, shlex.join(["python", *command]), today)


def page(out: Path, outcomes: Mapping[str, Mapping[str, Any]]) -> str:
    """Write the page of all parts that the folder has."""
    rows = [(name, each["status"], f"{each['seconds']:.0f}", each["date"]) for name, each in outcomes.items()]
    parts = ["# A GPU, measured", markdown(("part", "outcome", "s", "date"), rows)]
    for name, each in outcomes.items():
        part, report = PARTS[name], out / f"{name}.json"
        parts += [f"## {part.title}", f"    {each['command']}"]
        if part.report and report.is_file():
            headline, table = part.report
            values = json.loads(report.read_text(encoding="utf-8"))
            parts += [f"{headline(values)}.", table(values)]
            if (out / f"{name}.png").is_file():
                parts.append(f"![{part.title}]({name}.png)")
        if not part.report or each["status"] != "done":
            lines = (out / f"{name}.log").read_text(encoding="utf-8", errors="replace").splitlines()
            # A failed part says why at its end; a part without a report is its log.
            shown = lines if each["status"] == "done" and name == "doctor" else lines[-_LAST_LINES:]
            parts.append("\n".join(["```text", *shown, "```"]))
    return "\n\n".join(parts) + "\n"


def name_nvidia(out: Path) -> None:
    """Tell EGL of NVIDIA's driver where no file does, as in many containers; before anything has opened EGL."""
    if NVIDIA_CONTROL.exists() and not nvidia_is_named():
        vendor_file = out / "10_nvidia.json"
        vendor_file.write_text(NVIDIA_VENDOR_FILE, encoding="utf-8")
        os.environ["__EGL_VENDOR_LIBRARY_FILENAMES"] = str(vendor_file)


def check_gpu() -> None:
    """Refuse what is no GPU: EGL falls back on Mesa's software renderer without a word.

    Raises:
        ClickException: where OpenGL draws in software or not at all, with what is known of the cause.
    """
    try:
        renderer = context_facts("egl").renderer
    except BackendError as error:
        found = str(error)
    else:
        if not is_software(renderer):
            return
        found = f"OpenGL draws with {renderer}, which is no GPU."
    fault = nvidia_fault(egl_devices())
    cause = f" Of NVIDIA's: {fault}." if fault else ""
    raise click.ClickException(f"{found}{cause} --software measures it as it is")


def _plot(report: Path) -> None:
    command = [sys.executable, "benchmarks/plot.py", str(report), "--out", str(report.with_suffix(".png"))]
    # What cannot be drawn stands in the tables.
    subprocess.run(command, cwd=ROOT, check=False, stdout=subprocess.DEVNULL)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("names", nargs=-1, type=click.Choice(list(PARTS)), metavar="[PART]...")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("out/gpu"),
    show_default=True,
    help="Folder of everything; parts that it has stay on its page.",
)
@click.option(
    "--minutes", type=click.FloatRange(0, min_open=True), default=9.5, show_default=True, help="For all parts together."
)
@click.option("--images", multiple=True, metavar="PATH_OR_GLOB", help="Photographs that training sets wear.")
@click.option("--real", "folders", multiple=True, metavar="DIR", help="Scenes in Middlebury's layout that judge.")
@click.option("--software", is_flag=True, help="Measure a software renderer too.")
@click.option("--quick", is_flag=True, help="Least effort: whether all parts run, not how fast.")
def main(
    names: tuple[str, ...],
    out: Path,
    minutes: float,
    images: tuple[str, ...],
    folders: tuple[str, ...],
    *,
    software: bool,
    quick: bool,
) -> None:
    """Measure PARTs on this machine, all of them by default; the exit code is 1 where one failed or was cut off."""
    end = time.perf_counter() + 60 * minutes
    out = out.absolute()
    out.mkdir(parents=True, exist_ok=True)
    name_nvidia(out)
    if not software:
        check_gpu()
    kept = out / _PARTS_FILE
    outcomes: dict[str, dict[str, Any]] = json.loads(kept.read_text(encoding="utf-8")) if kept.is_file() else {}
    of_training = [
        word
        for option, given in (("--images", images), ("--real", folders))
        for each in given
        for word in (option, each)
    ]
    chosen = [name for name in PARTS if name in names] or list(PARTS)
    for name in chosen:
        left = end - time.perf_counter()
        if left < _LEAST_S:
            outcome = Outcome(_NO_TIME, 0.0, "", datetime.now(UTC).date().isoformat())
            (out / f"{name}.log").write_text(_NO_TIME, encoding="utf-8")
        else:
            # The last part may take all.
            share = 1.0 if name == chosen[-1] else PARTS[name].at_most
            arguments = of_training if name == "training" else []
            outcome = do_part(name, out, share * left, arguments, quick=quick)
            if PARTS[name].plot and (out / f"{name}.json").is_file():
                _plot(out / f"{name}.json")
        outcomes[name] = asdict(outcome)
        kept.write_text(json.dumps(outcomes, indent=1) + "\n", encoding="utf-8")
        (out / "README.md").write_text(page(out, outcomes), encoding="utf-8")
        click.echo(f"{name}: {outcome.status}, {outcome.seconds:.0f} s", err=True)
    click.echo(f"{out / 'README.md'}")
    if any(outcomes[name]["status"] != "done" for name in chosen):
        sys.exit(_FAILED)


if __name__ == "__main__":
    os.environ.setdefault("SEMISYNTH_GL_EXPECT_BACKENDS", "egl")
    main()
