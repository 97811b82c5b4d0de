"""The stage of a sequence: its camera, background and structures (a ground plane, slanted panels, curved panels)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from semisynth_gl.config import Range
from semisynth_gl.config.model import Config
from semisynth_gl.config.rig_sections import DisparitySection
from semisynth_gl.config.scene_sections import BackgroundSection, StructuresSection
from semisynth_gl.frame.camera import RECTIFIED, StereoCamera
from semisynth_gl.geometry.mesh import Mesh, cross, make_mesh, mesh_grid
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.scene import Bools, Floats, Ints
from semisynth_gl.scene.arrangement import Arrangement, Catalogue
from semisynth_gl.scene.background import (
    FACE,
    GROUND,
    Background,
    Kind,
    draw_background,
    draw_kind,
    lay_ground,
)
from semisynth_gl.scene.glance import glance
from semisynth_gl.scene.rig import (
    BEYOND_NEAR,
    STILL,
    Sway,
    check_reachable,
    draw_camera,
    draw_deviation,
    draw_sway,
    draw_views,
    near_depth_m,
)
from semisynth_gl.scene.room import DOORWAYS, NICHES, draw_room
from semisynth_gl.scene.scene import make_scene
from semisynth_gl.scene.street import draw_street
from semisynth_gl.scene.view_volume import smallest_offsets
from semisynth_gl.seeds.seeds import Purpose

_ARC_COLUMNS, _ARC_ROWS = 24, 4
_HALF_ARC_RAD = np.pi / 3


def _curved_panel() -> Mesh:
    """A third of a cylinder over the unit square about the origin, its middle towards -z; u along the arc."""
    u, v, triangles = mesh_grid(_ARC_ROWS, _ARC_COLUMNS)
    radius = 0.5 / np.sin(_HALF_ARC_RAD)
    angle = (2 * u - 1) * _HALF_ARC_RAD
    middle = radius * (1 + np.cos(_HALF_ARC_RAD)) / 2
    points = np.c_[radius * np.sin(angle), v - 0.5, middle - radius * np.cos(angle)]
    return make_mesh("curved panel", points, np.c_[radius * angle, v], triangles)


CURVED_PANEL = _curved_panel()
# The sampler counts them in this order. Flat panels are faces too.
STILL_MODELS = (FACE, GROUND, CURVED_PANEL, *DOORWAYS, *NICHES)
_FACE, _GROUND, _CURVED = range(3)

# The share of rays at each end that counts as seeing nothing of a surface: a ground that reaches to the horizon is
# seen where it is near.
_LEFT_OUT = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """The still things of one scene: S instances, the background's faces first.

    Attributes:
        model: (S,) int64, index into `STILL_MODELS` and, behind them, the models of the library.
        world_from_model: (S, 4, 4) float64, left camera's frame, metres.
        unit_m: (S, 2) float64, length of one UV unit.
        wears: (S,) int64, the still thing whose texture each wears: itself, or an earlier one.
        large: (S,) bool, whether it wears a large patch, where there are any.
        depth_m: (S,) float64, median depth in the left view; of a hidden face, the depth of the
            back wall, and of a hidden structure, its nearest depth or that of the near plane.
        low: (S, 2) float64, about the lowest UV that the left view sees; 0 of what is hidden.
        high: (S, 2) float64, about the highest UV that the left view sees.
        disparity_px: flat float64, disparities on a coarse grid over the left view.
        sky: (S,) bool, whether it is infinitely far away.
    """

    model: Ints
    world_from_model: Floats
    unit_m: Floats
    wears: Ints
    large: Bools
    depth_m: Floats
    low: Floats
    high: Floats
    disparity_px: Floats
    sky: Bools

    def __len__(self) -> int:
        return len(self.model)


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The camera of one sequence, and the still things that it sees.

    Attributes:
        camera: the camera that the scenes are composed for, of the longest baseline.
        views: the camera of each right view, see `draw_views`.
        sway: the motion of the camera.
        background: its kind.
        still: background and structures.
        up: (3,) float64, unit, the direction upwards in the left camera's frame.
        farthest_m: depth that the views of a room keep within; inf for other backgrounds.
    """

    camera: StereoCamera
    views: tuple[StereoCamera, ...]
    sway: Sway
    background: Kind
    still: Surroundings
    up: Floats
    farthest_m: float = np.inf


def take_stock(library: ModelLibrary) -> Catalogue:
    """Return the still models and a library's as those that things at rest are taken from."""
    drawn = library.drawn[library.chances > 0]
    names = np.array([library.models[number].name for number in drawn])
    by_name = {str(name): len(STILL_MODELS) + drawn[names == name] for name in np.unique(names)}
    models = (*STILL_MODELS, *library.models)
    boxes = np.array([(mesh.positions.min(axis=0), mesh.positions.max(axis=0)) for mesh in models], np.float64)
    return Catalogue(models, by_name, boxes[:, 0], boxes[:, 1])


def draw_stage(config: Config, catalogue: Catalogue, generator_for: Callable[[Purpose], np.random.Generator]) -> Stage:
    """Draw the stage of one sequence.

    Args:
        config: the configuration.
        catalogue: the models of things at rest, see `take_stock`.
        generator_for: returns the generator of CAMERA, RIG, SWAY, BACKGROUND, STRUCTURES and SKY.

    Raises:
        InputError: where a disparity of the config lies beyond infinity, or a far plane would have to be endless.
    """
    rng = generator_for(Purpose.CAMERA)
    views = draw_views(config.camera, draw_camera(config.camera, rng), rng)
    if not config.rig.none():
        deviation = draw_deviation(config.rig, generator_for(Purpose.RIG))
        twins = (deviation, RECTIFIED) if config.rig.twin else (deviation,)
        views = tuple(replace(view, deviation=each) for view in views for each in twins)
    camera = max(views, key=lambda view: view.baseline_m)
    sway = draw_sway(config.camera, generator_for(Purpose.SWAY))
    rng = generator_for(Purpose.BACKGROUND)
    kind = draw_kind(config.background, rng)
    sky = kind in ("plane", "street") and _has_sky(config.background, generator_for)
    if kind == "room":
        things = draw_room(config, camera, catalogue, rng, sway)
    elif kind == "street":
        things = draw_street(config, camera, catalogue, rng, sway, sky=sky)
    else:
        background = draw_background(kind, config.background, config.disparity, camera, rng, sway, sky=sky)
        still = draw_surroundings(
            config.structures, config.disparity, camera, background, generator_for(Purpose.STRUCTURES), sway
        )
        return Stage(camera, views, sway, kind, still, np.array([0.0, -1.0, 0.0]))
    up = things.view.camera_from_floor[:3, 2]
    return Stage(camera, views, sway, kind, _surroundings(things, sky=sky), up, things.farthest_m)


def _has_sky(section: BackgroundSection, generator_for: Callable[[Purpose], np.random.Generator]) -> bool:
    return section.sky > 0 and bool(generator_for(Purpose.SKY).random() < section.sky)


def _surroundings(things: Arrangement, *, sky: bool) -> Surroundings:
    """Measure what the camera sees of things at rest, before a sky if the first of them is one."""
    view = things.view
    matrices = view.camera_from_floor @ np.array(things.floor_from_model)
    return _measured(
        view.camera,
        view.near_m,
        things.catalogue.models,
        np.array(things.model),
        matrices,
        np.array(things.unit_m),
        np.array(things.wears),
        np.array(things.large),
        # What is hidden has the depth of its origin, or of the near plane where that is farther.
        hidden_m=np.maximum(matrices[:, 2, 3], view.near_m),
        sky=np.arange(len(matrices)) < int(sky),
    )


def _measured(
    camera: StereoCamera,
    near_m: float,
    models: Sequence[Mesh],
    model: Ints,
    world_from_model: Floats,
    unit_m: Floats,
    wears: Ints,
    large: Bools,
    hidden_m: Floats,
    sky: Bools,
) -> Surroundings:
    """Measure what the left view sees of still things; the sky, and what it does not see, have depths ``hidden_m``."""
    layer = np.zeros(len(model), np.int64)
    scene = make_scene(camera, model=model, world_from_model=world_from_model, layer=layer, near_m=near_m, sky=sky)
    seen = glance(scene, models)
    depth_m, low, high = np.array(hidden_m, np.float64), np.zeros((len(model), 2)), np.zeros((len(model), 2))
    for number in np.unique(seen.instance[seen.instance >= 0]):
        rays = seen.instance == number
        if not sky[number]:
            depth_m[number] = np.median(seen.depth_m[rays])
        uv = np.sort(seen.uv[rays], axis=0)
        left_out = int(_LEFT_OUT * len(uv))
        low[number], high[number] = uv[left_out], uv[-1 - left_out]
    disparity_px = camera.disparity_px(seen.depth_m)
    return Surroundings(
        model, world_from_model, unit_m, wears, large, depth_m, low, high, disparity_px[np.isfinite(disparity_px)], sky
    )


def draw_surroundings(
    section: StructuresSection,
    disparity: DisparitySection,
    camera: StereoCamera,
    background: Background,
    rng: np.random.Generator,
    sway: Sway = STILL,
) -> Surroundings:
    """Draw structures before a background.

    No structure comes nearer than the depth of ``disparity.max_px`` in either view. Where the camera sways, only the
    ground keeps this distance, and the near plane cuts off panels that come too near.

    Raises:
        InputError: where ``ground_disparity_px`` or ``panel_disparity_px`` lies beyond infinity.
    """
    near_m = near_depth_m(camera, disparity)
    bare_px = background.disparity_px(camera)
    # Before a sky, the ground ends where its plane stands.
    farthest_m = float(background.offset_m[0]) if background.sky else float(camera.depth_m(bare_px.min()))
    model, placed = list[int](), list[Floats]()
    if rng.random() < section.ground:
        model.append(_GROUND)
        placed.append(_place_ground(section, camera, Range(near_m, farthest_m), rng, sway))
    for _ in range(round(section.panels.draw(rng))):
        curved = bool(rng.random() < section.panel_curved)
        model.append(_CURVED if curved else _FACE)
        placed.append(_place_panel(section, disparity, camera, near_m, rng, curved=curved))
    faces, size_m = len(background.size_m), list(background.size_m)
    for number, matrix in zip(model, placed, strict=True):
        size_m.append(np.linalg.norm(matrix[:3, [0, 2 if number == _GROUND else 1]], axis=0))
    # A hidden structure has the depth of its nearest vertex, or of the near plane where that is farther.
    hidden_m = [max(float(_depths_m(*one).min()), near_m) for one in zip(model, placed, strict=True)]
    still = _measured(
        camera,
        near_m / BEYOND_NEAR,
        STILL_MODELS,
        np.array([_FACE] * faces + model),
        np.array([*background.world_from_face, *placed]),
        np.array(size_m),
        np.arange(faces + len(model)),
        np.ones(faces + len(model), bool),
        np.append(background.visible_depth_m, hidden_m),
        np.arange(faces + len(model)) < int(background.sky),
    )
    # Of the background, that before which nothing stands.
    still.depth_m[:faces] = background.visible_depth_m
    return still if placed else replace(still, disparity_px=bare_px[np.isfinite(bare_px)])


def _depths_m(model: int, matrix: Floats) -> Floats:
    """Return the depths of a still model's vertices."""
    return np.asarray(STILL_MODELS[model].positions.astype(np.float64) @ matrix[2, :3] + matrix[2, 3])


def _place_ground(
    section: StructuresSection, camera: StereoCamera, depth_m: Range, rng: np.random.Generator, sway: Sway
) -> Floats:
    height = _ground_height_m(section, camera, rng)
    roll, pitch = np.deg2rad(rng.uniform(-section.ground_tilt_deg, section.ground_tilt_deg, 2))
    across = np.array([np.cos(roll), np.sin(roll), 0.0])
    along = np.array([-np.sin(roll) * np.sin(pitch), np.cos(roll) * np.sin(pitch), np.cos(pitch)])
    offset = max(height, float(smallest_offsets(camera, cross(along, across)[None], depth_m.low, sway)[0]))
    return lay_ground(camera, depth_m, across, along, offset)


def _ground_height_m(section: StructuresSection, camera: StereoCamera, rng: np.random.Generator) -> float:
    if section.ground_disparity_px is None:
        return section.ground_height_m.draw(rng)
    drawn_px = section.ground_disparity_px.draw(rng)
    check_reachable(camera, drawn_px, "structures.ground_disparity_px")
    below = (camera.height_px - 0.5 - camera.cy_px) / camera.focal_px
    return float(camera.depth_m(drawn_px)) * below


def _farther_half(disparity: DisparitySection, camera: StereoCamera) -> Range:
    """Return the disparities of the farther half of the range, by ratios."""
    if not disparity.signed:
        return Range(disparity.min_px, (disparity.min_px * disparity.max_px) ** 0.5)
    # By ratios of depths: disparities may lie to both sides of 0.
    nearness = (disparity.min_px + camera.doffs_px) * (disparity.max_px + camera.doffs_px)
    return Range(disparity.min_px, max(disparity.min_px, nearness**0.5 - camera.doffs_px))


def _place_panel(
    section: StructuresSection,
    disparity: DisparitySection,
    camera: StereoCamera,
    near_m: float,
    rng: np.random.Generator,
    *,
    curved: bool,
) -> Floats:
    where = section.panel_disparity_px or _farther_half(disparity, camera)
    check_reachable(camera, where.low, "structures.panel_disparity_px")
    depth = float(camera.depth_m(where.draw(rng)))
    size = section.panel_size_px.draw_many(rng, 2) * depth / camera.focal_px
    x, y = rng.random(2) * (camera.width_px, camera.height_px) - 0.5
    slant = np.deg2rad(section.panel_slant_deg.draw(rng))
    towards, turn = rng.uniform(0, 2 * np.pi, 2)
    facing = bool(rng.random() < 0.5)
    normal = np.array([np.sin(slant) * np.cos(towards), np.sin(slant) * np.sin(towards), np.cos(slant)])
    first = cross(normal, np.array([np.sin(turn), np.cos(turn), 0.0]))
    first /= np.linalg.norm(first)
    second = cross(normal, first)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = first * size[0], second * size[1]
    matrix[:3, 2] = normal * size.mean() * (1 if facing else -1)
    mesh = STILL_MODELS[_CURVED if curved else _FACE]
    # A face begins at its corner, a curved panel lies about its middle.
    begin = np.zeros(3) if curved else -(matrix[:3, 0] + matrix[:3, 1]) / 2
    nearest = float((mesh.positions.astype(np.float64) @ matrix[:3, :3].T + begin)[:, 2].min())
    depth = max(depth, BEYOND_NEAR * near_m - nearest)
    ray = camera.rays("left", np.array(x), np.array(y))
    matrix[:3, 3] = begin + ray * depth
    return matrix
