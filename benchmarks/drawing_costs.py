"""What drawing a pair costs in vertices, depth tests, hidden fragments, textures, clears and reading back.

    python benchmarks/drawing_costs.py --turns 5 --json costs.json

All figures are user and system milliseconds of this process a pair, which draws in its own thread (llvmpipe without
threads of its own), each finished before the clock stops: of each scene the least of the turns, and of all scenes the
mean. Parts are differences of drawings into the same framebuffers, everything drawn and nothing left out as hidden:

- of one pixel alone (vertices: placing, clipping, culling),
- once more over what was drawn, where every fragment fails the depth test (triangles),
- once more with a depth test of EQUAL, so that what is seen is shaded again and nothing else, without a look at the
  patches and with it (what is written, patches),
- as it is, from a cleared framebuffer (fragments that something nearer hides later).

Order and state of caches differ between them: parts under a tenth of the whole are rough. "Shaded" counts
fragments that pass the depth test, divided by the pixels of the image.
"""

import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

os.environ.setdefault("LP_NUM_THREADS", "0")  # before OpenGL: the driver draws in this thread

import click
import numpy as np

from semisynth_gl.bench.scenes import sample_scenes
from semisynth_gl.config import load_config
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.render import programs
from semisynth_gl.render.model_buffers import Filled
from semisynth_gl.render.pair_targets import DrawnPair, PairTargets
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import Scene

MANY_TRIANGLES = 150_000
LOOK, NO_LOOK = "colour = patch_colour();", "colour = vec4(patch_coordinate, 0.0, 1.0);"
PARTS: Mapping[str, Sequence[tuple[str, int]]] = {
    "placing and uploading instances": [("place", 1)],
    "clears": [("clear", 1)],
    "vertices": [("one pixel", 1)],
    "triangles: set up, rasterised, depth tested": [("all fail", 1), ("one pixel", -1)],
    "writing what is seen": [("seen without patches", 1), ("all fail", -1)],
    "patches of what is seen": [("seen", 1), ("seen without patches", -1)],
    "shading what is hidden later": [("everything", 1), ("seen", -1)],
    "reading back colour and disparity": [("read", 1)],
    "drawing everything, without reading back": [("place", 1), ("clear", 1), ("everything", 1)],
    "drawing as it is, without reading back": [("draw", 1)],
}
"""Each part by the drawings that it is the sum or difference of."""


class Parts:
    """Draws scenes part by part.

    Args:
        renderer: makes both disparities and masks.
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer, self._drawing, self._loaded = renderer, renderer._drawing, renderer._loaded
        self._gl, self._placing = renderer._gl, renderer._placing
        with self._gl, patch.object(programs, "shader_source", _without_patches(programs.shader_source)):
            names = {name.upper(): number for number, name in enumerate(self._loaded.wanted.attachments("left"))}
            bare = programs.link_meshes(renderer._context, names)
            self._samples = self._gl.query(samples=True)
        self._bare = [bare] * len(self._loaded.anisotropies)

    def seconds(self, scene: Scene) -> dict[str, float]:
        """Return the CPU seconds of each drawing of both eyes, and how often a pixel is shaded."""
        total = defaultdict(float)
        with self._gl:
            sized = self._renderer._sized(scene, shared=False)
            for eye in EYES:
                self._draw_eye(scene, eye, sized)
                for name, work in self._works(scene, eye, sized):
                    self._gl.finish()
                    start = time.process_time()
                    work()
                    self._gl.finish()
                    total[name] += time.process_time() - start
                total["shaded"] += self._samples.samples / (2 * scene.camera.width_px * scene.camera.height_px)
        return dict(total)

    def _works(self, scene: Scene, eye: Eye, sized: PairTargets) -> Iterator[tuple[str, Callable[[], Any]]]:
        models, targets = self._loaded.models, sized.eyes[eye]
        placed = self._placing.place(scene)
        yield "draw", lambda: self._draw_eye(scene, eye, sized)
        yield "read", lambda: [targets.read(name) for name in ("colour", "disparity")]
        yield "place", lambda: models.fill(self._placing.place(scene), eye)
        filled = models.fill(placed, eye)
        programs_of_eye = self._drawing._programs(targets.names)
        yield "clear", targets.clear
        with self._samples:
            self._draw(filled, programs_of_eye, ">")
        targets.clear()
        yield "everything", lambda: self._draw(filled, programs_of_eye, ">")
        yield "all fail", lambda: self._draw(filled, programs_of_eye, ">")
        yield "seen", lambda: self._draw(filled, programs_of_eye, "==")
        yield "seen without patches", lambda: self._draw(filled, self._bare, "==")
        targets.framebuffer.scissor = 0, 0, 1, 1
        targets.framebuffer.use()
        yield "one pixel", lambda: self._draw(filled, programs_of_eye, ">")
        targets.limit(None)

    def _draw_eye(self, scene: Scene, eye: Eye, sized: PairTargets) -> None:
        pair = DrawnPair(self._placing.place(scene), None, sized, sized.eyes, {eye: {} for eye in EYES})
        self._drawing._draw(pair, eye, None)

    def _draw(self, filled: Sequence[Filled], own: Sequence[Any], test: str) -> None:
        self._gl.enable_only(self._gl.DEPTH_TEST)
        self._gl.depth_func = test
        for part in filled:
            self._loaded.patches.use(part.atlas)
            self._loaded.models.draw(own[part.atlas], part)


def _without_patches(shader_source: Callable[..., str]) -> Callable[..., str]:
    def source(name: str, defines: Mapping[str, int] | None = None) -> str:
        text = shader_source(name, defines)
        if name == "mesh.frag" and LOOK not in text:
            raise SystemExit(f"{name}: expected the line {LOOK}")
        return text.replace(LOOK, NO_LOOK)

    return source


def of_config(name: str, pairs: int) -> tuple[Renderer, dict[str, list[Scene]]]:
    """Open a renderer for a config, and sort the scenes of its first pairs by their triangles."""
    bench = sample_scenes(load_config(name), 0, pairs)
    renderer = bench.open_renderer("auto", outputs=("visibility",))
    triangles = np.array([len(mesh.triangles) for mesh in bench.models])
    kinds: dict[str, list[Scene]] = defaultdict(list)
    for scene in bench.scenes:
        many = triangles[scene.model].sum() > MANY_TRIANGLES
        kinds[f"{name}, {'clutter' if many else 'rooms and still lifes'}"].append(scene)
    return renderer, kinds


def of_peers(frames: int) -> tuple[Renderer, dict[str, list[Scene]]]:
    """Open a renderer for the scene of benchmarks/peers."""
    sys.path.insert(0, str(Path(__file__).parent / "peers"))
    from loop import Options  # noqa: PLC0415 - beside the peers
    from peer_semisynth_gl import SemisynthGl, own_scene  # noqa: PLC0415
    from scene import library_meshes, load_scene, make_scene  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder:
        make_scene(Path(folder), library_meshes(), frames)
        peer = load_scene(Path(folder))
        options = Options(Path(folder), Path(folder), [], "all", our_encoders=True)
        renderer = SemisynthGl(peer, options)._renderer
    return renderer, {"peers' scene": [own_scene(peer, frame) for frame in range(frames)]}


def table(results: Mapping[str, Mapping[str, float]]) -> str:
    """Lay the costs of kinds of scenes out in Markdown."""
    rows = [("ms a pair", list(results)), ("---", ["---:"] * len(results))]
    rows += [(part, [f"{costs[part]:.0f}" for costs in results.values()]) for part in PARTS]
    rows.append(("shaded, times a pixel", [f"{costs['shaded']:.2f}" for costs in results.values()]))
    return "\n".join(f"| {name} | {' | '.join(cells)} |" for name, cells in rows)


@click.command()
@click.option("--config", default="middlebury", show_default=True)
@click.option("--pairs", default=12, show_default=True, help="Scenes of the config.")
@click.option("--frames", default=4, show_default=True, help="Frames of the peers' scene.")
@click.option("--turns", default=5, show_default=True)
@click.option("--json", "file", type=click.Path(path_type=Path), help="Write the figures there, too.")
def main(config: str, pairs: int, frames: int, turns: int, file: Path | None) -> None:
    """Measure and print."""
    results: dict[str, dict[str, float]] = {}
    for renderer, kinds in (of_config(config, pairs), of_peers(frames)):
        parts = Parts(renderer)
        parts.seconds(next(iter(kinds.values()))[0])
        for kind, scenes in kinds.items():
            seconds = [[parts.seconds(scene) for scene in scenes] for _ in range(turns)]
            least = {
                name: float(np.mean([min(turn[number][name] for turn in seconds) for number in range(len(scenes))]))
                for name in seconds[0][0]
            }
            of_part = {part: 1e3 * sum(sign * least[name] for name, sign in names) for part, names in PARTS.items()}
            results[kind] = {"scenes": len(scenes)} | of_part | {"shaded": least["shaded"]}
            click.echo(f"{kind}: {len(scenes)} scenes", err=True)
        renderer.release()
    click.echo(table(results))
    if file is not None:
        file.write_text(json.dumps({"turns": turns, "costs": results}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
