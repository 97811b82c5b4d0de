"""Rooms and streets: no gaps, nothing too near, and furniture stands upright on a surface."""

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from samplers import catalogue, sampler_of, static_scene_of, still_rig
from scenes import noise_layers
from tiny_datasets import CLUTTER_ALONE

from semisynth_gl import load_config
from semisynth_gl.config.scene_sections import RoomSection, StreetSection
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.scene.catalogue import DOORWAYS, FACE, NICHES, SURFACE_MODELS
from semisynth_gl.scene.furnishing import _HANGING
from semisynth_gl.scene.instances import to_scene
from semisynth_gl.scene.left_view import grid_px, left_view_hits
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.room import sample_room
from semisynth_gl.scene.scene import make_scene
from semisynth_gl.scene.street import sample_street

KINDS = {"room": "middlebury", "street": "kitti"}
SECTIONS = {"room": RoomSection, "street": StreetSection}
CAMERAS = {
    "middlebury": (StereoCamera.centred(1500, 1000, 1900.0, 0.25, 120.0), 290.0),
    "kitti": (StereoCamera.centred(1242, 375, 721.5, 0.54), 192.0),
    "eth3d": (StereoCamera.centred(942, 489, 541.8, 0.06), 64.0),
}


@cache
def furnished(rig, kind, *overrides):
    weights = [f"background.{name}={int(name == kind)}" for name in ("cuboid", "plane", "room", "street")]
    variants = ["models.variants=1", "particles.layers=[]", "disparity.target={form: uniform}"]
    return load_config(rig, [*CLUTTER_ALONE, *weights, *variants, *overrides])


def arranged(kind, seed, rig=None, **keys):
    """Sample a room or a street with changed keys of its section."""
    rig = rig or KINDS[kind]
    config = furnished(rig, kind).model_copy(update={kind: SECTIONS[kind].model_validate(keys)})
    sample = sample_room if kind == "room" else sample_street
    return sample(config, still_rig(*CAMERAS[rig]), catalogue(), np.random.default_rng(seed))


def bordering(camera, columns, rows):
    """Return a grid of pixel positions from border to border of a view."""
    x, y = np.meshgrid(
        np.linspace(-0.37, camera.width_px - 0.61, columns), np.linspace(-0.41, camera.height_px - 0.57, rows)
    )
    return x.ravel(), y.ravel()


@pytest.mark.parametrize("rig", CAMERAS)
@pytest.mark.parametrize("kind", KINDS)
def test_every_ray_of_both_eyes_hits_something_within_the_limits(rig, kind):
    config = furnished(rig, kind)
    for seed in range(2):
        static = static_scene_of(config, seed)
        camera, near_m = static.rig.camera, static.rig.near_m
        # This near plane is 100 times nearer than the rig's, so that it clips nothing.
        scene = to_scene(static.instances, camera, 0.01 * near_m)
        for eye in EYES:
            depth_m = cast_rays(scene, catalogue().models, eye, *bordering(camera, 23, 17)).depth_m
            assert near_m < depth_m.min() <= depth_m.max() < camera.depth_m(0)


def first_hit(triangles, origin, direction):
    """Return the distance to the first of triangles (T, 3, 3) that a ray hits, in units of its direction's length."""
    corner, first, second = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(first, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((corner - origin) * normal).sum(axis=1) / (normal @ direction)
        at = origin + distance[:, None] * direction - corner
        u, v = ((np.cross(*sides) * normal).sum(axis=1) for sides in ((at, second), (first, at)))
        hit = (u >= 0) & (v >= 0) & (u + v <= (normal**2).sum(axis=1)) & (distance >= 0)
    return float(distance[hit].min(initial=np.inf))


def corners_of(things):
    """Return each thing's triangles (T, 3, 3) in the floor's frame."""
    both = [(things.catalogue.models[thing["model"]], thing["pose"]) for thing in things.things]
    return [(mesh.positions.astype(float) @ pose[:3, :3].T + pose[:3, 3])[mesh.triangles] for mesh, pose in both]


@pytest.mark.parametrize("kind", KINDS)
def test_things_at_rest_stand_upright_and_on_something(kind):
    bearers = Counter()
    for seed in range(2):
        things = arranged(kind, seed, **({"pictures": 20} if kind == "room" else {}))
        corners = corners_of(things)
        for k, thing in enumerate(things.things):
            number, matrix = thing["model"], thing["pose"]
            if number < len(SURFACE_MODELS):
                continue
            points = corners[k].reshape(-1, 3)
            up, back = (matrix[:3, column] / np.linalg.norm(matrix[:3, column]) for column in (2, 1))
            np.testing.assert_allclose(up, (0, 0, 1), atol=1e-12)
            assert things.depths_m(points).min() > things.rig.near_m
            size, lowest = np.ptp(points, axis=0).max(), points[:, 2].min()
            assert lowest > -1e-6 * size
            if lowest < 1e-6 * size:
                bearers["floor"] += 1
                continue
            # Rays: downwards from just above its foot, and backwards from its middle to a wall or picture.
            others = np.concatenate(corners[:k] + corners[k + 1 :])
            below = first_hit(others, np.array([*matrix[:2, 3], lowest + 1e-4 * size]), np.array([0, 0, -1.0]))
            behind = first_hit(others, matrix[:3, 3], back) - ((points - matrix[:3, 3]) @ back).max()
            assert below < 1e-3 * size or abs(behind) < 0.1 * size, (seed, things.catalogue.models[number].name)
            bearers["thing" if below < 1e-3 * size else "wall"] += 1
    assert bearers["floor"] > 10
    assert bearers["thing"] > 10
    assert (bearers["wall"] > 0) == (kind == "room")


def test_the_sides_of_a_box_wear_one_texture_and_are_the_size_that_they_say():
    things = arranged("room", 0)
    # Some walls have a corner behind the camera.
    assert things.table()["depth_m"].min() == things.rig.near_m
    for texture in (None, 3):
        first = things.add_box((0, 3, 0), (1, 0.4, 1.5), 0.4, texture)
        sides = things.things[first:]
        assert [side["texture"] for side in sides] == [first if texture is None else texture] * 5
        for side, corners in zip(sides, corners_of(things)[first:], strict=True):
            mesh = things.catalogue.models[side["model"]]
            in_uv = np.diff(mesh.uv[mesh.triangles].astype(float), axis=1) * side["unit_m"]
            np.testing.assert_allclose(
                np.linalg.norm(np.diff(corners, axis=1), axis=2), np.linalg.norm(in_uv, axis=2), rtol=1e-3
            )


def is_of(number, *names):
    return catalogue().models[number].name in names


def count(things):
    return len(things.things)


def number_of(*names):
    return lambda things: sum(is_of(thing["model"], *names) for thing in things.things)


def gap_of_fences(things):
    return np.ptp([thing["pose"][0, 3] for thing in things.things if is_of(thing["model"], "fence")])


def height(things):
    return float(-things.camera_from_floor[:3, 2] @ things.camera_from_floor[:3, 3])


# For each key: two values, a measure that is larger for the second value, and other keys to set.
EFFECTS = {
    "room": {
        "camera_height_m": (0.9, 1.7, height, {}),
        "floor_row": (0.5, 1.0, lambda things: things.camera_from_floor[2, 2], {}),
        "roll_deg": (0, 20, lambda things: abs(things.camera_from_floor[0, 2]), {}),
        "furniture": (0, 20, count, {"small": 0}),
        "small": (0, 40, count, {}),
        "pictures": (0, 20, count, {}),
        "doorway": (0, 1, number_of("wall with a doorway"), {}),
        "niche": (0, 1, number_of("wall with a niche"), {"doorway": 0}),
        "pillars": (0, 10, count, {"furniture": 0, "small": 0}),
        "rug": (0, 1, count, {"furniture": 0, "small": 0, "pillars": 0}),
        "curtain": (0, 1, number_of("curtain"), {"pictures": 0}),
    },
    "street": {
        "camera_height_m": (1.2, 3, height, {}),
        "yaw_deg": (0, 30, lambda things: abs(things.camera_from_floor[2, 0]), {}),
        "tilt_deg": (0, 20, lambda things: abs(things.camera_from_floor[0, 2]), {}),
        "road_width_m": (4, 30, gap_of_fences, {"houses": 0, "fences": 1}),
        "pavement": (0, 1, count, {"vehicles": 0, "tall": 0, "low": 0, "houses": 0, "fences": 0}),
        "houses": (0, 1, number_of("face", "house"), {"fences": 0}),
        "fences": (0, 1, number_of("fence"), {"houses": 0}),
        "vehicles": (0, 30, number_of("face", "car"), {"houses": 0}),
        "tall": (0, 40, number_of("tree", "scaffold"), {}),
        "low": (0, 60, number_of("grass", "chair", "table", "potted_plant"), {}),
    },
}


@pytest.mark.parametrize("kind", KINDS)
def test_each_key_of_rooms_and_streets_does_what_it_says(kind):
    assert EFFECTS[kind].keys() == SECTIONS[kind].model_fields.keys()
    for key, (low, high, measure, others) in EFFECTS[kind].items():
        less, more = (
            sum(measure(arranged(kind, seed, "kitti", **others, **{key: value})) for seed in range(2))
            for value in (low, high)
        )
        assert more > less + 1e-3, key


@pytest.mark.parametrize("fy_over_fx", [1.0, 1.3])
def test_the_left_view_cuts_triangles_at_the_near_plane(fy_over_fx):
    """Most of the random triangles have one or two corners behind the camera."""
    camera = replace(CAMERAS["kitti"][0], fy_over_fx=fy_over_fx)
    corners = np.random.default_rng(2).uniform((-4, -2, -2), (4, 2, 4), (60, 3, 3))
    pose = np.tile(np.eye(4), (60, 1, 1))
    pose[:, :3, :3] = np.linalg.qr(np.random.default_rng(3).normal(size=(60, 3, 3)))[0]
    pose[:, :3, 3] = corners[:, 0]
    triangles = [
        make_mesh(str(k), (points - points[0]) @ pose[k, :3, :3], points[:, :2], [[0, 1, 2]])
        for k, points in enumerate(corners)
    ]
    scene = make_scene(camera, model=range(60), world_from_model=pose, layer=[0] * 60, near_m=0.5)
    beyond = (corners[..., 2] >= scene.near_m).sum(axis=1)
    assert min((beyond == 1).sum(), (beyond == 2).sum()) > 10
    seen = left_view_hits(scene, triangles)
    hits = cast_rays(scene, triangles, "left", *grid_px(camera))
    np.testing.assert_array_equal(seen.instance, hits.instance)
    np.testing.assert_allclose(seen.depth_m, hits.depth_m, rtol=1e-9)
    # UV equals x and y at the corners; clipping must interpolate it.
    points = camera.rays("left", *grid_px(camera)) * seen.depth_m[:, None]
    hit = seen.instance >= 0
    np.testing.assert_allclose(seen.uv[hit], points[hit, :2], atol=1e-6)


# Left and right edges of holes, as shares of a wall's width.
HOLES = (0.12, 0.4), (0.37, 0.63), (0.6, 0.88)


def test_walls_are_open_where_they_have_a_hole_and_closed_elsewhere():
    for walls, (top, bottom) in ((DOORWAYS, (0.2, 1.0)), (NICHES, (0.3, 0.62))):
        for wall, (left, right) in zip(walls, HOLES, strict=True):
            corners = wall.positions[wall.triangles].astype(float)
            x, y, _ = corners.mean(axis=1).T
            assert not ((left < x) & (x < right) & (top < y) & (y < bottom)).any()
            areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
            assert areas.min() > 0
            assert areas.sum() == pytest.approx(1 - (right - left) * (bottom - top), rel=1e-5)


@pytest.mark.parametrize("hole", ["doorway", "niche"])
def test_what_hangs_on_a_wall_meets_neither_its_hole_nor_its_ends_nor_each_other(hole):
    hung = 0
    keys = dict.fromkeys(("furniture", "small", "curtain", "pillars", "rug", "doorway", "niche"), 0) | {hole: 1}
    for seed in range(8):
        things = arranged("room", seed, pictures=60, **keys)
        placed = [(things.catalogue.models[thing["model"]], thing["pose"]) for thing in things.things]
        for wall, wall_pose in placed:
            if wall not in (*DOORWAYS, *NICHES):
                continue
            top, bottom = (0.2, 1.0) if wall in DOORWAYS else (0.3, 0.62)
            left, right = HOLES[(DOORWAYS if wall in DOORWAYS else NICHES).index(wall)]
            boxes = [(np.array([left, top]), np.array([right, bottom]))]
            for mesh, pose in placed:
                points = np.c_[mesh.positions, np.ones(len(mesh.positions))] @ (np.linalg.inv(wall_pose) @ pose).T
                low, high = points[:, :3].min(axis=0), points[:, :3].max(axis=0)
                # Skip the sides of pictures, of this wall or of the next one.
                is_front = mesh is FACE and high[2] - low[2] < 1e-9 and (high - low)[0] > 0.02
                beside = low[0] > 1 - 1e-3 or high[0] < 1e-3  # a niche behind the next wall
                if low[2] > -0.1 and high[2] < -1e-6 and (mesh.name in _HANGING or is_front) and not beside:
                    assert low[:2].min() > -1e-3
                    assert high[:2].max() < 1 + 1e-3
                    boxes.append((low[:2], high[:2]))
            for number, (low, high) in enumerate(boxes):
                for begin, end in boxes[:number]:
                    assert not ((low < end - 1e-3) & (begin < high - 1e-3)).all(), seed
            hung += len(boxes) - 1
    assert hung > 5


def test_fences_and_houses_stand_clear_of_pavements():
    stood = 0
    for seed in range(3):
        things = arranged("street", seed, pavement=1, houses=0.3, fences=0.7, tall=0, low=0, vehicles=0)
        corners = corners_of(things)
        # The pavement's tops are level, 0.05 to 0.2 m above the ground.
        slabs = [each[..., 0] for each in corners if np.ptp(each[..., 2]) < 1e-9 and 0.05 < each[0, 0, 2] < 0.2]
        left, right = min(each.min() for each in slabs), max(each.max() for each in slabs)
        for thing, each in zip(things.things, corners, strict=True):
            if is_of(thing["model"], "fence", "house"):
                assert each[..., 0].max() < left or each[..., 0].min() > right
                stood += 1
    assert stood > 20


@pytest.mark.parametrize("kind", KINDS)
def test_float32_leaves_no_gap_where_walls_grounds_and_niches_meet(open_renderer, kind):
    sections = ["room.doorway=0.5", "room.niche=0.5", "room.furniture=0", "room.small=0", "models.complex=0"]
    sampler = sampler_of(furnished(KINDS[kind], kind, *sections), 4)
    renderer = open_renderer(sampler.models, noise_layers(1, 64), outputs=())
    for index in range(8):
        frame = renderer.render(sampler.sample(index).scene)
        for eye in EYES:
            assert np.isfinite(frame.view(eye).disparity).all(), (index, eye)
