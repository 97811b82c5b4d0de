"""Samples the static scene of a sequence: its rig, and all its instances except the particles."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from semisynth_gl.config import Config, Range
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.mesh import Mesh, cross
from semisynth_gl.scene import Floats
from semisynth_gl.scene.background import BackgroundKind, lay_ground, sample_cuboid, sample_kind, sample_plane
from semisynth_gl.scene.catalogue import CURVED_PANEL, FACE, GROUND, SURFACE_MODELS, ModelCatalogue
from semisynth_gl.scene.instances import INSTANCE, Instances, new_instances
from semisynth_gl.scene.left_view import GRID, measure_left_view
from semisynth_gl.scene.rig import BEYOND_NEAR, SequenceRig, sample_rig
from semisynth_gl.scene.room import sample_room
from semisynth_gl.scene.scene import transform_vertices
from semisynth_gl.scene.street import sample_street
from semisynth_gl.scene.view_volume import smallest_offsets
from semisynth_gl.seeds.seeds import Purpose


@dataclass(frozen=True, slots=True, eq=False)
class StaticScene:
    """The part of a scene that all frames of a sequence share."""

    rig: SequenceRig
    background: BackgroundKind
    instances: Instances  # first the background's faces (the backdrop of a street), then everything in front of them
    bare_px: Floats  # (R,) disparities of the left view, on the coarse grid of `grid_px`
    up: Floats  # (3,) unit vector upwards, in the left camera's frame
    farthest_m: float  # intended maximum depth in the views of a room; inf for other backgrounds


def sample_static_scene(
    config: Config, catalogue: ModelCatalogue, generator_for: Callable[[Purpose], np.random.Generator]
) -> StaticScene:
    """Sample the static scene of one sequence.

    ``generator_for`` returns the generator for CAMERA, RIG, SWAY, BACKGROUND, STRUCTURES and SKY. Raises InputError as
    `near_depth_m` and `sample_plane` do.
    """
    rig = sample_rig(config, generator_for)
    camera, near_m, rng = rig.camera, rig.near_m, generator_for(Purpose.BACKGROUND)
    kind = sample_kind(config.background, rng)
    may_be_sky = kind in ("plane", "street") and config.background.sky > 0
    sky = may_be_sky and bool(generator_for(Purpose.SKY).random() < config.background.sky)
    if kind in ("room", "street"):
        if kind == "room":
            builder = sample_room(config, rig, catalogue, rng)
        else:
            builder = sample_street(config, rig, catalogue, rng, sky=sky)
        table = builder.table()
        table["sky"][0] = sky
        bare_px = measure_left_view(table, camera, near_m, catalogue.models)
        return StaticScene(rig, kind, table, bare_px, builder.camera_from_floor[:3, 2], builder.farthest_m)
    if kind == "plane":
        background = sample_plane(config, rig, rng, sky=sky)
        seen_m = np.full(GRID[0] * GRID[1], np.inf if sky else background["depth_m"])
    else:
        background, seen_m = sample_cuboid(config, rig, rng)
    bare_px = camera.disparity_px(seen_m)
    # Below a sky, the ground ends at the sky's ``depth_m``.
    far_m = float(background["depth_m"][0] if sky else camera.depth_m(bare_px.min()))
    structures = sample_structures(config, rig, far_m, generator_for(Purpose.STRUCTURES))
    table = np.concatenate([background, structures], dtype=INSTANCE)
    table["texture"] = np.arange(len(table))
    # The background keeps its depths (``fixed``). The near plane is a little nearer here, so that it clips no wall.
    seen_px = measure_left_view(table, camera, near_m / BEYOND_NEAR, catalogue.models, fixed=len(background))
    bare_px = seen_px if len(structures) else bare_px
    return StaticScene(rig, kind, table, bare_px, np.array([0.0, -1.0, 0.0]), np.inf)


def sample_structures(config: Config, rig: SequenceRig, far_m: float, rng: np.random.Generator) -> Instances:
    """Sample ground and panels in front of a background of depth ``far_m``; ``depth_m`` is that of the nearest vertex.

    All are beyond the near plane, but a swaying camera may come so near to a panel that the near plane clips it.
    """
    section, sampled = config.structures, list[tuple[Mesh, Floats]]()
    if rng.random() < section.ground:
        sampled.append((GROUND, _sample_ground(config, rig, far_m, rng)))
    sampled.extend(_sample_panel(config, rig, rng) for _ in range(round(section.panels.sample(rng))))
    table = new_instances(len(sampled), large=True)
    for row, (model, pose) in zip(table, sampled, strict=True):
        nearest_m = (model.positions.astype(np.float64) @ pose[2, :3] + pose[2, 3]).min()
        row["model"], row["pose"] = SURFACE_MODELS.index(model), pose
        row["depth_m"] = max(float(nearest_m), rig.near_m)
        # The UV of a ground runs along the model's x and z, other UV along x and y.
        row["unit_m"] = np.linalg.norm(pose[:3, [0, 2 if model is GROUND else 1]], axis=0)
    return table


def _sample_ground(config: Config, rig: SequenceRig, far_m: float, rng: np.random.Generator) -> Floats:
    """Sample the pose (4, 4) of a ground."""
    section, camera = config.structures, rig.camera
    if section.ground_disparity_px is None:
        height = section.ground_height_m.sample(rng)
    else:
        sampled_px = section.ground_disparity_px.sample(rng)
        height = float(camera.depth_m(sampled_px)) * ((camera.height_px - 0.5 - camera.cy_px) / camera.focal_y_px)
    roll, pitch = np.deg2rad(rng.uniform(-section.ground_tilt_deg, section.ground_tilt_deg, 2))
    across = np.array([np.cos(roll), np.sin(roll), 0.0])
    along = np.array([-np.sin(roll) * np.sin(pitch), np.cos(roll) * np.sin(pitch), np.cos(pitch)])
    offset = max(height, float(smallest_offsets(rig, cross(along, across)[None])[0]))
    return lay_ground(camera, Range(rig.near_m, far_m), across, along, offset)


def _farther_half(config: Config, camera: StereoCamera) -> Range:
    """Return the farther half of the config's range of disparities; both halves have the same ratio max / min."""
    disparity = config.disparity
    if not disparity.signed:
        return Range(disparity.min_px, (disparity.min_px * disparity.max_px) ** 0.5)
    # Disparities may be on both sides of 0, so split the range where both halves have the same ratio of depths.
    product = (disparity.min_px + camera.doffs_px) * (disparity.max_px + camera.doffs_px)
    return Range(disparity.min_px, max(disparity.min_px, product**0.5 - camera.doffs_px))


def _sample_panel(config: Config, rig: SequenceRig, rng: np.random.Generator) -> tuple[Mesh, Floats]:
    """Sample a panel; return its model, and its pose (4, 4)."""
    section, camera = config.structures, rig.camera
    curved = bool(rng.random() < section.panel_curved)
    model = CURVED_PANEL if curved else FACE
    disparity_px = section.panel_disparity_px or _farther_half(config, camera)
    depth = float(camera.depth_m(disparity_px.sample(rng)))
    size = section.panel_size_px.sample_many(rng, 2) * depth / camera.focal_px
    x, y = rng.random(2) * (camera.width_px, camera.height_px) - 0.5
    slant = np.deg2rad(section.panel_slant_deg.sample(rng))
    azimuth, turn = rng.uniform(0, 2 * np.pi, 2)
    facing = bool(rng.random() < 0.5)
    normal = np.array([np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.cos(slant)])
    edge = cross(normal, np.array([np.sin(turn), np.cos(turn), 0.0]))
    edge /= np.linalg.norm(edge)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = edge * size[0], cross(normal, edge) * size[1]
    matrix[:3, 2] = normal * size.mean() * (1 if facing else -1)
    # The origin of a face is its corner; the origin of a curved panel is its middle.
    origin = np.zeros(3) if curved else -(matrix[:3, 0] + matrix[:3, 1]) / 2
    matrix[:3, 3] = origin
    nearest = float(transform_vertices(model, matrix)[:, 2].min())
    depth = max(depth, rig.clear_m - nearest)
    matrix[:3, 3] = origin + camera.rays("left", np.array(x), np.array(y)) * depth
    return model, matrix
