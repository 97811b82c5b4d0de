"""Pairs per second: rendered by a StereoStream, or read from WebDataset shards of the same pairs.

    python benchmarks/stream.py --out benchmarks/results/stream.json

Ways take turns, each in worker processes of its own, and a ratio is of two ways in one round. Files are read from the
system's cache. What counts is the time from when every worker has sent its first pair until the last one.
"""

import json
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
import torch
import webdataset
from torch.utils.data import DataLoader

from semisynth_gl.bench.summary import machine_facts
from semisynth_gl.config import Config, load_config
from semisynth_gl.dataset.engines import LocalEngine, cores
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import read_index, read_record
from semisynth_gl.listener import Listener
from semisynth_gl.render.backends import is_software
from semisynth_gl.torch import Selection, StereoStream

_CROP = 256, 512
_TIMEOUT_S = 300.0
_SHARDS_EACH = 2
# Reading is so much faster that more pairs are needed for as steady a figure; they are the same ones again.
_READINGS = 4


@dataclass(frozen=True, slots=True)
class Way:
    """A way to get pairs.

    Attributes:
        source: "stream", "stream, not checked" or "shards".
        crop: whether crops, instead of whole pairs.
        workers: processes of the loader.
    """

    source: str
    crop: bool
    workers: int


def _cropped(sample: dict[str, Any]) -> dict[str, Any]:
    """Crop tensors at a random place."""
    height, width = sample["left"].shape[-2:]
    y = int(torch.randint(height - _CROP[0] + 1, ()))
    x = int(torch.randint(width - _CROP[1] + 1, ()))
    return {
        name: value[..., y : y + _CROP[0], x : x + _CROP[1]].contiguous() if isinstance(value, torch.Tensor) else value
        for name, value in sample.items()
    }


def _decoded(sample: dict[str, Any], *, crop: bool) -> dict[str, Any]:
    """Make the stream's sample of the bytes in a tar."""
    facts = json.loads(sample["json"])
    camera = facts["camera"]
    made: dict[str, Any] = {"index": facts["pair"], "camera": {name: float(camera[name]) for name in camera}}
    for role, ending in (("left", "left.png"), ("right", "right.png")):
        image = cv2.imdecode(np.frombuffer(sample[ending], np.uint8), cv2.IMREAD_COLOR_RGB)
        made[role] = torch.from_numpy(image).permute(2, 0, 1).contiguous()
    for number, eye in enumerate(("left", "right")):
        for role, ending in (("disparity", f"disp{number}.pfm"), ("visibility", f"mask{number}.png")):
            array = cv2.imdecode(np.frombuffer(sample[ending], np.uint8), cv2.IMREAD_UNCHANGED)
            made[f"{role}_{eye}"] = torch.from_numpy(array)
    return _cropped(made) if crop else made


def _pairs_of(way: Way, config: Config, seed: int, tars: list[str], pairs: int) -> Iterable[dict[str, Any]]:
    """Yield what a way gives, in worker processes."""
    if way.source == "shards":
        dataset: Any = webdataset.WebDataset(tars, shardshuffle=False, nodesplitter=None)
        dataset = dataset.map(partial(_decoded, crop=way.crop)).repeat(_READINGS)
    else:
        dataset = StereoStream(
            config, seed, Selection(pairs=pairs), crop=_CROP if way.crop else None, checked=way.source == "stream"
        )  # fmt: skip
    # Forked processes start sooner; this one never opens OpenGL.
    return DataLoader(
        dataset, batch_size=1, num_workers=way.workers, multiprocessing_context="fork", timeout=_TIMEOUT_S
    )  # fmt: skip


def _rate(way: Way, samples: Iterable[dict[str, Any]]) -> float:
    """Pairs per second from when every worker has sent its first pair."""
    start, count, last = 0.0, 0, 0.0
    for sample in samples:
        if not sample["disparity_left"].isfinite().any():
            raise ValueError(f"pair {sample['index']} shows nothing")
        count += 1
        last = time.perf_counter()
        if count == way.workers:
            start = last
    return (count - way.workers) / (last - start)


def measure(config: Config, seed: int, pairs: int, rounds: int, listener: Listener) -> dict[str, Any]:
    """Write the shards, then let all ways take their turns."""
    most = max(2, cores())
    # Those that are compared follow each other.
    ways = [
        Way(source, crop, workers)
        for crop in (False, True)
        for workers in (1, 2)
        for source in ("shards", "stream", "stream, not checked")
    ]
    with tempfile.TemporaryDirectory() as scratch:
        shard_pairs = -(-pairs // (_SHARDS_EACH * most))
        generate(
            config, scratch, pairs, seed, layout="webdataset", engine=LocalEngine(2),
            shard_pairs=shard_pairs,
        )  # fmt: skip
        tars = [str(path) for path in sorted(Path(scratch).rglob("*.tar"))]
        about = read_index(scratch)
        renderer = read_record(about.root, about.plan.shards[0], packed=True).renderers[0]
        megabytes = sum(Path(tar).stat().st_size for tar in tars) / pairs / 1e6
        rates: dict[Way, list[float]] = defaultdict(list)
        for number in range(rounds):
            first = number * len(ways) // rounds
            for way in ways[first:] + ways[:first]:
                rates[way].append(_rate(way, _pairs_of(way, config, seed, tars, pairs)))
                listener.on_message(f"round {number + 1}: {way}: {rates[way][-1]:.2f} pairs/s")
    rows = []
    for way in ways:
        read = np.array(rates[Way("shards", way.crop, way.workers)])
        rows.append(
            asdict(way)
            | {
                "pairs_per_second": float(np.median(rates[way])),
                "ratio_to_shards": float(np.median(np.array(rates[way]) / read)),
                "rounds": rates[way],
            }
        )
    camera = config.camera
    return {
        "config": config.name,
        "config_sha256": config.digest(),
        "seed": seed,
        "size_px": [camera.width_px, camera.height_px],
        "crop_px": [_CROP[1], _CROP[0]],
        "pairs": pairs,
        "megabytes_per_pair_in_shards": megabytes,
        "machine": machine_facts()
        | {
            "usable_cores": cores(),
            "renderer": renderer,
            "software": is_software(renderer),
            "torch": torch.__version__,
            "webdataset": webdataset.__version__,
            "opencv": cv2.__version__,
        },
        "rows": rows,
    }


class _Messages(Listener):
    """Shows messages."""

    def on_message(self, text: str) -> None:
        """Print the message to standard error."""
        click.echo(text, err=True)


@click.command()
@click.option("--config", "config_name", default="sceneflow", show_default=True, help="A name or a YAML file.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--pairs", type=click.IntRange(min=4), default=8, show_default=True, help="That each way gives.")
@click.option("--rounds", type=click.IntRange(min=1), default=3, show_default=True, help="Turns of each way.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write everything here as JSON.")
def main(config_name: str, seed: int, pairs: int, rounds: int, out: Path | None) -> None:
    """Measure and print."""
    report = measure(load_config(config_name), seed, pairs, rounds, _Messages())
    report["command"] = " ".join(["python", *sys.argv])
    for row in report["rows"]:
        what = "crops" if row["crop"] else "whole pairs"
        print(
            f"{row['source']:20} {what:12} {row['workers']} workers {row['pairs_per_second']:8.2f} pairs/s "
            f"{row['ratio_to_shards']:6.3f} x"
        )
    if out is not None:
        out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
