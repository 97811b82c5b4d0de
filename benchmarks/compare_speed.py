"""Speed of two checkouts of this project, in alternating turns.

    python benchmarks/compare_speed.py ../before . --turns 12

Both checkouts run with the Python that runs this script, each with itself first on PYTHONPATH. They draw

- the peers' scene (benchmarks/peers: 1500 x 1000 px, about 60,000 triangles) through their own peer_semisynth_gl.py.
  In a turn, both processes open and draw a first pair, then one after the other draws and writes the pairs of the turn.
- pairs of `middlebury` through `semisynth-gl generate --engine serial`. The time is that between the writing of the
  first pair's and of the last pair's left image, so that start and first pair do not count.

The checkout that begins changes from turn to turn. For each of the two, the script prints the median over the turns of
the second checkout's time divided by the first one's in the same turn, the range of the middle 90 % of the turns, and a
90 % confidence interval of the median (bootstrap over the turns). It uses no more of a checkout than these two programs
and the maker of the peers' scene, so that versions with another API can be compared. Let the machine do nothing else
meanwhile.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

MAKE_SCENE = """
import sys
sys.path.insert(0, "benchmarks/peers")
from pathlib import Path
from scene import library_meshes, make_scene
make_scene(Path(sys.argv[1]), library_meshes(), int(sys.argv[2]))
"""
WHERE = "import semisynth_gl; print(semisynth_gl.__file__)"
_RESAMPLES = 10_000


class Checkout:
    """A folder that holds the project.

    Args:
        folder: the checkout.
        work: folder for the checkout's cache and output.

    Raises:
        SystemExit: where Python does not import the project from the folder.
    """

    def __init__(self, folder: Path, work: Path) -> None:
        self.folder, self.work = folder.resolve(), work
        self._environment = os.environ | {
            "PYTHONPATH": str(self.folder),
            "SEMISYNTH_GL_CACHE": str(work / "cache"),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        imported = self._run("-c", WHERE).strip()
        if not Path(imported).is_relative_to(self.folder):
            raise SystemExit(f"{self.folder}: expected the project there, but Python imports {imported}")

    def make_scene(self, folder: Path, frames: int) -> None:
        """Write the peers' scene."""
        self._run("-c", MAKE_SCENE, str(folder), str(frames))

    def open_peer(self, scene: Path, frames: int, variant: str) -> subprocess.Popen[str]:
        """Start a process that has drawn a first pair and waits for a line on its standard input."""
        arguments = ["--scene", str(scene), "--out", str(self.work / "peer"), "--variant", variant]
        arguments += ["--frames", ",".join(map(str, range(frames)))]
        process = self.start(str(self.folder / "benchmarks" / "peers" / "peer_semisynth_gl.py"), *arguments)
        line_with("READY", process)
        return process

    def start(self, *arguments: str, **environment: str) -> subprocess.Popen[str]:
        """Start Python on the checkout, with pipes to talk through and more variables of the environment."""
        pipe, variables = subprocess.PIPE, self._environment | environment
        command = [sys.executable, *arguments]
        return subprocess.Popen(command, cwd=self.folder, env=variables, stdin=pipe, stdout=pipe, text=True)

    def generate_s(self, pairs: int) -> float:
        """Make a dataset with one pair more than asked for, and return the seconds without the first pair."""
        out = self.work / "middlebury"
        shutil.rmtree(out, ignore_errors=True)
        arguments = ("generate", "--config", "middlebury", "--pairs", str(pairs + 1), "--out", str(out))
        self._run("-m", "semisynth_gl", *arguments, "--engine", "serial")
        written = sorted(path.stat().st_mtime for path in out.rglob("im0.png"))
        if len(written) != pairs + 1:
            raise SystemExit(f"{self.folder}: expected {pairs + 1} left images in {out}, got {len(written)}")
        return written[-1] - written[0]

    def _run(self, *arguments: str) -> str:
        result = subprocess.run(
            [sys.executable, *arguments], cwd=self.folder, env=self._environment, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        if result.returncode:
            raise SystemExit(f"{self.folder}: {arguments} ended with {result.returncode}:\n{result.stderr}")
        return result.stdout


def peer_turn(checkouts: Sequence[Checkout], scene: Path, frames: int, variant: str) -> list[float]:
    """Let each checkout draw and write the peers' scene; return the seconds per pair of each."""
    processes = [checkout.open_peer(scene, frames, variant) for checkout in checkouts]
    seconds = []
    for process in processes:
        say("", process)
        seconds.append(float(np.sum(json.loads(line_with("DONE", process))["frame_s"])) / frames)
        process.communicate()
    return seconds


def ratios(
    checkouts: Sequence[Checkout], turns: int, measure: Callable[[Sequence[Checkout]], list[float]], title: str
) -> np.ndarray:
    """Take turns and return (turns,) float64 ratios of the second checkout's seconds to the first one's."""
    result = np.zeros(turns)
    for turn in range(turns):
        step = 1 if turn % 2 == 0 else -1
        first, second = measure(checkouts[::step])[::step]
        result[turn] = second / first
        print(f"{title}, turn {turn + 1}: {first:.3f} s, {second:.3f} s, ratio {second / first:.3f}", file=sys.stderr)
    return result


def summary(own: np.ndarray) -> str:
    """Describe ratios by their median, the middle 90 % and a 90 % confidence interval of the median."""
    low, high = np.quantile(own, [0.05, 0.95])
    median, least, most = median_interval(own)
    return (
        f"median ratio {median:.3f} ({least:.3f} to {most:.3f} with 90 % confidence), "
        f"90 % of {len(own)} turns {low:.3f} to {high:.3f}"
    )


def median_interval(own: np.ndarray) -> tuple[float, float, float]:
    """Return the median of ratios, and its 90 % confidence interval: bootstrap over the turns."""
    resamples = np.random.default_rng(0).choice(own, (_RESAMPLES, len(own)))
    least, most = np.quantile(np.median(resamples, axis=1), [0.05, 0.95])
    return float(np.median(own)), float(least), float(most)


def say(line: str, process: subprocess.Popen[str]) -> None:
    """Send a line to a process."""
    process.stdin.write(f"{line}\n")
    process.stdin.flush()


def line_with(mark: str, process: subprocess.Popen[str]) -> str:
    """Read up to the line that begins with ``mark``, and return the rest of that line."""
    for line in process.stdout:
        if line.startswith(mark):
            return line.removeprefix(mark)
    raise SystemExit(f"{process.args} ended without saying {mark}")


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before", type=Path, help="the checkout whose time is 1")
    parser.add_argument("after", type=Path, help="the checkout that is compared with it")
    parser.add_argument("--turns", type=int, default=12, help="turns of the peers' scene")
    parser.add_argument("--frames", type=int, default=12, help="pairs of the peers' scene in a turn")
    parser.add_argument("--variant", choices=["none", "all"], default="all", help="see peer_semisynth_gl.py")
    parser.add_argument("--middlebury-turns", type=int, default=6, help="0 leaves middlebury out")
    parser.add_argument("--middlebury-pairs", type=int, default=24, help="pairs of middlebury in a turn")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        checkouts = [Checkout(options.before, work / "before"), Checkout(options.after, work / "after")]
        if options.turns:
            checkouts[0].make_scene(work / "scene", options.frames)
            own = ratios(
                checkouts,
                options.turns,
                lambda ordered: peer_turn(ordered, work / "scene", options.frames, options.variant),
                "peers' scene",
            )
            print(f"peers' scene, {options.frames} pairs a turn: {summary(own)}")
        if options.middlebury_turns:
            own = ratios(
                checkouts,
                options.middlebury_turns,
                lambda ordered: [checkout.generate_s(options.middlebury_pairs) for checkout in ordered],
                "middlebury",
            )
            print(f"middlebury, {options.middlebury_pairs} pairs a turn: {summary(own)}")


if __name__ == "__main__":
    main()
