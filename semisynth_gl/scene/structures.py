"""The stage of a sequence: its camera, background and structures (a ground plane, slanted panels, curved panels)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import StereoCamera
from semisynth_gl.config import Range
from semisynth_gl.config.model import Config
from semisynth_gl.config.scene_sections import DisparitySection, StructuresSection
from semisynth_gl.geometry.mesh import Mesh, make_mesh, mesh_grid
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.scene.arrangement import Arrangement, Catalogue
from semisynth_gl.scene.background import (
    FACE,
    Background,
    Kind,
    draw_background,
    draw_kind,
    lay_ground,
    smallest_offsets,
)
from semisynth_gl.scene.glance import glance
from semisynth_gl.scene.rig import BEYOND_NEAR, STILL, Sway, check_reachable, draw_camera, draw_sway, near_depth_m
from semisynth_gl.scene.room import DOORWAYS, NICHES, draw_room
from semisynth_gl.scene.scene import make_scene
from semisynth_gl.scene.street import draw_street
from semisynth_gl.seeds import Purpose

Floats = NDArray[np.float64]

_GROUND_ROWS, _GROUND_COLUMNS = 24, 8
# The ground's nearest row, as a share of its length.
_GROUND_FROM = 1 / 400
_ARC_COLUMNS, _ARC_ROWS = 24, 4
_HALF_ARC_RAD = np.pi / 3


def _ground() -> Mesh:
    """A wedge with its tip at the origin, 1 long, 2 wide at its end; rows close up towards the tip.

    float32 rounds a vertex by its distance: a near surface must not hang between vertices far away.
    """
    u, v, triangles = mesh_grid(_GROUND_ROWS, _GROUND_COLUMNS)
    along = _GROUND_FROM ** (1 - v)
    across = (2 * u - 1) * along
    return make_mesh("ground", np.c_[across, np.zeros(len(u)), along], np.c_[across, along], triangles)


def _curved_panel() -> Mesh:
    """A third of a cylinder over the unit square about the origin, its middle towards -z; u along the arc."""
    u, v, triangles = mesh_grid(_ARC_ROWS, _ARC_COLUMNS)
    radius = 0.5 / np.sin(_HALF_ARC_RAD)
    angle = (2 * u - 1) * _HALF_ARC_RAD
    middle = radius * (1 + np.cos(_HALF_ARC_RAD)) / 2
    points = np.c_[radius * np.sin(angle), v - 0.5, middle - radius * np.cos(angle)]
    return make_mesh("curved panel", points, np.c_[radius * angle, v], triangles)


GROUND, CURVED_PANEL = _ground(), _curved_panel()
# The sampler counts them in this order. Flat panels are faces too.
STILL_MODELS = (FACE, GROUND, CURVED_PANEL, *DOORWAYS, *NICHES)
_FACE, _GROUND, _CURVED = range(3)
_DOORWAY = 3
_NICHE = _DOORWAY + len(DOORWAYS)


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
        disparity_px: flat float64, disparities on a coarse grid over the left view.
    """

    model: NDArray[np.int64]
    world_from_model: Floats
    unit_m: Floats
    wears: NDArray[np.int64]
    large: NDArray[np.bool_]
    depth_m: Floats
    disparity_px: Floats

    def __len__(self) -> int:
        return len(self.model)


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The camera of one sequence, and the still things that it sees.

    Attributes:
        camera: the camera.
        sway: the motion of the camera.
        background: its kind.
        still: background and structures.
    """

    camera: StereoCamera
    sway: Sway
    background: Kind
    still: Surroundings


def take_stock(library: ModelLibrary) -> Catalogue:
    """Return the still models and a library's as those that things at rest are taken from."""
    return Catalogue.of(STILL_MODELS, library.models, library.drawn[library.chances > 0])


def draw_stage(config: Config, catalogue: Catalogue, generator_for: Callable[[Purpose], np.random.Generator]) -> Stage:
    """Draw the stage of one sequence.

    Args:
        config: the configuration.
        catalogue: the models of things at rest, see `take_stock`.
        generator_for: returns the generator of CAMERA, SWAY, BACKGROUND and STRUCTURES.

    Raises:
        InputError: where a disparity of the config lies beyond infinity, or a far plane would have to be endless.
    """
    camera = draw_camera(config.camera, generator_for(Purpose.CAMERA))
    sway = draw_sway(config.camera, generator_for(Purpose.SWAY))
    rng = generator_for(Purpose.BACKGROUND)
    kind = draw_kind(config.background, rng)
    if kind == "room":
        numbers = {"doorway": _DOORWAY, "niche": _NICHE}
        things = draw_room(config.room, config.background, config.disparity, camera, catalogue, numbers, rng, sway)
    elif kind == "street":
        things = draw_street(config.street, config.background, config.disparity, camera, catalogue, _GROUND, rng, sway)
    else:
        background = draw_background(kind, config.background, config.disparity, camera, rng, sway)
        still = draw_surroundings(
            config.structures, config.disparity, camera, background, generator_for(Purpose.STRUCTURES), sway
        )
        return Stage(camera, sway, kind, still)
    return Stage(camera, sway, kind, _seen(things))


def _seen(things: Arrangement) -> Surroundings:
    """Measure what the camera sees of things at rest, on a coarse grid over the left view."""
    view = things.view
    matrices = view.camera_from_floor @ np.array(things.floor_from_model)
    model, layer = np.array(things.model), np.zeros(len(things), np.int64)
    scene = make_scene(view.camera, model=model, world_from_model=matrices, layer=layer, near_m=view.near_m)
    depth_m, instance = glance(scene, things.catalogue.models)
    # What is hidden has the depth of its origin, or of the near plane where that is farther.
    depths = np.maximum(matrices[:, 2, 3], view.near_m)
    for number in np.unique(instance[instance >= 0]):
        depths[number] = np.median(depth_m[instance == number])
    seen_px = view.camera.disparity_px(depth_m)
    return Surroundings(
        model,
        matrices,
        np.array(things.unit_m),
        np.array(things.wears),
        np.array(things.large),
        depths,
        seen_px[np.isfinite(seen_px)],
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
    faces = len(background.size_m)
    model = [_FACE] * faces
    matrices = list(background.world_from_face)
    units = [tuple(size) for size in background.size_m]
    depths = background.visible_depth_m.tolist()
    seen_px = background.disparity_px(camera)
    near_m = near_depth_m(camera, disparity)
    farthest_m = float(camera.depth_m(seen_px.min()))
    if rng.random() < section.ground:
        model.append(_GROUND)
        matrices.append(_place_ground(section, camera, Range(near_m, farthest_m), rng, sway))
    for _ in range(round(section.panels.draw(rng))):
        curved = bool(rng.random() < section.panel_curved)
        model.append(_CURVED if curved else _FACE)
        matrices.append(_place_panel(section, disparity, camera, near_m, rng, curved=curved))
    if len(model) > faces:
        layer = [0] * len(model)
        scene = make_scene(camera, model=model, world_from_model=matrices, layer=layer, near_m=near_m / BEYOND_NEAR)
        depth_m, instance = glance(scene, STILL_MODELS)
        seen_px = camera.disparity_px(depth_m)
        for number in range(faces, len(model)):
            columns = np.linalg.norm(matrices[number][:3, :3], axis=0)
            units.append((columns[0], columns[2 if model[number] == _GROUND else 1]))
            seen_m = depth_m[instance == number]
            # A hidden structure has the depth of its nearest vertex, or of the near plane where the plane is farther.
            vertices = STILL_MODELS[model[number]].positions.astype(np.float64)
            nearest_m = float((vertices @ matrices[number][2, :3] + matrices[number][2, 3]).min())
            depths.append(float(np.median(seen_m)) if seen_m.size else max(nearest_m, near_m))
    seen_px = seen_px[np.isfinite(seen_px)]
    wears = np.arange(len(model))
    return Surroundings(
        np.array(model, np.int64),
        np.array(matrices),
        np.array(units),
        wears,
        np.ones(len(model), bool),
        np.array(depths),
        seen_px,
    )


def _place_ground(
    section: StructuresSection, camera: StereoCamera, depth_m: Range, rng: np.random.Generator, sway: Sway
) -> Floats:
    height = _ground_height_m(section, camera, rng)
    roll, pitch = np.deg2rad(rng.uniform(-section.ground_tilt_deg, section.ground_tilt_deg, 2))
    across = np.array([np.cos(roll), np.sin(roll), 0.0])
    along = np.array([-np.sin(roll) * np.sin(pitch), np.cos(roll) * np.sin(pitch), np.cos(pitch)])
    offset = max(height, float(smallest_offsets(camera, np.cross(along, across)[None], depth_m.low, sway)[0]))
    return lay_ground(camera, depth_m, across, along, offset)


def _ground_height_m(section: StructuresSection, camera: StereoCamera, rng: np.random.Generator) -> float:
    if section.ground_disparity_px is None:
        return section.ground_height_m.draw(rng)
    drawn_px = section.ground_disparity_px.draw(rng)
    check_reachable(camera, drawn_px, "structures.ground_disparity_px")
    below = (camera.height_px - 0.5 - camera.cy_px) / camera.focal_px
    return float(camera.depth_m(drawn_px)) * below


def _place_panel(
    section: StructuresSection,
    disparity: DisparitySection,
    camera: StereoCamera,
    near_m: float,
    rng: np.random.Generator,
    *,
    curved: bool,
) -> Floats:
    where = section.panel_disparity_px or Range(disparity.min_px, (disparity.min_px * disparity.max_px) ** 0.5)
    check_reachable(camera, where.low, "structures.panel_disparity_px")
    depth = float(camera.depth_m(where.draw(rng)))
    size = section.panel_size_px.draw_many(rng, 2) * depth / camera.focal_px
    x, y = rng.random(2) * (camera.width_px, camera.height_px) - 0.5
    slant = np.deg2rad(section.panel_slant_deg.draw(rng))
    towards, turn = rng.uniform(0, 2 * np.pi, 2)
    facing = bool(rng.random() < 0.5)
    normal = np.array([np.sin(slant) * np.cos(towards), np.sin(slant) * np.sin(towards), np.cos(slant)])
    first = np.cross(normal, [np.sin(turn), np.cos(turn), 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
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
