"""Large still things between background and particles: a ground plane, slanted panels, curved panels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import StereoCamera
from semisynth_gl.config import Range
from semisynth_gl.config.model import DisparitySection, StructuresSection
from semisynth_gl.geometry.mesh import Mesh, make_mesh
from semisynth_gl.scene.background import (
    BEYOND_NEAR,
    FACE,
    Background,
    corner_rays,
    grid_px,
    smallest_offsets,
)
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.rig import STILL, Sway, check_reachable, near_depth_m
from semisynth_gl.scene.scene import make_scene

Floats = NDArray[np.float64]

_GROUND_ROWS, _GROUND_COLUMNS = 24, 8
# The ground's nearest row, as a share of its length.
_GROUND_FROM = 1 / 400
_ARC_COLUMNS, _ARC_ROWS = 24, 4
_HALF_ARC_RAD = np.pi / 3


def _grid(rows: int, columns: int) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Rows and columns, 0 to 1, of a grid's vertices, and its triangles."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    below = first + columns + 1
    triangles = np.concatenate([np.stack([first, first + 1, below + 1], 1), np.stack([first, below + 1, below], 1)])
    return u.ravel(), v.ravel(), triangles


def _ground() -> Mesh:
    """A wedge with its tip at the origin, 1 long, 2 wide at its end; rows close up towards the tip.

    float32 rounds a vertex by its distance: what is near should not hang between vertices far away.
    """
    u, v, triangles = _grid(_GROUND_ROWS, _GROUND_COLUMNS)
    along = _GROUND_FROM ** (1 - v)
    across = (2 * u - 1) * along
    return make_mesh("ground", np.c_[across, np.zeros(len(u)), along], np.c_[across, along], triangles)


def _curved_panel() -> Mesh:
    """A third of a cylinder over the unit square about the origin, its middle towards -z; u along the arc."""
    u, v, triangles = _grid(_ARC_ROWS, _ARC_COLUMNS)
    radius = 0.5 / np.sin(_HALF_ARC_RAD)
    angle = (2 * u - 1) * _HALF_ARC_RAD
    middle = radius * (1 + np.cos(_HALF_ARC_RAD)) / 2
    return make_mesh(
        "curved panel",
        np.c_[radius * np.sin(angle), v - 0.5, middle - radius * np.cos(angle)],
        np.c_[radius * angle, v],
        triangles,
    )


GROUND, CURVED_PANEL = _ground(), _curved_panel()
# How the sampler counts them: the background's face comes first, and flat panels are faces too.
STILL_MODELS = (FACE, GROUND, CURVED_PANEL)
_FACE, _GROUND, _CURVED = range(3)


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """All that stands still in one scene: S instances, the background's faces first.

    Attributes:
        model: (S,) int64, index into `STILL_MODELS`.
        world_from_model: (S, 4, 4) float64, left camera's frame, metres.
        unit_m: (S, 2) float64, length of one UV unit.
        depth_m: (S,) float64, median depth in the left view, or nearest depth where it is not seen.
        disparity_px: flat float64, disparities on a coarse grid over the left view.
    """

    model: NDArray[np.int64]
    world_from_model: Floats
    unit_m: Floats
    depth_m: Floats
    disparity_px: Floats

    def __len__(self) -> int:
        return len(self.model)


def draw_surroundings(
    section: StructuresSection,
    disparity: DisparitySection,
    camera: StereoCamera,
    background: Background,
    rng: np.random.Generator,
    sway: Sway = STILL,
) -> Surroundings:
    """Put structures before a background.

    Nothing of them comes nearer than the depth of ``disparity.max_px`` in either view; where the camera sways, that
    holds for the ground alone, and the near plane cuts panels off that come too near.

    Raises:
        InputError: where ``panel_disparity_px`` lies beyond infinity.
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
        matrices.append(_place_ground(section, camera, near_m, farthest_m, rng, sway))
    for _ in range(round(section.panels.draw(rng))):
        curved = bool(rng.random() < section.panel_curved)
        model.append(_CURVED if curved else _FACE)
        matrices.append(_place_panel(section, disparity, camera, near_m, rng, curved=curved))
    if len(model) > faces:
        x, y = grid_px(camera)
        scene = make_scene(
            camera, model=model, world_from_model=matrices, layer=[0] * len(model), near_m=near_m / BEYOND_NEAR
        )
        hits = cast_rays(scene, STILL_MODELS, "left", x, y)
        seen_px = camera.disparity_px(hits.depth_m)
        for number in range(faces, len(model)):
            columns = np.linalg.norm(matrices[number][:3, :3], axis=0)
            units.append((columns[0], columns[2]) if model[number] == _GROUND else (columns[0], columns[1]))
            of = hits.depth_m[hits.instance == number]
            depths.append(float(np.median(of)) if of.size else _nearest_m(model[number], matrices[number], near_m))
    return Surroundings(
        np.array(model, np.int64), np.array(matrices), np.array(units), np.array(depths), seen_px[np.isfinite(seen_px)]
    )


def _nearest_m(model: int, world_from_model: Floats, near_m: float) -> float:
    """Depth of a structure's nearest vertex, or of the near plane where that is farther."""
    depth = STILL_MODELS[model].positions.astype(np.float64) @ world_from_model[2, :3] + world_from_model[2, 3]
    return max(float(depth.min()), near_m)


def _place_ground(
    section: StructuresSection,
    camera: StereoCamera,
    near_m: float,
    farthest_m: float,
    rng: np.random.Generator,
    sway: Sway,
) -> Floats:
    height = section.ground_height_m.draw(rng)
    roll, pitch = np.deg2rad(rng.uniform(-section.ground_tilt_deg, section.ground_tilt_deg, 2))
    across = np.array([np.cos(roll), np.sin(roll), 0.0])
    along = np.array([-np.sin(roll) * np.sin(pitch), np.cos(roll) * np.sin(pitch), np.cos(pitch)])
    down = np.cross(along, across)
    offset = max(height, float(smallest_offsets(camera, down[None], near_m, sway)[0]))
    # The wedge's tip lies so far behind that both views fit between its sides.
    widest = float(np.abs(corner_rays(camera)[:, 0]).max()) * 1.1
    behind = abs(camera.offset_m("right")) / widest + 0.5 * near_m
    length = behind + 1.05 * farthest_m
    matrix = np.eye(4)
    matrix[:3, 0] = across * length * widest
    matrix[:3, 1] = down * length
    matrix[:3, 2] = along * length
    matrix[:3, 3] = down * offset - along * behind
    return matrix


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
