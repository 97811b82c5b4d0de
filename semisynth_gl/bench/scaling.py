"""Time to draw a pair as one quantity grows: instances, triangles, pixels, samples, outputs."""

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
from semisynth_gl.frame.channels import DEFAULT_OUTPUTS, DRAWN_OUTPUTS, FLOW_OUTPUTS
from semisynth_gl.geometry.mesh import Mesh, without_degenerate
from semisynth_gl.geometry.surfaces import lathe
from semisynth_gl.geometry.topology import marked_solid
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.scene import Scene, make_scene

# Number of patches that are uploaded; more patches would only take longer to upload.
_LAYERS = 64
# Number of rings of each ball, from few triangles to many; see `ball`.
_RINGS = (4, 8, 16, 32, 64)
# Indices into _RINGS: the ball where instances or pixels vary, and the ball where balls out of view vary.
_USUAL, _SMALL = 2, 1
# Sum of the areas of all balls in the image, as a share of the image's area.
_COVERED = 0.8
_BALL_DEPTHS_M = (2.0, 6.0)
_WALL_M = 8.0
_INSTANCES = (10, 100, 1000)
_IN_VIEW, _OUTSIDE = 1000, (0, 1000, 10_000)
_BASE_INSTANCES = 100
_SIZES = (0.5, 1.0, 2.0)
# Options of the renderer that each row measures, by the row's name.
OUTPUT_OPTIONS: Mapping[str, dict[str, Any]] = {
    "left disparity": {"truth": "left", "outputs": ()},
    "both disparities": {"truth": "both", "outputs": ()},
    "both, both masks": {"truth": "both", "outputs": DEFAULT_OUTPUTS},
    "both, masks, instances, depth": {"truth": "both", "outputs": ("visibility", "instances", "depth")},
}
_USUAL_OUTPUTS = "both, both masks"
STRESS = (10_000, 5_000_000)
"""Instances and triangles of the stress test, all in view."""


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

    Instances, triangles and pixels are varied in scenes of balls in front of a wall; the balls cover the same area of
    the image whatever their number. Antialiasing and outputs are varied in the config's scenes.

    Args:
        bench: the config's scenes. The first scene's image size is the usual size, also in the scenes of balls.
        seed: decides where the balls are.
        backend: as of `Renderer`.
        repeats: how often each row is timed; rows are timed in turns, and balls out of view twice as often.

    Returns:
        A dictionary for each of "instances", "outside", "triangles", "resolution", "antialias" and "outputs": "text"
        describes the scenes, "baseline" is a row's name, "left_out" has the driver's reason by the names of rows that
        could not be measured, and "rows" the others. A row has "name"; "instances", their mean number with the wall;
        "triangles", their mean number in view; "pixels" of an image; "seconds_per_pair", the median time to draw and
        read back both eyes; and "ratio", the median of that time divided by the baseline's.
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
    outputs = tuple(name for name in bench.config.outputs if name in DRAWN_OUTPUTS and name not in FLOW_OUTPUTS)
    modes = {mode: {"antialias": mode, "outputs": outputs} for mode in MODES}
    groups["antialias"] = _option_group(bench, modes, DEFAULT_MODE, backend, repeats)
    groups["outputs"] = _option_group(bench, OUTPUT_OPTIONS, _USUAL_OUTPUTS, backend, repeats)
    return groups


def measure_stress(
    bench: BenchScenes, seed: int, backend: Backend, instances: int = STRESS[0], triangles: int = STRESS[1]
) -> dict[str, Any]:
    """Time one pair of balls, drawn once with the default outputs; return its row as in `measure_scaling`.

    The pair has ``instances`` balls and at least ``triangles`` triangles in view, and a wall.
    """
    rings = next(rings for rings in range(3, 10_000) if instances * 4 * rings * (rings - 1) >= triangles)
    model = marked_solid(ball(rings))
    layers = bench.layers[:_LAYERS]
    size = bench.scenes[0].camera.width_px, bench.scenes[0].camera.height_px
    with Renderer([FACE, model], layers, backend=backend) as renderer:
        # An untimed pair first, since drawing it compiles the shaders.
        renderer.render(_case(renderer, [model], len(layers), seed, size, 0, 1).scenes[0])
        case = _case(renderer, [model], len(layers), seed, size, 0, instances)
        start = time.perf_counter()
        renderer.render(case.scenes[0])
        seconds = time.perf_counter() - start
    return case.row("stress", seconds, 1.0)


def ball(rings: int) -> Mesh:
    """Make a closed ball of radius 1.

    It has n ``rings`` of faces from pole to pole, 2 n faces in each ring, and 4 n (n - 1) triangles.
    """
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = np.stack([np.cos(latitude), np.sin(latitude)], axis=-1)
    profile[[0, -1], 0] = 0.0
    return without_degenerate(lathe(profile, 2 * rings))


def _case(
    renderer: Renderer, balls: Sequence[Mesh], layers: int, seed: int, size: tuple[int, int], model: int, count: int,
    outside: int = 0,
) -> _Case:  # fmt: skip
    """Place ``count`` balls at random in front of a wall, and ``outside`` balls behind the camera.

    ``model`` is an index into ``balls``; ``layers`` is the number of the renderer's patches; ``size`` is the image's
    width and height in px.
    """
    rng = np.random.default_rng(seed)
    width, height = size
    camera = StereoCamera.centred(width, height, float(width), 0.1)
    radius_px = np.sqrt(_COVERED * width * height / (np.pi * count))
    depth = rng.uniform(*_BALL_DEPTHS_M, count)
    x_px, y_px = (rng.uniform(0.05, 0.95, count) * side for side in size)
    matrices = np.zeros((1 + count + outside, 4, 4))
    matrices[:, 3, 3] = 1
    # The wall is a square that is larger than the view.
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
        # About one texel for each pixel.
        uv_scale=np.r_[width * 1.5, np.full(count + outside, radius_px)][:, None] / 256,
        near_m=0.1,
    )
    return _Case([scene], count * len(balls[model].triangles) + len(FACE.triangles), renderer.render)


def _rotations(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Draw (count, 3, 3) rotation matrices, uniformly among all rotations."""
    turns, triangular = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    turns = turns * np.sign(np.diagonal(triangular, axis1=1, axis2=2))[:, None, :]
    rotations: NDArray[np.float64] = turns * np.sign(np.linalg.det(turns))[:, None, None]
    return rotations


def _option_group(
    bench: BenchScenes, options: Mapping[str, dict[str, Any]], baseline: str, backend: Backend, repeats: int
) -> dict[str, Any]:
    """Time the config's scenes with each of several sets of renderer options; ``baseline`` is the name of one."""
    bench = bench.with_worn_patches()
    triangles = np.array([len(mesh.triangles) for mesh in bench.models])
    in_scene = float(np.mean([triangles[scene.model].sum() for scene in bench.scenes]))
    with bench.open_renderers(backend, options) as (renderers, left_out):
        cases = {name: _Case(bench.scenes, in_scene, renderer.render) for name, renderer in renderers.items()}
        return _group("the config's pairs", cases, repeats, baseline=baseline) | {"left_out": left_out}


def _group(text: str, cases: Mapping[str, _Case], repeats: int, *, baseline: str | None = None) -> dict[str, Any]:
    """Time cases, which have equally many scenes, in turns; without a name, the first case is the baseline."""
    baseline = next(iter(cases)) if baseline is None else baseline
    for case in cases.values():  # untimed, since buffers grow at the first drawing
        case.draw_all()
    seconds = alternated({name: case.draw_all for name, case in cases.items()}, repeats)
    times = compare_times(seconds, baseline, len(cases[baseline].scenes))
    rows = [case.row(name, *times[name]) for name, case in cases.items()]
    return {"text": text, "baseline": baseline, "left_out": {}, "rows": rows}
