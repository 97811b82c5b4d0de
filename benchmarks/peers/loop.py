"""The loop that every compared renderer runs: render and write pairs of the scene, and time it.

A renderer's script passes `run` a function that opens the renderer. The process renders its first pair, prints READY,
and waits for a line on standard input, so that several processes start at the same time. Then it renders its pairs, and
prints DONE with its measurements.
"""

import argparse
import io
import json
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from scene import PeerScene, load_scene

# The encoders of semisynth_gl need numpy, isal and Pillow: see `ENCODER_PACKAGES` in run.py.
sys.path.append(str(Path(__file__).resolve().parents[2]))


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a renderer's process.

    Attributes:
        scene: the scene's folder.
        out: folder for the pairs' folders.
        frames: numbers of the frames that this process renders.
        variant: one of the variants that the renderer's script lists.
        our_encoders: whether to write with semisynth_gl's encoders instead of the renderer's usual ones.
    """

    scene: Path
    out: Path
    frames: list[int]
    variant: str
    our_encoders: bool


class Peer(Protocol):
    """A renderer with the scene's models and patches loaded."""

    @property
    def version(self) -> str:
        """Its version, and the device on which it renders; called after rendering."""

    def write_pair(self, frame: int, folder: Path) -> None:
        """Render a frame; write both images and the left disparity into an existing folder."""


def write_arrays(
    folder: Path, left: np.ndarray, right: np.ndarray, disparity: np.ndarray, *, our_encoders: bool
) -> None:
    """Write a pair from arrays: images by Pillow at its fastest level, or by our encoders.

    Args:
        folder: an existing folder.
        left: (H, W, 3) uint8.
        right: (H, W, 3) uint8.
        disparity: (H, W) float32.
        our_encoders: see `Options`.
    """
    # These modules are found only with the path above.
    from semisynth_gl.codecs.pfm import PFM  # noqa: PLC0415
    from semisynth_gl.codecs.png import RGB8  # noqa: PLC0415

    encode = RGB8.encode if our_encoders else _pillow_png
    (folder / "left.png").write_bytes(encode(left))
    (folder / "right.png").write_bytes(encode(right))
    (folder / "disp.pfm").write_bytes(PFM.encode(disparity))


def run(open_peer: Callable[[PeerScene, Options], Peer]) -> None:
    """Run the loop with the options of the command line."""
    options = _parse()
    peer = open_peer(load_scene(options.scene), options)
    first_frame_s = _timed(peer, options.frames[0], options.out)
    print("READY", flush=True)
    sys.stdin.readline()
    cpu_s = time.process_time()
    frame_s = [_timed(peer, frame, options.out) for frame in options.frames]
    cpu_s = time.process_time() - cpu_s
    measured = {
        "version": peer.version,
        "first_frame_s": first_frame_s,
        "frame_s": frame_s,
        "cpu_s_per_pair": cpu_s / len(frame_s),
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
    }
    print("\nDONE " + json.dumps(measured), flush=True)


def _parse() -> Options:
    parser = argparse.ArgumentParser(description="Draw pairs of a scene; benchmarks/peers/run.py starts this.")
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--frames", required=True, help="numbers, with commas")
    parser.add_argument("--variant", required=True)
    parser.add_argument("--our-encoders", action="store_true")
    given = parser.parse_args()
    frames = [int(number) for number in given.frames.split(",")]
    return Options(given.scene, given.out, frames, given.variant, given.our_encoders)


def _timed(peer: Peer, frame: int, out: Path) -> float:
    start = time.perf_counter()
    folder = out / f"{frame:06d}"
    folder.mkdir(parents=True, exist_ok=True)
    peer.write_pair(frame, folder)
    return time.perf_counter() - start


def _pillow_png(image: np.ndarray) -> bytes:
    from PIL import Image  # noqa: PLC0415 - Blender the program may lack it

    data = io.BytesIO()
    Image.fromarray(image).save(data, "PNG", compress_level=1)
    return data.getvalue()
