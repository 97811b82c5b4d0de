"""The static scene of a sequence: its camera, and its background with structures (ground, panels) or furniture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from semisynth_gl.config import Range
from semisynth_gl.config.model import Config
from semisynth_gl.config.rig_sections import DisparitySection
from semisynth_gl.config.scene_sections import StructuresSection
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.mesh import Mesh, cross, make_mesh, mesh_grid
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.scene import Bools, Floats, Ints
from semisynth_gl.scene.arrangement import Arrangement, Catalogue
from semisynth_gl.scene.background import (
    FACE,
    GROUND,
    Background,
    Kind,
    lay_ground,
    sample_cuboid,
    sample_kind,
    sample_plane,
)
from semisynth_gl.scene.glance import glance
from semisynth_gl.scene.mapping import Surfaces
from semisynth_gl.scene.rig import BEYOND_NEAR, STILL, Sway, check_reachable, near_depth_m, sample_rig
from semisynth_gl.scene.room import DOORWAYS, NICHES, sample_room
from semisynth_gl.scene.scene import Scene, make_scene, placed_vertices
from semisynth_gl.scene.street import sample_street
from semisynth_gl.scene.view_volume import smallest_offsets
from semisynth_gl.seeds.seeds import Purpose

_ARC_COLUMNS, _ARC_ROWS = 24, 4
_HALF_ARC_RAD = np.pi / 3


def _curved_panel() -> Mesh:
    """Build a third of a cylinder over the unit square about the origin, its middle towards -z; u is along the arc."""
    u, v, triangles = mesh_grid(_ARC_ROWS, _ARC_COLUMNS)
    radius = 0.5 / np.sin(_HALF_ARC_RAD)
    angle = (2 * u - 1) * _HALF_ARC_RAD
    middle = radius * (1 + np.cos(_HALF_ARC_RAD)) / 2
    points = np.c_[radius * np.sin(angle), v - 0.5, middle - radius * np.cos(angle)]
    return make_mesh("curved panel", points, np.c_[radius * angle, v], triangles)


CURVED_PANEL = _curved_panel()
# `SampledScene` refers to the models in this order. Flat panels are faces, too.
STILL_MODELS = (FACE, GROUND, CURVED_PANEL, *DOORWAYS, *NICHES)
_FACE, _GROUND, _CURVED = range(3)

# Share of rays at each end of a surface's UV that is ignored: a ground that reaches to the horizon is measured where it
# is near.
_LEFT_OUT = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """The S still things of one scene; the background's faces, or a street's backdrop, come first."""

    model: Ints  # (S,) indices into `STILL_MODELS` and, behind them, the models of the library
    world_from_model: Floats  # (S, 4, 4), left camera's frame, metres
    wears: Ints  # (S,) the still thing whose texture each wears: itself, or an earlier one
    # Median depths in the left view, and about the lowest and the highest UV there, which are 0 for hidden things. The
    # depths of hidden things are substitutes: the background's faces have `Background.visible_depth_m`, structures the
    # depth of their nearest vertex, and the things of rooms and streets that of their origin, or the near plane's.
    surfaces: Surfaces
    sky: Bools  # (S,) whether each thing is infinitely far away
    disparity_px: Floats  # (R,) finite disparities on a coarse grid over the left view

    def __len__(self) -> int:
        return len(self.model)


@dataclass(frozen=True, slots=True, eq=False)
class StaticScene:
    """The camera of one sequence, and the still things that it sees."""

    camera: StereoCamera  # the camera of the longest baseline, for which the scenes are composed
    views: tuple[StereoCamera, ...]  # the camera of each right view, see `sample_views`
    sway: Sway
    background: Kind
    still: Surroundings  # background, structures and furniture
    up: Floats  # (3,) unit, the direction upwards in the left camera's frame
    farthest_m: float = np.inf  # depth that no view of a room exceeds; inf for other backgrounds


def take_stock(library: ModelLibrary) -> Catalogue:
    """Return the catalogue of the still models and a library's models, from which still things are taken."""
    drawn = library.drawn[library.chances > 0]
    names = np.array([library.models[number].name for number in drawn])
    by_name = {str(name): len(STILL_MODELS) + drawn[names == name] for name in np.unique(names)}
    models = (*STILL_MODELS, *library.models)
    boxes = np.array([(mesh.positions.min(axis=0), mesh.positions.max(axis=0)) for mesh in models], np.float64)
    return Catalogue(models, by_name, boxes[:, 0], boxes[:, 1])


def sample_static_scene(
    config: Config, catalogue: Catalogue, generator_for: Callable[[Purpose], np.random.Generator]
) -> StaticScene:
    """Sample the static scene of one sequence.

    ``generator_for`` returns the generator for CAMERA, RIG, SWAY, BACKGROUND, STRUCTURES and SKY.

    Raises:
        InputError: where a disparity of the config lies beyond infinity, or a far plane would have to be endless.
    """
    views, sway = sample_rig(config, generator_for)
    camera = max(views, key=lambda view: view.baseline_m)
    rng = generator_for(Purpose.BACKGROUND)
    kind = sample_kind(config.background, rng)
    may_be_sky = kind in ("plane", "street") and config.background.sky > 0
    sky = may_be_sky and bool(generator_for(Purpose.SKY).random() < config.background.sky)
    if kind == "room":
        things = sample_room(config, camera, catalogue, rng, sway)
    elif kind == "street":
        things = sample_street(config, camera, catalogue, rng, sway, sky=sky)
    else:
        if kind == "plane":
            background = sample_plane(config.background, config.disparity, camera, rng, sway, sky=sky)
        else:
            background = sample_cuboid(config.background, config.disparity, camera, rng, sway)
        rng = generator_for(Purpose.STRUCTURES)
        still = sample_surroundings(config.structures, config.disparity, camera, background, rng, sway)
        return StaticScene(camera, views, sway, kind, still, np.array([0.0, -1.0, 0.0]))
    up = things.view.camera_from_floor[:3, 2]
    return StaticScene(camera, views, sway, kind, _surroundings(things, sky=sky), up, things.farthest_m)


def _surroundings(things: Arrangement, *, sky: bool) -> Surroundings:
    """Measure how the left view shows an arrangement of still things; with ``sky`` the first thing is the sky."""
    view = things.view
    matrices = view.camera_from_floor @ np.array(things.floor_from_model)
    scene = _still_scene(view.camera, view.near_m, things.model, matrices, sky=sky)
    # A hidden thing has the depth of its origin.
    hidden_m = np.maximum(matrices[:, 2, 3], view.near_m)
    unit_m, wears, large = np.array(things.unit_m), np.array(things.wears), np.array(things.large)
    return _measured(scene, things.catalogue.models, unit_m, wears, large, hidden_m)


def _still_scene(camera: StereoCamera, near_m: float, model: list[int], matrices: Floats, *, sky: bool) -> Scene:
    """Return still things as a scene; with ``sky`` the first thing is the sky."""
    layer, is_sky = np.zeros(len(model), np.int64), np.arange(len(model)) < int(sky)
    return make_scene(camera, model=model, world_from_model=matrices, layer=layer, near_m=near_m, sky=is_sky)


def _measured(
    scene: Scene, models: Sequence[Mesh], unit_m: Floats, wears: Ints, large: Bools, hidden_m: Floats
) -> Surroundings:
    """Measure how the left view shows a scene of S still things.

    ``unit_m`` (S, 2), ``wears`` (S,) and ``large`` (S,) are as in `Arrangement`. The sky and hidden things get the
    depths ``hidden_m`` (S,).
    """
    seen = glance(scene, models)
    depth_m, (low, high) = hidden_m.copy(), np.zeros((2, len(scene), 2))
    for number in np.unique(seen.instance[seen.instance >= 0]):
        rays = seen.instance == number
        if not scene.sky[number]:
            depth_m[number] = np.median(seen.depth_m[rays])
        uv = np.sort(seen.uv[rays], axis=0)
        left_out = int(_LEFT_OUT * len(uv))
        low[number], high[number] = uv[left_out], uv[-1 - left_out]
    disparity_px = scene.camera.disparity_px(seen.depth_m)
    return Surroundings(
        scene.model,
        scene.world_from_model,
        wears,
        Surfaces(depth_m, unit_m, low, high, large),
        scene.sky,
        disparity_px[np.isfinite(disparity_px)],
    )


def sample_surroundings(
    section: StructuresSection,
    disparity: DisparitySection,
    camera: StereoCamera,
    background: Background,
    rng: np.random.Generator,
    sway: Sway = STILL,
) -> Surroundings:
    """Sample structures in front of a background, and measure how the left view shows both.

    No structure comes nearer than the depth of ``disparity.max_px`` in either view. Where the camera sways, only the
    ground keeps this distance, and the near plane cuts off panels that come too near.

    Raises:
        InputError: where ``ground_disparity_px`` or ``panel_disparity_px`` lies beyond infinity.
    """
    near_m = near_depth_m(camera, disparity)
    bare_px = background.disparity_px(camera)
    # Before a sky, the ground ends where its plane stands.
    farthest_m = float(background.offset_m[0]) if background.sky else float(camera.depth_m(bare_px.min()))
    structures = list[tuple[int, Floats]]()
    if rng.random() < section.ground:
        structures.append((_GROUND, _place_ground(section, camera, Range(near_m, farthest_m), rng, sway)))
    for _ in range(round(section.panels.sample(rng))):
        structures.append(_place_panel(section, disparity, camera, near_m, rng))
    # The UV of a ground goes along its x and z.
    sizes = [np.linalg.norm(matrix[:3, [0, 2 if number == _GROUND else 1]], axis=0) for number, matrix in structures]
    # A hidden structure has the depth of its nearest vertex.
    hidden_m = [max(_nearest_m(number, matrix), near_m) for number, matrix in structures]
    faces, count = len(background.size_m), len(background.size_m) + len(structures)
    model = [_FACE] * faces + [number for number, _ in structures]
    matrices = np.array([*background.world_from_face, *(matrix for _, matrix in structures)])
    still = _measured(
        _still_scene(camera, near_m / BEYOND_NEAR, model, matrices, sky=background.sky),
        STILL_MODELS,
        np.array([*background.size_m, *sizes]),
        np.arange(count),
        np.ones(count, bool),
        np.append(background.visible_depth_m, hidden_m),
    )
    # The background is measured as if nothing stood in front of it.
    still.surfaces.depth_m[:faces] = background.visible_depth_m
    return still if structures else replace(still, disparity_px=bare_px[np.isfinite(bare_px)])


def _nearest_m(model: int, matrix: Floats) -> float:
    """Return the depth of the nearest vertex of a still model."""
    return float((STILL_MODELS[model].positions.astype(np.float64) @ matrix[2, :3] + matrix[2, 3]).min())


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
        return section.ground_height_m.sample(rng)
    sampled_px = section.ground_disparity_px.sample(rng)
    check_reachable(camera, sampled_px, "structures.ground_disparity_px")
    below = (camera.height_px - 0.5 - camera.cy_px) / camera.focal_y_px
    return float(camera.depth_m(sampled_px)) * below


def _farther_half(disparity: DisparitySection, camera: StereoCamera) -> Range:
    """Return the disparities of the farther half of the config's range, where the halves have equal ratios."""
    if not disparity.signed:
        return Range(disparity.min_px, (disparity.min_px * disparity.max_px) ** 0.5)
    # Here the halves have equal ratios of depths, since disparities may lie on both sides of 0.
    nearness = (disparity.min_px + camera.doffs_px) * (disparity.max_px + camera.doffs_px)
    return Range(disparity.min_px, max(disparity.min_px, nearness**0.5 - camera.doffs_px))


def _place_panel(
    section: StructuresSection,
    disparity: DisparitySection,
    camera: StereoCamera,
    near_m: float,
    rng: np.random.Generator,
) -> tuple[int, Floats]:
    """Sample a panel; return the number of its model, and its pose (4, 4)."""
    curved = bool(rng.random() < section.panel_curved)
    number = _CURVED if curved else _FACE
    where = section.panel_disparity_px or _farther_half(disparity, camera)
    check_reachable(camera, where.low, "structures.panel_disparity_px")
    depth = float(camera.depth_m(where.sample(rng)))
    size = section.panel_size_px.sample_many(rng, 2) * depth / camera.focal_px
    x, y = rng.random(2) * (camera.width_px, camera.height_px) - 0.5
    slant = np.deg2rad(section.panel_slant_deg.sample(rng))
    towards, turn = rng.uniform(0, 2 * np.pi, 2)
    facing = bool(rng.random() < 0.5)
    normal = np.array([np.sin(slant) * np.cos(towards), np.sin(slant) * np.sin(towards), np.cos(slant)])
    first = cross(normal, np.array([np.sin(turn), np.cos(turn), 0.0]))
    first /= np.linalg.norm(first)
    second = cross(normal, first)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = first * size[0], second * size[1]
    matrix[:3, 2] = normal * size.mean() * (1 if facing else -1)
    # The origin of a face is its corner, and that of a curved panel is its middle.
    begin = np.zeros(3) if curved else -(matrix[:3, 0] + matrix[:3, 1]) / 2
    matrix[:3, 3] = begin
    nearest = float(placed_vertices(STILL_MODELS[number], matrix)[:, 2].min())
    depth = max(depth, BEYOND_NEAR * near_m - nearest)
    matrix[:3, 3] = begin + camera.rays("left", np.array(x), np.array(y)) * depth
    return number, matrix
