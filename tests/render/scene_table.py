"""Difficult scenes. test_truth.py compares every channel of each with float64 rays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from samplers import patches, sampler_of
from scenes import SQUARE, facing, on_plane, posed
from tiny_datasets import lean

from semisynth_gl.frame.camera import CameraDeviation, StereoCamera
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS
from semisynth_gl.geometry.mesh import Mesh, make_mesh
from semisynth_gl.geometry.rotations import rotations_about
from semisynth_gl.scene.scene import Scene, SceneMotion, make_scene, move

CAMERA = StereoCamera(120, 90, 132.0, 0.2, 57.0, 63.0, 42.0)
DEVIATION = CameraDeviation(-0.03, 0.02, -1.7, 0.98)


@dataclass(frozen=True)
class Case:
    """A scene, its models, its motions to the next and the previous frame, and limits of its errors."""

    scene: Scene
    models: Sequence[Mesh]
    future: SceneMotion
    past: SceneMotion
    signed: bool = False  # disparities of 0 and below are valid
    exact: float = 0.995  # smallest share of pixels with the rays' disparity
    seen: float = 0.97  # smallest share of pixels with the rays' masks
    thin: bool = False  # some surfaces are thinner than a pixel; if no pixel shows them, the masks miss what they hide
    steep: bool = False  # disparities change by many pixels from pixel to pixel


def rotation(seed):
    """Return a random rotation."""
    matrix = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return matrix * np.sign(np.linalg.det(matrix))


def pose_of(turn, scale, at):
    """Return the pose of a rotation, scales along the model's axes, and a position."""
    return posed(np.asarray(turn) * np.asarray(scale), at)


def flat(name, corners):
    """Make a quadrangle in the plane z = 0, with u and v from 0 to 1."""
    positions = np.c_[np.asarray(corners, float), np.zeros(4)]
    return make_mesh(name, positions, [[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]])


def ball(rows=224, columns=224):
    """Make a watertight sphere of 100k triangles."""
    v, u = np.meshgrid(np.linspace(0, np.pi, rows + 1), 2 * np.pi * np.arange(columns) / columns, indexing="ij")
    positions = np.stack([np.sin(v) * np.cos(u), np.cos(v), np.sin(v) * np.sin(u)], -1).reshape(-1, 3)
    i, j = (index.ravel() for index in np.mgrid[:rows, :columns])
    a, b = i * columns + j, i * columns + (j + 1) % columns
    triangles = np.concatenate([np.c_[a, b, a + columns], np.c_[b, b + columns, a + columns]])
    return make_mesh("ball", positions, np.stack([u, v], -1).reshape(-1, 2) / np.pi, triangles)


_DEGENERATE = make_mesh(
    "degenerate",
    [[-1, -1, 0], [1, -1, 0.1], [1, 1, 0], [-1, 1, 0.2], [0, 0, 0.05], [1e-7, 1, 0], [0, -1, 0]],
    np.zeros((7, 2)),
    [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [4, 4, 4], [0, 4, 2], [6, 5, 5], [6, 5, 4]],
)
_PYRAMID = make_mesh(
    "pyramid",
    [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, -1]],
    [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]],
    [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
)


def _soup():
    """Make random triangles that intersect the camera plane or are behind it."""
    rng = np.random.default_rng(2)
    positions = rng.uniform(-3, 3, (60, 3))
    positions[:, 2] += 0.5
    positions[:6] = rng.uniform(-3, 3, (6, 3)) - [0, 0, 9]
    return make_mesh("soup", positions, rng.random((60, 2)), np.arange(60).reshape(-1, 3))


@cache
def models():
    """Build the models of the hand-made scenes: difficult ones, and one of each kind."""
    rng = np.random.default_rng(5)
    own = [SQUARE, flat("rod", [(-0.001, -3), (0.001, -3), (0.001, 3), (-0.001, 3)]), _soup(), _DEGENERATE, _PYRAMID]
    return (*own, ball(), *(build(rng) for build in (SIMPLE_KINDS | COMPLEX_KINDS).values()))


ROD, SOUP, DEGENERATE, PYRAMID, BALL, FIRST_KIND = 1, 2, 3, 4, 5, 6


def kind(name):
    return FIRST_KIND + list(SIMPLE_KINDS | COMPLEX_KINDS).index(name)


def wall(camera, depth_m):
    """Return a pose of the square that covers both views and more."""
    return facing(camera, -2 * camera.width_px, -400, 5 * camera.width_px, 800 + camera.height_px, depth_m)


def case(scene, own=None, *, away_m=0.02, turn_rad=0.02, **bounds):
    """Make a case in which each instance and the camera move."""
    rng, number = np.random.default_rng(1), len(scene)
    turns = rotations_about(np.tile([0.0, 0.6, 0.8], (number, 1)), rng.uniform(-0.05, 0.05, number))
    moved = scene.world_from_model.copy()
    centre = moved[:, :3, 3].copy()
    moved[:, :3] = turns @ moved[:, :3]
    moved[:, :3, 3] = centre + rng.uniform(-away_m, away_m, (number, 3))
    moved[scene.sky] = scene.world_from_model[scene.sky]
    turn = rotations_about(np.array([[0.0, 0.8, 0.6]]), np.array([turn_rad]))[0]
    swayed = posed(turn, (away_m / 2, -away_m / 3, away_m / 2)) @ scene.camera_from_world
    then = move(scene, world_from_model=moved, camera_from_world=swayed)
    back = scene.camera_from_world @ np.linalg.inv(swayed)
    before = move(scene, camera_from_world=back @ scene.camera_from_world)
    return Case(scene, models() if own is None else own, then, before, **bounds)


def scene_of(camera, instances, **options):
    """Make a scene of pairs of model number and pose; instances use the four patches in turn."""
    number, poses = [list(each) for each in zip(*instances, strict=True)] if instances else ([], [])
    return make_scene(camera, model=number, world_from_model=poses, layer=np.arange(len(number)) % 4, **options)


def clutter(seed, camera=CAMERA, *, sky=False, count=18):
    """Make a scene of a wall or sky, and models in front of it; each seed has other kinds of models."""
    rng = np.random.default_rng(seed)
    number = FIRST_KIND + (np.arange(count) + seed * count) % (len(models()) - FIRST_KIND)
    depth = rng.uniform(1.0, 3.0, count)
    at = np.c_[rng.uniform(-0.45, 0.45, count) * depth, rng.uniform(-0.35, 0.35, count) * depth, depth]
    poses = [pose_of(rotation(seed + k), 0.12 * at[k, 2] * rng.uniform(0.5, 1, 3), at[k]) for k in range(count)]
    behind = (0, wall(camera, 4.0))
    return scene_of(camera, [behind, *zip(number, poses, strict=True)], sky=[sky] + [False] * count, uv_scale=0.7)


def _far_away():
    """Move a scene 10^6 m from the origin, where float64 resolves 1e-10 m."""
    shift, here = np.eye(4), clutter(1, count=8)
    shift[:3, 3] = 1e6, 1e6, -1e6
    moved = replace(here, world_from_model=shift @ here.world_from_model, camera_from_world=np.linalg.inv(shift))
    return case(moved)


def _near_and_far():
    camera = StereoCamera.centred(120, 90, 132.0, 0.05)
    walls = [(0, wall(camera, 10_000.0)), (0, facing(camera, -100, 30, 400, 300, 9_990.0))]
    return case(scene_of(camera, [*walls, (0, facing(camera, 60, 0, 30, 150, 0.05))], near_m=0.01), away_m=0.001)


def _rods():
    rng, instances = np.random.default_rng(0), [(0, wall(CAMERA, 4.0))]
    for k in range(60):
        turn = rotations_about(np.array([[0.0, 0, 1]]), rng.uniform(0, np.pi, 1))[0]
        instances.append((ROD, pose_of(turn, 1.0, [rng.uniform(-0.8, 0.8), rng.uniform(-0.5, 0.5), 1.5 + k / 100])))
    return case(scene_of(CAMERA, instances), seen=0.92, exact=0.9, thin=True)


def _tiny():
    rng = np.random.default_rng(0)
    small = [(0, pose_of(np.eye(3), 1e-3, [*rng.uniform(-0.5, 0.5, 2), 2.0])) for _ in range(1000)]
    return case(scene_of(CAMERA, [(0, wall(CAMERA, 4.0)), *small]), seen=0.98, exact=0.98, thin=True)


def _mirrored():
    """Mirrored models: one extremely flat, one inside out."""
    poses = [
        (kind("torus"), pose_of(rotation(1), [-0.4, 0.4, 0.4], [-0.3, 0, 2.0])),
        (kind("mug"), pose_of(rotation(2), [0.3, -0.3, -0.5], [0.4, 0.1, 2.2])),
        (kind("torus"), pose_of(rotation(3), [1e-3, 0.3, 0.3], [0.0, 0.3, 1.8])),
    ]
    return case(scene_of(CAMERA, poses))


def _edge_on():
    """The right eye sees the box's side so obliquely that the disparity changes by 9 px within a pixel."""
    camera = StereoCamera(300, 60, 1500.0, 0.2, 400.0, 400.0, 25.0)
    places = [(0.3, 2.0), (-0.3, 2.0), (0.2 - 1.5015 / 2, 3.0)]
    positions = [(x, y, z) for x, z in places for y in (-0.2, 0.2)]
    box = make_mesh("box", positions, [(0.0, 0.0)] * 6, [(0, 1, 3), (0, 3, 2), (2, 3, 5), (2, 5, 4)])
    scene = make_scene(camera, model=[1, 0], world_from_model=[np.eye(4), wall(camera, 5.0)], layer=[0, 0])
    return case(scene, [SQUARE, box], away_m=0.001, steep=True)


def _grazing(turn_deg):
    """A plane beside the camera's axis, seen nearly edge-on."""
    angle = np.deg2rad(turn_deg)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1] = (6 * np.cos(angle), 0, 6 * np.sin(angle)), (0, 4, 0)
    pose[:3, 3] = np.array([0.25, -2, 4.0]) - pose[:3, 0] / 2
    return case(scene_of(CAMERA, [(0, wall(CAMERA, 9.0)), (0, pose)], near_m=0.3), steep=True)


def _fence(camera):
    """Pyramids, some of them spokes narrower than a pixel."""
    near = np.array([[0.2, 0.08, 0, 0.15], [-0.12, 0.17, 0, -0.1], [0.02, 0, 0.2, 1.6], [0, 0, 0, 1]])
    board = np.array([[0.003, 0.15, 0, -0.2], [0.25, 0.001, 0, 0.1], [0, 0.1, 0.2, 1.2], [0, 0, 0, 1]])
    spoke = np.array([[0.001, 0.03, 0, -0.35], [0, 0.25, 0, 0], [0, 0.02, 0.001, 1], [0, 0, 0, 1]])
    spokes = [spoke + np.eye(4)[0, :, None] * np.array([0, 0, 0, 0.06 * k]) for k in range(12)]
    slanted = on_plane((0.2, 0.1, 1.0), 4.0, 12.0)
    return scene_of(camera, [(0, slanted), *((PYRAMID, pose) for pose in (near, board, *spokes))])


def _sampled(name, recipe, index=5):
    """Sample a scene of a packaged config at an eighth of its size, with few models."""
    config = lean(name, models={"complex": 0.3}, textures={"source": "procedural", "max_patches": 4}, **recipe)
    sampler = sampler_of(config, atlas_patches=patches(4))
    return case(sampler.sample(index).scene, sampler.models, thin=True)


def _with(camera=CAMERA, **changes):
    return replace(camera, **changes)


_BALLS = enumerate(((0.08, 0.02, 0.01, 1.2), (0.05, -0.3, 0.15, 1.5), (0.06, 0.25, -0.2, 1.8)))
_ROOM = {"background": {"cuboid": 0.0, "room": 1.0}}
_STREET = {"background": {"cuboid": 0.0, "room": 0.0, "street": 1.0, "sky": 1.0}, "structures": {"panels": [1, 3]}}
_SMALL = StereoCamera.centred(100, 50, 300.0, 1.0)
_NARROW = StereoCamera.centred(17, 3, 20.0, 0.1)

CASES: dict[str, Callable[[], Case]] = {
    **{f"clutter {seed}": lambda seed=seed: case(clutter(seed)) for seed in range(4)},
    "fast": lambda: case(clutter(3), away_m=0.3, turn_rad=0.2),
    "sky, signed": lambda: case(clutter(0, _with(cx_right_px=75.0), sky=True), signed=True),
    "sky": lambda: case(clutter(1, _with(cx_right_px=52.0), sky=True)),
    "far wall, signed": lambda: case(clutter(2, _with(cx_right_px=74.0), count=6), signed=True),
    "deviating": lambda: case(clutter(3, _with(deviation=DEVIATION))),
    "deviating, sky, signed": lambda: case(
        clutter(2, _with(deviation=DEVIATION, cx_right_px=72.0, fy_over_fx=1.2), sky=True), signed=True
    ),
    "fence": lambda: case(_fence(CAMERA), seen=0.98, thin=True),
    "fence, high pixels": lambda: case(_fence(_with(fy_over_fx=1.25)), seen=0.97, thin=True),
    "fence, wide pixels, deviating": lambda: case(
        _fence(_with(fy_over_fx=0.8, deviation=DEVIATION)), seen=0.97, thin=True
    ),
    "short lens": lambda: case(clutter(0, StereoCamera.centred(120, 90, 24.0, 0.2)), thin=True),
    "long lens": lambda: case(clutter(1, StereoCamera.centred(120, 90, 2400.0, 0.02), count=10)),
    "10^6 m away": _far_away,
    "0.05 and 10,000 m": _near_and_far,
    "grazing": lambda: _grazing(89.9),
    "grazing from behind": lambda: _grazing(-80.0),
    "edge on": _edge_on,
    "through the camera plane": lambda: case(scene_of(CAMERA, [(SOUP, np.eye(4))], near_m=0.05), seen=0.97, steep=True),
    # The masks do not trace surfaces across edges of more than two triangles, such as those of duplicates.
    "degenerate triangles": lambda: case(
        scene_of(CAMERA, [(DEGENERATE, pose_of(np.eye(3), 1.0, [0, 0, 2.5]))]), seen=0.985, exact=0.99
    ),
    "rods": _rods,
    "smaller than a pixel": _tiny,
    "mirrored and flattened": _mirrored,
    "stretched": lambda: case(
        scene_of(CAMERA, [(kind("mug"), pose_of(np.eye(3), [1e3, 1e-3, 1e3], [0, 0.3, 2.0]))], near_m=0.1), exact=0.97
    ),
    "fine ball": lambda: case(
        scene_of(CAMERA, [(0, wall(CAMERA, 9.0)), (BALL, pose_of(rotation(1), 0.4, [0.05, 0, 2.0]))]), exact=0.99
    ),
    # A pixel of a small ball contains dozens of triangles.
    "fine balls": lambda: case(
        scene_of(
            CAMERA, [(0, wall(CAMERA, 4.0)), *((BALL, pose_of(rotation(k), size, at)) for k, (size, *at) in _BALLS)]
        ),
        seen=0.9995,
    ),
    "parallel, near first": lambda: case(scene_of(CAMERA, [(0, wall(CAMERA, d)) for d in (2.0, 2.0 * (1 + 1e-5))])),
    "parallel, far first": lambda: case(scene_of(CAMERA, [(0, wall(CAMERA, d)) for d in (2.0 * (1 + 1e-5), 2.0)])),
    "coplanar": lambda: case(scene_of(CAMERA, [(0, pose_of(rotation(4), 3.0, [-0.6, -0.4, 3.0]))] * 3)),
    "singular": lambda: case(
        scene_of(CAMERA, [(0, wall(CAMERA, 4.0) @ np.diag([1.0, 1, 0, 1])), (0, posed(np.zeros((3, 3)), (0, 0, 2)))])
    ),
    "disparity wider than the image": lambda: case(scene_of(_SMALL, [(0, wall(_SMALL, 2.0))])),
    "no baseline": lambda: case(scene_of(_with(baseline_m=0.0), [(0, wall(CAMERA, 2.0))])),
    "17 x 3 px": lambda: case(scene_of(_NARROW, [(0, on_plane((0.3, 0.2, 1.0), 2.0, 9.0))])),
    "nothing": lambda: case(scene_of(CAMERA, [])),
    "behind": lambda: case(scene_of(CAMERA, [(0, facing(CAMERA, 0, 0, 33, 21, -2.0))])),
    "room": lambda: _sampled("middlebury", _ROOM),
    "street": lambda: _sampled("kitti", _STREET),
    "still life": lambda: _sampled("middlebury", {"structures": {"ground": 1.0, "panels": [1, 3]}}, 0),
}
