"""`antialias: edges`: outlines approach 64 samples per pixel, and other pixels do not change."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import SQUARE, facing, one_model, posed

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS
from semisynth_gl.geometry.mesh import make_mesh
from semisynth_gl.geometry.topology import marked_solid
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.outlines import OutlineFinder
from semisynth_gl.scene.scene import make_scene

pytestmark = pytest.mark.one_backend
CAMERA = replace(StereoCamera.centred(160, 120, 200.0, 0.05), fy_over_fx=1.2)
# Each patch has one colour.
FLAT = np.full((4, 16, 16, 4), 255, np.uint8)
FLAT[:, ..., :3] = np.array([[20, 30, 40], [220, 60, 20], [40, 200, 90], [90, 120, 250]])[:, None, None]
WALL = facing(CAMERA, -200, -200, 700, 700, 8.0)
TURN = np.array([[0.8, -0.6, 0], [0.36, 0.48, -0.8], [0.48, 0.64, 0.6]])


def polygon(points, *, depth_m=2.0):
    """Make a flat, convex polygon from its corners in pixels of the left view."""
    centre, focal = (CAMERA.cx_left_px, CAMERA.cy_px), (CAMERA.focal_px, CAMERA.focal_y_px)
    corners = (np.asarray(points, float) - centre) * depth_m / focal
    fan = [(0, k, k + 1) for k in range(1, len(corners) - 1)]
    return make_mesh("polygon", np.c_[corners, np.full(len(corners), depth_m)], corners, fan)


def rod(start, stop, width_px, **depth):
    """Make a strip between two points."""
    start, stop = np.asarray(start, float), np.asarray(stop, float)
    along = (stop - start) / np.linalg.norm(stop - start)
    aside = np.array([-along[1], along[0]]) * width_px / 2
    return polygon([start + aside, stop + aside, stop - aside, start - aside], **depth)


def render(open_renderer, scenes, mode):
    """Render scenes of shapes in front of a wall, each shape with another patch; return both eyes' images."""
    shapes = [shape for own in scenes.values() for shape in own]
    images, first = {}, 1
    renderer = open_renderer([SQUARE, *shapes], FLAT, antialias=mode, outputs=())
    for name, own in scenes.items():
        scene = make_scene(
            CAMERA,
            model=[0, *range(first, first + len(own))],
            world_from_model=[WALL] + [np.eye(4)] * len(own),
            layer=np.arange(len(own) + 1) % len(FLAT),
        )
        frame = renderer.render(scene)
        images[name] = np.stack([frame.view(eye).image for eye in EYES]).astype(float)
        first += len(own)
    return images


def outlines(mesh, poses, *, solid=False):
    """Find the outlines of instances of a mesh for the left eye."""
    scene, count = one_model(CAMERA, poses), len(poses)
    solids, colours = np.full(count, solid), np.ones((count, 4))
    transforms = InstanceTransforms(scene, scene.world_from_model, np.ones(count), solids, colours)
    finder = OutlineFinder([mesh], np.arange(len(mesh.positions), dtype=np.uint32))
    return finder.find(transforms, "left", np.arange(count))


def error(images, reference):
    return float(((images - reference) ** 2).mean())


# Shapes, and the limit of their error relative to the error without antialiasing.
SHAPES = {
    "a triangle": (0.005, [polygon([(20.3, 15.2), (140.8, 40.7), (60.1, 105.4)])]),
    "nearly upright": (0.01, [rod((60.2, -20), (71.9, 150), 30.0)]),
    "slivers": (0.08, [polygon([(10, y), (150, y + 2.3), (150, y + 3.4)]) for y in range(10, 108, 14)]),
    "three in a pixel": (
        0.005,
        [
            polygon([(-10, -10), (75.3, -10), (88.7, 130), (-10, 130)], depth_m=3.0),
            polygon([(-10, -10), (170, -10), (170, 50.2), (-10, 71.6)], depth_m=2.0),
        ],
    ),
    "nine corners in a pixel": (
        0.25,
        [
            polygon([(80, 60), *((80 + 50 * np.cos(end), 60 + 50 * np.sin(end)) for end in (turn, turn + 0.2))])
            for turn in np.arange(0, 6.2, 0.7)
        ],
    ),
}


def test_outlines_come_near_to_many_samples(open_renderer):
    scenes = {name: shapes for name, (_, shapes) in SHAPES.items()}
    none, edges, many = (render(open_renderer, scenes, mode) for mode in ("none", "edges", "ssaa8"))
    for name, (left, _) in SHAPES.items():
        assert error(none[name], many[name]) > 10, name
        assert error(edges[name], many[name]) < left * error(none[name], many[name]), name
        # One of the 8 x 8 samples changes a pixel by 3 levels, so the reference is no more exact than 6 levels.
        assert np.quantile(np.abs(edges[name] - many[name]), 0.98) <= 6, name
    assert len(np.unique(edges["nearly upright"][..., 0])) > 64


def covered(angle, offset_px):
    """Return the share of each pixel below a line through (80, 60 + offset), (H, W)."""
    (across, down), fine = (-np.sin(angle), np.cos(angle)), (np.arange(64) + 0.5) / 64 - 0.5
    columns = np.arange(160)[:, None] + fine
    begin = 60 + offset_px - across * (columns - 80) / down
    rows = np.arange(120)[:, None, None]
    return np.clip(rows + 0.5 - begin, 0, 1).mean(axis=-1)


def test_shares_are_those_of_the_square_of_a_pixel(open_renderer):
    layers = np.zeros((2, 16, 16, 4), np.uint8)
    layers[1] = 255
    angles = [(0.0, 0.3), (0.05, 0.1), (0.3, -0.4), (0.5, 0.2), (np.pi / 4, 0.1), (-0.4, 0.35)]
    lines = [
        polygon(
            [(80 + 300 * np.cos(turn) * way, 60 + offset + 300 * np.sin(turn) * way) for way in (-1, 1)] + [(80, 900)]
        )
        for turn, offset in angles
    ]
    renderer = open_renderer([SQUARE, *lines], layers, antialias="edges", outputs=())
    for number, (turn, offset) in enumerate(angles):
        scene = make_scene(CAMERA, model=[0, 1 + number], world_from_model=[WALL, np.eye(4)], layer=[0, 1])
        shown = renderer.render(scene).left.image[..., 0].astype(float)
        assert np.abs(shown - 255 * covered(turn, offset)).max() < 2.5, (turn, offset)


@pytest.mark.parametrize("mirrored", [False, True])
def test_outlines_of_curved_surfaces_come_near_to_many_samples_too(open_renderer, mirrored):
    placed = posed(0.5 * TURN @ np.diag([-1 if mirrored else 1, 1, 1]), (0, 0, 2.5))
    kinds = {"sphere": 0.22, "torus": 0.06, "cone": 0.11, "cylinder": 0.06}
    models = [SQUARE, *(marked_solid(SIMPLE_KINDS[kind](np.random.default_rng(0))) for kind in kinds)]
    renderers = [open_renderer(models, FLAT, antialias=mode, outputs=()) for mode in ("none", "edges", "ssaa8")]
    for model, (kind, left) in enumerate(kinds.items(), 1):
        scene = make_scene(CAMERA, model=[0, model], world_from_model=[WALL, placed], layer=[0, 1])
        none, edges, many = (renderer.render(scene).left.image.astype(float) for renderer in renderers)
        assert error(edges, many) < left * error(none, many), kind


@pytest.mark.parametrize("large", [False, True])
def test_beyond_an_edge_goes_on_what_the_patch_shows_there(open_renderer, large):
    """Pixels at the edge mix the patch's own colours, not its mean, another patch or the other atlas."""
    left, right = np.array([200, 40, 90]), np.array([10, 120, 250])
    others, patches = np.zeros((2, 64, 64, 4), np.uint8), np.full((2, 64, 64, 4), 250, np.uint8)
    others[1, ..., :3], patches[0, :, :32, :3], patches[0, :, 32:, :3] = (240, 240, 0), left, right
    atlases = (others, patches) if large else (np.concatenate([others, patches]), None)
    renderer = open_renderer([SQUARE], atlases[0], large_layers=atlases[1], antialias="edges", outputs=())
    # The square covers two fifths of column 29 and three fifths of column 93.
    placed = facing(CAMERA, 29.6, 19.6, 64, 64, 2.0)
    image = renderer.render(make_scene(CAMERA, model=[0, 0], world_from_model=[WALL, placed], layer=[0, 2])).left.image
    shares = np.array([0, 0.4, 1, 1, 0.6, 0])[:, None]
    shown = image[40, [28, 29, 30, 92, 93, 94]]
    np.testing.assert_allclose(shown, shares * np.repeat([left, right], 3, axis=0), atol=1.5)


def test_rods_thinner_than_a_pixel_are_whole(open_renderer):
    scenes = {
        (width_px, lean): [
            rod((10.3 + 20 * number, 10.2), (10.3 + 20 * number + 100 * lean, 110.1), width_px) for number in range(4)
        ]
        for width_px in (0.1, 0.2, 0.4, 0.55, 0.7, 0.9)
        for lean in (0.13, 0.37, 1.0)
    }
    none, edges, many = (render(open_renderer, scenes, mode) for mode in ("none", "edges", "ssaa8"))
    wall = FLAT[0, 0, 0, :3]
    for (width_px, lean), reference in many.items():
        shown, true = (np.abs(images[width_px, lean] - wall).sum(axis=-1) for images in (edges, many))
        case = f"{width_px} px, {lean}"
        # The rod has no gap in any row, and its true total brightness; rods below a third of a pixel are too bright.
        assert (shown[:, 12:108].max(axis=-1) > 8).all(), case
        most = 1.2 if width_px > 0.3 else 2.6
        assert 0.9 < shown.sum() / true.sum() < most, case
        if width_px > 0.3:
            assert error(edges[width_px, lean], reference) < 0.05 * error(none[width_px, lean], reference), case


def test_what_the_near_plane_cuts_is_smooth_too(open_renderer):
    floor = make_mesh("floor", [[-1, 0.45, -1], [1, 0.45, -1], [0.2, 0.45, 6]], np.zeros((3, 2)), [[0, 1, 2]])
    none, edges, many = (
        render(open_renderer, {"floor": [floor]}, mode)["floor"] for mode in ("none", "edges", "ssaa8")
    )
    assert error(edges, many) < 0.02 * error(none, many)


def test_outlines_of_many_instances_are_those_of_each(monkeypatch):
    mesh = SIMPLE_KINDS["torus"](np.random.default_rng(0))
    places = np.tile(np.eye(4), (7, 1, 1))
    places[:, :3, 3] = np.random.default_rng(1).uniform([-1, -1, 4], [1, 1, 9], (7, 3))
    together = outlines(mesh, places)
    # Process only a few of the seven instances at once.
    monkeypatch.setattr("semisynth_gl.render.outlines._MOST_AT_ONCE", 3 * len(mesh.triangles))
    np.testing.assert_array_equal(outlines(mesh, places), together)
    # The finder returns far instances first.
    seen = together[np.sort(np.unique(together[:, 0], return_index=True)[1]), 0]
    assert list(seen) == list(np.argsort(-places[:, 2, 3]))


def test_of_a_solid_no_edge_is_outlined_that_its_own_front_hides():
    torus, pose = marked_solid(SIMPLE_KINDS["torus"](np.random.default_rng(0))), posed(0.5 * TURN, (0, 0, 2.5))
    found = outlines(torus, [pose], solid=True)
    assert 50 < len(found) < len(outlines(torus, [pose]))
    # Outlined triangles face the eye, which is at the origin.
    faces = {frozenset(triangle): triangle for triangle in torus.triangles.tolist()}
    points = torus.positions @ pose[:3, :3].T + pose[:3, 3]
    a, b, c = np.moveaxis(points[[faces[frozenset(corners)] for corners in found[:, 1:].tolist()]], 1, 0)
    assert (np.cross(b - a, c - a) * -a).sum(axis=1).min() > 0


def test_outlines_are_alike_where_vertices_are_repeated(open_renderer):
    """For masks, the renderer reorders and repeats vertices, since masks find triangles by their last corner."""
    rng = np.random.default_rng(0)
    models = [build(rng) for build in (SIMPLE_KINDS["torus"], COMPLEX_KINDS["chair"], SIMPLE_KINDS["sphere"])]
    places = np.tile(np.eye(4), (3, 1, 1))
    places[:, :3, 3] = [[-0.7, 0, 3], [0, 0.1, 2.5], [0.7, 0, 3]]
    scene = make_scene(CAMERA, model=range(3), world_from_model=places, layer=[1, 2, 3])
    plain, traced = (
        open_renderer(models, FLAT, antialias="edges", outputs=outputs).render(scene).left.image
        for outputs in ((), ("visibility",))
    )
    assert len(np.unique(plain[..., 0])) > 50
    np.testing.assert_array_equal(plain, traced)
