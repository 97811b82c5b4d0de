"""Pairs per second into memory: arrays of one process, tensors in shared memory, tensors on a GPU.

    python benchmarks/memory_rates.py --json memory-rates.json

*plain* pairs have the left disparity alone, *full* ones both disparities and both masks. What counts is the time from
when every process has made its first pair until the last pair. Each way is also compared with the files that `generate`
writes of the same pairs, value by value. What PyTorch is needed for is left out where it is not installed.
"""

import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.speed import headline
from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.config import Config, load_config
from semisynth_gl.dataset.engines import LocalEngine, cores
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.inputs.errors import SemisynthError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render.backends import is_software

try:
    import torch
    from torch.utils.data import DataLoader

    from semisynth_gl.torch import StereoStream
    from semisynth_gl.torch.stream import TensorDevice
except ImportError as fault:
    NO_TORCH: str | None = str(fault).splitlines()[0]
else:
    NO_TORCH = None

KINDS: Mapping[str, tuple[str, ...]] = {
    "plain": ("truth=left", "outputs=[]"),
    "full": ("truth=both", "outputs=[visibility]"),
}
# A stream on the GPU takes images as they were drawn.
SHARP = "imperfections={}"
_COMPARED = 4
_TIMEOUT_S = 300.0
_FAILED = 1

Arrays = Mapping[str, NDArray[Any]]
"""The arrays of a pair by role, images as (H, W, 3)."""


@dataclass(frozen=True, slots=True)
class Way:
    """A way into memory.

    Attributes:
        name: of the table.
        workers: processes that draw; 0 for this one.
        checked: whether pairs are checked and, where they fail, drawn again.
        device: of the tensors; None for arrays.
    """

    name: str
    workers: int
    checked: bool
    device: TensorDevice | None

    @contextmanager
    def pairs(self, config: Config, seed: int, count: int) -> Iterator[Iterator[tuple[int, Callable[[], Arrays]]]]:
        """Give an iterator over pairs in any order: the number of each, and what makes arrays of it."""
        if self.device is None:
            with PairRenderer(config, seed) as renderer:
                yield ((i, renderer.render(i, checked=self.checked).frame.arrays) for i in range(count))
            return
        stream = StereoStream(config, seed, count, checked=self.checked, device=self.device)
        # Forked processes have no OpenGL once this one has used it or CUDA.
        context, timeout = ("spawn", _TIMEOUT_S) if self.workers else (None, 0)
        loader = DataLoader(
            stream, batch_size=None, num_workers=self.workers, multiprocessing_context=context, timeout=timeout
        )
        yield ((sample["index"], partial(_arrays, sample)) for sample in loader)

    def rate(self, config: Config, seed: int, count: int) -> float:
        """Return pairs per second, from when every process has made its first."""
        first = max(1, self.workers)
        with self.pairs(config, seed, count + first) as made:
            for _ in range(first):
                next(made)
            self._finish()
            start = time.perf_counter()
            numbers = [number for number, _ in made]
            self._finish()
            seconds = time.perf_counter() - start
        if len(numbers) != count:
            raise RuntimeError(f"{self.name}: expected {count} pairs, got {len(numbers)}")
        return count / seconds

    def _finish(self) -> None:
        if self.device == "cuda":
            torch.cuda.synchronize()


def ways(processes: int) -> tuple[list[Way], dict[str, str]]:
    """Return the ways that this machine has, and why it has not the others."""
    found, left_out = [], {}
    for checked in (True, False):
        of = "checked" if checked else "not checked"
        found.append(Way(f"arrays of one process, {of}", 0, checked, None))
        if NO_TORCH is None:
            found.append(Way(f"tensors in shared memory, {of}", processes, checked, "cpu"))
    if NO_TORCH is not None:
        left_out = dict.fromkeys(("tensors in shared memory", "tensors on the GPU"), NO_TORCH)
    elif torch.cuda.is_available():
        found.append(Way("tensors on the GPU, not checked", 0, checked=False, device="cuda"))
    else:
        left_out["tensors on the GPU"] = f"PyTorch (for CUDA {torch.version.cuda}) sees no GPU"
    return found, left_out


def _arrays(sample: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Bring a sample's tensors back to arrays."""
    tensors = {name: value.cpu().numpy() for name, value in sample.items() if isinstance(value, torch.Tensor)}
    return {name: each.transpose(1, 2, 0) if each.ndim == 3 else each for name, each in tensors.items()}


def differences(found: Mapping[int, Arrays], files: Mapping[int, Arrays]) -> list[str]:
    """Name each array of each pair that is not, bit for bit, what the files have; a role that is missing too."""
    faults = []
    for number, expected in files.items():
        got = found.get(number, {})
        for role in sorted(expected.keys() | got.keys()):
            if role not in got or role not in expected:
                faults.append(f"pair {number}: {role} is only in {'memory' if role in got else 'the files'}")
            elif got[role].shape != expected[role].shape or not (got[role] == expected[role]).all():
                faults.append(f"pair {number}: {role} differs")
    return faults


def measure(
    config_name: str,
    settings: Sequence[str],
    seed: int,
    pairs: int,
    rounds: int,
    processes: int,
    save: Callable[[dict[str, Any]], None],
) -> dict[str, Any]:
    """Let all ways take their turns, and compare each with files; ``save`` gets the report after each round."""
    chosen, left_out = ways(processes)
    configs = {kind: load_config(config_name, (*settings, *keys, SHARP)) for kind, keys in KINDS.items()}
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    failed: dict[str, str] = {}
    for kind, config in configs.items():
        with tempfile.TemporaryDirectory() as scratch:
            generate(config, scratch, _COMPARED, seed, layout="middlebury", engine=LocalEngine(1))
            files = {number: frame.arrays() for number, frame in enumerate(open_dataset(scratch))}
        for way in chosen:
            row: dict[str, Any] = {"way": way.name, "kind": kind, "workers": way.workers, "rates": []}
            try:
                with way.pairs(config, seed, _COMPARED) as made:
                    row["differences"] = differences({number: arrays() for number, arrays in made}, files)
            except (SemisynthError, RuntimeError) as error:
                failed[f"{way.name}, {kind}"] = str(error)
            else:
                rows[way.name, kind] = row
    with PairRenderer(configs["plain"], seed) as renderer:
        facts = renderer.facts
    camera = configs["plain"].camera
    report: dict[str, Any] = {
        "command": " ".join(["python", *sys.argv]),
        "config": configs["plain"].name,
        "settings": list(settings),
        "size_px": [camera.width_px, camera.height_px],
        "seed": seed,
        "pairs": pairs,
        "machine": machine_facts() | facts | {"usable_cores": cores(), "software": is_software(facts["renderer"])},
        "left_out": left_out,
        "failed": failed,
    }
    for number in range(rounds):
        for way in chosen[number % len(chosen) :] + chosen[: number % len(chosen)]:
            for kind, config in configs.items():
                if (way.name, kind) in rows:
                    rows[way.name, kind]["rates"].append(way.rate(config, seed, pairs))
        # Time may be up before the last round.
        report["rows"] = [row | {"pairs_per_second": float(np.median(row["rates"]))} for row in rows.values()]
        save(report)
    return report


def table(report: Mapping[str, Any]) -> str:
    """Lay out the rates, and what is missing."""
    rows = [
        (row["way"], row["kind"], str(row["workers"] or 1), f"{row['pairs_per_second']:.1f}",
         "yes" if not row["differences"] else f"no: {len(row['differences'])} arrays differ")
        for row in report["rows"]
    ]  # fmt: skip
    parts = [markdown(("way", "pairs", "processes", "pairs/s", "values as in the files"), rows)]
    parts += [f"Left out: {name}: {why}." for name, why in report["left_out"].items()]
    parts += [f"Failed: {name}: {why}" for name, why in report["failed"].items()]
    return "\n\n".join(parts)


@click.command()
@click.option("--config", "config_name", default="middlebury", show_default=True, help="A name or a YAML file.")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="As for generate.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--pairs", type=click.IntRange(min=1), default=64, show_default=True, help="That each way makes a turn.")
@click.option("--rounds", type=click.IntRange(min=1), default=3, show_default=True, help="Turns of each way.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes of the loader.  [default: a core each]")
@click.option("--json", "out", type=click.Path(path_type=Path, dir_okay=False), help="Write everything here.")
def main(
    config_name: str,
    settings: tuple[str, ...],
    seed: int,
    pairs: int,
    rounds: int,
    workers: int | None,
    out: Path | None,
) -> None:
    """Measure and print; the exit code is 1 where a value differs or a way failed."""

    def save(report: dict[str, Any]) -> None:
        if out is not None:
            out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")

    report = measure(config_name, settings, seed, pairs, rounds, workers or cores(), save)
    print(f"{headline(report)}\n\n{table(report)}")
    if report["failed"] or any(row["differences"] for row in report["rows"]):
        sys.exit(_FAILED)


if __name__ == "__main__":
    main()
