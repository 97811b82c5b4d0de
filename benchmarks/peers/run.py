"""Compare renderers that a user could choose: the same scene and loop, with files written.

    python benchmarks/peers/run.py --setup pyrender,blender
    python benchmarks/peers/run.py --frames 12 --rounds 3 --json peers.json

--setup makes an environment for each of its renderers. Renderers without an environment are skipped. The table names
renderers that could not run.
"""

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
import venv
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from accuracy import cast_truth, errors_px
from scene import PeerScene, library_meshes, make_scene

from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.dataset.engines import LLVMPIPE_THREADS

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]

OURS = "semisynth_gl"
PACKAGES = {
    "pyrender": ("pyrender==0.1.45", "numpy==1.26.4", "trimesh==4.5.3", "PyOpenGL-accelerate==3.1.10"),
    "blender": ("bpy==5.0.1",),  # only for Python 3.11
}
# Packages that semisynth_gl.codecs imports, without numpy, which all renderers need. Pillow also reads the patches.
ENCODER_PACKAGES = ("isal", "Pillow")
CHECKED_FRAMES = (0, 1)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A renderer with its variant and the encoders that write its pairs.

    Attributes:
        peer: name of the renderer, and of its environment.
        variant: one of the variants that the renderer's script lists.
        label: its name in the table.
        our_encoders: whether it writes with semisynth_gl's encoders.
        frames_divisor: a slow candidate renders only this fraction of the frames.
    """

    peer: str
    variant: str
    label: str
    our_encoders: bool = False
    frames_divisor: int = 1

    @property
    def name(self) -> str:
        """A name for folders."""
        return f"{self.peer}-{self.variant}" + ("-our-encoders" if self.our_encoders else "")


CANDIDATES = (
    Candidate(OURS, "none", "semisynth-gl"),
    Candidate(OURS, "edges", "semisynth-gl, images antialiased along edges"),
    Candidate(OURS, "ssaa2", "semisynth-gl, images 2x2 supersampled"),
    Candidate(OURS, "all", "semisynth-gl, both disparities and visibilities"),
    *(
        Candidate(peer, variant, label, our_encoders, frames_divisor)
        for peer, variant, label, frames_divisor in (
            ("pyrender", "msaa4", "pyrender as it ships, 4x multisampled", 1),
            ("pyrender", "none", "pyrender, multisampling patched out", 1),
            ("blender", "workbench", "Blender 5.0 Workbench", 1),
            ("blender", "eevee", "Blender 5.0 Eevee, 1 sample", 4),
        )
        for our_encoders in (False, True)
    ),
)
PEERS = (OURS, *PACKAGES)
# The candidates with which the others are compared: with usual encoders, and with ours.
REFERENCE = CANDIDATES[0]


@dataclass(frozen=True, slots=True)
class Parallel:
    """A number of processes, and of Mesa's threads in each (LP_NUM_THREADS; None for Mesa's default)."""

    processes: int
    threads: str | None = None

    def __str__(self) -> str:
        return f"{self.processes} x {self.threads or 'default'}"


@dataclass(slots=True)
class Measured:
    """All runs of a candidate.

    Attributes:
        seconds_per_pair: for each run, wall time of the loop divided by the number of pairs.
        details: for each run, the measurements that its processes printed.
        error_px: error of the disparity; see `accuracy.errors_px`.
        fault: why the candidate could not be run.
    """

    seconds_per_pair: dict[Parallel, list[float]] = field(default_factory=dict)
    details: dict[Parallel, list[list[dict[str, Any]]]] = field(default_factory=dict)
    error_px: dict[str, float] = field(default_factory=dict)
    fault: str = ""

    def best(self, *, processes: int) -> Parallel:
        """Return the threads with which this number of processes is fastest, by the median over runs."""
        candidates = [parallel for parallel in self.seconds_per_pair if parallel.processes == processes]
        return min(candidates, key=lambda parallel: median(self.seconds_per_pair[parallel]))


class PeerError(Exception):
    """A renderer could not be run."""


def main() -> None:
    """Set up environments, or measure and print."""
    options = _parse()
    options.work.mkdir(parents=True, exist_ok=True)
    if options.setup:
        for peer in options.setup:
            set_up(peer, options.work)
        return
    scene = make_scene(options.work / "scene", library_meshes(), options.frames)
    triangles = float(np.mean([len(scene.models[number].triangles) for number in scene.model.ravel()]))
    candidates = [
        candidate
        for candidate in CANDIDATES
        if candidate == REFERENCE
        or (
            (candidate.peer == OURS or _python_of(candidate.peer, options.work).is_file())
            and (not options.peers or candidate.peer in options.peers)
            and (not options.variants or candidate.variant in options.variants)
        )
    ]
    measured = measure(candidates, scene, options.work, options.rounds)
    if measured[REFERENCE].fault:
        sys.exit(f"nothing to compare with: {REFERENCE.label} {measured[REFERENCE].fault}")
    report = {
        "command": shlex.join(["python", "benchmarks/peers/run.py", *sys.argv[1:]]),
        "machine": machine_facts(),
        "scene": {
            "size_px": [scene.width_px, scene.height_px],
            "instances": scene.model.shape[1],
            "triangles_per_instance": round(triangles),
            "frames": options.frames,
        },
        "rounds": options.rounds,
        "peers": [as_json(candidate, result) for candidate, result in measured.items()],
    }
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    print(table(report))


def set_up(peer: str, work: Path) -> None:
    """Make a renderer's virtual environment with the Python that runs this script."""
    folder = work / f"venv-{peer}"
    packages = (*PACKAGES[peer], *ENCODER_PACKAGES)
    print(f"Installing {', '.join(packages)} into {folder}")
    venv.create(folder, with_pip=True, clear=True)
    install = [str(_python_of(peer, work)), "-m", "pip", "install", "--quiet"]
    subprocess.run([*install, *packages], check=True)
    # The encoders read the project's version from its installed metadata.
    subprocess.run([*install, "--no-deps", "--editable", str(ROOT)], check=True)


def measure(candidates: Sequence[Candidate], scene: PeerScene, work: Path, rounds: int) -> dict[Candidate, Measured]:
    """Run the candidates in rounds, each of which begins with a different candidate.

    The first round tries all numbers of processes and threads, the others one process and the fastest with several.
    """
    frames, cores = len(scene.model), os.cpu_count() or 1
    several = [Parallel(cores, threads) for threads in (None, "0", "1")] if cores > 1 else []
    truth = cast_truth(scene, CHECKED_FRAMES)
    measured = {candidate: Measured() for candidate in candidates}
    for number in range(rounds):
        start = number % len(candidates)
        for candidate in [*candidates[start:], *candidates[:start]]:
            result = measured[candidate]
            if result.fault:
                continue
            best = [result.best(processes=cores)] if several and number > 0 else []
            # Each process gets the same number of frames, and at least as many as are checked.
            rows = max(frames // candidate.frames_divisor // cores, -(-len(CHECKED_FRAMES) // cores))
            drawn = range(rows * cores)
            for parallel in [Parallel(1), *(best or several)]:
                try:
                    seconds, details = run_together(candidate, parallel, scene.folder, drawn, work)
                    if not result.error_px:
                        result.error_px = errors_px(work / "out" / candidate.name, truth)
                except PeerError as error:
                    result.fault = str(error)
                    print(f"{candidate.name}: {error}", file=sys.stderr)
                    break
                result.seconds_per_pair.setdefault(parallel, []).append(seconds)
                result.details.setdefault(parallel, []).append(details)
                print(f"round {number + 1}: {candidate.name}, {parallel}: {seconds:.3f} s per pair", file=sys.stderr)
    return measured


def run_together(
    candidate: Candidate, parallel: Parallel, scene: Path, frames: Sequence[int], work: Path
) -> tuple[float, list[dict[str, Any]]]:
    """Run a candidate's processes at the same time, each on its share of the frames.

    Returns:
        Seconds per pair from the common start to the end of the last process, without the first pairs; and the
        measurements of each process.
    """
    out = work / "out" / candidate.name
    shutil.rmtree(out, ignore_errors=True)
    environment = dict(os.environ)
    environment.pop(LLVMPIPE_THREADS, None)
    if parallel.threads is not None:
        environment[LLVMPIPE_THREADS] = parallel.threads
    log = work / f"{candidate.name}.log"
    processes = []
    started = time.perf_counter()
    with log.open("w") as errors:
        try:
            for number in range(parallel.processes):
                own_frames = ",".join(str(frame) for frame in frames[number :: parallel.processes])
                command = [*_command(candidate, work), "--scene", str(scene), "--out", str(out)]
                command += ["--frames", own_frames, "--variant", candidate.variant]
                command += ["--our-encoders"] if candidate.our_encoders else []
                pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": errors}
                processes.append(subprocess.Popen(command, env=environment, text=True, **pipes))
            # A thread reads each process's output, so that no process waits for a full pipe.
            with ThreadPoolExecutor(len(processes)) as readers:
                list(readers.map(lambda process: _line_with("READY", process, log), processes))
                ready = time.perf_counter()
                for process in processes:
                    process.stdin.write("\n")
                    process.stdin.flush()
                details = list(readers.map(lambda process: json.loads(_line_with("DONE", process, log)), processes))
                seconds = time.perf_counter() - ready
        except OSError as error:
            raise PeerError(f"could not be started: {error}") from error
        finally:
            for process in processes:
                process.communicate()
    for detail in details:
        detail["start_s"] = ready - started - detail["first_frame_s"]
    return seconds / len(frames), details


def table(report: Mapping[str, Any]) -> str:
    """Return a report in Markdown: a table of the renderers, and the ratios of their times to ours."""
    peers, cores = report["peers"], report["machine"]["cores"]
    reference = _best_seconds(peers[0])
    columns = ["renderer", "files written by", "s per pair, 1 process", f"{cores} processes", "best, x ours"]
    columns += ["error median, px", "99.9 %", "worst"]
    rows = []
    ratios: dict[bool, dict[str, float]] = {False: {}, True: {}}
    for peer in peers:
        encoders = "us" if peer["our_encoders"] else "itself"
        if peer["fault"]:
            rows.append((peer["peer"], encoders, "could not be run", *[""] * 5))
            continue
        ratio = _best_seconds(peer) / reference
        if not peer["peer"].startswith(REFERENCE.label):
            ratios[peer["our_encoders"]][peer["peer"]] = ratio
        alone, together = (f"{_best_seconds(peer, processes):.3f}" for processes in (1, cores))
        error = [f"{peer['error_px'][key]:.1e}" for key in ("median", "p99_9", "worst")]
        rows.append((peer["peer"], encoders, alone, together, f"{ratio:.2f}", *error))
    lines = [markdown(columns, rows, text_last=False), ""]
    for our_encoders, title in ((False, "as a user would run it"), (True, "given our encoders")):
        if ratios[our_encoders]:
            label = min(ratios[our_encoders], key=ratios[our_encoders].__getitem__)
            lines.append(f"Best peer {title}: {label}, {ratios[our_encoders][label]:.2f} times our time.")
    versions: dict[str, str] = {}
    for peer in peers:
        if peer["parallel"]:
            versions.setdefault(peer["parallel"][0]["runs"][0][0]["version"], peer["peer"])
    named = (f"{label}: {version}" for version, label in versions.items())
    return "\n".join([*lines, "", f"Versions: {'; '.join(named)}."])


def _best_seconds(peer: Mapping[str, Any], processes: int | None = None) -> float:
    """Return the smallest median of seconds per pair, over all runs or those with this number of processes."""
    return min(
        parallel["seconds_per_pair"]["median"]
        for parallel in peer["parallel"]
        if processes in (None, parallel["processes"])
    )


def _parse() -> argparse.Namespace:
    def names(text: str) -> list[str]:
        return text.split(",")

    cores = os.cpu_count() or 1
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--setup", type=names, metavar="PEERS", help=f"build environments: {','.join(PACKAGES)}")
    parser.add_argument("--peers", type=names, help="renderers to compare with ours; default: all with an environment")
    parser.add_argument("--variants", type=names, help="only these variants, and our plain one")
    parser.add_argument(
        "--frames", type=int, default=max(12, 2 * cores), help="pairs of a run, shared evenly by its processes"
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--work", type=Path, default=HERE / "made", help="folder of environments, scene and output")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    options.work = options.work.resolve()
    unknown = set(options.setup or ()) - set(PACKAGES)
    unknown |= set(options.peers or ()) - set(PEERS)
    if unknown:
        parser.error(f"unknown peers: {', '.join(sorted(unknown))}")
    if options.peers:
        options.peers.append(OURS)
    least = max(cores, len(CHECKED_FRAMES))
    if options.frames < least:
        parser.error(f"--frames: at least {least}, one for each core and those whose disparity is checked")
    return options


def _python_of(peer: str, work: Path) -> Path:
    return work / f"venv-{peer}" / "bin" / "python"


def _command(candidate: Candidate, work: Path) -> list[str]:
    """Return the command that starts a candidate's process."""
    python = sys.executable if candidate.peer == OURS else str(_python_of(candidate.peer, work))
    return [python, str(HERE / f"peer_{candidate.peer}.py")]


def _line_with(mark: str, process: subprocess.Popen[str], log: Path) -> str:
    """Read up to a line that begins with ``mark``, and return the rest of that line."""
    for line in process.stdout:
        if line.startswith(mark):
            return line.removeprefix(mark)
    raise PeerError(f"ended without saying {mark}: see {log}")


def as_json(candidate: Candidate, result: Measured) -> dict[str, Any]:
    """Convert a candidate's runs to JSON's types."""
    return {
        "peer": candidate.label,
        "our_encoders": candidate.our_encoders or candidate.peer == OURS,
        "fault": result.fault,
        "error_px": result.error_px,
        "parallel": [
            {
                "processes": parallel.processes,
                "lp_num_threads": parallel.threads,
                "seconds_per_pair": {"median": median(runs), "runs": runs},
                "runs": result.details.get(parallel, []),
            }
            for parallel, runs in result.seconds_per_pair.items()
        ],
    }


if __name__ == "__main__":
    main()
