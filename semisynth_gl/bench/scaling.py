"""What the drawing of a pair costs as one quantity grows: instances, triangles, pixels, samples, outputs."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.antialias import DEFAULT_MODE, MODES
from semisynth_gl.bench.scenes import BenchScenes
from semisynth_gl.bench.timing import alternated, compare_times
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.frame import DEFAULT_OUTPUTS, FLOW_OUTPUTS
from semisynth_gl.geometry.mesh import Mesh, without_degenerate
from semisynth_gl.geometry.surfaces import lathe
from semisynth_gl.geometry.topology import marked_solid
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.scene import Scene, make_scene

# Patches that are uploaded; more would change nothing but the time to open a renderer.
_LAYERS = 64
# Rings of the balls, from few triangles to many; see `ball`.
_RINGS = (4, 8, 16, 32, 64)
# Indices of rings: for many instances or pixels, and for many balls out of view.
_USUAL, _SMALL = 2, 1
# Area that all balls of a scene cover together, in images.
_COVERED = 0.8
_BALL_DEPTHS_M = (2.0, 6.0)
_WALL_M = 8.0
_INSTANCES = (10, 100, 1000)
_IN_VIEW, _OUTSIDE = 1000, (0, 1000, 10_000)
_BASE_INSTANCES = 100
_SIZES = (0.5, 1.0, 2.0)
# Options of a renderer by the row's name.
OUTPUT_OPTIONS: Mapping[str, dict[str, Any]] = {
    "left disparity": {"truth": "left", "outputs": ()},
    "both disparities": {"truth": "both", "outputs": ()},
    "both, both masks": {"truth": "both", "outputs": DEFAULT_OUTPUTS},
    "both, masks, instances, depth": {"truth": "both", "outputs": ("visibility", "instances", "depth")},
}
_USUAL_OUTPUTS = "both, both masks"
STRESS = (10_000, 5_000_000)
"""Instances and triangles, all in view."""


class _Case(NamedTuple):
    """Scenes, the mean number of their triangles in view, and a function that draws a scene."""

    scenes: Sequence[Scene]
    triangles: float
    draw: Callable[[Scene], object]

    def draw_all(self) -> None:
        for scene in self.scenes:
            self.draw(scene)

    def row(self, name: str, seconds_per_pair: float, ratio: float) -> dict[str, Any]:
        camera = self.scenes[0].camera
        return {
            "name": name,
            "instances": float(np.mean([len(scene) for scene in self.scenes])),
            "triangles": self.triangles,
            "pixels": camera.width_px * camera.height_px,
            "seconds_per_pair": seconds_per_pair,
            "ratio": ratio,
        }


def measure_scaling(bench: BenchScenes, seed: int, backend: Backend, repeats: int) -> dict[str, dict[str, Any]]:
    """Measure all quantities.

    Instances, triangles and pixels are varied in scenes of balls before a wall, which cover the same part of the image
    whatever their number; antialiasing and outputs in the config's scenes, whose first one has the usual image size.
    The seed decides where balls are. Each row takes its turn ``repeats`` times.

    Returns:
        By quantity: "text", "baseline" (a row's name), "left_out" (names with the driver's reason) and "rows". A row
        has the mean number of instances, the wall included, and of triangles in view, the pixels of an image, the
        median time to draw and read back both eyes, and the median "ratio" of that time to the baseline's.
    """
    layers = bench.layers[:_LAYERS]
    balls = [marked_solid(ball(rings)) for rings in _RINGS]
    size = bench.scenes[0].camera.width_px, bench.scenes[0].camera.height_px
    groups = {}
    with Renderer([FACE, *balls], layers, backend=backend) as renderer:
        place = partial(_case, renderer, balls, len(layers), seed)
        groups["instances"] = _group(
            f"balls of {len(balls[_USUAL].triangles)} triangles in view",
            {f"{count}": place(size, _USUAL, count) for count in _INSTANCES},
            repeats,
        )
        groups["outside"] = _group(
            f"balls out of view, beside {_IN_VIEW} in view",
            {f"{count}": place(size, _SMALL, _IN_VIEW, count) for count in _OUTSIDE},
            2 * repeats,
        )
        groups["triangles"] = _group(
            f"triangles of each of {_BASE_INSTANCES} balls",
            {f"{len(ball_.triangles)}": place(size, k, _BASE_INSTANCES) for k, ball_ in enumerate(balls)},
            repeats,
        )
        sizes = [(max(1, round(size[0] * side)), max(1, round(size[1] * side))) for side in _SIZES]
        groups["resolution"] = _group(
            f"image size, {_BASE_INSTANCES} balls",
            {f"{w} x {h}": place((w, h), _USUAL, _BASE_INSTANCES) for w, h in sizes},
            repeats,
            baseline=f"{size[0]} x {size[1]}",
        )
    # Outputs of flow need the scene's motion.
    outputs = tuple(name for name in bench.config.outputs if name not in FLOW_OUTPUTS)
    modes = {mode: {"antialias": mode, "outputs": outputs} for mode in MODES}
    groups["antialias"] = _option_group(bench, modes, DEFAULT_MODE, backend, repeats)
    groups["outputs"] = _option_group(bench, OUTPUT_OPTIONS, _USUAL_OUTPUTS, backend, repeats)
    return groups


def measure_stress(
    bench: BenchScenes, seed: int, backend: Backend, instances: int = STRESS[0], triangles: int = STRESS[1]
) -> dict[str, Any]:
    """Time one pair with at least as many instances and triangles in view, drawn once, masks included."""
    rings = next(rings for rings in range(3, 10_000) if instances * 4 * rings * (rings - 1) >= triangles)
    model = marked_solid(ball(rings))
    layers = bench.layers[:_LAYERS]
    size = bench.scenes[0].camera.width_px, bench.scenes[0].camera.height_px
    with Renderer([FACE, model], layers, backend=backend) as renderer:
        # Shaders are compiled with a first pair.
        renderer.render(_case(renderer, [model], len(layers), seed, size, 0, 1).scenes[0])
        case = _case(renderer, [model], len(layers), seed, size, 0, instances)
        start = time.perf_counter()
        renderer.render(case.scenes[0])
        seconds = time.perf_counter() - start
    return case.row("stress", seconds, 1.0)


def ball(rings: int) -> Mesh:
    """Make a closed ball of radius 1: n rings from pole to pole, 2 n around, 4 n (n - 1) triangles."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = np.stack([np.cos(latitude), np.sin(latitude)], axis=-1)
    profile[[0, -1], 0] = 0.0
    return without_degenerate(lathe(profile, 2 * rings))


def _case(
    renderer: Renderer, balls: Sequence[Mesh], layers: int, seed: int, size: tuple[int, int], model: int, count: int,
    outside: int = 0,
) -> _Case:  # fmt: skip
    """Place balls at random before a wall, and others behind the camera."""
    rng = np.random.default_rng(seed)
    width, height = size
    camera = StereoCamera.centred(width, height, float(width), 0.1)
    radius_px = np.sqrt(_COVERED * width * height / (np.pi * count))
    depth = rng.uniform(*_BALL_DEPTHS_M, count)
    x_px, y_px = (rng.uniform(0.05, 0.95, count) * side for side in size)
    matrices = np.zeros((1 + count + outside, 4, 4))
    matrices[:, 3, 3] = 1
    # The wall's square, with some beyond the view on each side.
    side_m = 1.5 * _WALL_M
    matrices[0, :3, :3] = np.diag([side_m, side_m, 1.0])
    matrices[0, :3, 3] = -side_m / 2, -side_m / 2, _WALL_M
    scale = radius_px * depth / camera.focal_px
    matrices[1 : 1 + count, :3, :3] = scale[:, None, None] * _rotations(rng, count)
    matrices[1 : 1 + count, :3, 3] = np.stack(
        [(x_px - camera.cx_left_px) * depth / width, (y_px - camera.cy_px) * depth / width, depth], axis=-1
    )
    matrices[1 + count :, :3, :3] = scale.mean() * _rotations(rng, outside)
    matrices[1 + count :, :3, 3] = rng.uniform(-5, 5, (outside, 3)) - [0, 0, 10]
    scene = make_scene(
        camera,
        model=np.r_[0, np.full(count + outside, 1 + model)],
        world_from_model=matrices,
        layer=rng.integers(0, layers, 1 + count + outside),
        # One texel to a pixel, about.
        uv_scale=np.r_[width * 1.5, np.full(count + outside, radius_px)][:, None] / 256,
        near_m=0.1,
    )
    return _Case([scene], count * len(balls[model].triangles) + len(FACE.triangles), renderer.render)


def _rotations(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Draw (count, 3, 3) rotations."""
    turns, triangular = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    turns = turns * np.sign(np.diagonal(triangular, axis1=1, axis2=2))[:, None, :]
    rotations: NDArray[np.float64] = turns * np.sign(np.linalg.det(turns))[:, None, None]
    return rotations


def _option_group(
    bench: BenchScenes, options: Mapping[str, dict[str, Any]], baseline: str, backend: Backend, repeats: int
) -> dict[str, Any]:
    """Time the config's scenes with several options of the renderer."""
    bench = bench.with_worn_patches()
    triangles = np.array([len(mesh.triangles) for mesh in bench.models])
    in_scene = float(np.mean([triangles[scene.model].sum() for scene in bench.scenes]))
    with bench.open_renderers(backend, options) as (renderers, left_out):
        cases = {name: _Case(bench.scenes, in_scene, renderer.render) for name, renderer in renderers.items()}
        return _group("the config's pairs", cases, repeats, baseline=baseline) | {"left_out": left_out}


def _group(text: str, cases: Mapping[str, _Case], repeats: int, *, baseline: str | None = None) -> dict[str, Any]:
    """Time cases of equally many scenes in turns; without a name, the first case is the baseline."""
    baseline = next(iter(cases)) if baseline is None else baseline
    for case in cases.values():  # buffers grow once
        case.draw_all()
    seconds = alternated({name: case.draw_all for name, case in cases.items()}, repeats)
    times = compare_times(seconds, baseline, len(cases[baseline].scenes))
    rows = [case.row(name, *times[name]) for name, case in cases.items()]
    return {"text": text, "baseline": baseline, "left_out": {}, "rows": rows}
