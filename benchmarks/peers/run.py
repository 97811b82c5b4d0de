"""Renderers a user could pick, side by side: one scene, one loop, files written.

python benchmarks/peers/run.py --setup pyrender,blender,pygfx
python benchmarks/peers/run.py --frames 12 --rounds 3 --json peers.json
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
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from accuracy import cast_truth, errors_px
from scene import PeerScene, library_meshes, make_scene, read_meshes

from semisynth_gl.bench.summary import machine_facts

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]

OURS = "semisynth_gl"
# The Python of a machine's own Blender finds isal in the environment of the Blender package.
SYSTEM_BLENDER = "blender-system"
PACKAGES = {
    "pyrender": ("pyrender==0.1.45", "numpy==1.26.4", "trimesh==4.5.3", "PyOpenGL-accelerate==3.1.10", "Pillow"),
    "blender": ("bpy==5.0.1",),  # for Python 3.11 alone
    "pygfx": ("pygfx==0.17.0", "wgpu==0.32.0", "Pillow"),
}
# Meshes that a folder shared/ beside the project may hold.
SHARED_MESHES = ROOT.parent / "shared" / "peers" / "scene" / "meshes.npz"
CHECKED_FRAMES = (0, 1)


@dataclass(frozen=True, slots=True)
class Candidate:
    """One way of one peer to draw and write the scene.

    Attributes:
        peer: whose environment runs it.
        variant: see the peer's script.
        label: what the table calls it.
        our_encoders: whether the peer is given the encoders of semisynth_gl.
        frames_divisor: slow ones draw only this part of the frames.
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
    Candidate(OURS, "msaa4", "semisynth-gl, images 4x multisampled"),
    Candidate(OURS, "ssaa2", "semisynth-gl, images 2x2 supersampled"),
    Candidate(OURS, "all", "semisynth-gl, both disparities and visibilities"),
    *(
        Candidate(peer, variant, label, our_encoders, frames_divisor)
        for peer, variant, label, frames_divisor in (
            ("pyrender", "msaa4", "pyrender as it ships, 4x multisampled", 1),
            ("pyrender", "none", "pyrender, multisampling patched out", 1),
            ("blender", "workbench", "Blender 5.0 Workbench", 1),
            (SYSTEM_BLENDER, "workbench", "Blender of the system, Workbench", 1),
            ("pygfx", "none", "pygfx", 1),
            ("blender", "eevee", "Blender 5.0 Eevee, 1 sample", 4),
            (SYSTEM_BLENDER, "eevee", "Blender of the system, Eevee, 1 sample", 4),
        )
        for our_encoders in (False, True)
    ),
)
# The reference that the others are compared with, as a user would run both and both with our encoders.
REFERENCE = CANDIDATES[0]


@dataclass(frozen=True, slots=True)
class Way:
    """How the cores are used: so many processes, and LP_NUM_THREADS, Mesa's threads on the CPU, if it is set."""

    processes: int
    threads: str | None = None

    def __str__(self) -> str:
        return f"{self.processes} x {self.threads or 'default'}"


@dataclass(slots=True)
class Measured:
    """All runs of a candidate.

    Attributes:
        seconds_per_pair: of each way, the wall time of the pairs' loop divided by the number of pairs, run by run.
        details: of each way, what its processes said, run by run.
        error_px: of the disparity; see `accuracy.errors_px`.
        fault: why it could not be run.
    """

    seconds_per_pair: dict[Way, list[float]] = field(default_factory=dict)
    details: dict[Way, list[list[dict[str, Any]]]] = field(default_factory=dict)
    error_px: dict[str, float] = field(default_factory=dict)
    fault: str = ""

    def seconds(self, way: Way) -> float:
        """Median over the runs of one way."""
        return median(self.seconds_per_pair[way])

    def best(self, *, processes: int | None = None) -> Way:
        """Return the fastest way, of all or of those with so many processes."""
        ways = [way for way in self.seconds_per_pair if processes in (None, way.processes)]
        return min(ways, key=self.seconds)


class PeerError(Exception):
    """A peer that could not be run."""


def main() -> None:
    """Set up environments, or measure and print."""
    options = _parse()
    options.work.mkdir(parents=True, exist_ok=True)
    if options.setup:
        for peer in options.setup:
            set_up(peer, options.work)
        return
    meshes, source = _meshes(options.meshes)
    scene = make_scene(options.work / "scene", meshes, options.frames)
    triangles = float(np.mean([len(scene.models[number].triangles) for number in scene.model.ravel()]))
    print(f"Meshes: {source}, {triangles:.0f} triangles per instance", file=sys.stderr)
    candidates = [
        candidate
        for candidate in CANDIDATES
        if candidate.peer in (options.peers or (OURS, *PACKAGES, SYSTEM_BLENDER))
        and (options.peers or _is_there(candidate.peer, options.work))
        and (not options.variants or candidate.variant in options.variants or candidate == REFERENCE)
    ]
    measured = measure(candidates, scene, options.work, options.rounds)
    if measured[REFERENCE].fault:
        sys.exit(f"nothing to compare with: {REFERENCE.label} {measured[REFERENCE].fault}")
    cores = os.cpu_count() or 1
    print(table(measured, cores))
    if options.json:
        result = {
            "command": shlex.join(["python", "benchmarks/peers/run.py", *sys.argv[1:]]),
            "machine": machine_facts(),
            "scene": {
                "size_px": [scene.width_px, scene.height_px],
                "instances": scene.model.shape[1],
                "meshes": source,
                "triangles_per_instance": round(triangles),
                "frames": options.frames,
            },
            "rounds": options.rounds,
            "peers": [_as_json(candidate, found) for candidate, found in measured.items()],
        }
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def set_up(peer: str, work: Path) -> None:
    """Build a peer's virtual environment with the Python that runs this."""
    folder = work / f"venv-{peer}"
    print(f"Installing {', '.join(PACKAGES[peer])} into {folder}")
    venv.create(folder, with_pip=True, clear=True)
    pip = [str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet"]
    subprocess.run([*pip, *PACKAGES[peer], "isal"], check=True)


def measure(candidates: Sequence[Candidate], scene: PeerScene, work: Path, rounds: int) -> dict[Candidate, Measured]:
    """Run the candidates in turn, round after round, starting with another one each time.

    The first round tries every way to use the cores, the others one process and the best way with several.
    """
    frames, cores = len(scene.model), os.cpu_count() or 1
    several = [Way(cores, threads) for threads in (None, "0", "1")] if cores > 1 else []
    truth = cast_truth(scene, CHECKED_FRAMES)
    measured = {candidate: Measured() for candidate in candidates}
    for number in range(rounds):
        start = number % len(candidates)
        for candidate in [*candidates[start:], *candidates[:start]]:
            found = measured[candidate]
            if found.fault:
                continue
            best = [found.best(processes=cores)] if several and number > 0 else []
            ways = [Way(1), *(best or several)]
            # The same number for each process, and no less than are checked.
            rows = max(frames // candidate.frames_divisor // cores, -(-len(CHECKED_FRAMES) // cores))
            drawn = range(rows * cores)
            for way in ways:
                try:
                    seconds, details = run_together(candidate, way, scene.folder, drawn, work)
                    if not found.error_px:
                        found.error_px = errors_px(work / "out" / candidate.name, truth)
                except PeerError as error:
                    found.fault = str(error)
                    print(f"{candidate.name}: {error}", file=sys.stderr)
                    break
                found.seconds_per_pair.setdefault(way, []).append(seconds)
                found.details.setdefault(way, []).append(details)
                print(f"round {number + 1}: {candidate.name}, {way}: {seconds:.3f} s per pair", file=sys.stderr)
    return measured


def run_together(
    candidate: Candidate, way: Way, scene: Path, frames: Sequence[int], work: Path
) -> tuple[float, list[dict[str, Any]]]:
    """Run a candidate's processes at the same time, each on its share of the frames.

    Returns:
        Seconds per pair from their common start to the last one's end, without start and first pair, and what each
        process measured.
    """
    out = work / "out" / candidate.name
    shutil.rmtree(out, ignore_errors=True)
    environment = dict(os.environ)
    environment.pop("LP_NUM_THREADS", None)
    if way.threads is not None:
        environment["LP_NUM_THREADS"] = way.threads
    environment["PEER_PACKAGES"] = str(next(iter((work / "venv-blender").glob("lib/*/site-packages")), ""))
    log = work / f"{candidate.name}.log"
    processes = []
    started = time.perf_counter()
    with log.open("w") as errors:
        for number in range(way.processes):
            own_frames = ",".join(str(frame) for frame in frames[number :: way.processes])
            command = [*_command(candidate, work, number), "--scene", str(scene), "--out", str(out)]
            command += ["--frames", own_frames, "--variant", candidate.variant]
            command += ["--our-encoders"] if candidate.our_encoders else []
            processes.append(
                subprocess.Popen(
                    command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
                )
            )
        # A thread for each process reads what it says, so that none waits for a full pipe.
        try:
            with ThreadPoolExecutor(len(processes)) as readers:
                list(readers.map(lambda process: _line_with("READY", process, log), processes))
                ready = time.perf_counter()
                for process in processes:
                    process.stdin.write("\n")
                    process.stdin.flush()
                details = list(readers.map(lambda process: json.loads(_line_with("DONE", process, log)), processes))
                seconds = time.perf_counter() - ready
        finally:
            for process in processes:
                process.communicate()
    for detail in details:
        detail["start_s"] = ready - started - detail["first_frame_s"]
    return seconds / len(frames), details


def table(measured: dict[Candidate, Measured], cores: int) -> str:
    """Put all in a Markdown table, and below it how far the best peers are behind."""
    reference = measured[REFERENCE].seconds(measured[REFERENCE].best())
    columns = ["renderer", "files written by", "s per pair, 1 process", f"{cores} processes", "best, x ours"]
    columns += ["error median, px", "99.9 %", "worst"]
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    ratios: dict[bool, dict[str, float]] = {False: {}, True: {}}
    for candidate, found in measured.items():
        encoders = "us" if candidate.our_encoders or candidate.peer == OURS else "itself"
        if found.fault:
            lines.append(f"| {candidate.label} | {encoders} | could not be run | | | | | |")
            continue
        ratio = found.seconds(found.best()) / reference
        if candidate.peer != OURS:
            ratios[candidate.our_encoders][candidate.label] = ratio
        error = " | ".join(f"{found.error_px[key]:.1e}" for key in ("median", "p99_9", "worst"))
        several = f"{found.seconds(found.best(processes=cores)):.3f}"
        lines.append(
            f"| {candidate.label} | {encoders} | {found.seconds(Way(1)):.3f} | {several} | {ratio:.2f} | {error} |"
        )
    lines.append("")
    for our_encoders, title in ((False, "as a user would run it"), (True, "given our encoders")):
        if ratios[our_encoders]:
            label = min(ratios[our_encoders], key=ratios[our_encoders].__getitem__)
            lines.append(f"Best peer {title}: {label}, {ratios[our_encoders][label]:.2f} times our time.")
    versions = {
        candidate.peer: f"{candidate.peer} {found.details[Way(1)][0][0]['version']}"
        for candidate, found in measured.items()
        if found.details
    }
    return "\n".join([*lines, f"Versions: {'; '.join(versions.values())}."])


def _parse() -> argparse.Namespace:
    def names(text: str) -> list[str]:
        return text.split(",")

    cores = os.cpu_count() or 1
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--setup", type=names, metavar="PEERS", help=f"build environments: {','.join(PACKAGES)}")
    parser.add_argument("--peers", type=names, help="which to measure beside ours; all that are set up if left out")
    parser.add_argument("--variants", type=names, help="only these ways of drawing, and our plain one")
    parser.add_argument(
        "--frames", type=int, default=max(12, 2 * cores), help="pairs of a run, shared evenly by its processes"
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--meshes", type=Path, help="an .npz of meshes; see scene.py")
    parser.add_argument("--work", type=Path, default=HERE / "made", help="folder of environments, scene and output")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    options.work = options.work.resolve()
    unknown = set(options.setup or ()) - set(PACKAGES)
    unknown |= set(options.peers or ()) - {OURS, SYSTEM_BLENDER, *PACKAGES}
    if unknown:
        parser.error(f"unknown peers: {', '.join(sorted(unknown))}")
    if options.peers:
        options.peers.append(OURS)
    least = max(cores, len(CHECKED_FRAMES))
    if options.frames < least:
        parser.error(f"--frames: at least {least}, one for each core and those whose disparity is checked")
    return options


def _meshes(path: Path | None) -> tuple[dict, str]:
    if path is None and SHARED_MESHES.is_file():
        path = SHARED_MESHES
    if path is not None:
        return read_meshes(path), path.name
    return library_meshes(), "the project's own models"


def _is_there(peer: str, work: Path) -> bool:
    if peer == SYSTEM_BLENDER:
        return bool(shutil.which("blender") and shutil.which("xvfb-run"))
    return peer == OURS or (work / f"venv-{peer}").is_dir()


def _command(candidate: Candidate, work: Path, number: int) -> list[str]:
    """Say how a candidate's process is started."""
    if candidate.peer == SYSTEM_BLENDER:
        # Its own range of display numbers for each process: xvfb-run does not look for free ones safely.
        display = ["xvfb-run", "--auto-servernum", "--server-num", str(100 + 20 * number)]
        blender = ["blender", "--background", "--factory-startup", "--python-exit-code", "1"]
        return [*display, *blender, "--python", str(HERE / "peer_blender.py"), "--"]
    python = sys.executable if candidate.peer == OURS else str(work / f"venv-{candidate.peer}" / "bin" / "python")
    return [python, str(HERE / f"peer_{candidate.peer}.py")]


def _line_with(mark: str, process: subprocess.Popen[str], log: Path) -> str:
    """Read up to the line that starts with ``mark`` and return the rest of it; peers may print other things."""
    for line in process.stdout:
        if line.startswith(mark):
            return line.removeprefix(mark)
    raise PeerError(f"ended without saying {mark}: see {log}")


def _as_json(candidate: Candidate, found: Measured) -> dict[str, Any]:
    return {
        "peer": candidate.label,
        "our_encoders": candidate.our_encoders or candidate.peer == OURS,
        "fault": found.fault,
        "error_px": found.error_px,
        "ways": [
            {
                "processes": way.processes,
                "lp_num_threads": way.threads,
                "seconds_per_pair": {"median": found.seconds(way), "runs": runs},
                "runs": found.details[way],
            }
            for way, runs in found.seconds_per_pair.items()
        ],
    }


if __name__ == "__main__":
    main()
