"""The loop that every peer runs: draw and write pair after pair of the scene, and time it.

A peer's script hands `run` a function that opens the peer. The process warms up on its first pair, says READY, waits
for a line on its standard input, so that several processes can start at the same time, draws its pairs and says DONE
with what it measured.
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
    """Options of a peer's process.

    Attributes:
        scene: the scene's folder.
        out: where the pairs' folders go.
        frames: which frames this process draws.
        variant: the peer's variant of drawing; the peer's script lists them.
        our_encoders: write with the encoders of semisynth_gl instead of the peer's usual ones.
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
        """Its version and the device it draws on; asked for at the end."""

    def write_pair(self, frame: int, folder: Path) -> None:
        """Draw one frame and write left and right image and the left disparity into an existing folder."""


def write_arrays(
    folder: Path, left: np.ndarray, right: np.ndarray, disparity: np.ndarray, *, our_encoders: bool
) -> None:
    """Write a pair that a peer has as arrays: the images as Pillow does at its fastest level, or as ours.

    Args:
        folder: where to.
        left: (H, W, 3) uint8.
        right: (H, W, 3) uint8.
        disparity: (H, W) float32.
        our_encoders: see `Options`.
    """
    # Found once the path above is set.
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
