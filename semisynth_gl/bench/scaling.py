"""What the drawing of a pair costs as one quantity grows: instances, triangles, pixels, samples, outputs."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.scenes import BenchScenes
from semisynth_gl.bench.timing import alternated, compared
from semisynth_gl.camera import StereoCamera
from semisynth_gl.errors import BackendError
from semisynth_gl.frame import DEFAULT_OUTPUTS
from semisynth_gl.geometry.mesh import Mesh, make_mesh
from semisynth_gl.geometry.topology import marked_solid
from semisynth_gl.render.context import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.scene import Scene, make_scene

# Patches that are uploaded; more would change nothing but the time to open a renderer.
_LAYERS = 64
# Rings of the balls, from few triangles to many; see `ball`.
_RINGS = (4, 8, 16, 32, 64)
# Which of them: where instances or pixels are many, and where many stand out of view.
_USUAL, _SMALL = 2, 1
# What all balls of a scene cover together, in images.
_COVERED = 0.8
_BALL_DEPTHS_M = (2.0, 6.0)
_WALL_M = 8.0
_INSTANCES = (10, 100, 1000)
_IN_VIEW, _OUTSIDE = 1000, (0, 1000, 10_000)
_BASE_INSTANCES = 100
_SIZES = (0.5, 1.0, 2.0)
ANTIALIAS_MODES = ("none", "msaa4", "ssaa2", "ssaa3")
# The option's values of a renderer by the row's name.
OUTPUT_WAYS: Mapping[str, dict[str, Any]] = {
    "left disparity": {"truth": "left", "outputs": ()},
    "both disparities": {"truth": "both", "outputs": ()},
    "both, both masks": {"truth": "both", "outputs": DEFAULT_OUTPUTS},
    "both, masks, instances, depth": {"truth": "both", "outputs": ("visibility", "instances", "depth")},
}
_USUAL_OUTPUTS = "both, both masks"
STRESS = (10_000, 5_000_000)
"""Instances and triangles, all in view."""


@dataclass(frozen=True, slots=True)
class ScalingRow:
    """One scene, or one way to draw the config's.

    Attributes:
        name: of the row.
        instances: of the scene, the wall included; mean over the scenes.
        triangles: in view, likewise.
        pixels: of one image.
        seconds_per_pair: drawn and read back, both eyes; median over the repeats.
        ratio: to the baseline's, median over the repeats.
    """

    name: str
    instances: float
    triangles: float
    pixels: int
    seconds_per_pair: float
    ratio: float


@dataclass(frozen=True, slots=True)
class _Case:
    """A scene or several, and how to draw them."""

    scenes: Sequence[Scene]
    triangles: float
    draw: Callable[[Scene], object]


def measure_scaling(bench: BenchScenes, seed: int, backend: Backend, repeats: int) -> dict[str, dict[str, Any]]:
    """Measure all quantities.

    Instances, triangles and pixels are those of balls before a wall, which cover the same part of the image whatever
    their number. Antialiasing and outputs are those of the config's scenes.

    Args:
        bench: the config's scenes; the first one's image size is the usual one.
        seed: of where the balls are.
        backend: "auto", "egl" or "osmesa".
        repeats: how often each row takes its turn.

    Returns:
        By quantity: "text", "baseline" (a row's name), "left_out" (names with the driver's reason) and "rows".
    """
    layers = bench.layers[:_LAYERS]
    balls = [marked_solid(ball(rings)) for rings in _RINGS]
    size = bench.scenes[0].camera.width_px, bench.scenes[0].camera.height_px
    found = {}
    with Renderer([FACE, *balls], layers, backend=backend) as renderer:
        place = partial(_case, renderer, balls, len(layers), seed)
        found["instances"] = _group(
            f"balls of {len(balls[_USUAL].triangles)} triangles in view",
            {f"{count}": place(size, _USUAL, count) for count in _INSTANCES},
            repeats,
        )
        found["outside"] = _group(
            f"balls out of view, beside {_IN_VIEW} in view",
            {f"{count}": place(size, _SMALL, _IN_VIEW, count) for count in _OUTSIDE},
            2 * repeats,
        )
        found["triangles"] = _group(
            f"triangles of each of {_BASE_INSTANCES} balls",
            {f"{len(ball_.triangles)}": place(size, k, _BASE_INSTANCES) for k, ball_ in enumerate(balls)},
            repeats,
        )
        sizes = [(max(1, round(size[0] * side)), max(1, round(size[1] * side))) for side in _SIZES]
        found["resolution"] = _group(
            f"image size, {_BASE_INSTANCES} balls",
            {f"{w} x {h}": place((w, h), _USUAL, _BASE_INSTANCES) for w, h in sizes},
            repeats,
            baseline=f"{size[0]} x {size[1]}",
        )
    found["antialias"] = _ways(bench, {mode: {"antialias": mode} for mode in ANTIALIAS_MODES}, "none", backend, repeats)
    found["outputs"] = _ways(bench, OUTPUT_WAYS, _USUAL_OUTPUTS, backend, repeats)
    return found


def measure_stress(
    bench: BenchScenes, seed: int, backend: Backend, instances: int = STRESS[0], triangles: int = STRESS[1]
) -> ScalingRow:
    """Draw one pair with at least so many instances and triangles in view, once, masks included."""
    rings = next(rings for rings in range(3, 10_000) if instances * _triangle_count(rings) >= triangles)
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
    return ScalingRow("stress", instances + 1, case.triangles, size[0] * size[1], seconds, 1.0)


def ball(rings: int) -> Mesh:
    """A closed ball of radius 1: n rings from pole to pole, 2 n around, 4 n (n - 1) triangles."""
    around = 2 * rings
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, around + 1), indexing="ij")
    # Equal positions at the seam and the poles, so that the surface counts as closed.
    azimuth_position = np.where(np.arange(around + 1) == around, 0.0, azimuth)
    ring = np.sin(polar)
    ring[[0, -1]] = 0.0
    positions = np.stack([ring * np.cos(azimuth_position), ring * np.sin(azimuth_position), np.cos(polar)], axis=-1)
    uv = np.stack([azimuth, polar], axis=-1)
    first = (np.arange(rings)[:, None] * (around + 1) + np.arange(around)).reshape(rings, around)
    right, below = first + 1, first + around + 1
    upper = np.stack([first, below, right], axis=-1)[1:]
    lower = np.stack([right, below, below + 1], axis=-1)[:-1]
    triangles = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    return make_mesh("ball", positions.reshape(-1, 3), uv.reshape(-1, 2), triangles)


def _triangle_count(rings: int) -> int:
    return 4 * rings * (rings - 1)


def _case(
    renderer: Renderer, balls: Sequence[Mesh], layers: int, seed: int, size: tuple[int, int], model: int, count: int,
    outside: int = 0,
) -> _Case:  # fmt: skip
    """Balls in a grid of random depths before a wall, and as many others behind the camera as asked for."""
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


def _ways(
    bench: BenchScenes, options: Mapping[str, dict[str, Any]], baseline: str, backend: Backend, repeats: int
) -> dict[str, Any]:
    """The config's scenes, drawn by renderers with other options."""
    layers = bench.layers[:_LAYERS]
    scenes = [replace(scene, layer=scene.layer % len(layers)) for scene in bench.scenes]
    triangles = np.array([len(mesh.triangles) for mesh in bench.models])
    in_scene = float(np.mean([triangles[scene.model].sum() for scene in scenes]))
    left_out: dict[str, str] = {}
    cases = {}
    with ExitStack() as stack:
        for name, values in options.items():
            try:
                renderer = stack.enter_context(
                    Renderer(bench.models, layers, wrap=bench.config.textures.wrap, backend=backend, **values)
                )
                renderer.render(scenes[0])
            except BackendError as error:
                left_out[name] = str(error)
                continue
            cases[name] = _Case(scenes, in_scene, renderer.render)
        return _group("the config's pair", cases, repeats, baseline=baseline) | {"left_out": left_out}


def _group(text: str, cases: Mapping[str, _Case], repeats: int, *, baseline: str | None = None) -> dict[str, Any]:
    """Time cases in turns; the first is the baseline where none is named."""
    baseline = next(iter(cases)) if baseline is None else baseline
    calls = {name: partial(_draw_all, case) for name, case in cases.items()}
    for call in calls.values():  # buffers grow once
        call()
    seconds = alternated(calls, repeats)
    rows = {}
    for name, case in cases.items():
        times = compared({name: seconds[name], baseline: seconds[baseline]}, baseline, len(case.scenes))[name]
        camera = case.scenes[0].camera
        rows[name] = ScalingRow(
            name, float(np.mean([len(scene) for scene in case.scenes])), case.triangles,
            camera.width_px * camera.height_px, times.seconds, times.ratio,
        )  # fmt: skip
    return {"text": text, "baseline": baseline, "left_out": {}, "rows": list(rows.values())}


def _draw_all(case: _Case) -> None:
    for scene in case.scenes:
        case.draw(scene)
